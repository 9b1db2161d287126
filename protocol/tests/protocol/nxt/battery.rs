//! GETBATTERYLEVEL: LEGO's Bluetooth developer kit, appendix 2; nxt-python 3.5.1 sends `00 0b` and reads 7900 from `02 0b 00 dc 1e`.

use posebridge_protocol::bricks::nxt::{MaxOutstanding, NxtSettings};
use posebridge_protocol::message::{Battery, Message};
use posebridge_telemetry::ReceiveError;

use super::bench::Bench;
use super::brick::{BatteryAnswer, IoMapLimit, SimulatedNxt};
use super::session::{SECOND, assert_true, moving_brick};
use crate::support::{RecordedEvent, from_hex};

const REQUEST: [u8; 2] = [0x00, 0x0B];

fn asked(bench: &Bench) -> usize {
    bench.brick.requests.iter().filter(|telegram| **telegram == REQUEST).count()
}

/// When a voltage was told, whole seconds, and what it was.
fn told(bench: &Bench) -> Vec<(i64, Battery)> {
    let batteries = bench.events.iter().filter_map(|(at, item)| match item {
        RecordedEvent::Message(Message::BatteryStatus(battery)) => Some((at / SECOND, *battery)),
        _ => None,
    });
    batteries.collect()
}

fn volts(voltage_v: f64) -> Battery {
    Battery { voltage_v: Some(voltage_v), ..Battery::default() }
}

#[test]
fn the_answer_of_the_developer_kit_is_read_in_chunks_of_every_size() {
    for chunk in 1..=7 {
        let mut bench = Bench::new(NxtSettings::default(), moving_brick());
        bench.chunk = chunk;
        bench.damage = Box::new(|_, reply| if reply[3] == 0x0B { from_hex("0500 020b00 dc1e") } else { reply });
        bench.begin();
        bench.run_to(3 * SECOND);
        assert_eq!(told(&bench), [(2, volts(7.9))], "chunks of {chunk}");
    }
}

#[test]
fn it_is_asked_after_two_seconds_and_then_every_ten_by_every_way_of_asking() {
    for maps in [IoMapLimit::UpTo(119), IoMapLimit::UpTo(55), IoMapLimit::Unknown] {
        for outstanding in [MaxOutstanding::One, MaxOutstanding::Two] {
            let settings = NxtSettings { outstanding, ..NxtSettings::default() };
            let brick = SimulatedNxt { io_map_limit: maps, ..moving_brick() };
            let bench = Bench::run(settings, brick, 25 * SECOND);
            assert_eq!(told(&bench), [2, 12, 22].map(|at| (at, volts(7.9))), "{maps:?} {outstanding:?}");
            assert_eq!((asked(&bench), bench.lost()), (3, 0));
            assert_true(&bench);
        }
    }
    let mut pushed = Bench::of("nxt-push", NxtSettings::default(), SimulatedNxt::new());
    pushed.begin();
    pushed.run_to(25 * SECOND);
    assert_eq!(told(&pushed), [2, 12, 22].map(|at| (at, volts(7.9))));
}

#[test]
fn a_brick_that_does_not_tell_is_asked_twice_and_loses_nothing_else() {
    for (protocol, answer, lost) in [
        ("nxt", BatteryAnswer::Unknown, 0),
        ("nxt", BatteryAnswer::Silence, 2),
        ("nxt-push", BatteryAnswer::Unknown, 0),
        ("nxt-push", BatteryAnswer::Silence, 2),
    ] {
        let brick = SimulatedNxt { battery: answer, ..moving_brick() };
        let mut bench = Bench::of(protocol, NxtSettings::default(), brick);
        bench.begin();
        bench.run_to(60 * SECOND);
        assert_eq!((asked(&bench), bench.lost(), told(&bench)), (2, lost, vec![]), "{protocol} {answer:?}");
        let notes = bench.notes();
        assert_eq!(notes, ["LEGO NXT with firmware 1.31", "this NXT does not report the voltage of its battery"]);
        assert_true(&bench);
        if protocol == "nxt" {
            // Each silence costs its time-out of half a second and the barrier behind it: 18 of 32 states.
            let states = bench.wheels().len();
            let least = 60 * 30 - 20 * lost as usize;
            assert!(states > least, "{answer:?}: {states} states");
        } else {
            assert!(bench.clock_replies().len() >= 60, "{}", bench.clock_replies().len());
        }
        // The next connection asks again.
        bench.begin();
        bench.run_to(63 * SECOND);
        assert_eq!(asked(&bench), 3);
    }
}

#[test]
fn a_voltage_that_no_brick_runs_on_is_damage() {
    let brick = SimulatedNxt { battery: BatteryAnswer::Millivolts(40_668), ..moving_brick() };
    let bench = Bench::run(NxtSettings::default(), brick, 3 * SECOND);
    assert_eq!(told(&bench), []);
    let error = RecordedEvent::Error(ReceiveError::Payload { message_id: 0x0B });
    assert_eq!(bench.events.iter().filter(|(_, item)| *item == error).count(), 1);
}
