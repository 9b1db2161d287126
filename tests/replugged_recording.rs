//! A cable that is pulled in the middle of a frame, again and again: the recording of the real station has every byte that arrived,
//! and what is left of the torn frame is not taken for one, not even when its other half is the first that comes afterwards.
//!
//! A hundred times and with the processor time is a test of the link (`crates/link/tests/replug.rs`).
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;
#[path = "support/terminal.rs"]
mod terminal;

use std::io::{Read as _, Write as _};
use std::path::Path;

use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, TimeSync, WheelTicks, WireStamp};
use posebridge_recording::container::{RecordingEnd, RecordingReader};
use posebridge_telemetry::{Address, EncoderTicks, Input, LinkState, Timestamp};
use support::{RunningProgram, events_named, posebridge};
use terminal::PseudoTerminal;

const BRICK: Address = Address::new(1, 1);
/// The waits before the next attempt double from one to the next: five make four seconds.
const PLUGGINGS: usize = 5;
/// Wheel messages of one plugging, behind its heartbeat.
const MESSAGES: i64 = 20;
/// All messages of a plugging come at once, and no clock may leap by a second.
const STEP_MICROS: u32 = 20_000;

/// What a plugging has sent: whether it must all be there is known of the bytes before the torn frame.
struct SentBytes {
    whole: Vec<u8>,
    torn: Vec<u8>,
}

/// A brick that numbers its messages through all pluggings.
struct Brick {
    encoder: Encoder,
    message_count: i64,
}

impl Brick {
    fn frame(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(BRICK, message, &mut bytes);
        bytes
    }

    fn next_ticks(&mut self) -> Vec<u8> {
        self.message_count += 1;
        self.frame(&ticks(self.message_count))
    }

    /// Waits until the station speaks, says its part, waits for the answer to its last word, and is torn off in the middle of
    /// the next. `remainder` is what the plugging before has not got rid of.
    fn talk(&mut self, mut terminal: PseudoTerminal, remainder: &[u8]) -> SentBytes {
        read_until(&mut terminal, |_| true);
        let mut whole = remainder.to_vec();
        whole.extend(self.frame(&HEARTBEAT));
        for _ in 0..MESSAGES {
            whole.extend(self.next_ticks());
        }
        let request_nanos = 1_000 + self.message_count;
        whole.extend(self.frame(&Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, target: None })));
        terminal.wire.write_all(&whole).expect("it is plugged in");
        read_until(
            &mut terminal,
            |message| matches!(message, Message::TimeSync(sync) if sync.request_nanos == request_nanos && sync.answer_nanos != 0),
        );
        let torn = self.next_ticks();
        let half = torn.len() / 2;
        terminal.wire.write_all(&torn[..half]).expect("it is plugged in");
        SentBytes { whole, torn }
    }
}

/// The wheels of the message of this number; the one that is torn has one, too.
fn ticks(number: i64) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(5_000_000 + number as u32 * STEP_MICROS),
        left: EncoderTicks(3 * number),
        right: EncoderTicks(4 * number),
    })
}

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

/// Reads what the station says until a message of it is wanted.
fn read_until(terminal: &mut PseudoTerminal, is_wanted: impl Fn(&Message) -> bool) {
    let mut framer = Framer::new(FramerConfig::default());
    let mut buffer = [0; 4_096];
    let mut is_received = false;
    while !is_received {
        let read = terminal.wire.read(&mut buffer).expect("the station speaks");
        framer.push(Timestamp::ZERO, &buffer[..read], &mut |found| {
            if let FramerOutput::Frame(frame) = found
                && let Ok(Some(message)) = decode(&frame)
            {
                is_received |= is_wanted(&message);
            }
        });
    }
}

/// The recorded bytes of each time that the link was up.
fn recorded(path: &Path) -> Vec<Vec<u8>> {
    let file = std::fs::read(path).expect("the recording is there");
    let reader = RecordingReader::open(&file).expect("it is one");
    assert_eq!(reader.recording_end(), RecordingEnd::Complete);
    let mut times: Vec<Vec<u8>> = Vec::new();
    for input in reader {
        match input.expect("every record is good").1 {
            Input::Link { state: LinkState::Up, .. } => times.push(Vec::new()),
            Input::Bytes { bytes, .. } => {
                times.last_mut().expect("the link is up").extend(bytes);
            }
            Input::Link { .. }
            | Input::Port { .. }
            | Input::Observation(_)
            | Input::Command(_)
            | Input::RobotCommand { .. }
            | Input::Report { .. }
            | Input::Tick => {}
        }
    }
    times
}

#[test]
fn every_byte_that_arrived_is_recorded_and_no_torn_frame_is_believed() {
    let folder = tempfile::tempdir().unwrap();
    let name = folder.path().join("brick.tty");
    let link = format!("serial:{}", name.display());
    let mut terminal = PseudoTerminal::open_as(&name);
    let args = ["run", "--link", &link, "--out", "run", "--events", "live.txt"];
    let station = RunningProgram::start(posebridge(folder.path()).args(args));
    let mut brick = Brick { encoder: Encoder::new(WireVersion::V2), message_count: 0 };
    let mut sent = vec![brick.talk(terminal, &[])];
    while sent.len() < PLUGGINGS {
        terminal = PseudoTerminal::open_as(&name);
        let torn = &sent[sent.len() - 1].torn;
        let remainder = torn[torn.len() / 2..].to_vec();
        sent.push(brick.talk(terminal, &remainder));
    }
    station.interrupt();

    let recorded = recorded(&folder.path().join("run/recording.mcap"));
    assert_eq!(recorded.len(), sent.len(), "the link was up so often");
    for (number, (found, sent)) in recorded.iter().zip(&sent).enumerate() {
        let all = [&sent.whole[..], &sent.torn[..sent.torn.len() / 2]].concat();
        assert!(found.starts_with(&sent.whole), "plugging {number}: bytes are missing");
        assert!(all.starts_with(found), "plugging {number}: bytes are made up");
    }
    check_events(folder.path(), brick.message_count);
}

/// Every whole message was observed once and in order, no torn one was, and the recording replays to the same events.
fn check_events(folder: &Path, message_count: i64) {
    let live = std::fs::read_to_string(folder.join("live.txt")).unwrap();
    let observed = events_named(&live, "observed");
    let stamps: Vec<i64> = observed.iter().map(|event| event["robot_ns"].as_i64().unwrap()).collect();
    // The last of each plugging is the torn one.
    let expected: Vec<i64> = (1..=message_count)
        .filter(|number| number % (MESSAGES + 1) != 0)
        .map(|number| 1_000 * (5_000_000 + number * i64::from(STEP_MICROS)))
        .collect();
    assert_eq!(stamps, expected);
    // The station may be stopped before it has noticed the last.
    assert!(live.matches("\"state\":\"down\"").count() >= PLUGGINGS - 1);
    assert!(events_named(&live, "robot_restarted").is_empty());

    let args = ["replay", "run/recording.mcap", "--events", "again.txt"];
    let replay = posebridge(folder).args(args).output().unwrap();
    assert!(replay.status.success(), "{replay:?}");
    let again = std::fs::read_to_string(folder.join("again.txt")).unwrap();
    assert!(again == live, "the replay tells something else");
}
