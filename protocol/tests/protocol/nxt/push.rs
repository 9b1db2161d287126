//! A program on the brick that sends MAVLink frames of itself, each behind its length.

use posebridge_protocol::bricks::nxt::NxtSettings;
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks};

use super::bench::Bench;
use super::brick::SimulatedNxt;
use super::session::SECOND;
use crate::support::{RecordedEvent, golden_frames};

/// PB_WHEEL_TICKS of system 1, component 1, behind its length.
fn prefixed() -> Vec<u8> {
    let frame = &golden_frames()["pb_wheel_ticks"];
    [&[frame.len() as u8, 0x00], &frame[..]].concat()
}

fn ticks() -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(0xFFFF_FFFA),
        left: EncoderTicks(-123_456),
        right: EncoderTicks(2_147_483_647),
    })
}

fn bench() -> Bench {
    Bench::of("nxt-push", NxtSettings::default(), SimulatedNxt::new())
}

fn pushed(bench: &Bench) -> usize {
    bench.messages().filter(|message| **message == ticks()).count()
}

#[test]
fn a_programs_frames_are_received_in_chunks_of_every_size_among_replies() {
    for chunk in 1..=60 {
        let mut bench = bench();
        bench.begin();
        bench.chunk = chunk;
        for step in 1..=100 {
            bench.run_to(step * 20_000);
            for part in [prefixed(), prefixed()].concat().chunks(chunk) {
                bench.push(part);
            }
        }
        assert_eq!(pushed(&bench), 200, "chunks of {chunk}");
        assert_eq!(bench.codec.source_health()[0].source, Address::new(1, 1));
        // The clock is requested all the while: three times at connect, then once a second.
        assert_eq!(bench.clock_replies().len(), 4, "chunks of {chunk}");
    }
}

#[test]
fn a_damaged_frame_costs_itself_and_the_next_come() {
    for at in 0..prefixed().len() {
        let mut bench = bench();
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
fn a_damaged_byte_costs_a_frame_or_two_of_a_program_that_never_rests() {
    const FRAMES: i64 = 150;
    for at in 0..prefixed().len() {
        for chunk in [1, 7, usize::MAX] {
            let mut bench = bench();
            bench.begin();
            for step in 1..=FRAMES {
                bench.run_to(step * 20_000);
                let mut frame = prefixed();
                if step == 50 {
                    frame.remove(at);
                }
                for part in frame.chunks(chunk.min(frame.len())) {
                    bench.push(part);
                }
            }
            let lost = FRAMES as usize - pushed(&bench);
            assert!((1..=2).contains(&lost), "without byte {at}, chunks of {chunk}: {lost} lost");
            // The clock is requested again: replies to the barrier and to a tick.
            let damaged_at = 50 * 20_000;
            let is_time = |(when, item): &(i64, RecordedEvent)| {
                *when > damaged_at + 100_000 && matches!(item, RecordedEvent::ClockReply { .. })
            };
            assert!(bench.events.iter().any(is_time), "without byte {at}");
        }
    }
}

#[test]
fn frames_of_a_polled_brick_are_reported_and_it_is_not_called_silent() {
    for is_answering in [true, false] {
        let mut bench = Bench::new(NxtSettings::default(), SimulatedNxt::new());
        bench.is_cut = !is_answering;
        bench.begin();
        for step in 1..=500 {
            bench.run_to(step * 20_000);
            // One byte is lost on the way.
            bench.push(&prefixed()[usize::from(step == 100)..]);
        }
        let notes = bench.notes();
        let warnings = notes.iter().filter(|text| text.contains("--brick nxt-push"));
        assert_eq!(warnings.count(), 1, "{notes:?}");
        assert!(!notes.iter().any(|text| text.contains("not answered")), "{notes:?}");
        assert_eq!(pushed(&bench), 0);
        // 30 ms for each request, and the one byte costs a request or two.
        if is_answering {
            assert!(bench.wheels().len() > 250, "{}", bench.wheels().len());
            assert!(bench.lost() <= 1, "{}", bench.lost());
        }
    }
}

#[test]
fn a_program_that_writes_something_else_costs_no_request() {
    for period_millis in [12, 83, 250] {
        let mut bench = Bench::new(NxtSettings::default(), SimulatedNxt::new());
        bench.begin();
        let mut step = 0;
        while bench.now_micros < 10 * SECOND {
            step += 1;
            bench.run_to(step * period_millis * 1_000);
            bench.push(b"\x06\x00hello\x00");
        }
        assert_eq!(bench.lost(), 0, "each {period_millis} ms");
        assert!(bench.wheels().len() > 280, "{}", bench.wheels().len());
        let notes = bench.notes();
        let warnings = notes.iter().filter(|text| text.contains("messages of its own"));
        assert_eq!(warnings.count(), 1, "{notes:?}");
    }
}

#[test]
fn sensors_are_the_programs_business() {
    let mut bench = bench();
    bench.begin();
    bench.run_to(10 * SECOND);
    let codes: Vec<u8> = bench.brick.requests.iter().map(|request| request[1]).collect();
    assert!(codes.iter().all(|code| [0x88, 0x94, 0x0B, 0x0D].contains(code)), "{codes:02x?}");
    assert!((12..=16).contains(&codes.len()), "{}", codes.len());
}

#[test]
fn a_program_that_answers_no_commands_is_left_alone_and_lives_by_its_frames() {
    let mut bench = bench();
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
    // It is still waited for: two seconds without a frame are reported.
    assert_eq!(deadlines, 50);
    bench.run_to(13 * SECOND);
    assert_eq!(bench.notes().len(), 2);
    assert_eq!(bench.codec.deadline(), None);
    // A new connection is a new chance.
    bench.is_cut = false;
    bench.begin();
    bench.run_to(14 * SECOND);
    assert!(!bench.clock_replies().is_empty());
}

#[test]
fn a_program_that_comes_after_one_that_answers_no_commands_is_polled_again() {
    let mut bench = bench();
    bench.is_cut = true;
    bench.begin();
    bench.run_to(10 * SECOND);
    assert_eq!(bench.codec.deadline(), None);
    bench.is_cut = false;
    bench.push(&prefixed());
    bench.run_to(11 * SECOND);
    assert!(!bench.clock_replies().is_empty(), "{:?}", bench.notes());
}

#[test]
fn noise_is_not_taken_for_a_program_that_answers_no_commands() {
    let mut bench = bench();
    bench.begin();
    for step in 1..=20 {
        // Wrong from the first byte, before the barrier's reply at 30 ms; then the link is quiet for longer than a drain.
        bench.run_to(step * 120_000 - 100_000);
        bench.push(&[0xFF, 0xFF]);
    }
    bench.run_to(20 * 120_000 + SECOND);
    assert!(!bench.clock_replies().is_empty(), "{:?}", bench.notes());
}
