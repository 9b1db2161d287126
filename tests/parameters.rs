//! A ground station tunes and commands a running station: what it sets, saves, freezes, switches off and records, and the replay of it.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test stops where its set-up is broken")]
#![expect(clippy::wildcard_enum_match_arm, reason = "helpers of tests")]

mod support;

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::time::Duration;

use posebridge_estimator::PARAMS;
use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{CommandLong, Heartbeat, Message};
use posebridge_telemetry::{Address, Timestamp};
use support::{RunningProgram, posebridge, stdout_of};

const STATION: Address = Address::new(1, 197);
const ALL_OF_SYSTEM_1: Address = Address::new(1, 0);
const GCS: Address = Address::new(254, 190);

/// Only a test that fails waits for so long.
const PATIENCE: Duration = Duration::from_secs(30);

const PREFLIGHT_STORAGE: u16 = 245;
const LOGGING_START: u16 = 2_510;
const LOGGING_STOP: u16 = 2_511;
const CALIBRATION: u16 = 31_012;
const SOURCE: u16 = 31_013;
const CAMERA: f32 = 3.0;

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 });
/// So often among what it hears a ground station shows that it is there: the station forgets who is silent.
const HEARD_PER_HEARTBEAT: u32 = 20;

const ACCEPTED: u8 = 0;
const DENIED: u8 = 2;

/// A brick that drives squares for as long as anybody looks.
const SCENARIO: &str = r#"
seed = 11
steering = "estimate"

[path.square]
side_m = 0.3

[drive]
laps = 1000
speed_m_per_s = 0.2
"#;

const CONFIG: &str = r#"
[[link]]
url = "sim://endless.toml"

[[link]]
url = "udp://127.0.0.1:0"
listen = true
outputs = [{ message = "planar_pose" }]
"#;

/// A ground station on UDP.
struct Gcs {
    socket: UdpSocket,
    encoder: Encoder,
    framer: Framer,
    waiting: Vec<Message>,
    heard: u32,
}

impl Gcs {
    fn call(station: &str) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.connect(station).expect("an address");
        socket.set_read_timeout(Some(PATIENCE)).expect("it can wait");
        let mut gcs = Self {
            socket,
            encoder: Encoder::new(WireVersion::V2),
            framer: Framer::new(FramerConfig::default()),
            waiting: Vec::new(),
            heard: 0,
        };
        gcs.send(&HEARTBEAT);
        gcs
    }

    fn send(&mut self, message: &Message) {
        let mut bytes = Vec::new();
        self.encoder.encode(GCS, message, &mut bytes);
        self.socket.send(&bytes).expect("it is sent");
    }

    /// The next message for which `take` has an answer.
    fn wait_for<T>(&mut self, take: impl Fn(&Message) -> Option<T>) -> T {
        loop {
            while !self.waiting.is_empty() {
                if let Some(taken) = take(&self.waiting.remove(0)) {
                    return taken;
                }
            }
            let mut buffer = [0; 2_048];
            let length = self.socket.recv(&mut buffer).expect("it arrives");
            self.heard += 1;
            if self.heard.is_multiple_of(HEARD_PER_HEARTBEAT) {
                self.send(&HEARTBEAT);
            }
            let waiting = &mut self.waiting;
            self.framer.push(Timestamp::ZERO, &buffer[..length], &mut |scanned| {
                if let FramerOutput::Frame(frame) = scanned
                    && frame.source == STATION
                {
                    waiting.extend(decode(&frame).expect("the station makes sense"));
                }
            });
        }
    }

    fn value(&mut self, wanted: &str) -> f32 {
        self.wait_for(|message| match message {
            Message::ParamValue { name, value, .. } if name.eq_ignore_ascii_case(wanted) => Some(*value),
            _ => None,
        })
    }

    fn text(&mut self, beginning: &str) -> String {
        self.wait_for(|message| match message {
            Message::StatusText { text, .. } if text.starts_with(beginning) => Some(text.clone()),
            _ => None,
        })
    }

    fn set(&mut self, name: &str, value: f32) -> f32 {
        self.send(&Message::ParamSet { target: STATION, name: name.to_owned(), value });
        self.value(name)
    }

    fn command(&mut self, command: u16, first: &[f32]) -> u8 {
        let mut params = [0.0; 7];
        params[..first.len()].copy_from_slice(first);
        self.send(&Message::Command(CommandLong { target: STATION, command, params }));
        self.wait_for(|message| match message {
            Message::CommandAck(ack) if ack.command == command => Some(ack.result),
            _ => None,
        })
    }

    /// The largest of the position's sigmas in the next estimates for which `enough` holds.
    fn sigma_m_until(&mut self, enough: impl Fn(f64) -> bool) -> f64 {
        self.wait_for(|message| match message {
            Message::PlanarPose(pose) => {
                let sigma_m = pose.covariance[0].max(pose.covariance[3]).sqrt();
                enough(sigma_m).then_some(sigma_m)
            }
            _ => None,
        })
    }
}

fn start(folder: &Path, config: &str, out: &str) -> (RunningProgram, Gcs) {
    let mut station = RunningProgram::start(posebridge(folder).args([
        "run",
        "--config",
        config,
        "--out",
        out,
        "--events",
        &format!("{out}.txt"),
    ]));
    let gcs = Gcs::call(&station.listening_address(""));
    station.wait_for("robot 1/254/190 detected");
    (station, gcs)
}

fn replayed_events(folder: &Path, recording: &str) -> String {
    stdout_of(posebridge(folder).args(["replay", recording, "--events", "replayed.txt"]));
    std::fs::read_to_string(folder.join("replayed.txt")).unwrap()
}

fn fetch_all(gcs: &mut Gcs) {
    gcs.send(&Message::ParamRequestList { target: ALL_OF_SYSTEM_1 });
    for (expected, row) in PARAMS.iter().enumerate() {
        let (name, value, count, index) = gcs.wait_for(|message| match message {
            Message::ParamValue { name, value, count, index } => Some((name.clone(), *value, *count, *index)),
            _ => None,
        });
        assert_eq!((name, value), (row.key.to_uppercase(), row.default as f32));
        assert_eq!((usize::from(count), usize::from(index)), (PARAMS.len(), expected));
    }
}

/// Sets, refuses, and switches the camera off and on: without it the robot knows less and less where it is.
fn tune_and_switch(gcs: &mut Gcs) {
    assert_eq!(gcs.set("slip_nis", 20.0), 20.0);
    assert_eq!(gcs.set("slip_nis", 1e6), 20.0, "what stands");
    gcs.text("slip_nis 1000000.0 not in 4..100");
    let seen_m = gcs.sigma_m_until(|sigma_m| sigma_m < 0.02);
    assert_eq!(gcs.command(SOURCE, &[CAMERA, 0.0]), ACCEPTED);
    gcs.sigma_m_until(|sigma_m| sigma_m > 2.0 * seen_m);
    assert_eq!(gcs.command(CALIBRATION, &[0.0]), ACCEPTED);
    assert_eq!(gcs.command(SOURCE, &[CAMERA, 1.0]), ACCEPTED);
    gcs.sigma_m_until(|sigma_m| sigma_m < 1.5 * seen_m);
    for (change, answer) in [(1.0, ACCEPTED), (2.0, ACCEPTED), (9.0, DENIED)] {
        assert_eq!(gcs.command(CALIBRATION, &[change]), answer);
    }
}

/// Saves, goes back to what was saved, and begins a second recording.
fn save_and_record(gcs: &mut Gcs) {
    assert_eq!(gcs.command(PREFLIGHT_STORAGE, &[1.0]), ACCEPTED);
    assert_eq!(gcs.text("saved "), "saved parameters.toml in first");
    assert_eq!(gcs.set("slip_nis", 50.0), 50.0);
    assert_eq!(gcs.command(PREFLIGHT_STORAGE, &[0.0]), ACCEPTED);
    assert_eq!(gcs.command(LOGGING_STOP, &[]), ACCEPTED);
    assert_eq!(gcs.text("recorded "), "recorded recording.mcap in first");
    assert_eq!(gcs.command(LOGGING_START, &[]), ACCEPTED);
    assert_eq!(gcs.text("recording "), "recording recording-2.mcap in first");
    gcs.sigma_m_until(|_| true);
}

/// All that happened until the recording was stopped happens again, word for word.
fn check_replay(folder: &Path) {
    let live = std::fs::read_to_string(folder.join("first.txt")).unwrap();
    let replayed = replayed_events(folder, "first/recording.mcap");
    let count = replayed.lines().count();
    assert!(count > 1_000, "{count}");
    for (number, (live, replayed)) in live.lines().zip(replayed.lines()).enumerate() {
        assert_eq!(live, replayed, "event {number}");
    }
    for asked in [
        "slip_nis set to 20 (was 10.83)",
        "slip_nis 1000000.0 not in 4..100",
        "source 3 (camera) is left out",
        "calibration frozen",
        "saved parameters.toml in first",
        "parameters as saved last",
        "the recording's end was asked for",
    ] {
        assert!(replayed.contains(asked), "{asked}");
    }
}

#[test]
fn a_ground_station_tunes_a_running_station_and_the_replay_does_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("endless.toml"), SCENARIO).unwrap();
    std::fs::write(folder.join("station.toml"), CONFIG).unwrap();
    let (station, mut gcs) = start(folder, "station.toml", "first");
    fetch_all(&mut gcs);
    tune_and_switch(&mut gcs);
    save_and_record(&mut gcs);
    let printed = station.interrupt();
    for name in ["first/recording.mcap", "first/recording-2.mcap"] {
        assert!(printed.contains(name), "{printed}");
    }
    check_replay(folder);
    // The second one goes by what was set when it began.
    let second = replayed_events(folder, "first/recording-2.mcap");
    assert!(second.lines().count() > 10);
    assert_eq!(saved_slip_nis(folder.join("first/parameters.toml")), 20.0);

    // The next run begins with what was saved.
    let (station, mut gcs) = start(folder, "first/parameters.toml", "second");
    gcs.send(&Message::ParamRequestRead { target: STATION, name: "slip_nis".to_owned(), index: -1 });
    assert_eq!(gcs.value("slip_nis"), 20.0);
    station.interrupt();
}

fn saved_slip_nis(path: PathBuf) -> f64 {
    let text = std::fs::read_to_string(path).unwrap();
    let table: toml::Table = toml::from_str(&text).unwrap();
    table["filter"]["slip_nis"].as_float().unwrap()
}
