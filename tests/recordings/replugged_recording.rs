//! A cable that is pulled in the middle of a frame: the recording of the real station has every byte that arrived, and what is left of
//! the torn frame is not taken for one, not even when its other half is the first that comes afterwards.

use std::io::Write as _;
use std::path::Path;

use crate::support::mavlink::{HEARTBEAT, MavlinkPeer, wheel_ticks};
use crate::support::terminal::PseudoTerminal;
use crate::support::{RunningProgram, assert_replays, events_named};
use posebridge_protocol::message::{Message, TimeSync};
use posebridge_recording::container::{RecordingEnd, RecordingReader};
use posebridge_telemetry::{Address, Input, LinkState};

/// Wheel messages of one plugging, behind its heartbeat; the one behind them is torn.
const MESSAGES: u32 = 20;

/// What a plugging has sent: `whole` must all have arrived; half of the torn frame may have.
struct SentBytes {
    whole: Vec<u8>,
    torn: Vec<u8>,
}

/// Waits until the station speaks, says its part behind `remainder`, waits for the answer to its last word, and is torn off in the
/// middle of the next.
fn talk(brick: &mut MavlinkPeer, mut terminal: PseudoTerminal, first_step: u32, remainder: &[u8]) -> SentBytes {
    brick.wait_for(&mut terminal.wire, |_| Some(()));
    let mut whole = remainder.to_vec();
    whole.extend(brick.frame(&HEARTBEAT));
    for step in first_step..first_step + MESSAGES {
        whole.extend(brick.frame(&wheel_ticks(step)));
    }
    let request_nanos = 1_000 + i64::from(first_step);
    whole.extend(brick.frame(&Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, target: None })));
    terminal.wire.write_all(&whole).expect("it is plugged in");
    brick.wait_for(&mut terminal.wire, |message| match message {
        Message::TimeSync(sync) if sync.request_nanos == request_nanos && sync.answer_nanos != 0 => Some(()),
        _ => None,
    });
    let torn = brick.frame(&wheel_ticks(first_step + MESSAGES));
    terminal.wire.write_all(&torn[..torn.len() / 2]).expect("it is plugged in");
    SentBytes { whole, torn }
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
            Input::Bytes { bytes, .. } => times.last_mut().expect("the link is up").extend(bytes),
            _ => {}
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
    let station = RunningProgram::posebridge(folder.path(), &args);
    let mut brick = MavlinkPeer::new(Address::new(1, 1));
    let first = talk(&mut brick, terminal, 0, &[]);
    terminal = PseudoTerminal::open_as(&name);
    let remainder = &first.torn[first.torn.len() / 2..];
    let second = talk(&mut brick, terminal, MESSAGES + 1, remainder);
    station.hang_up();

    let recorded = recorded(&folder.path().join("run/recording.mcap"));
    assert_eq!(recorded.len(), 2, "the link was up so often");
    for (number, (found, sent)) in recorded.iter().zip([first, second]).enumerate() {
        let all = [&sent.whole[..], &sent.torn[..sent.torn.len() / 2]].concat();
        assert!(found.starts_with(&sent.whole), "plugging {number}: bytes are missing");
        assert!(all.starts_with(found), "plugging {number}: bytes are made up");
    }
    // Every whole message was observed once and in order, and no torn one was.
    let live = assert_replays(folder.path(), "run/recording.mcap", "live.txt");
    let observed = events_named(&live, "observed");
    let stamps: Vec<i64> = observed.iter().map(|event| event["robot_ns"].as_i64().unwrap()).collect();
    let steps = (0..=2 * MESSAGES).filter(|step| *step != MESSAGES);
    let expected: Vec<i64> = steps.map(|step| 5_000_000_000 + 50_000_000 * i64::from(step)).collect();
    assert_eq!(stamps, expected);
    assert!(live.contains("\"state\":\"down\""));
    assert!(events_named(&live, "robot_restarted").is_empty());
}
