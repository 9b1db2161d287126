//! Published and hand-written telegrams against the whole brick, in virtual time.

use crate::scenario::{BrickProgram, MissingSensor, Personality, Scenario};
use crate::simulation::Simulation;

/// A brick at the other end of a link without delay.
struct Host {
    simulation: Simulation,
    counter: u16,
}

impl Host {
    fn of(change: impl FnOnce(&mut Scenario)) -> Self {
        let mut scenario = Scenario::default();
        scenario.camera.is_present = false;
        scenario.brick.personality = Personality::Ev3;
        scenario.brick.program = BrickProgram::None;
        change(&mut scenario);
        Self { simulation: Simulation::new(scenario), counter: 41 }
    }

    fn programless() -> Self {
        Self::of(|_| {})
    }

    /// What comes within `millis`, and when, in milliseconds from here.
    fn listen(&mut self, millis: usize) -> Vec<(usize, Vec<u8>)> {
        let mut heard = Vec::new();
        for at in 1..=millis {
            self.simulation.step();
            heard.extend(std::iter::from_fn(|| self.simulation.poll()).map(|bytes| (at, bytes)));
        }
        heard
    }

    /// Sends byte codes and returns when the answer came, its type, and the globals.
    fn request(&mut self, globals: u8, code: &[u8]) -> (usize, u8, Vec<u8>) {
        self.counter += 1;
        let body = [&self.counter.to_le_bytes()[..], &[0, globals, 0], code].concat();
        self.simulation.receive(&[&(body.len() as u16).to_le_bytes()[..], &body].concat());
        let heard = self.listen(300);
        assert_eq!(heard.len(), 1, "{code:02x?}: {heard:02x?}");
        let (at, bytes) = &heard[0];
        let length = (bytes.len() - 2) as u16;
        assert_eq!(bytes[..2], length.to_le_bytes());
        assert_eq!(bytes[2..4], self.counter.to_le_bytes());
        (*at, bytes[4], bytes[5..].to_vec())
    }

    fn value(&mut self, globals: u8, code: &[u8]) -> Vec<u8> {
        let (_, kind, memory) = self.request(globals, code);
        assert_eq!((kind, memory.len()), (2, usize::from(globals)), "{code:02x?}");
        memory
    }

    fn count(&mut self, port: u8) -> i32 {
        let memory = self.value(4, &[0xB3, 0, port, 0x60]);
        i32::from_le_bytes(memory.try_into().unwrap())
    }
}

fn real(bytes: &[u8]) -> f32 {
    f32::from_le_bytes(bytes.try_into().unwrap())
}

#[test]
fn one_telegram_asks_for_clock_encoders_and_gyro() {
    let mut host = Host::of(|scenario| {
        scenario.gyro.bias_sigma_deg_per_s = 0.0;
        scenario.brick.clock_skew_ppm = 0.0;
        scenario.brick.turn_around_ms = Some(20.0);
    });
    // Published for ev3-dc's encoder; counter 1, 16 bytes of answer.
    let telegram = [
        0x18, 0x00, 0x01, 0x00, 0x00, 0x10, 0x00, 0x8F, 0x60, 0xB3, 0x00, 0x01, 0x64, 0xB3, 0x00, 0x02, 0x68, 0x99,
        0x1D, 0x00, 0x01, 0x81, 0x20, 0x01, 0x01, 0x6C,
    ];
    host.simulation.receive(&telegram);
    let heard = host.listen(200);
    // The gyro changes its mode: 100 ms, then the turn-around.
    assert_eq!((heard.len(), heard[0].0), (1, 121));
    let answer = &heard[0].1;
    assert_eq!(answer[..5], [0x13, 0x00, 0x01, 0x00, 0x02]);
    assert_eq!(answer[5..9], 5_001_000_u32.to_le_bytes());
    assert_eq!(answer[9..17], [0; 8]);
    assert!(real(&answer[17..21]).abs() <= 2.0);
    host.simulation.receive(&telegram);
    assert_eq!(host.listen(200)[0].0, 21);
}

#[test]
fn the_clock_of_microseconds_wraps() {
    let mut host = Host::of(|scenario| {
        scenario.brick.clock_start_micros = (1 << 32) - 500_000;
        scenario.brick.clock_tick_micros = 1;
        scenario.brick.clock_skew_ppm = 0.0;
    });
    let mut read = || u32::from_le_bytes(host.value(4, &[0x8F, 0x60]).try_into().unwrap());
    assert_eq!(read(), u32::MAX - 498_999);
    assert_eq!(read(), u32::MAX - 198_999);
    assert_eq!(read(), 101_000);
}

#[test]
fn unknown_and_broken_codes_are_answered_with_an_error() {
    let mut host = Host::programless();
    for code in [&[0xFF][..], &[0xB3, 0, 1], &[0xB3, 0, 1, 0x64], &[0x81, 0x63, 0x60], &[0xB0, 0, 6, 50, 0, 0, 0]] {
        assert_eq!(host.request(4, code).1, 4, "{code:02x?}");
    }
    // Without a wish for an answer there is none.
    host.simulation.receive(&[6, 0, 9, 0, 0x80, 0, 0, 0xFF]);
    assert_eq!(host.listen(100), []);
}

#[test]
fn motors_follow_power_speed_and_steps() {
    let mut host = Host::programless();
    // Power 40 on B, start; the counter of C stays.
    host.value(0, &[0xA4, 0, 2, 0x81, 40, 0xA6, 0, 2]);
    host.listen(700);
    assert!(host.count(1) > 150 && host.count(2) == 0);
    host.value(0, &[0xA3, 0, 0x0F, 1]);
    host.listen(300);
    host.value(0, &[0xB2, 0, 2]);
    assert_eq!(host.count(1), 0);
    // 30, 120 and 30 degrees at 30 percent on C, with brake.
    let steps = [0xAE, 0, 4, 30, 30, 0x81, 120, 30, 1];
    assert_eq!(host.value(1, &[&steps[..], &[0xA9, 0, 4, 0x60]].concat()), [1]);
    host.listen(2_500);
    assert_eq!(host.value(1, &[0xA9, 0, 4, 0x60]), [0]);
    assert!((175..=190).contains(&host.count(2)), "{}", host.count(2));
    // As a sensor at port 18, in degrees.
    let shown = host.value(4, &[0x99, 0x1D, 0, 0x12, 0, 0x3F, 1, 0x60]);
    assert_eq!(real(&shown) as i32, host.count(2));
}

#[test]
fn regulated_speed_is_10_and_a_half_degrees_per_second_for_each_percent() {
    let mut host = Host::programless();
    host.value(0, &[0xA5, 0, 6, 0x81, 40, 0xA6, 0, 6]);
    host.listen(1_000);
    let before = host.count(1);
    host.listen(1_700);
    // Two seconds from reading to reading.
    let turned = host.count(1) - before;
    assert!((830..=850).contains(&turned), "{turned}");
}

#[test]
fn the_gyro_turns_clockwise_and_empty_ports_have_nothing_to_say() {
    let mut host = Host::of(|scenario| {
        scenario.gyro.bias_sigma_deg_per_s = 0.0;
        scenario.gyro.sigma_deg_per_s = 0.0;
    });
    let both = [0x99, 0x1C, 0, 1, 0x81, 32, 3, 2, 0x60, 0x64];
    host.value(8, &both);
    // The left wheel ahead: a right turn.
    host.value(0, &[0xA4, 0, 2, 30, 0xA6, 0, 2]);
    host.listen(500);
    let memory = host.value(8, &both);
    let long = |at: usize| i32::from_le_bytes(memory[at..at + 4].try_into().unwrap());
    assert!(long(0) > 20 && long(4) > 40, "{memory:?}");
    // READSI of an empty port, and of the gyro as something else.
    assert!(real(&host.value(4, &[0x9D, 0, 0, 0, 0x3F, 0x60])).is_nan());
    assert!(real(&host.value(4, &[0x9D, 0, 1, 0x81, 30, 0, 0x60])).is_nan());
    let kinds = [0x99, 5, 0, 1, 0x60, 0x61, 0x99, 5, 0, 0, 0x62, 0x63, 0x99, 5, 0, 0x11, 0x64, 0x65];
    assert_eq!(host.value(6, &kinds), [32, 3, 126, 0, 7, 0]);
}

#[test]
fn commands_that_wait_are_followed_in_their_order() {
    let mut host = Host::programless();
    // The first waits for the gyro's mode, the second for the first.
    host.simulation.receive(&[0x0F, 0, 1, 0, 0, 4, 0, 0x99, 0x1D, 0, 1, 0x81, 0x20, 1, 1, 0x60, 0x01]);
    host.simulation.receive(&[7, 0, 2, 0, 0, 4, 0, 0x8F, 0x60]);
    let heard = host.listen(300);
    let counters: Vec<u8> = heard.iter().map(|(_, bytes)| bytes[2]).collect();
    assert_eq!(counters, [1, 2]);
}

#[test]
fn a_jump_to_itself_holds_nobody_up() {
    let mut host = Host::programless();
    host.simulation.receive(&[8, 0, 1, 0, 0, 0, 0, 0x40, 0x3E, 0x01]);
    assert_eq!(host.listen(50), []);
    host.simulation.reopen_link();
    assert_eq!(host.count(0), 0);
}

#[test]
fn the_program_takes_the_estimate_out_of_its_mailbox() {
    let mut host = Host::of(|scenario| scenario.brick.program = BrickProgram::Path);
    host.listen(100);
    // Published: name with its zero, payload of seven bytes.
    let published = b"\x12\x00\x01\x00\x81\x9e\x04abc\0\x07\0hello!\0";
    host.simulation.receive(published);
    let mut estimate = b"\x25\0\x02\0\x01\x9e\x09estimate\0\x18\0".to_vec();
    // Tick 5100 ms, 1.5 m, -0.5 m, 0.25 rad, flags 3.
    estimate.extend([0xEC, 0x13, 0, 0, 0, 0, 0xC0, 0x3F, 0, 0, 0, 0xBF]);
    estimate.extend([0, 0, 0x80, 0x3E, 0, 0, 0, 0x3C, 3, 0, 1, 0]);
    estimate[0] = (estimate.len() - 2) as u8;
    host.simulation.receive(&estimate);
    let heard = host.listen(100);
    assert_eq!(heard[0].1, [5, 0, 2, 0, 3, 0x9E, 0]);
    let received = host.simulation.received_estimates();
    assert_eq!(received.len(), 1);
    assert_eq!(received[0].estimate_time.as_micros(), 5_100_000);
    assert_eq!(host.simulation.truth().last().unwrap().onboard_estimate.x.0, 1.5);
    // Another system command is not known.
    host.simulation.receive(&[4, 0, 3, 0, 1, 0x99]);
    assert_eq!(host.listen(100)[0].1, [5, 0, 3, 0, 5, 0x99, 0x0A]);
}

#[test]
fn names_volume_and_battery() {
    let mut host = Host::programless();
    // COM_SET name, COM_GET name with room for four bytes.
    let name = [0xD4, 8, 0x84, b'r', b'o', b'v', b'e', b'r', 0, 0xD3, 0x0D, 4, 0x60];
    assert_eq!(host.value(4, &name), *b"rov\0");
    assert_eq!(host.value(2, &[0x7C, 5, 7, 0x7C, 4, 0x60, 0x7C, 6, 0x61]), [7, 30]);
    let battery = host.value(5, &[0x81, 1, 0x60, 0x81, 0x12, 0x64]);
    assert!((real(&battery[..4]) - 8.0).abs() < 0.01 && battery[4] == 100);
}

#[test]
fn a_set_up_of_a_sensor_that_is_not_there_may_wait_for_the_next_command() {
    // READY_SI of port 1 as a gyro.
    let set_up = [0x99, 0x1D, 0, 0, 0x81, 0x20, 1, 1, 0x60];
    let mut answering = Host::programless();
    assert!(real(&answering.value(4, &set_up)).is_nan());
    let mut waiting = Host::of(|scenario| scenario.brick.missing_sensor = MissingSensor::Awaited);
    let telegram = [&[14, 0, 7, 0, 0, 4, 0][..], &set_up].concat();
    waiting.simulation.receive(&telegram);
    assert_eq!(waiting.listen(5_000), []);
    // The clock is told as ever.
    assert_eq!(waiting.value(4, &[0x8F, 0x60]).len(), 4);
}

#[test]
fn a_program_that_begins_anew_zeroes_the_counters() {
    let mut host = Host::of(|scenario| {
        scenario.brick.program = BrickProgram::Path;
        scenario.brick.program_restart_s = Some(5.0);
    });
    host.listen(4_900);
    let before = host.count(1);
    let after = host.count(1);
    assert!(before > 500 && after < 200, "{before} {after}");
}
