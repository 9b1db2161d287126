//! Published and hand-written telegrams against the whole brick, in virtual time.

use super::lego::with_length;
use crate::scenario::{BrickProgram, MissingSensor, Personality, PortSensor, Scenario};
use crate::simulation::Simulation;

/// A brick without a camera at the other end of a link without delay.
struct Host {
    simulation: Simulation,
    /// How long an answer is waited for.
    reply_timeout_ms: usize,
    /// Of the EV3's last request.
    counter: u16,
}

/// An NXT on which no program runs.
fn nxt(change: impl FnOnce(&mut Scenario)) -> Host {
    Host::new(Personality::Nxt, 60, change)
}

/// An EV3 on which no program runs.
fn ev3(change: impl FnOnce(&mut Scenario)) -> Host {
    Host::new(Personality::Ev3, 300, change)
}

impl Host {
    fn new(personality: Personality, reply_timeout_ms: usize, change: impl FnOnce(&mut Scenario)) -> Self {
        let mut scenario = Scenario::default().with_personality(personality);
        scenario.camera.is_present = false;
        scenario.brick.program = BrickProgram::None;
        change(&mut scenario);
        Self { simulation: Simulation::new(scenario), reply_timeout_ms, counter: 41 }
    }

    /// What comes within `millis`, and when, in milliseconds from here.
    fn listen(&mut self, millis: usize) -> Vec<(usize, Vec<u8>)> {
        let mut received = Vec::new();
        for at in 1..=millis {
            self.simulation.step();
            received.extend(std::iter::from_fn(|| self.simulation.poll()).map(|bytes| (at, bytes)));
        }
        received
    }

    fn send(&mut self, telegram: &[u8]) -> Vec<(usize, Vec<u8>)> {
        self.simulation.receive(&with_length(telegram));
        self.listen(self.reply_timeout_ms)
    }

    /// A request to which no answer comes.
    fn send_without_reply(&mut self, telegram: &[u8]) {
        assert_eq!(self.send(telegram), [], "{telegram:02x?}");
    }

    /// The one answer to a request, both without their length.
    fn request(&mut self, telegram: &[u8]) -> Vec<u8> {
        let received = self.send(telegram);
        assert_eq!(received.len(), 1, "{telegram:02x?}: {received:02x?}");
        let (length, answer) = received[0].1.split_at(2);
        assert_eq!(length, (answer.len() as u16).to_le_bytes());
        answer.to_vec()
    }

    /// The NXT's block count of a motor, which its programs read as the tacho.
    fn tacho(&mut self, port: u8) -> i32 {
        let state = self.request(&[0x00, 0x06, port]);
        assert_eq!((state.len(), &state[..4]), (25, &[2, 6, 0, port][..]));
        long(&state, 13)
    }

    /// Type and globals of the EV3's answer to byte codes.
    fn run(&mut self, globals: u8, code: &[u8]) -> (u8, Vec<u8>) {
        self.counter += 1;
        let answer = self.request(&[&self.counter.to_le_bytes()[..], &[0, globals, 0], code].concat());
        assert_eq!(answer[..2], self.counter.to_le_bytes());
        (answer[2], answer[3..].to_vec())
    }

    /// The globals after byte codes that the EV3 follows.
    fn globals(&mut self, globals: u8, code: &[u8]) -> Vec<u8> {
        let (kind, memory) = self.run(globals, code);
        assert_eq!((kind, memory.len()), (2, usize::from(globals)), "{code:02x?}");
        memory
    }

    fn count(&mut self, port: u8) -> i32 {
        long(&self.globals(4, &[0xB3, 0, port, 0x60]), 0)
    }
}

fn long(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn real(bytes: &[u8]) -> f32 {
    f32::from_bits(long(bytes, 0) as u32)
}

/// Tick 5100 ms, 1.5 m, -0.5 m, 0.25 rad, sigma 0.0078125 m, flags 3, resets 0, sequence 1.
const ESTIMATE: [u8; 24] =
    [0xEC, 0x13, 0, 0, 0, 0, 0xC0, 0x3F, 0, 0, 0, 0xBF, 0, 0, 0x80, 0x3E, 0, 0, 0, 0x3C, 3, 0, 1, 0];

fn assert_estimate_was_taken(host: &Host) {
    let received = host.simulation.received_estimates();
    assert_eq!(received.len(), 1);
    assert_eq!((received[0].estimate_time.as_micros(), received[0].pose.x.0), (5_100_000, 1.5));
    assert_eq!(host.simulation.truth().last().unwrap().onboard_estimate.x.0, 1.5);
}

#[test]
fn the_nxt_tells_who_it_is() {
    let mut host = nxt(|_| {});
    // Published: 02 00 01 88 and 02 00 01 9b.
    assert_eq!(host.request(&[0x01, 0x88]), [2, 0x88, 0, 124, 1, 31, 1]);
    let info = host.request(&[0x01, 0x9B]);
    assert_eq!((info.len(), &info[..7], &info[18..21]), (33, &b"\x02\x9b\0NXT\0"[..], &[0x00, 0x16, 0x53][..]));
    assert_eq!(host.request(&[&[0x01, 0x98][..], b"rover", &[0; 11]].concat()), [2, 0x98, 0]);
    assert_eq!(host.request(&[0x01, 0x9B])[3..9], *b"rover\0");
    // 8 V, and a hundredth less after a minute.
    let battery = host.request(&[0x00, 0x0B]);
    assert!(
        battery.len() == 5 && (7_990..=8_000).contains(&u16::from_le_bytes([battery[3], battery[4]])),
        "{battery:?}"
    );
    assert_eq!(host.request(&[0x00, 0x0D]), [2, 0x0D, 0, 0xC0, 0x27, 9, 0]);
}

#[test]
fn what_the_nxt_cannot_do_has_a_status_of_its_own() {
    let mut host = nxt(|_| {});
    let cases: &[(&[u8], u8)] = &[
        (&[0x00, 0x77], 0xBE),
        (&[0x01, 0x77], 0xBE),
        (&[0x00, 0x06, 3], 0xC0),
        (&[0x00, 0x07, 4], 0xC0),
        (&[0x00, 0x05, 4, 6, 0], 0xC0),
        (&[0x00, 0x05, 0, 19, 0], 0xC0),
        (&[0x00, 0x04, 3, 50, 1, 0, 0, 0x20, 0, 0, 0, 0], 0xC0),
        (&[0x00, 0x0A, 3, 0], 0xC0),
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
    host.send_without_reply(&[0x80, 0x77]);
    host.send_without_reply(&[0x02, 0x0B, 0]);
}

#[test]
fn an_order_turns_the_nxts_motor_and_all_counters_count() {
    let mut host = nxt(|_| {});
    // Motor B at half power without a limit: 0c 00 80 04 01 32 01 00 00 20 ..
    host.send_without_reply(&[0x80, 0x04, 1, 50, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    host.listen(1_000);
    let turned = host.tacho(1);
    // (4 V - 0.33 V) / 0.487 V s is 7.5 rad/s: 430 degrees in a second, less the run-up.
    assert!((330..480).contains(&turned), "{turned}");
    assert_eq!((host.tacho(2), host.tacho(0)), (0, 0));
    assert_eq!(host.request(&[0x00, 0x0A, 1, 0]), [2, 0x0A, 0]);
    let state = host.request(&[0x00, 0x06, 1]);
    assert_eq!(state[3..13], [1, 50, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    assert!(long(&state, 13) > turned && long(&state, 17) == long(&state, 13) && long(&state, 21) < 60, "{state:?}");
}

#[test]
fn regulated_motors_turn_as_fast_as_their_firmware_says() {
    // Ten degrees per second for each percent on the NXT, ten and a half on the EV3; from answer to answer two seconds.
    let mut nxt = nxt(|_| {});
    nxt.send_without_reply(&[0x80, 0x04, 2, 40, 5, 1, 0, 0x20, 0, 0, 0, 0]);
    nxt.listen(1_000);
    let before = nxt.tacho(2);
    nxt.listen(1_940);
    let turned = nxt.tacho(2) - before;
    assert!((790..=810).contains(&turned), "{turned}");

    let mut ev3 = ev3(|_| {});
    ev3.globals(0, &[0xA5, 0, 6, 0x81, 40, 0xA6, 0, 6]);
    ev3.listen(1_000);
    let before = ev3.count(1);
    ev3.listen(1_700);
    let turned = ev3.count(1) - before;
    assert!((830..=850).contains(&turned), "{turned}");
}

#[test]
fn the_nxts_io_maps_show_what_single_commands_show() {
    let mut host = nxt(|_| {});
    host.send_without_reply(&[0x80, 0x04, 0xFF, 60, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    host.send_without_reply(&[0x80, 0x05, 0, 6, 0]);
    host.listen(500);
    // Published: 0a 00 01 94 01 00 02 00 00 00 60 00.
    let outputs = host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 0x60, 0]);
    assert_eq!((outputs.len(), &outputs[..9]), (105, &[2, 0x94, 0, 1, 0, 2, 0, 0x60, 0][..]));
    assert!(long(&outputs, 9 + 32) > 100, "{outputs:?}");
    assert_eq!((outputs[9 + 32 + 20], outputs[9 + 32 + 25]), (60, 0x20));
    let inputs = host.request(&[0x01, 0x94, 1, 0, 3, 0, 0, 0, 80, 0]);
    let raw = |port: usize| u16::from_le_bytes([inputs[9 + 20 * port + 2], inputs[9 + 20 * port + 3]]);
    assert!((550..660).contains(&raw(0)) && raw(1) == 1_023, "{inputs:?}");
    assert_eq!((inputs[9 + 8], inputs[9 + 16]), (6, 0));
    assert_eq!(host.request(&[0x01, 0x94, 1, 0, 0x0B, 0, 0, 0, 76, 0])[9..], [0; 76]);
    // Tick: 0a 00 01 94 01 00 01 00 14 00 04 00. Answered 33 ms, read 1 ms after it was asked.
    let mut tick = || long(&host.request(&[0x01, 0x94, 1, 0, 1, 0, 20, 0, 4, 0]), 9);
    // 5 s, 0.8 s by the steps above, and 60 ppm of that.
    let first = tick();
    assert_eq!((first, tick() - first), (5_801, 60));
}

#[test]
fn an_old_nxt_takes_and_sends_64_bytes() {
    let mut host = nxt(|scenario| scenario.brick.telegram_bytes = 64);
    assert_eq!(host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 56, 0]), [2, 0x94, 0x91]);
    assert_eq!(host.request(&[0x01, 0x94, 1, 0, 2, 0, 0, 0, 55, 0]).len(), 64);
}

#[test]
fn sensors_on_the_nxts_bus_answer_once_port_and_transaction_are_ready() {
    let mut host = nxt(|scenario| {
        scenario.accelerometer.sigma_m_per_s2 = 0.0;
        scenario.accelerometer.bias_sigma_m_per_s2 = 0.0;
        scenario.brick.sensors[2] = PortSensor::Temperature;
    });
    host.send_without_reply(&[0x80, 0x05, 1, 0x0B, 0]);
    host.send_without_reply(&[0x80, 0x05, 2, 0x0B, 0]);
    // Published: 07 00 00 0f port 02 06 02 42.
    assert_eq!(host.request(&[0x00, 0x0F, 1, 2, 6, 0x02, 0x42]), [2, 0x0F, 0]);
    assert_eq!(host.request(&[0x00, 0x0E, 1]), [2, 0x0E, 0, 6]);
    let answer = host.request(&[0x00, 0x10, 1]);
    assert_eq!((answer.len(), &answer[..10]), (20, &[2, 0x10, 0, 6, 0, 0, 50, 0, 0, 0][..]));
    // A room of 21 degrees.
    host.send_without_reply(&[0x80, 0x0F, 2, 2, 2, 0x98, 0x00]);
    assert_eq!(host.request(&[0x00, 0x10, 2])[..6], [2, 0x10, 0, 2, 21, 0]);
    // A fresh port is not ready, and a running transaction is pending; nothing is ahead of the ultrasonic sensor.
    for (requests, status) in [
        ([&[0x80, 0x05, 3, 0x0B, 0][..], &[0x00, 0x0F, 3, 2, 1, 0x02, 0x42]], 0xE0),
        ([&[0x80, 0x0F, 3, 2, 1, 0x02, 0x42], &[0x00, 0x0E, 3]], 0x20),
    ] {
        host.simulation.receive(&requests.map(with_length).concat());
        assert_eq!(host.listen(60)[0].1, [3, 0, 2, requests[1][1], status]);
    }
    assert_eq!(host.request(&[0x00, 0x10, 3])[..5], [2, 0x10, 0, 1, 255]);
}

#[test]
fn the_nxts_radio_turns_around_and_drops_the_third_answer() {
    for (turn_around_ms, expected) in [(30.0, 32), (10.0, 12), (0.0, 2)] {
        let mut host = nxt(|scenario| scenario.brick.turn_around_ms = Some(turn_around_ms));
        assert_eq!(host.send(&[0, 0x0B])[0].0, expected);
    }
    // One telegram is followed per pass.
    let mut host = nxt(|_| {});
    host.simulation.receive(&with_length(&[0x01, 0x94, 1, 0, 1, 0, 20, 0, 4, 0]).repeat(3));
    let received = host.listen(100);
    assert_eq!(received.len(), 2);
    assert_eq!(long(&received[1].1, 11) - long(&received[0].1, 11), 1);
}

#[test]
fn the_nxt_falls_asleep_after_ten_minutes_without_keep_alive() {
    let mut host = nxt(|_| {});
    host.listen(300_000);
    host.request(&[0x00, 0x0D]);
    host.listen(599_000);
    host.request(&[0x00, 0x0B]);
    // Other commands keep nobody awake.
    host.listen(1_000);
    host.send_without_reply(&[0x00, 0x0B]);
    host.send_without_reply(&[0x00, 0x0D]);
    host.simulation.restart_brick();
    assert_eq!(host.request(&[0x00, 0x0B])[..3], [2, 0x0B, 0]);
}

#[test]
fn a_program_of_the_nxt_zeroes_counters_and_ports_when_it_starts_and_when_it_stops() {
    let mut host = nxt(|_| {});
    host.send_without_reply(&[0x80, 0x04, 0xFF, 80, 1, 0, 0, 0x20, 0, 0, 0, 0]);
    host.send_without_reply(&[0x80, 0x05, 0, 6, 0]);
    host.listen(500);
    assert!(host.tacho(1) > 100);
    assert_eq!(host.request(&[&[0x00, 0x00][..], b"path.rxe", &[0; 12]].concat()), [2, 0, 0]);
    assert_eq!(host.request(&[0x00, 0x11])[..12], *b"\x02\x11\0path.rxe\0");
    // The robot rolls out, stands, and drives two seconds later.
    assert!(host.tacho(1) < 60);
    assert_eq!(host.request(&[0x00, 0x07, 0])[6..8], [0, 0]);
    host.listen(4_000);
    assert!(host.tacho(1) > 200 && host.simulation.progress() > 0.0);
    assert_eq!(host.request(&[0x00, 0x01]), [2, 1, 0]);
    assert!(host.tacho(1) < 30);
    host.listen(500);
    let progress = host.simulation.progress();
    host.listen(1_000);
    assert_eq!(host.simulation.progress(), progress);
}

#[test]
fn the_nxts_program_takes_the_estimate_out_of_its_mailbox() {
    let mut host = nxt(|scenario| scenario.brick.program = BrickProgram::Path);
    host.listen(100);
    host.send_without_reply(&[&[0x80, 0x09, 0, 25][..], &ESTIMATE, &[0]].concat());
    assert_estimate_was_taken(&host);
    // An outbox is read and found empty; a message without its zero is refused.
    assert_eq!(host.request(&[0x00, 0x13, 10, 0, 1]), [2, 0x13, 0x40]);
    assert_eq!(host.request(&[0x00, 0x09, 0, 1, 7]), [2, 0x09, 0xC0]);
    assert_eq!(host.request(&[0x00, 0x09, 20, 1, 0]), [2, 0x09, 0xEE]);
}

#[test]
fn one_telegram_asks_the_ev3_for_clock_encoders_and_gyro() {
    let mut host = ev3(|scenario| {
        scenario.gyro.bias_sigma_deg_per_s = 0.0;
        scenario.brick.clock_skew_ppm = 0.0;
        scenario.brick.turn_around_ms = Some(20.0);
    });
    // Published for ev3-dc's encoder; counter 1, 16 bytes of answer.
    let telegram = [
        0x01, 0x00, 0x00, 0x10, 0x00, 0x8F, 0x60, 0xB3, 0x00, 0x01, 0x64, 0xB3, 0x00, 0x02, 0x68, 0x99, 0x1D, 0x00,
        0x01, 0x81, 0x20, 0x01, 0x01, 0x6C,
    ];
    let received = host.send(&telegram);
    // The gyro changes its mode: 100 ms, then the turn-around.
    assert_eq!((received.len(), received[0].0), (1, 121));
    let answer = &received[0].1;
    assert_eq!(answer[..5], [0x13, 0x00, 0x01, 0x00, 0x02]);
    assert_eq!((long(answer, 5), &answer[9..17]), (5_001_000, &[0; 8][..]));
    assert!(real(&answer[17..]).abs() <= 2.0);
    assert_eq!(host.send(&telegram)[0].0, 21);
}

#[test]
fn the_ev3s_clock_of_microseconds_wraps() {
    let mut host = ev3(|scenario| {
        scenario.brick.clock_start_micros = (1 << 32) - 500_000;
        scenario.brick.clock_tick_micros = 1;
        scenario.brick.clock_skew_ppm = 0.0;
    });
    let readings = [(); 3].map(|()| long(&host.globals(4, &[0x8F, 0x60]), 0));
    assert_eq!(readings, [-499_000, -199_000, 101_000]);
}

#[test]
fn unknown_and_broken_codes_of_the_ev3_are_answered_with_an_error() {
    let mut host = ev3(|_| {});
    for code in [&[0xFF][..], &[0xB3, 0, 1], &[0xB3, 0, 1, 0x64], &[0x81, 0x63, 0x60], &[0xB0, 0, 6, 50, 0, 0, 0]] {
        assert_eq!(host.run(4, code).0, 4, "{code:02x?}");
    }
    // Without a wish for an answer there is none.
    host.send_without_reply(&[9, 0, 0x80, 0, 0, 0xFF]);
}

#[test]
fn the_ev3s_motors_follow_power_and_steps() {
    let mut host = ev3(|_| {});
    // Power 40 on B, start; the counter of C stays.
    host.globals(0, &[0xA4, 0, 2, 0x81, 40, 0xA6, 0, 2]);
    host.listen(700);
    assert!(host.count(1) > 150 && host.count(2) == 0);
    host.globals(0, &[0xA3, 0, 0x0F, 1]);
    host.listen(300);
    host.globals(0, &[0xB2, 0, 2]);
    assert_eq!(host.count(1), 0);
    // 30, 120 and 30 degrees at 30 percent on C, with brake.
    assert_eq!(host.globals(1, &[0xAE, 0, 4, 30, 30, 0x81, 120, 30, 1, 0xA9, 0, 4, 0x60]), [1]);
    host.listen(2_500);
    assert_eq!(host.globals(1, &[0xA9, 0, 4, 0x60]), [0]);
    assert!((175..=190).contains(&host.count(2)), "{}", host.count(2));
    // As a sensor at port 18, in degrees.
    let shown = host.globals(4, &[0x99, 0x1D, 0, 0x12, 0, 0x3F, 1, 0x60]);
    assert_eq!(real(&shown) as i32, host.count(2));
}

#[test]
fn the_ev3s_gyro_turns_clockwise_and_empty_ports_have_no_reading() {
    let mut host = ev3(|scenario| {
        scenario.gyro.bias_sigma_deg_per_s = 0.0;
        scenario.gyro.sigma_deg_per_s = 0.0;
    });
    let both = [0x99, 0x1C, 0, 1, 0x81, 32, 3, 2, 0x60, 0x64];
    host.globals(8, &both);
    // The left wheel ahead: a right turn.
    host.globals(0, &[0xA4, 0, 2, 30, 0xA6, 0, 2]);
    host.listen(500);
    let memory = host.globals(8, &both);
    assert!(long(&memory, 0) > 20 && long(&memory, 4) > 40, "{memory:?}");
    // READSI of an empty port, and of the gyro as something else.
    assert!(real(&host.globals(4, &[0x9D, 0, 0, 0, 0x3F, 0x60])).is_nan());
    assert!(real(&host.globals(4, &[0x9D, 0, 1, 0x81, 30, 0, 0x60])).is_nan());
    let kinds = [0x99, 5, 0, 1, 0x60, 0x61, 0x99, 5, 0, 0, 0x62, 0x63, 0x99, 5, 0, 0x11, 0x64, 0x65];
    assert_eq!(host.globals(6, &kinds), [32, 3, 126, 0, 7, 0]);
}

#[test]
fn commands_of_the_ev3_are_followed_in_their_order_and_a_jump_to_itself_holds_nobody_up() {
    let mut host = ev3(|_| {});
    // The first waits for the gyro's mode, the second for the first.
    host.simulation.receive(&with_length(&[1, 0, 0, 4, 0, 0x99, 0x1D, 0, 1, 0x81, 0x20, 1, 1, 0x60, 0x01]));
    let received = host.send(&[2, 0, 0, 4, 0, 0x8F, 0x60]);
    assert_eq!(received.iter().map(|(_, bytes)| bytes[2]).collect::<Vec<_>>(), [1, 2]);
    host.send_without_reply(&[1, 0, 0, 0, 0, 0x40, 0x3E, 0x01]);
    host.simulation.reopen_link();
    assert_eq!(host.count(0), 0);
}

#[test]
fn the_ev3s_program_takes_the_estimate_out_of_its_mailbox() {
    let mut host = ev3(|scenario| scenario.brick.program = BrickProgram::Path);
    host.listen(100);
    // Published: name with its zero, payload of seven bytes. Nobody has opened that mailbox.
    host.simulation.receive(b"\x12\x00\x01\x00\x81\x9e\x04abc\0\x07\0hello!\0");
    assert_eq!(host.request(&[&b"\x02\0\x01\x9e\x09estimate\0\x18\0"[..], &ESTIMATE].concat()), [2, 0, 3, 0x9E, 0]);
    assert_estimate_was_taken(&host);
    // Another system command is not known.
    assert_eq!(host.request(&[3, 0, 1, 0x99]), [3, 0, 5, 0x99, 0x0A]);
}

#[test]
fn the_ev3_has_a_name_a_volume_and_a_battery() {
    let mut host = ev3(|_| {});
    // COM_SET name, COM_GET name with room for four bytes.
    let name = [0xD4, 8, 0x84, b'r', b'o', b'v', b'e', b'r', 0, 0xD3, 0x0D, 4, 0x60];
    assert_eq!(host.globals(4, &name), *b"rov\0");
    assert_eq!(host.globals(2, &[0x7C, 5, 7, 0x7C, 4, 0x60, 0x7C, 6, 0x61]), [7, 30]);
    let battery = host.globals(5, &[0x81, 1, 0x60, 0x81, 0x12, 0x64]);
    assert!((real(&battery) - 8.0).abs() < 0.01 && battery[4] == 100);
}

#[test]
fn a_set_up_of_a_sensor_that_the_ev3_lacks_may_wait_for_the_next_command() {
    // READY_SI of port 1 as a gyro.
    let set_up = [0x99, 0x1D, 0, 0, 0x81, 0x20, 1, 1, 0x60];
    assert!(real(&ev3(|_| {}).globals(4, &set_up)).is_nan());
    let mut waiting = ev3(|scenario| scenario.brick.missing_sensor = MissingSensor::Awaited);
    waiting.send_without_reply(&[&[7, 0, 0, 4, 0][..], &set_up].concat());
    assert_eq!(waiting.listen(5_000), []);
    assert_eq!(waiting.globals(4, &[0x8F, 0x60]).len(), 4);
}

#[test]
fn a_program_of_the_ev3_that_begins_anew_zeroes_the_counters() {
    let mut host = ev3(|scenario| {
        scenario.brick.program = BrickProgram::Path;
        scenario.brick.program_restart_s = Some(5.0);
    });
    host.listen(4_900);
    let (before, after) = (host.count(1), host.count(1));
    assert!(before > 500 && after < 200, "{before} {after}");
}
