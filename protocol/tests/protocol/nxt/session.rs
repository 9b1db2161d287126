//! From connect to disconnect: detection, reports and recovery.

use posebridge_protocol::bricks::nxt::{
    AccelerometerMounting, ForwardAxis, MaxOutstanding, MotorMounting, MotorPort, NxtSensor, NxtSettings, WheelMotor,
};
use posebridge_protocol::message::{Message, PoseFlags};
use posebridge_telemetry::{Heading, Meters, Pose, Timestamp};

use super::bench::{Bench, request_and_reply_ms};
use super::brick::{IoMapLimit, SimulatedNxt};
use crate::support::{HEARTBEAT, RecordedEvent, STATION, estimate};

pub(crate) const SECOND: i64 = 1_000_000;

/// Left forwards, right backwards, half a degree and a quarter per millisecond.
pub(crate) fn drive(at_micros: i64) -> [i32; 3] {
    [0, (at_micros / 2_000) as i32, -(at_micros / 4_000) as i32]
}

pub(crate) fn moving_brick() -> SimulatedNxt {
    SimulatedNxt { drive, ..SimulatedNxt::new() }
}

/// Each count was the motor's between request and reply.
pub(crate) fn assert_true(bench: &Bench) {
    for message in bench.messages() {
        let Message::WheelTicks(ticks) = message else {
            continue;
        };
        let (sent, answered) = request_and_reply_ms(ticks.stamp);
        let (left, right) = (ticks.left.0, ticks.right.0);
        let least = (sent / 2.0 - 1.0, answered / 2.0 + 1.0);
        assert!((least.0..=least.1).contains(&(left as f64)), "{ticks:?}");
        let least = (-answered / 4.0 - 1.0, -sent / 4.0 + 1.0);
        assert!((least.0..=least.1).contains(&(right as f64)), "{ticks:?}");
    }
}

fn every_sensor() -> [NxtSensor; 4] {
    [NxtSensor::HtGyro, NxtSensor::HtCompass, NxtSensor::Ultrasonic, NxtSensor::Temperature]
}

pub(crate) fn equipped_brick() -> SimulatedNxt {
    let mut brick = moving_brick();
    brick.ports[0].raw = 610;
    for port in &mut brick.ports {
        port.is_plugged = true;
    }
    brick.ports[1].registers = [0x2D, 0x00, 0, 0, 0, 0];
    brick.ports[2].registers = [0x96, 0, 0, 0, 0, 0];
    brick.ports[3].registers = [0x17, 0x80, 0, 0, 0, 0];
    brick
}

pub(crate) fn equipped() -> NxtSettings {
    NxtSettings {
        sensors: every_sensor(),
        gyro_rest_counts: Some(600.0),
        compass_zero_deg: 90.0,
        ..NxtSettings::default()
    }
}

fn pose(micros: u32) -> Message {
    let pose = Pose::new(Meters(1.5), Meters(0.0), Heading::from_rad(0.0));
    Message::PlanarPose(estimate(micros, pose, [1e-4; 6], PoseFlags::default()))
}

fn encode(bench: &mut Bench, micros: u32) -> usize {
    let mut bytes = Vec::new();
    let now = bench.now();
    let length = bench.codec.encode(now, STATION, &pose(micros), &mut bytes);
    assert_eq!(length, bytes.len());
    bench.brick.push_bytes(bench.now_micros, &bytes);
    length
}

/// All four sensors and the wheels are reported, and rightly.
fn assert_all_senses(bench: &Bench) {
    let (mut gyro, mut compass, mut range, mut warmth) = (0, 0, 0, 0);
    for message in bench.messages() {
        match message {
            Message::Inertial(inertial) => {
                gyro += 1;
                let rate = inertial.turn_rate.expect("a rate").0;
                assert!((rate.to_degrees() - 10.0).abs() < 1e-9);
            }
            Message::Compass { heading, .. } => {
                compass += 1;
                assert!(heading.rad().abs() < 1e-9, "{heading:?}");
            }
            Message::DistanceSensor { range: found, .. } => {
                range += 1;
                assert_eq!(*found, Meters(1.5));
            }
            Message::Thermometer { channel, temperature, .. } => {
                warmth += 1;
                assert_eq!((channel.as_str(), temperature.0), ("temp4", 23.5));
            }
            _ => {}
        }
    }
    println!("in 5 s: gyro {gyro}, compass {compass}, range {range}, temperature {warmth}");
    assert!(gyro > 12 && compass > 12 && range > 12, "{gyro} {compass} {range}");
    assert!((3..=6).contains(&warmth), "{warmth}");
    assert!(bench.wheels().len() > 12);
}

#[test]
fn every_sensor_is_read_with_any_limit_of_the_io_map() {
    for (maps, note) in [
        (IoMapLimit::UpTo(119), None),
        (IoMapLimit::UpTo(55), Some("only in pieces")),
        (IoMapLimit::UpTo(4), Some("no IO maps")),
        (IoMapLimit::Unknown, Some("no IO maps")),
    ] {
        let mut brick = equipped_brick();
        brick.io_map_limit = maps;
        let bench = Bench::run(equipped(), brick, 5 * SECOND);
        print!("{maps:?} ");
        assert_all_senses(&bench);
        assert_true(&bench);
        assert_eq!(bench.lost(), 0, "{maps:?}");
        let notes = bench.notes();
        match note {
            Some(note) => assert!(notes.iter().any(|text| text.contains(note)), "{notes:?}"),
            None => assert!(!notes.iter().any(|text| text.contains("maps")), "{notes:?}"),
        }
        assert_eq!(bench.brick.ports[2].prepared, [0x02, 0x41, 0x02]);
        assert_eq!(bench.brick.ports[3].prepared, [0x98, 0x01, 0x60]);
    }
}

#[test]
fn the_clock_is_requested_three_times_and_then_about_every_twentieth() {
    let bench = Bench::run(NxtSettings::default(), moving_brick(), 10 * SECOND);
    let times = bench.clock_replies();
    for (sent, peer) in &times {
        // The double reads its clock in the middle of the turn-around, and shows whole milliseconds.
        let read_micros = sent + 15_000_000 + 5_000_000_000;
        assert!((read_micros - 1_000_000..=read_micros).contains(peer), "{sent} {peer}");
    }
    assert_eq!(times[1].0 - times[0].0, 30_000_000);
    let request_count = bench.brick.requests.len();
    assert!((request_count / 20..=request_count / 16).contains(&times.len()), "{} of {request_count}", times.len());
}

#[test]
fn a_brick_without_a_clock_lives_by_the_stations() {
    let brick = SimulatedNxt { io_map_limit: IoMapLimit::Unknown, ..moving_brick() };
    let bench = Bench::run(NxtSettings::default(), brick, 2 * SECOND);
    let mut times = 0;
    for (at, item) in &bench.events {
        if let RecordedEvent::ClockReply { sent, peer_nanos } = item {
            times += 1;
            assert_eq!(*peer_nanos, i64::midpoint(sent.as_nanos(), at * 1_000));
        }
    }
    assert!(times >= 3, "{times}");
    assert!(bench.notes().iter().any(|text| text.contains("clock")));
    assert!(bench.wheels().len() > 15);
}

#[test]
fn motors_may_sit_at_any_ports_in_either_direction() {
    for maps in [IoMapLimit::UpTo(119), IoMapLimit::UpTo(55), IoMapLimit::Unknown] {
        let settings = NxtSettings {
            left_motor: WheelMotor { port: MotorPort::C, mounting: MotorMounting::Backward },
            right_motor: WheelMotor { port: MotorPort::A, mounting: MotorMounting::Forward },
            ..NxtSettings::default()
        };
        let brick = SimulatedNxt {
            io_map_limit: maps,
            drive: |at| [(at / 10_000) as i32, 7, -(at / 5_000) as i32],
            ..SimulatedNxt::new()
        };
        let bench = Bench::run(settings, brick, 3 * SECOND);
        let (left, right) = *bench.wheels().last().unwrap();
        assert!((580..=600).contains(&left), "{maps:?} {left}");
        assert!((290..=300).contains(&right), "{maps:?} {right}");
    }
}

#[test]
fn two_accelerometers_are_one_message() {
    let accelerometer = |place| NxtSensor::HtAccelerometer { forward: ForwardAxis::X, place };
    let mut brick = SimulatedNxt::new();
    for (port, high) in [(0, 0x32), (1, 0xCE)] {
        brick.ports[port].is_plugged = true;
        brick.ports[port].registers = [high, 0, 0, 0, 0, 0];
    }
    let sensors = [
        accelerometer(AccelerometerMounting::Left),
        accelerometer(AccelerometerMounting::Right),
        NxtSensor::None,
        NxtSensor::None,
    ];
    let bench = Bench::run(NxtSettings { sensors, ..NxtSettings::default() }, brick, 3 * SECOND);
    let found: Vec<_> = bench
        .messages()
        .filter_map(|message| match message {
            Message::Inertial(inertial) => inertial.wheel_accelerations,
            _ => None,
        })
        .collect();
    assert!(found.len() > 15, "{}", found.len());
    for (left, right) in found {
        assert!((left.0 - 9.80665).abs() < 1e-9 && (right.0 + 9.80665).abs() < 1e-9);
    }
}

#[test]
fn the_start_of_a_program_is_no_motion_and_ports_are_set_up_again() {
    let mut bench = Bench::run(equipped(), equipped_brick(), 3 * SECOND);
    bench.brick.restart_program(3 * SECOND);
    let before = bench.brick.requests.len();
    bench.run_to(6 * SECOND);
    let wheels = bench.wheels();
    for pair in wheels.windows(2) {
        let (step, turn) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
        assert!((0..=150).contains(&step) && (-80..=0).contains(&turn), "{pair:?}");
    }
    // What the wheels turned in the one interval in which the counters fell is partly gone: less than two rounds' worth.
    let (left, _) = *wheels.last().unwrap();
    assert!((2_840..=3_000).contains(&left), "{left}");
    // Once because the ports have no sensor any more, once because the counters fell.
    let mut set_up = [0; 4];
    for request in &bench.brick.requests[before..] {
        if request[1] == 0x05 {
            set_up[usize::from(request[2])] += 1;
        }
    }
    assert!(set_up.iter().all(|times| (1..=2).contains(times)), "{set_up:?}");
    let reports = bench.notes().iter().filter(|text| text.contains("began anew")).count();
    assert_eq!(reports, 1);
    assert_eq!(bench.lost(), 0);
}

#[test]
fn a_brick_that_was_switched_off_and_on_is_noticed_by_its_clock() {
    let mut bench = Bench::run(NxtSettings::default(), moving_brick(), 5 * SECOND);
    bench.is_cut = true;
    bench.run_to(12 * SECOND);
    bench.is_cut = false;
    bench.brick.restart(11 * SECOND);
    let before = *bench.wheels().last().unwrap();
    bench.begin();
    bench.run_to(12 * SECOND + 300_000);
    assert!(bench.notes().contains(&"the NXT was switched off and on"));
    // Its motors have turned for a second and a bit since: 500 to 650 counts, and none of the fall.
    let after = *bench.wheels().last().unwrap();
    assert!((500..=650).contains(&(after.0 - before.0)), "{before:?} {after:?}");
}

#[test]
fn a_silent_brick_is_reported_once_and_its_heartbeat_stops() {
    let mut bench = Bench::run(NxtSettings::default(), moving_brick(), 4 * SECOND);
    bench.is_cut = true;
    bench.run_to(20 * SECOND);
    let beats = bench.messages().filter(|message| matches!(message, Message::Heartbeat(_))).count();
    assert_eq!(beats, 4);
    bench.is_cut = false;
    bench.run_to(22 * SECOND);
    let notes = bench.notes();
    for line in ["not answered for two seconds", "answers again"] {
        let count = notes.iter().filter(|text| text.contains(line)).count();
        assert_eq!(count, 1, "{notes:?}");
    }
    // One data request was pending; the requests in the silence were barriers.
    assert_eq!(bench.lost(), 1);
    assert_true(&bench);
}

#[test]
fn a_brick_that_never_answers_is_polled_forever_and_never_twice_at_once() {
    let mut bench = Bench::new(NxtSettings::default(), SimulatedNxt::new());
    bench.is_cut = true;
    bench.begin();
    bench.run_to(60 * SECOND);
    assert!(bench.messages().next().is_none());
    assert_eq!(bench.notes().len(), 1);
    bench.is_cut = false;
    bench.run_to(62 * SECOND);
    assert!(bench.wheels().len() > 20);
}

#[test]
fn answers_that_come_too_late_are_counted_and_never_used() {
    let mut bench = Bench::new(NxtSettings::default(), moving_brick());
    bench.begin();
    for stall in 1..=20 {
        let start = stall * 2 * SECOND;
        bench.run_to(start);
        bench.brick.stall(start + 700_000 + 13_000 * stall);
    }
    bench.run_to(44 * SECOND);
    assert_true(&bench);
    assert_eq!(bench.lost(), 20);
    assert!(bench.notes().iter().any(|text| text.contains("came later than 500 ms")));
    // 27 states a second, but for the 20 stalls of 700 to 970 ms.
    assert!(bench.wheels().len() > 700, "{}", bench.wheels().len());
}

#[test]
fn a_stall_within_the_time_out_costs_nothing() {
    let mut bench = Bench::run(NxtSettings::default(), moving_brick(), 2 * SECOND);
    bench.brick.stall(2 * SECOND + 450_000);
    bench.run_to(4 * SECOND);
    assert_eq!(bench.lost(), 0);
    assert_true(&bench);
}

#[test]
fn two_outstanding_are_used_only_where_both_are_answered() {
    let mut rates = Vec::new();
    for (outstanding, most_replies) in [(MaxOutstanding::One, 2), (MaxOutstanding::Two, 2), (MaxOutstanding::Two, 1)] {
        let mut brick = equipped_brick();
        brick.most_replies = most_replies;
        let settings = NxtSettings { outstanding, ..equipped() };
        let bench = Bench::run(settings, brick, 10 * SECOND);
        assert_true(&bench);
        let is_refused = bench.notes().iter().any(|text| text.contains("one by one"));
        assert_eq!(is_refused, most_replies == 1);
        assert_eq!(bench.lost(), u32::from(most_replies == 1));
        rates.push(bench.wheels().len());
    }
    println!("states in 10 s with one, two, refused two outstanding: {rates:?}");
    assert!(rates[1] >= rates[0], "{rates:?}");
    assert!(rates[2] + 10 >= rates[0], "{rates:?}");
}

#[test]
fn the_estimate_goes_to_a_program_and_nowhere_without_one() {
    let mut bench = Bench::run(NxtSettings::default(), moving_brick(), SECOND);
    assert_eq!(encode(&mut bench, 6_000_000), 0);
    bench.run_to(2 * SECOND);
    assert_eq!(encode(&mut bench, 7_000_000), 0);
    let is_reported = bench.notes().contains(&"the NXT takes no estimate: no program runs on the brick");
    assert!(is_reported, "{:?}", bench.notes());

    bench.brick.has_program = true;
    bench.run_to(6 * SECOND + 100_000);
    assert_eq!(encode(&mut bench, 11_000_000), 0);
    bench.run_to(7 * SECOND);
    assert_eq!(encode(&mut bench, 12_003_999), 31);
    let [(probe, _), (inbox, message)] = &bench.brick.mailbox[..] else {
        panic!("{:?}", bench.brick.mailbox);
    };
    assert_eq!((*probe, *inbox, message.len()), (0, 0, 25));
    // 12 003 ms; x = 1.5 m; the third estimate that was made up.
    assert_eq!(message[..8], [0xE3, 0x2E, 0, 0, 0, 0, 0xC0, 0x3F]);
    assert_eq!(message[22..], [2, 0, 0]);
    let now = bench.now();
    assert_eq!(bench.codec.encode(now, STATION, &HEARTBEAT, &mut Vec::new()), 0);
}

#[test]
fn the_brick_is_kept_awake_once_a_minute() {
    let bench = Bench::run(NxtSettings::default(), moving_brick(), 181 * SECOND);
    assert_eq!(bench.brick.keep_alives, 4);
}

#[test]
fn nothing_is_requested_before_the_link_is_up() {
    let mut bench = Bench::new(NxtSettings::default(), SimulatedNxt::new());
    bench.push(&[0x07, 0x00, 0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01]);
    assert_eq!(bench.codec.deadline(), None);
    assert_eq!(bench.codec.poll(), None);
    bench.codec.tick(Timestamp::from_millis(5), &mut |_| {});
    assert_eq!(bench.codec.poll(), None);
}
