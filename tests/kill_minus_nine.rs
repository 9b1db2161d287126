//! A recording is readable after `kill -9`, up to at most one second before.
//!
//! The test is the brick: the station's requests for the time carry the station's own clock, so the test knows at what time of the
//! session it kills. It kills at several, so that no period of flushing passes by luck. A hundred times more it kills a program that
//! does nothing but write, while it writes, at a moment drawn at random.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use posebridge::config::RecordingLimits;
use posebridge::station::recording_parts::{FLUSH_PERIOD, RecordingParts};
use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_protocol::message::Message;
use posebridge_recording::container::{FORMAT, RecordingEnd, RecordingHeader, RecordingReader};
use posebridge_telemetry::{Input, LinkId, PeerId, TimeDelta, Timestamp};
use rand::RngExt as _;
use support::{RunningProgram, posebridge, stdout_of};

#[test]
fn a_killed_run_leaves_a_recording_that_replays_up_to_a_second_before() {
    for kill_at_s in [1.3, 2.4, 4.4] {
        let folder = tempfile::tempdir().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let link = format!("tcp://{}", listener.local_addr().unwrap());
        let run = RunningProgram::start(posebridge(folder.path()).args(["run", "--link", &link, "--out", "run"]));
        let (mut station, _) = listener.accept().unwrap();
        let killed_at_s = wait_for_time(&mut station, kill_at_s);
        run.kill();
        let recorded_to_s = recorded_to_s(&folder.path().join("run/recording.mcap"));
        println!("killed at {killed_at_s:.2} s or later, recorded up to {recorded_to_s:.2} s");
        assert!(recorded_to_s > killed_at_s - 1.0, "{recorded_to_s} {killed_at_s}");

        let replay = stdout_of(posebridge(folder.path()).args(["replay", "run/recording.mcap", "--json"]));
        // Nobody knows where the robot was: the figures are null, not zero.
        let report: serde_json::Value = serde_json::from_str(&replay).unwrap();
        let estimator = &report["estimators"][0];
        assert_eq!(estimator["name"], "pose");
        for figure in ["position_rms_m", "position_max_m", "position_end_m", "heading_rms_rad", "anees"] {
            assert!(estimator[figure].is_null(), "{report}");
        }
    }
}

/// The file that the writer writes, when this program is the writer.
const WRITER_FILE: &str = "POSEBRIDGE_TEST_WRITER_FILE";
/// The session's time between two inputs of the writer.
const STEP: TimeDelta = TimeDelta::from_millis(10);
/// So many inputs the writer writes each time it is asked to.
const BATCH: u64 = 20;

/// One input as large as a whole read from a busy link.
fn write_batch(parts: &mut RecordingParts) {
    for _ in 0..BATCH {
        let number = parts.next();
        let now = Timestamp::from_nanos(STEP.as_nanos() * i64::try_from(number).expect("few"));
        let (link, peer) = (LinkId(0), PeerId::default());
        let bytes = vec![number as u8; 4_096];
        let written = parts.record(now, number, &Input::Bytes { link, peer, bytes });
        written.expect("the disk has room");
    }
}

/// Where this is the writer: writes a batch for every line that it reads, until it is killed. Otherwise: a batch is there when the file
/// has ended.
#[test]
fn the_writer() {
    let file = std::env::var_os(WRITER_FILE);
    let folder = tempfile::tempdir().unwrap();
    let path = file.as_ref().map_or_else(|| folder.path().join("whole.mcap"), PathBuf::from);
    let header = RecordingHeader { format: FORMAT, ..RecordingHeader::default() };
    let mut parts = RecordingParts::create(&path, header, RecordingLimits::default(), 0).unwrap();
    if file.is_some() {
        println!("\nready");
        for line in std::io::stdin().lines() {
            line.unwrap();
            write_batch(&mut parts);
            println!("written");
        }
    }
    write_batch(&mut parts);
    let next = parts.next();
    parts.finish(next).unwrap();
    let whole = STEP.as_secs_f64() * (next - 1) as f64;
    assert!((recorded_to_s(&path) - whole).abs() < 1e-9);
}

/// Reads what the writer says up to this line.
fn wait_for_line(lines: &mut impl Iterator<Item = std::io::Result<String>>, wanted: &str) {
    let found = lines.find(|line| line.as_ref().is_ok_and(|line| line == wanted));
    assert!(found.is_some(), "the writer ended before it said `{wanted}`");
}

#[test]
fn a_hundred_kills_at_random_leave_a_hundred_recordings_up_to_a_second_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = rand_pcg::Pcg64Mcg::new(0x6b69_6c6c);
    let mut torn = 0;
    let mut longest_loss_s = 0.0_f64;
    for run in 0..100 {
        let path = folder.path().join(format!("{run}.mcap"));
        let mut writer = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "the_writer", "--nocapture"])
            .env(WRITER_FILE, &path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut asked = writer.stdin.take().unwrap();
        let mut lines = BufReader::new(writer.stdout.take().unwrap()).lines();
        wait_for_line(&mut lines, "ready");
        let batches = random.random_range(0..15_u64);
        for _ in 0..batches {
            writeln!(asked).unwrap();
            wait_for_line(&mut lines, "written");
        }
        // It writes the next batch while it is killed.
        writeln!(asked).unwrap();
        for _ in 0..random.random_range(0..100_000) {
            std::hint::spin_loop();
        }
        writer.kill().unwrap();
        writer.wait().unwrap();

        let bytes = std::fs::read(&path).unwrap();
        let reader = RecordingReader::open(&bytes).unwrap();
        torn += u32::from(matches!(reader.recording_end(), RecordingEnd::Truncated { .. }));
        let last = reader.map(Result::unwrap).last();
        let reached_s = last.map_or(0.0, |(now, _)| now.as_secs_f64());
        let written_s = STEP.as_secs_f64() * (BATCH * batches) as f64;
        longest_loss_s = longest_loss_s.max(written_s - reached_s);
        std::fs::remove_file(&path).unwrap();
    }
    println!("{torn} of 100 cut off; at most {longest_loss_s:.3} s lost");
    assert_eq!(torn, 100);
    let most_s = (FLUSH_PERIOD + STEP + STEP).as_secs_f64();
    assert!(longest_loss_s < most_s, "{longest_loss_s}");
}

/// Reads what the station says until its clock shows at least `secs`; returns what it shows.
fn wait_for_time(station: &mut TcpStream, secs: f64) -> f64 {
    let mut framer = Framer::new(FramerConfig::default());
    let mut buffer = [0; 1024];
    loop {
        let read = station.read(&mut buffer).expect("the station speaks");
        assert!(read > 0, "the station has hung up");
        let mut shown_s = 0.0_f64;
        framer.push(Timestamp::ZERO, &buffer[..read], &mut |scanned| {
            if let FramerOutput::Frame(frame) = scanned
                && let Ok(Some(Message::TimeSync(request))) = decode(&frame)
            {
                shown_s = shown_s.max(request.request_nanos as f64 * 1e-9);
            }
        });
        if shown_s >= secs {
            return shown_s;
        }
    }
}

/// The last instant in a recording.
fn recorded_to_s(path: &Path) -> f64 {
    let bytes = std::fs::read(path).expect("the recording is there");
    let inputs = RecordingReader::open(&bytes).expect("its header is whole");
    let last = inputs.map(|input| input.expect("every whole record is good").0).max();
    last.expect("something was recorded").as_secs_f64()
}
