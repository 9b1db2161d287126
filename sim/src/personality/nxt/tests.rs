//! The telegrams of the protocol's documents against the whole brick, in virtual time.

use crate::scenario::{BrickProgram, Personality, PortSensor, Scenario};
use crate::simulation::Simulation;

/// A brick at the other end of a Bluetooth link without delay.
struct Host {
    simulation: Simulation,
}

impl Host {
    fn of(change: impl FnOnce(&mut Scenario)) -> Self {
        let mut scenario = Scenario::default();
        scenario.camera.is_present = false;
        scenario.brick.personality = Personality::Nxt;
        scenario.brick.program = BrickProgram::None;
        change(&mut scenario);
        Self { simulation: Simulation::new(scenario) }
    }

    fn programless() -> Self {
        Self::of(|_| {})
    }

    fn with_program() -> Self {
        Self::of(|scenario| scenario.brick.program = BrickProgram::Path)
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

    /// The one answer to a request, both without their length.
    fn request(&mut self, request: &[u8]) -> Vec<u8> {
        self.simulation.receive(&framed(request));
        let heard = self.listen(60);
        assert_eq!(heard.len(), 1, "{request:02x?} {heard:02x?}");
        let (length, telegram) = heard[0].1.split_at(2);
        assert_eq!(length, (telegram.len() as u16).to_le_bytes());
        telegram.to_vec()
    }

    /// A request to which no answer is wanted.
    fn send(&mut self, request: &[u8]) {
        self.simulation.receive(&framed(request));
        assert_eq!(self.listen(60), []);
    }

    fn tacho(&mut self, port: u8) -> i32 {
        let state = self.request(&[0x00, 0x06, port]);
        assert_eq!((state.len(), &state[..4]), (25, &[2, 6, 0, port][..]));
        i32::from_le_bytes(state[13..17].try_into().unwrap())
    }
}

fn framed(telegram: &[u8]) -> Vec<u8> {
    [&(telegram.len() as u16).to_le_bytes()[..], telegram].concat()
}

#[test]
fn the_brick_tells_who_it_is() {
    let mut host = Host::programless();
    // Published: 02 00 01 88 and 02 00 01 9b.
    assert_eq!(host.request(&[0x01, 0x88]), [2, 0x88, 0, 124, 1, 31, 1]);
    let info = host.request(&[0x01, 0x9B]);
    assert_eq!((info.len(), &info[..7]), (33, b"\x02\x9b\0NXT\0".as_slice()));
    assert_eq!(info[18..21], [0x00, 0x16, 0x53]);
    assert_eq!(host.request(&[&[0x01, 0x98][..], b"rover", &[0; 11]].concat()), [2, 0x98, 0]);
    assert_eq!(host.request(&[0x01, 0x9B])[3..9], *b"rover\0");
    // 8 V, and a hundredth less after a minute.
    let battery = host.request(&[0x00, 0x0B]);
    let millivolts = u16::from_le_bytes([battery[3], battery[4]]);
    assert_eq!(battery.len(), 5);
    assert!((7_990..=8_000).contains(&millivolts), "{millivolts}");
    assert_eq!(host.request(&[0x00, 0x0D]), [2, 0x0D, 0, 0xC0, 0x27, 9, 0]);
}

#[test]
fn what_it_does_not_know_has_a_status_of_its_own() {
    let mut host = Host::programless();
    let cases: &[(&[u8], u8)] = &[
        (&[0x00, 0x77], 0xBE),
        (&[0x01, 0x77], 0xBE),
        (&[0x00, 0x06, 3], 0xC0),
        (&[0x00, 0x07, 4], 0xC0),
        (&[0x00, 0x05, 4, 6, 0], 0xC0),
        (&[0x00, 0x04, 3, 50, 1, 0, 0, 0x20, 0, 0, 0, 0], 0xC0),
        (&[0x00, 0x0E, 4], 0xC0),
        (&[0x00, 0x0E, 1], 0xE0),
        (&[0x00, 0x10, 1], 0xE0),
        (&[0x00, 0x06], 0xBF),
        (&[0x00, 0x09, 0, 2, 1, 0], 0xEC),
        (&[0x00, 0x13, 10, 0, 1], 0xEC),
        (&[0x00, 0x11], 0xEC),
        (&[0x00, 0x01], 0xEC),
        (&[0x00, 0x00, b'x', b'.', b'r', b'x', b'e', 0], 0xBD),
        (&[0x01, 0x94, 9, 0, 9, 0, 0, 0, 4, 0], 0x90),
        (&[0x01, 0x94, 1, 0, 2, 0, 90, 0, 8, 0], 0x91),
        (&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 120, 0], 0x91),
    ];
    for (request, status) in cases {
        assert_eq!(host.request(request), [2, request[1], *status], "{request:02x?}");
    }
    // Without a wish for an answer there is none, and what is no request has none either.
    host.send(&[0x80, 0x77]);
    host.send(&[0x02, 0x0B, 0]);
}

#[test]
fn an_order_turns_a_motor_and_all_counters_count() {
    let mut host = Host::programless();
    // Motor B at half power without a limit: 0c 00 80 04 01 32 01 00 00 20 ..
    host.send(&[0x80, 0x04, 1, 50, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    host.listen(1_000);
    let turned = host.tacho(1);
    // (4 V - 0.33 V) / 0.487 V s is 7.5 rad/s: 430 degrees in a second, less the run-up.
    assert!((330..480).contains(&turned), "{turned}");
    assert_eq!(host.tacho(2), 0);
    assert_eq!(host.tacho(0), 0);
    assert_eq!(host.request(&[0x00, 0x0A, 1, 0]), [2, 0x0A, 0]);
    let state = host.request(&[0x00, 0x06, 1]);
    assert_eq!(state[3..13], [1, 50, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    let long = |at: usize| i32::from_le_bytes(state[at..at + 4].try_into().unwrap());
    assert!(long(13) > turned && long(17) == long(13) && long(21) < 60, "{state:?}");
}

#[test]
fn a_regulated_motor_turns_ten_degrees_per_second_for_each_percent() {
    let mut host = Host::programless();
    host.send(&[0x80, 0x04, 2, 40, 5, 1, 0, 0x20, 0, 0, 0, 0]);
    host.listen(1_000);
    let before = host.tacho(2);
    host.listen(1_940);
    let turned = host.tacho(2) - before;
    assert!((790..=810).contains(&turned), "{turned}");
}

#[test]
fn the_io_maps_show_what_single_commands_show() {
    let mut host = Host::programless();
    host.send(&[0x80, 0x04, 0xFF, 60, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    host.send(&[0x80, 0x05, 0, 6, 0]);
    host.listen(500);
    // Published: 0a 00 01 94 01 00 02 00 00 00 60 00.
    let outputs = host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 0x60, 0]);
    assert_eq!((outputs.len(), &outputs[..9]), (105, &[2, 0x94, 0, 1, 0, 2, 0, 0x60, 0][..]));
    let tacho = i32::from_le_bytes(outputs[9 + 32..][..4].try_into().unwrap());
    assert!(tacho > 100, "{tacho}");
    assert_eq!((outputs[9 + 32 + 20], outputs[9 + 32 + 25]), (60, 0x20));
    let inputs = host.request(&[0x01, 0x94, 1, 0, 3, 0, 0, 0, 80, 0]);
    let raw = |port: usize| u16::from_le_bytes([inputs[9 + 20 * port + 2], inputs[9 + 20 * port + 3]]);
    assert!((550..660).contains(&raw(0)) && raw(1) == 1_023, "{inputs:?}");
    assert_eq!((inputs[9 + 8], inputs[9 + 16]), (6, 0));
    let buses = host.request(&[0x01, 0x94, 1, 0, 0x0B, 0, 0, 0, 76, 0]);
    assert_eq!(buses[9..], [0; 76]);
    // Tick: 0a 00 01 94 01 00 01 00 14 00 04 00. Answered 33 ms, read 1 ms after it was asked.
    let tick = |host: &mut Host| {
        let answer = host.request(&[0x01, 0x94, 1, 0, 1, 0, 20, 0, 4, 0]);
        u32::from_le_bytes(answer[9..13].try_into().unwrap())
    };
    let first = tick(&mut host);
    // 5 s, 1.0 s by the steps above, and 60 ppm of that.
    assert_eq!((first, tick(&mut host) - first), (5_801, 60));
}

#[test]
fn an_old_firmware_takes_and_sends_64_bytes() {
    let mut host = Host::of(|scenario| scenario.brick.telegram_bytes = 64);
    assert_eq!(host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 56, 0]), [2, 0x94, 0x91]);
    assert_eq!(host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 55, 0]).len(), 64);
}

#[test]
fn the_accelerometer_answers_over_the_bus() {
    let mut host = Host::of(|scenario| {
        scenario.accelerometer.sigma_m_per_s2 = 0.0;
        scenario.accelerometer.bias_sigma_m_per_s2 = 0.0;
    });
    host.send(&[0x80, 0x05, 1, 0x0B, 0]);
    // Published: 07 00 00 0f port 02 06 02 42.
    assert_eq!(host.request(&[0x00, 0x0F, 1, 2, 6, 0x02, 0x42]), [2, 0x0F, 0]);
    assert_eq!(host.request(&[0x00, 0x0E, 1]), [2, 0x0E, 0, 6]);
    let answer = host.request(&[0x00, 0x10, 1]);
    assert_eq!((answer.len(), &answer[..10]), (20, &[2, 0x10, 0, 6, 0, 0, 50, 0, 0, 0][..]));
}

#[test]
fn a_fresh_bus_is_not_ready_and_a_running_transaction_is_pending() {
    let mut host = Host::programless();
    let requests = [framed(&[0x80, 0x05, 3, 0x0B, 0]), framed(&[0x00, 0x0F, 3, 2, 1, 0x02, 0x42])];
    host.simulation.receive(&requests.concat());
    assert_eq!(host.listen(60)[0].1, [3, 0, 2, 0x0F, 0xE0]);
    let requests = [framed(&[0x80, 0x0F, 3, 2, 1, 0x02, 0x42]), framed(&[0x00, 0x0E, 3])];
    host.simulation.receive(&requests.concat());
    assert_eq!(host.listen(60)[0].1, [3, 0, 2, 0x0E, 0x20]);
    // Nothing ahead.
    assert_eq!(host.request(&[0x00, 0x10, 3])[..5], [2, 0x10, 0, 1, 255]);
}

#[test]
fn an_answer_takes_the_radio_as_long_as_it_needs_to_turn_around() {
    for (turn_around_ms, expected) in [(30.0, 32), (10.0, 12), (0.0, 2)] {
        let mut host = Host::of(|scenario| scenario.brick.turn_around_ms = Some(turn_around_ms));
        host.simulation.receive(&[2, 0, 0, 0x0B]);
        assert_eq!(host.listen(60)[0].0, expected);
    }
}

#[test]
fn one_telegram_is_followed_per_pass_and_the_third_answer_is_dropped() {
    let mut host = Host::programless();
    let ticks = framed(&[0x01, 0x94, 1, 0, 1, 0, 20, 0, 4, 0]).repeat(3);
    host.simulation.receive(&ticks);
    let heard = host.listen(100);
    let tick = |bytes: &[u8]| u32::from_le_bytes(bytes[11..15].try_into().unwrap());
    assert_eq!(heard.len(), 2);
    assert_eq!(tick(&heard[1].1) - tick(&heard[0].1), 1);
    assert!(heard.iter().all(|(_, bytes)| bytes.len() == 15));
}

#[test]
fn it_falls_asleep_after_ten_minutes_without_keep_alive() {
    let mut host = Host::programless();
    host.listen(300_000);
    host.request(&[0x00, 0x0D]);
    host.listen(599_000);
    host.request(&[0x00, 0x0B]);
    // Other commands keep nobody awake.
    host.listen(1_000);
    host.send(&[0x00, 0x0B]);
    host.send(&[0x00, 0x0D]);
    host.simulation.restart_brick();
    assert_eq!(host.request(&[0x00, 0x0B])[..3], [2, 0x0B, 0]);
}

#[test]
fn a_program_zeroes_counters_and_ports_when_it_starts_and_when_it_stops() {
    let mut host = Host::programless();
    host.send(&[0x80, 0x04, 0xFF, 80, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    host.send(&[0x80, 0x05, 0, 6, 0]);
    host.listen(500);
    assert!(host.tacho(1) > 100);
    let start = [&[0x00, 0x00][..], b"path.rxe", &[0; 12]].concat();
    assert_eq!(host.request(&start), [2, 0, 0]);
    assert_eq!(host.request(&[0x00, 0x11])[..12], *b"\x02\x11\0path.rxe\0");
    // The robot rolls out, stands, and drives two seconds later.
    assert!(host.tacho(1) < 60);
    assert_eq!(host.request(&[0x00, 0x07, 0])[6..8], [0, 0]);
    host.listen(4_000);
    assert!(host.tacho(1) > 200 && host.simulation.progress() > 0.0);
    assert_eq!(host.request(&[0x00, 0x01]), [2, 1, 0]);
    assert!(host.tacho(1) < 30);
    host.listen(500);
    let place = host.simulation.progress();
    host.listen(1_000);
    assert_eq!(host.simulation.progress(), place);
}

#[test]
fn the_program_takes_the_estimate_out_of_its_mailbox() {
    let mut host = Host::with_program();
    host.listen(100);
    // Tick 5100 ms, 1.5 m, -0.5 m, 0.25 rad, flags 3.
    let mut estimate = vec![0x80, 0x09, 0, 25, 0xEC, 0x13, 0, 0, 0, 0, 0xC0, 0x3F, 0, 0, 0, 0xBF];
    estimate.extend([0, 0, 0x80, 0x3E, 0, 0, 0, 0x3C, 3, 0, 1, 0, 0]);
    host.send(&estimate);
    let received = host.simulation.received_estimates();
    assert_eq!(received.len(), 1);
    assert_eq!(received[0].estimate_time.as_micros(), 5_100_000);
    assert_eq!(received[0].pose.x.0, 1.5);
    assert_eq!(host.simulation.truth().last().unwrap().onboard_estimate.x.0, 1.5);
    // An outbox is read and found empty; a message without its zero is refused.
    assert_eq!(host.request(&[0x00, 0x13, 10, 0, 1]), [2, 0x13, 0x40]);
    assert_eq!(host.request(&[0x00, 0x09, 0, 1, 7]), [2, 0x09, 0xC0]);
    assert_eq!(host.request(&[0x00, 0x09, 20, 1, 0]), [2, 0x09, 0xEE]);
}

#[test]
fn the_thermometer_of_the_scenario_can_be_plugged_in() {
    let mut host = Host::of(|scenario| scenario.brick.sensors[3] = PortSensor::Temperature);
    host.send(&[0x80, 0x05, 3, 0x0B, 0]);
    host.send(&[0x80, 0x0F, 3, 2, 2, 0x98, 0x00]);
    // A room of 21 degrees.
    assert_eq!(host.request(&[0x00, 0x10, 3])[..6], [2, 0x10, 0, 2, 21, 0]);
}

#[test]
fn the_same_requests_give_the_same_bytes() {
    let talk = || {
        let mut host = Host::with_program();
        let mut heard = Vec::new();
        for _ in 0..50 {
            heard.push(host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 0x60, 0]));
            heard.push(host.request(&[0x01, 0x94, 1, 0, 3, 0, 0, 0, 80, 0]));
        }
        heard
    };
    assert_eq!(talk(), talk());
}
