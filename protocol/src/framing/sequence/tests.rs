use posebridge_telemetry::{EncoderTicks, TimeDelta};

use super::*;
use crate::dialect::Encoder;
use crate::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use crate::message::{Heartbeat, Message, WheelTicks, WireStamp};

const ROBOT: Address = Address::new(1, 1);

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

#[derive(Clone, Copy)]
enum Step {
    Transmit(i64),
    Lose(i64),
    LoseLink,
    Restart(i64),
}

#[test]
fn losses_of_a_sender_with_stamps_are_counted_to_the_frame() {
    use Step::{Lose, LoseLink, Restart, Transmit};
    let before_wrap_ms = (1 << 32) / 1_000 - 4_000;
    let silences: Vec<Step> = [100, 2_900, 3_000, 6_000, 12_000, 20_000]
        .into_iter()
        .flat_map(|silent| [Lose(silent), Transmit(3_000)])
        .collect();
    let restart = [Lose(100), Transmit(1_000), Restart(5_000), Transmit(5_000), Lose(8_000), Transmit(1_000)];
    for (case, clock_ms, first_ms, steps) in [
        ("silences of any number of turns", 777, 5_000, &silences[..]),
        ("the link is away", 777, 5_000, &[LoseLink, Lose(9_000), Transmit(1_000)]),
        ("switched off and on after 5 s", 777, 5_000, &restart),
        ("switched off and on after 20 s", 777, 20_000, &restart),
        ("a register that wraps", before_wrap_ms, 3_500, &[Lose(9_000), Transmit(1_000)]),
    ] {
        let mut robot = Robot::new();
        robot.clock_ms = clock_ms;
        robot.transmit(first_ms);
        for step in steps {
            match *step {
                Transmit(duration_ms) => {
                    robot.transmit(duration_ms);
                    assert_eq!(lost(&robot.tracker), robot.lost, "{case}");
                }
                Lose(duration_ms) => robot.lose(duration_ms),
                LoseLink => robot.tracker.handle_link_loss(),
                Restart(off_ms) => robot.restart(off_ms),
            }
        }
        assert!(robot.lost > 256 || case.starts_with("switched"), "{case}: {}", robot.lost);
    }
}

#[test]
fn a_stall_that_delivers_everything_at_once_is_no_loss() {
    let mut robot = Robot::new();
    robot.transmit(5_000);
    // Ten seconds arrive in one instant, and a moment of them is missing.
    robot.arrival = Some(Timestamp::from_millis(15_000));
    robot.transmit(4_000);
    robot.lose(100);
    robot.transmit(5_900);
    robot.arrival = None;
    robot.transmit(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
    assert_eq!(robot.lost, 4);
}

#[test]
fn late_frames_and_copies_of_a_sender_with_stamps_count_once() {
    let mut robot = Robot::new();
    robot.transmit(5_000);
    for step_ms in 1..=12 {
        // Two frames change their places, across the border of an interval and within, and one of them comes twice.
        robot.transmit(73 * step_ms);
        let (first, second) = (robot.ticks(), robot.heartbeat());
        robot.receive(&second);
        robot.receive(&first);
        robot.receive(&first);
        let (first, second) = (robot.heartbeat(), robot.ticks());
        robot.receive(&second);
        robot.receive(&second);
        robot.receive(&first);
    }
    robot.transmit(500);
    assert_eq!(lost(&robot.tracker), 0);
}

#[test]
fn a_datagram_overtaken_by_a_stalls_complete_burst_is_late_and_no_restart() {
    let mut robot = Robot::new();
    robot.transmit(5_000);
    let held_back = [robot.ticks(), robot.heartbeat()];
    let sent_ms = robot.now_ms;
    robot.transmit(7_000);
    robot.lose(200);
    assert_eq!(lost(&robot.tracker), 2, "those that are held back");
    robot.arrival = Some(Timestamp::ZERO + TimeDelta::from_millis(robot.now_ms));
    for frame in held_back {
        robot.receive_at(&(sent_ms, frame));
    }
    robot.arrival = None;
    robot.transmit(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
}

#[test]
fn what_was_held_back_before_a_silence_of_more_than_a_turn_is_late_too() {
    let mut robot = Robot::new();
    robot.transmit(5_000);
    let held_back = [robot.ticks(), robot.heartbeat()];
    let sent_ms = robot.now_ms;
    robot.lose(9_000);
    robot.transmit(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost + 2);
    for frame in held_back {
        robot.receive_at(&(sent_ms, frame));
    }
    assert_eq!(lost(&robot.tracker), robot.lost);
    robot.transmit(1_000);
    assert_eq!(lost(&robot.tracker), robot.lost);
}

#[test]
fn a_late_frame_is_taken_off_before_the_next_stamp_comes() {
    let mut robot = Robot::new();
    robot.transmit(5_000);
    let held_back = robot.heartbeat();
    let sent_ms = robot.now_ms;
    robot.transmit(1_000);
    assert_eq!(lost(&robot.tracker), 1);
    robot.receive_at(&(sent_ms, held_back));
    assert_eq!(lost(&robot.tracker), 0);
}

#[test]
fn after_the_stamps_have_ceased_the_numbers_have_to_do() {
    let mut robot = Robot::new();
    robot.transmit(5_000);
    for count in 0..300 {
        let frame = robot.heartbeat();
        if count % 10 != 0 {
            robot.receive(&frame);
        }
    }
    assert_eq!(lost(&robot.tracker), 30);
}

#[test]
fn a_sender_with_a_constant_sequence_number_loses_nothing() {
    let mut robot = Robot::new();
    for _ in 0..200 {
        robot.encoder = Encoder::new(WireVersion::V2);
        robot.transmit(25);
    }
    robot.now_ms += 10_000;
    robot.clock_ms += 10_000;
    robot.encoder = Encoder::new(WireVersion::V2);
    robot.transmit(25);
    assert_eq!(lost(&robot.tracker), 0);
}

#[test]
fn reported_losses_add_up_to_the_missing_frames() {
    let mut robot = Robot::new();
    for silent_ms in [300, 4_000, 7_000] {
        robot.transmit(3_000);
        robot.lose(silent_ms);
    }
    robot.transmit(500);
    assert_eq!(robot.new_losses, lost(&robot.tracker));
    assert_eq!(robot.new_losses, robot.lost);
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
    new_losses: u64,
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
            new_losses: 0,
        }
    }

    fn transmit(&mut self, duration_ms: i64) {
        for frame in self.frames(duration_ms) {
            self.receive_at(&frame);
        }
    }

    fn lose(&mut self, duration_ms: i64) {
        self.lost += self.frames(duration_ms).len() as u64;
    }

    fn restart(&mut self, off_ms: i64) {
        self.encoder = Encoder::new(WireVersion::V2);
        self.clock_ms = 0;
        self.now_ms += off_ms;
    }

    fn frames(&mut self, duration_ms: i64) -> Vec<(i64, Vec<u8>)> {
        let mut frames = Vec::new();
        for _ in 0..duration_ms {
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
        let (tracker, new_losses) = (&mut self.tracker, &mut self.new_losses);
        Framer::new(FramerConfig::default()).push(arrival, frame, &mut |scanned| {
            if let FramerOutput::Frame(frame) = scanned {
                *new_losses += u64::from(tracker.record(&frame, arrival));
            }
        });
    }
}
