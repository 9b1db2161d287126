use posebridge_telemetry::{EncoderTicks, TimeDelta};

use super::*;
use crate::dialect::Encoder;
use crate::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use crate::message::{Heartbeat, Message, WheelTicks, WireStamp};

const ROBOT: Address = Address::new(1, 1);

#[test]
fn a_gap_is_counted_across_the_wrap() {
    let mut tracker = SequenceTracker::new();
    assert_eq!(tracker.record_number(ROBOT, 254), 0, "first frame");
    assert_eq!(tracker.record_number(ROBOT, 255), 0, "next frame");
    assert_eq!(tracker.record_number(ROBOT, 2), 2, "0 and 1 are missing");
}

#[test]
fn duplicates_and_absurd_gaps_are_no_losses_and_late_frames_are_taken_off() {
    let mut tracker = SequenceTracker::new();
    tracker.record_number(ROBOT, 10);
    assert_eq!(tracker.record_number(ROBOT, 10), 0, "duplicate");
    assert_eq!(tracker.record_number(ROBOT, 8), 0, "older frame");
    assert_eq!(tracker.record_number(ROBOT, 138), 127, "largest gap");
    assert_eq!(tracker.record_number(ROBOT, 11), 0, "gap of 128");
    assert_eq!(lost(&tracker), 126, "11 came late");
    assert_eq!(tracker.record_number(ROBOT, 11), 0, "and again");
    assert_eq!(lost(&tracker), 126);
    assert_eq!(tracker.record_number(ROBOT, 139), 0, "nothing new is missing");
}

#[test]
fn a_sender_without_stamps_that_begins_anew_is_followed_from_its_second_frame() {
    let mut tracker = SequenceTracker::new();
    tracker.record_number(ROBOT, 100);
    assert_eq!(tracker.record_number(ROBOT, 0), 0);
    assert_eq!(tracker.record_number(ROBOT, 1), 0);
    assert_eq!(tracker.record_number(ROBOT, 5), 3);
}

#[test]
fn without_stamps_what_was_sent_while_the_link_was_away_is_no_loss() {
    let mut tracker = SequenceTracker::new();
    tracker.record_number(ROBOT, 10);
    tracker.record_number(ROBOT, 12);
    tracker.handle_link_loss();
    assert_eq!(tracker.record_number(ROBOT, 90), 0);
    assert_eq!(lost(&tracker), 1);
}

#[test]
fn every_component_counts_for_itself() {
    let mut tracker = SequenceTracker::new();
    tracker.record_number(ROBOT, 5);
    assert_eq!(tracker.record_number(Address::new(1, 197), 90), 0);
    assert_eq!(tracker.record_number(ROBOT, 7), 1);
}

#[test]
fn silences_of_any_number_of_turns_are_counted_to_the_frame() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    for silent_ms in [100, 2_900, 3_000, 6_000, 12_000, 20_000] {
        robot.lose(silent_ms);
        robot.talk(3_000);
        assert_eq!(lost(&robot.tracker), robot.lost, "after {silent_ms} ms");
    }
}

#[test]
fn a_stall_that_delivers_everything_at_once_is_no_loss() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    // Ten seconds arrive in one instant, and a moment of them is missing.
    robot.arrival = Some(Timestamp::from_millis(15_000));
    robot.talk(4_000);
    robot.lose(100);
    robot.talk(5_900);
    robot.arrival = None;
    robot.talk(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
    assert_eq!(robot.lost, 4);
}

#[test]
fn a_sender_with_stamps_is_followed_while_the_link_is_away() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    robot.tracker.handle_link_loss();
    robot.lose(9_000);
    robot.talk(1_000);
    assert!(robot.lost > 256, "{}", robot.lost);
    assert_eq!(lost(&robot.tracker), robot.lost);
}

#[test]
fn a_brick_that_was_switched_off_and_on_has_lost_nothing() {
    for up_ms in [5_000, 20_000] {
        let mut robot = Robot::new();
        robot.talk(up_ms);
        robot.lose(100);
        robot.talk(1_000);
        robot.restart(5_000);
        robot.talk(5_000);
        assert_eq!(lost(&robot.tracker), robot.lost);
        robot.lose(8_000);
        robot.talk(1_000);
        assert_eq!(lost(&robot.tracker), robot.lost, "and is counted again");
    }
}

#[test]
fn a_register_that_wraps_changes_nothing() {
    let mut robot = Robot::new();
    robot.clock_ms = (1 << 32) / 1_000 - 4_000;
    robot.talk(3_500);
    robot.lose(9_000);
    robot.talk(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
}

#[test]
fn late_frames_and_copies_of_a_sender_with_stamps_count_once() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    for step_ms in 1..=12 {
        // Two frames change their places, across the border of an interval and within, and one of them comes twice.
        robot.talk(73 * step_ms);
        let (first, second) = (robot.ticks(), robot.heartbeat());
        robot.receive(&second);
        robot.receive(&first);
        robot.receive(&first);
        let (first, second) = (robot.heartbeat(), robot.ticks());
        robot.receive(&second);
        robot.receive(&second);
        robot.receive(&first);
    }
    robot.talk(500);
    assert_eq!(lost(&robot.tracker), 0);
}

#[test]
fn a_datagram_that_a_stall_s_whole_burst_overtakes_is_late_and_no_restart() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    let held_back = [robot.ticks(), robot.heartbeat()];
    let sent_ms = robot.now_ms;
    robot.talk(7_000);
    robot.lose(200);
    assert_eq!(lost(&robot.tracker), 2, "those that are held back");
    robot.arrival = Some(Timestamp::ZERO + TimeDelta::from_millis(robot.now_ms));
    for frame in held_back {
        robot.receive_at(&(sent_ms, frame));
    }
    robot.arrival = None;
    robot.talk(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
}

#[test]
fn what_was_held_back_before_a_silence_of_more_than_a_turn_is_late_too() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    let held_back = [robot.ticks(), robot.heartbeat()];
    let sent_ms = robot.now_ms;
    robot.lose(9_000);
    robot.talk(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost + 2);
    for frame in held_back {
        robot.receive_at(&(sent_ms, frame));
    }
    assert_eq!(lost(&robot.tracker), robot.lost);
    robot.talk(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
}

#[test]
fn a_late_frame_is_taken_off_before_the_next_stamp_comes() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    let held_back = robot.heartbeat();
    let sent_ms = robot.now_ms;
    robot.talk(1_000);
    assert_eq!(lost(&robot.tracker), 1);
    robot.receive_at(&(sent_ms, held_back));
    assert_eq!(lost(&robot.tracker), 0);
}

#[test]
fn after_the_stamps_have_ceased_the_numbers_have_to_do() {
    let mut robot = Robot::new();
    robot.talk(5_000);
    for count in 0..300 {
        let frame = robot.heartbeat();
        if count % 10 != 0 {
            robot.receive(&frame);
        }
    }
    assert_eq!(lost(&robot.tracker), 30);
}

#[test]
fn a_sender_that_gives_every_frame_the_same_number_loses_nothing() {
    let mut robot = Robot::new();
    for _ in 0..200 {
        robot.encoder = Encoder::new(WireVersion::V2);
        robot.talk(25);
    }
    robot.now_ms += 10_000;
    robot.clock_ms += 10_000;
    robot.encoder = Encoder::new(WireVersion::V2);
    robot.talk(25);
    assert_eq!(lost(&robot.tracker), 0);
}

#[test]
fn news_add_up_to_what_is_missing() {
    let mut robot = Robot::new();
    for silent_ms in [300, 4_000, 7_000] {
        robot.talk(3_000);
        robot.lose(silent_ms);
    }
    robot.talk(500);
    assert_eq!(robot.news, lost(&robot.tracker));
    assert_eq!(robot.news, robot.lost);
}

fn lost(tracker: &SequenceTracker) -> u64 {
    tracker.source_health().map(|source| source.lost).sum()
}

/// A robot that sends wheel ticks every 25 ms and a heartbeat every second, and its receiver.
struct Robot {
    tracker: SequenceTracker,
    encoder: Encoder,
    clock_ms: i64,
    now_ms: i64,
    /// When everything arrives; `None` at once.
    arrival: Option<Timestamp<HostClock>>,
    lost: u64,
    news: u64,
}

impl Robot {
    fn new() -> Self {
        Self {
            tracker: SequenceTracker::new(),
            encoder: Encoder::new(WireVersion::V2),
            clock_ms: 777,
            now_ms: 0,
            arrival: None,
            lost: 0,
            news: 0,
        }
    }

    fn talk(&mut self, span_ms: i64) {
        for frame in self.frames(span_ms) {
            self.receive_at(&frame);
        }
    }

    fn lose(&mut self, span_ms: i64) {
        self.lost += self.frames(span_ms).len() as u64;
    }

    fn restart(&mut self, off_ms: i64) {
        self.encoder = Encoder::new(WireVersion::V2);
        self.clock_ms = 0;
        self.now_ms += off_ms;
    }

    /// What is sent in a span, with the instant of each.
    fn frames(&mut self, span_ms: i64) -> Vec<(i64, Vec<u8>)> {
        let mut frames = Vec::new();
        for _ in 0..span_ms {
            self.clock_ms += 1;
            self.now_ms += 1;
            if self.now_ms % 1_000 == 0 {
                frames.push((self.now_ms, self.heartbeat()));
            }
            if self.now_ms % 25 == 0 {
                frames.push((self.now_ms, self.ticks()));
            }
        }
        frames
    }

    fn ticks(&mut self) -> Vec<u8> {
        self.encoded(&Message::WheelTicks(WheelTicks {
            stamp: WireStamp::Micros32((self.clock_ms * 1_000) as u32),
            left: EncoderTicks(7),
            right: EncoderTicks(9),
        }))
    }

    fn heartbeat(&mut self) -> Vec<u8> {
        self.encoded(&Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 }))
    }

    fn encoded(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(ROBOT, message, &mut bytes);
        bytes
    }

    fn receive(&mut self, frame: &[u8]) {
        self.receive_at(&(self.now_ms, frame.to_vec()));
    }

    fn receive_at(&mut self, (sent_ms, frame): &(i64, Vec<u8>)) {
        let arrival = self.arrival.unwrap_or_else(|| Timestamp::ZERO + TimeDelta::from_millis(*sent_ms));
        let (tracker, news) = (&mut self.tracker, &mut self.news);
        Framer::new(FramerConfig::default()).push(arrival, frame, &mut |scanned| {
            if let FramerOutput::Frame(frame) = scanned {
                *news += u64::from(tracker.record(&frame, arrival));
            }
        });
    }
}
