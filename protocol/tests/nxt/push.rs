//! A program on the brick that sends MAVLink frames of itself, each behind its length.

use posebridge_protocol::bricks::nxt::{NxtFraming, NxtSettings};
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks};

use crate::bench::{Bench, Noted};
use crate::brick::Brick;

/// PB_WHEEL_TICKS of system 1, component 1, as pymavlink encodes it (`pb_wheel_ticks` of protocol/tests/data/golden.json).
const FRAME: [u8; 25] = [
    0xFD, 0x0D, 0x00, 0x00, 0x07, 0x01, 0x01, 0x74, 0xA4, 0x00, 0xFA, 0xFF, 0xFF, 0xFF, 0xC0, 0x1D,
    0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F, 0x03, 0xF9, 0x7F,
];
const SECOND: i64 = 1_000_000;

fn prefixed() -> Vec<u8> {
    [&[FRAME.len() as u8, 0x00][..], &FRAME].concat()
}

fn ticks() -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(0xFFFF_FFFA),
        left: EncoderTicks(-123_456),
        right: EncoderTicks(2_147_483_647),
    })
}

fn bench(framing: NxtFraming) -> Bench {
    let settings = NxtSettings {
        framing,
        ..NxtSettings::default()
    };
    Bench::of("nxt-push", settings, Brick::new())
}

fn pushed(bench: &Bench) -> usize {
    bench
        .messages()
        .filter(|message| **message == ticks())
        .count()
}

#[test]
fn a_programs_frames_are_heard_in_chunks_of_every_size_among_answers() {
    for chunk in 1..=60 {
        let mut bench = bench(NxtFraming::Prefixed);
        bench.begin();
        bench.chunk = chunk;
        for step in 1..=100 {
            bench.run_to(step * 20_000);
            for part in [prefixed(), prefixed()].concat().chunks(chunk) {
                bench.push(part);
            }
        }
        assert_eq!(pushed(&bench), 200, "chunks of {chunk}");
        assert_eq!(bench.codec.sources()[0].source, Address::new(1, 1));
        // The clock is asked all the while: three times at connect, then once a second.
        let times = bench
            .heard
            .iter()
            .filter(|(_, item)| matches!(item, Noted::Time(..)))
            .count();
        assert_eq!(times, 4, "chunks of {chunk}");
    }
}

#[test]
fn a_damaged_frame_costs_itself_and_the_next_come() {
    for at in 0..prefixed().len() {
        let mut bench = bench(NxtFraming::Prefixed);
        bench.begin();
        bench.run_to(SECOND);
        let mut damaged = prefixed();
        damaged.remove(at);
        bench.push(&damaged);
        bench.run_to(SECOND + 200_000);
        assert_eq!(pushed(&bench), 0, "without byte {at}");
        bench.push(&prefixed());
        assert_eq!(pushed(&bench), 1, "without byte {at}");
    }
}

#[test]
fn a_bare_datagram_is_a_frame() {
    let mut bench = bench(NxtFraming::Bare);
    bench.push(&FRAME);
    assert_eq!(pushed(&bench), 1);
}

#[test]
fn sensors_are_the_programs_business() {
    let mut bench = bench(NxtFraming::Prefixed);
    bench.begin();
    bench.run_to(10 * SECOND);
    let asked: Vec<u8> = bench
        .brick
        .requests
        .iter()
        .map(|request| request[1])
        .collect();
    assert!(
        asked.iter().all(|code| [0x88, 0x94, 0x0D].contains(code)),
        "{asked:02x?}"
    );
    assert!((12..=16).contains(&asked.len()), "{}", asked.len());
}

#[test]
fn a_program_that_answers_no_commands_is_left_alone_and_lives_by_its_frames() {
    let mut bench = bench(NxtFraming::Prefixed);
    bench.is_cut = true;
    bench.begin();
    let mut deadlines = 0;
    for step in 1..=100 {
        bench.run_to(step * SECOND / 10);
        bench.push(&prefixed());
        deadlines += usize::from(step > 50 && bench.codec.deadline().is_some());
    }
    assert_eq!(pushed(&bench), 100);
    let notes = bench.notes();
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert!(notes[0].contains("answers no commands"), "{notes:?}");
    // It is still waited for: two seconds without a frame are told.
    assert_eq!(deadlines, 50);
    bench.run_to(13 * SECOND);
    assert_eq!(bench.notes().len(), 2);
    assert_eq!(bench.codec.deadline(), None);
    // A new connection is a new chance.
    bench.is_cut = false;
    bench.begin();
    bench.run_to(14 * SECOND);
    assert!(
        bench
            .heard
            .iter()
            .any(|(_, item)| matches!(item, Noted::Time(..)))
    );
}
