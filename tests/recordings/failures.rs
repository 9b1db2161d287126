//! The disk fills, the folder takes no files, a file goes: the station says so once and goes on answering its robot.
//! The test is the brick: it floods the station so that the recording grows, and the station's requests for the time show that the
//! station goes on.

use std::io::Write as _;
use std::net::{TcpListener, TcpStream};
use std::process::Command;

use crate::support::mavlink::MavlinkPeer;
use crate::support::{RunningProgram, posebridge};
use posebridge_protocol::message::Message;
use posebridge_recording::container::{RecordingEnd, RecordingReader};
use posebridge_telemetry::{Address, Input};

/// What is said when a recording ends before its run, and of the telemetry log beside it.
const ENDED: &str = "the recording ends here";
const LOG_ENDED: &str = "the telemetry log ends here";
const EVENTS_ENDED: &str = "the event file ends here";
/// What is said when there never was one.
const NONE: &str = "there is no recording";
const NO_LOG: &str = "there is no telemetry log";

/// A station on a link to this test.
struct Station {
    running: RunningProgram,
    link: TcpStream,
    peer: MavlinkPeer,
}

impl Station {
    /// Starts it by `command`, which ends where the arguments of `posebridge` begin.
    fn start(command: &mut Command, flags: &[&str]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("tcp://{}", listener.local_addr().unwrap());
        let running = RunningProgram::start(command.args(["run", "--link", &url]).args(flags));
        Self { running, link: listener.accept().unwrap().0, peer: MavlinkPeer::new(Address::new(1, 1)) }
    }

    /// Its clock as its next request for the time shows it, s. It is sent `noise` first.
    fn time_s(&mut self, noise: &[u8]) -> f64 {
        self.link.write_all(noise).unwrap();
        self.peer.wait_for(&mut self.link, |message| match message {
            Message::TimeSync(request) => Some(request.request_nanos as f64 * 1e-9),
            _ => None,
        })
    }

    /// It goes on for two seconds of its own clock, then it is asked to end. Returns what it printed and said; `once` must have been
    /// said once.
    fn goes_on_and_ends(mut self, heard: &str, once: &[&str]) -> (String, String) {
        let end_s = self.time_s(&[]) + 2.0;
        while self.time_s(&[]) < end_s {}
        let (code, printed, said) = self.running.interrupted();
        let said = format!("{heard}{said}");
        // It ran, and something that was wanted is missing.
        assert_eq!(code, Some(1), "{said}");
        for what in once {
            assert_eq!(said.matches(what).count(), 1, "{what}: {said}");
        }
        (printed, said)
    }
}

#[test]
fn a_file_that_may_not_grow_ends_the_recording_and_not_the_run() {
    let folder = tempfile::tempdir().unwrap();
    // A file of more than 200 kB is refused by the system, as a full disk refuses it.
    let limited = "ulimit -f 400; exec \"$0\" \"$@\"";
    let mut shell = Command::new("sh");
    shell.current_dir(folder.path()).args(["-c", limited, env!("CARGO_BIN_EXE_posebridge")]);
    let mut station = Station::start(&mut shell, &["--out", "run"]);
    for _ in 0..15 {
        station.time_s(&[0x55; 16_384]);
    }
    let line = station.running.wait_for(ENDED);
    assert!(line.contains("recording.mcap"), "{line}");
    let (_, said) = station.goes_on_and_ends(&line, &[ENDED]);
    assert!(said.contains("File too large"), "{said}");

    let bytes = std::fs::read(folder.path().join("run/recording.mcap")).unwrap();
    let reader = RecordingReader::open(&bytes).unwrap();
    assert!(matches!(reader.recording_end(), RecordingEnd::Truncated { .. }));
    assert!(reader.map(Result::unwrap).count() > 10);
}

#[test]
fn an_event_file_on_a_full_disk_is_told_once_while_the_station_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["--out", "run", "--events", "/dev/full"];
    let mut station = Station::start(&mut posebridge(folder.path()), &flags);
    for _ in 0..15 {
        station.time_s(&[0x55; 16_384]);
    }
    let line = station.running.wait_for(EVENTS_ENDED);
    assert!(line.contains("/dev/full") && line.contains("No space left"), "{line}");
    station.goes_on_and_ends(&line, &[EVENTS_ENDED]);
}

#[test]
fn a_telemetry_log_that_is_deleted_is_told_once_and_stands_in_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let mut station = Station::start(&mut posebridge(folder.path()), &["--out", "run", "--tlog"]);
    station.time_s(&[]);
    let run = folder.path().join("run");
    std::fs::remove_file(run.join("recording.tlog")).unwrap();
    let line = station.running.wait_for(LOG_ENDED);
    assert!(line.contains("deleted or moved"), "{line}");
    let (_, said) = station.goes_on_and_ends(&line, &[LOG_ENDED]);
    assert!(said.contains("the telemetry log is not whole") && !said.contains(ENDED), "{said}");

    let bytes = std::fs::read(run.join("recording.mcap")).unwrap();
    let inputs = RecordingReader::open(&bytes).unwrap().map(|input| input.unwrap().1);
    let reports: Vec<String> = inputs
        .filter_map(|input| if let Input::Report { severity: 4, text } = input { Some(text) } else { None })
        .collect();
    assert!(reports.len() == 1 && reports[0].starts_with("no more telemetry log: "), "{reports:?}");
}

#[test]
fn a_folder_that_takes_no_files_costs_recording_log_and_pictures_but_not_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let mut station = Station::start(&mut posebridge(folder.path()), &["--out", "/proc/self/task", "--tlog"]);
    // In either order.
    let heard = station.running.wait_for("there is no ") + &station.running.wait_for("there is no ");
    for name in ["/proc/self/task/recording.mcap", "/proc/self/task/recording.tlog"] {
        assert!(heard.contains(name), "{heard}");
    }
    let (printed, said) = station.goes_on_and_ends(&heard, &[NONE, NO_LOG]);
    assert!(printed.contains("too little data") && !printed.contains("track.svg"), "{printed}");
    assert!(said.contains("not all pictures are drawn"), "{said}");
}
