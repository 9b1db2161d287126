//! The disk fills, the folder takes no files, the folder goes: the station says so once and goes on answering its robot.
//!
//! The test is the brick: it floods the station so that the recording grows, and hears by the station's requests for the time that the
//! station goes on.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;

use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_protocol::message::Message;
use posebridge_recording::container::{RecordingEnd, RecordingReader};
use posebridge_telemetry::{Input, Timestamp};
use support::{RunningProgram, posebridge};

/// What is said when a recording ends before its run.
const ENDED: &str = "the recording ends here";
/// What is said when there never was one.
const NONE: &str = "there is no recording";
/// The same of the telemetry log beside it.
const LOG_ENDED: &str = "the telemetry log ends here";
const NO_LOG: &str = "there is no telemetry log";

/// A station on a link to this test.
struct Station {
    running: RunningProgram,
    link: TcpStream,
    framer: Framer,
}

impl Station {
    /// Starts it by `command`, which ends where the arguments of `posebridge` begin.
    fn start(command: &mut Command, out: &str) -> Self {
        Self::start_with(command, &["--out", out])
    }

    /// The same with these flags.
    fn start_with(command: &mut Command, flags: &[&str]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("tcp://{}", listener.local_addr().unwrap());
        let running = RunningProgram::start(command.args(["run", "--link", &url]).args(flags));
        Self { running, link: listener.accept().unwrap().0, framer: Framer::new(FramerConfig::default()) }
    }

    /// Its clock as its next request for the time shows it, s. It is sent `noise` while it is awaited.
    fn time_s(&mut self, noise: &[u8]) -> f64 {
        let mut buffer = [0; 1024];
        loop {
            self.link.write_all(noise).unwrap();
            let read = self.link.read(&mut buffer).unwrap();
            assert!(read > 0, "the station has hung up");
            let mut shown_s = None;
            self.framer.push(Timestamp::ZERO, &buffer[..read], &mut |scanned| {
                if let FramerOutput::Frame(frame) = scanned
                    && let Ok(Some(Message::TimeSync(request))) = decode(&frame)
                {
                    shown_s = Some(request.request_nanos as f64 * 1e-9);
                }
            });
            if let Some(shown_s) = shown_s {
                return shown_s;
            }
        }
    }

    /// For two seconds of its own clock.
    fn goes_on(&mut self) {
        let end_s = self.time_s(&[]) + 2.0;
        while self.time_s(&[]) < end_s {}
    }

    /// It goes on, then it is asked to end; gives what it said, and how often it said `what`.
    fn goes_on_and_said_once(mut self, heard: &str, what: &str) -> String {
        self.goes_on();
        let (code, said) = self.running.interrupted();
        let said = format!("{heard}{said}");
        // It ran, and something that was wanted is missing.
        assert_eq!(code, Some(1), "{said}");
        assert_eq!(said.matches(what).count(), 1, "{said}");
        said
    }
}

#[test]
fn a_file_that_may_not_grow_ends_the_recording_and_not_the_run() {
    let folder = tempfile::tempdir().unwrap();
    // A file of more than 200 kB is refused by the system, as a full disk refuses it.
    let limited = "trap '' XFSZ; ulimit -f 400; exec \"$0\" \"$@\"";
    let mut shell = Command::new("sh");
    shell.current_dir(folder.path()).args(["-c", limited, env!("CARGO_BIN_EXE_posebridge")]);
    let mut station = Station::start(&mut shell, "run");
    for _ in 0..15 {
        station.time_s(&[0x55; 16_384]);
    }
    let line = station.running.wait_for(ENDED);
    assert!(line.contains("recording.mcap"), "{line}");
    let said = station.goes_on_and_said_once(&line, ENDED);
    assert!(said.contains("File too large"), "{said}");

    let bytes = std::fs::read(folder.path().join("run/recording.mcap")).unwrap();
    let mut reader = RecordingReader::open(&bytes).unwrap();
    assert!(matches!(reader.recording_end(), RecordingEnd::Truncated { .. }));
    let read = reader.by_ref().map(Result::unwrap).count();
    assert!(read > 10, "{read}");
}

#[test]
fn a_folder_that_takes_no_files_costs_the_recording_and_not_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let mut station = Station::start(&mut posebridge(folder.path()), "/proc/self/task");
    let line = station.running.wait_for(NONE);
    assert!(line.contains("/proc/self/task/recording.mcap"), "{line}");
    station.goes_on_and_said_once(&line, NONE);
}

#[test]
fn a_folder_that_is_deleted_costs_the_recording_and_not_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let mut station = Station::start(&mut posebridge(folder.path()), "run");
    station.time_s(&[]);
    let run = folder.path().join("run");
    assert!(Path::new(&run).join("recording.mcap").exists());
    std::fs::remove_dir_all(&run).unwrap();
    let line = station.running.wait_for(ENDED);
    assert!(line.contains("deleted or moved"), "{line}");
    station.goes_on_and_said_once(&line, ENDED);
}

#[test]
fn a_telemetry_log_that_is_deleted_is_told_once_and_stands_in_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["--out", "run", "--tlog"];
    let mut station = Station::start_with(&mut posebridge(folder.path()), &flags);
    station.time_s(&[]);
    let run = folder.path().join("run");
    std::fs::remove_file(run.join("recording.tlog")).unwrap();
    let line = station.running.wait_for(LOG_ENDED);
    assert!(line.contains("deleted or moved"), "{line}");
    let said = station.goes_on_and_said_once(&line, LOG_ENDED);
    assert!(said.contains("the telemetry log is not whole"), "{said}");
    assert!(!said.contains(ENDED), "{said}");

    let bytes = std::fs::read(run.join("recording.mcap")).unwrap();
    let inputs = RecordingReader::open(&bytes).unwrap().map(Result::unwrap);
    let reports: Vec<String> = inputs
        .filter_map(|(_, input)| if let Input::Report { severity: 4, text } = input { Some(text) } else { None })
        .collect();
    let [report] = &reports[..] else {
        panic!("{reports:?}");
    };
    assert!(report.starts_with("no more telemetry log: "), "{report}");
}

#[test]
fn a_disk_without_room_ends_the_telemetry_log_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["--out", "run", "--tlog", "--set", "record.min_free_mb=4000000000"];
    let mut station = Station::start_with(&mut posebridge(folder.path()), &flags);
    // They may end in either order.
    let mut heard = station.running.wait_for("ends here");
    heard += &station.running.wait_for("ends here");
    for what in [ENDED, LOG_ENDED] {
        let line = heard.lines().find(|line| line.contains(what));
        let line = line.unwrap_or_else(|| panic!("{what}: {heard}"));
        assert!(line.contains("record.min_free_mb"), "{line}");
    }
    let said = station.goes_on_and_said_once(&heard, LOG_ENDED);
    for what in ["the recording is not whole", "the telemetry log is not whole"] {
        assert!(said.contains(what), "{said}");
    }
}

#[test]
fn a_folder_that_takes_no_files_costs_the_telemetry_log_and_not_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["--out", "/proc/self/task", "--tlog"];
    let mut station = Station::start_with(&mut posebridge(folder.path()), &flags);
    let line = station.running.wait_for(NO_LOG);
    assert!(line.contains("/proc/self/task/recording.tlog"), "{line}");
    station.goes_on_and_said_once(&line, NO_LOG);
}

#[test]
fn a_folder_that_is_moved_costs_the_pictures_and_not_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let mut station = Station::start(&mut posebridge(folder.path()), "run");
    station.time_s(&[]);
    let run = folder.path().join("run");
    std::fs::rename(&run, folder.path().join("elsewhere")).unwrap();
    station.running.wait_for(ENDED);
    station.goes_on();
    let (code, printed, said) = station.running.interrupted_with_output();
    assert_eq!(code, Some(1), "{said}");
    assert!(printed.contains("NIS/dof"), "{printed}");
    assert!(!printed.contains("track.svg"), "{printed}");
    for what in ["not all pictures are drawn", "run/track.svg", "the recording is not whole"] {
        assert!(said.contains(what), "{said}");
    }
}
