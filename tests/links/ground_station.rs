//! A ground station beside the program: it sees a robot that speaks no MAVLink and its estimator, and it tunes and commands a station.

use std::net::UdpSocket;
use std::path::Path;

use crate::support::mavlink::{GCS_HEARTBEAT, MavlinkPeer, PATIENCE};
use crate::support::{RunningProgram, read_text, run, write_text};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    CommandLong, Heartbeat, Message, MessageInterval, OdometryPose, SetMessageInterval,
};
use posebridge_telemetry::{Address, TimeDelta};

const ROBOT: Address = Address::new(1, 1);
const ESTIMATOR: Address = Address::new(1, 197);
const GCS: Address = Address::new(254, 190);

/// MAV_RESULT of the answers.
const ACCEPTED: u8 = 0;
const UNSUPPORTED: u8 = 3;

/// A command of no definition.
const NO_COMMAND: u16 = 65_000;
const PREFLIGHT_STORAGE: u16 = 245;
const LOGGING_START: u16 = 2_510;
const LOGGING_STOP: u16 = 2_511;

/// So often among what it hears a ground station shows that it is there: the station forgets who is silent.
const DATAGRAMS_PER_HEARTBEAT: u32 = 20;

/// A brick that drives squares for as long as anybody looks.
const SCENARIO: &str = include_str!("../data/endless-square.toml");

/// A ground station on UDP.
struct GroundStation {
    socket: UdpSocket,
    peer: MavlinkPeer,
    /// What has come and was not looked at.
    waiting: Vec<(Address, Message)>,
    datagrams: u32,
}

impl GroundStation {
    fn call(station: &str) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.connect(station).expect("an address");
        socket.set_read_timeout(Some(PATIENCE)).expect("it can wait");
        let mut gcs = Self { socket, peer: MavlinkPeer::new(GCS), waiting: Vec::new(), datagrams: 0 };
        gcs.send(&GCS_HEARTBEAT);
        gcs
    }

    fn send(&mut self, message: &Message) {
        let frame = self.peer.frame(message);
        self.socket.send(&frame).expect("it is sent");
    }

    /// The next message for which `take` has an answer.
    fn wait_for<T>(&mut self, take: impl Fn(Address, &Message) -> Option<T>) -> T {
        loop {
            while !self.waiting.is_empty() {
                let (from, message) = self.waiting.remove(0);
                if let Some(taken) = take(from, &message) {
                    return taken;
                }
            }
            let mut buffer = [0; 2_048];
            let length = self.socket.recv(&mut buffer).expect("it arrives");
            self.waiting = self.peer.decode(&buffer[..length]);
            self.datagrams += 1;
            if self.datagrams.is_multiple_of(DATAGRAMS_PER_HEARTBEAT) {
                self.send(&GCS_HEARTBEAT);
            }
        }
    }

    /// Waits until somebody says something of a kind.
    fn hear(&mut self, from: Address, is_kind: impl Fn(&Message) -> bool) {
        self.wait_for(|sender, message| (sender == from && is_kind(message)).then_some(()));
    }

    /// Gives a command, and returns the result in its answer.
    fn command(&mut self, target: Address, command: u16, first: &[f32]) -> u8 {
        let mut params = [0.0; 7];
        params[..first.len()].copy_from_slice(first);
        self.send(&Message::Command(CommandLong { target, command, params }));
        self.answer(target, command)
    }

    fn answer(&mut self, target: Address, command: u16) -> u8 {
        let answer = self.wait_for(|from, message| match message {
            Message::CommandAck(ack) if from == target && ack.command == command => Some(*ack),
            _ => None,
        });
        assert_eq!(answer.target, Some(GCS));
        answer.result
    }

    fn value(&mut self, wanted: &str) -> f32 {
        self.wait_for(|_, message| match message {
            Message::ParamValue { name, value, .. } if name.eq_ignore_ascii_case(wanted) => Some(*value),
            _ => None,
        })
    }

    fn text(&mut self, beginning: &str) -> String {
        self.wait_for(|_, message| match message {
            Message::StatusText { text, .. } if text.starts_with(beginning) => Some(text.clone()),
            _ => None,
        })
    }

    fn hear_estimates(&mut self, count: usize) {
        for _ in 0..count {
            self.hear(ESTIMATOR, |message| matches!(message, Message::PlanarPose(_)));
        }
    }

    fn set(&mut self, name: &str, value: f32) -> f32 {
        self.send(&Message::ParamSet { target: ESTIMATOR, name: name.to_owned(), value });
        self.value(name)
    }
}

/// Over a pseudo-terminal, with the camera on a link of its own: the station is the robot's voice.
#[test]
fn a_brick_that_speaks_no_mavlink_is_a_vehicle_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "endless.toml", SCENARIO);
    let robot = "[robot]\nadopt_description = false\n[robot.nxt]\nsensor = [{ port = 1, kind = \"ht-gyro\" }]\n";
    write_text(folder, "robot.toml", robot);
    let sim = ["sim", "endless.toml", "--brick", "nxt", "--listen", "pty:brick.tty"];
    let camera = ["--camera-listen", "tcp://127.0.0.1:0"];
    let mut brick = RunningProgram::posebridge(folder, &[&sim[..], &camera].concat());
    let camera = format!("tcp://{}", brick.listening_address("camera "));
    let run = ["run", "--link", "serial:brick.tty", "--brick", "nxt", "--link", &camera, "--robot", "robot.toml"];
    let mut station = RunningProgram::posebridge(folder, &[&run[..], &["--gcs", "udp://:0", "--no-record"]].concat());
    let mut gcs = GroundStation::call(&station.listening_address(""));
    for (who, vehicle_type, autopilot) in [(ROBOT, 10, 0), (ESTIMATOR, 18, 8)] {
        let expected = Heartbeat { vehicle_type, autopilot, base_mode: 0, system_status: 4 };
        gcs.hear(who, |message| *message == Message::Heartbeat(expected));
    }
    // The estimate, each message from whom ground stations take it.
    gcs.hear(ROBOT, |message| matches!(message, Message::Attitude { .. }));
    gcs.hear(ESTIMATOR, |message| match message {
        // The decoder takes MAV_FRAME_LOCAL_FRD for a floor of its own.
        Message::Odometry(said) => matches!(said.pose, OdometryPose::Odom(_)) && said.covariance.is_some(),
        _ => false,
    });
    gcs.hear(ESTIMATOR, |message| matches!(message, Message::LocalPosition { .. }));
    gcs.hear(ESTIMATOR, |message| matches!(message, Message::EstimatorStatus(_)));
    for who in [ROBOT, ESTIMATOR] {
        assert_eq!(gcs.command(who, NO_COMMAND, &[]), UNSUPPORTED, "{who}");
        assert_eq!(gcs.command(who, ids::COMMAND_REQUEST_MESSAGE, &[ids::AUTOPILOT_VERSION as f32]), ACCEPTED);
        let capabilities = gcs.wait_for(|from, message| match message {
            Message::AutopilotVersion(version) if from == who => Some(version.capabilities),
            _ => None,
        });
        // COMMAND_INT, PARAM_ENCODE_BYTEWISE, MAVLINK2: of the estimator, which has parameters.
        assert!(who == ROBOT || capabilities == 8 + 16 + 8_192, "{capabilities}");
    }
    let (target, message_id, interval) = (ROBOT, ids::ATTITUDE, Some(TimeDelta::from_millis(400)));
    gcs.send(&Message::SetMessageInterval(SetMessageInterval { target, message_id, interval }));
    assert_eq!(gcs.answer(ROBOT, ids::COMMAND_SET_MESSAGE_INTERVAL), ACCEPTED);
    assert_eq!(gcs.command(ROBOT, ids::COMMAND_GET_MESSAGE_INTERVAL, &[ids::ATTITUDE as f32]), ACCEPTED);
    let expected = MessageInterval { message_id: 30, interval_micros: 400_000 };
    gcs.hear(ROBOT, |message| *message == Message::MessageInterval(expected));
}

fn start(folder: &Path, config: &str, out: &str) -> (RunningProgram, GroundStation) {
    let run = ["run", "--config", config, "--out", out, "--events", &format!("{out}.txt")];
    let mut station = RunningProgram::posebridge(folder, &run);
    let gcs = GroundStation::call(&station.listening_address(""));
    station.wait_for("robot 1/254/190 detected");
    (station, gcs)
}

/// Sets, refuses, saves, goes back to what was saved, and begins a second recording.
fn tune_and_record(gcs: &mut GroundStation) {
    assert_eq!(gcs.set("slip_nis", 20.0), 20.0);
    assert_eq!(gcs.set("slip_nis", 1e6), 20.0, "what stands");
    gcs.text("slip_nis 1000000.0 not in 4..100");
    gcs.hear_estimates(150);
    assert_eq!(gcs.command(ESTIMATOR, PREFLIGHT_STORAGE, &[1.0]), ACCEPTED);
    assert_eq!(gcs.text("saved "), "saved parameters.toml in first");
    assert_eq!(gcs.set("slip_nis", 50.0), 50.0);
    assert_eq!(gcs.command(ESTIMATOR, PREFLIGHT_STORAGE, &[0.0]), ACCEPTED);
    assert_eq!(gcs.command(ESTIMATOR, LOGGING_STOP, &[]), ACCEPTED);
    assert_eq!(gcs.text("recorded "), "recorded recording.mcap in first");
    assert_eq!(gcs.command(ESTIMATOR, LOGGING_START, &[]), ACCEPTED);
    assert_eq!(gcs.text("recording "), "recording recording-2.mcap in first");
    gcs.hear_estimates(1);
}

#[test]
fn a_ground_station_tunes_a_running_station_and_the_replay_does_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "endless.toml", SCENARIO);
    let links = "[[link]]\nurl = \"sim://endless.toml\"\n\n[[link]]\nurl = \"udp://127.0.0.1:0\"\nlisten = true\n\
                 outputs = [{ message = \"planar_pose\" }]\n";
    write_text(folder, "station.toml", links);
    let (station, mut gcs) = start(folder, "station.toml", "first");
    tune_and_record(&mut gcs);
    let printed = station.interrupt();
    for name in ["first/recording.mcap", "first/recording-2.mcap"] {
        assert!(printed.contains(name), "{printed}");
    }
    // All that happened until the recording was stopped happens again, word for word.
    run(folder, &["replay", "first/recording.mcap", "--events", "replayed.txt"]);
    let (live, replayed) = (read_text(folder, "first.txt"), read_text(folder, "replayed.txt"));
    assert!(replayed.lines().count() > 500, "{}", replayed.lines().count());
    for (number, (live, replayed)) in live.lines().zip(replayed.lines()).enumerate() {
        assert_eq!(live, replayed, "event {number}");
    }
    for requested in [
        "slip_nis set to 20 (was 10.83)",
        "slip_nis 1000000.0 not in 4..100",
        "saved parameters.toml in first",
        "parameters as saved last",
        "the recording's end was asked for",
    ] {
        assert!(replayed.contains(requested), "{requested}");
    }
    // The second one goes by what was set when it began.
    run(folder, &["replay", "first/recording-2.mcap"]);

    // The next run begins with what was saved.
    let (station, mut gcs) = start(folder, "first/parameters.toml", "second");
    gcs.send(&Message::ParamRequestRead { target: ESTIMATOR, name: "slip_nis".to_owned(), index: -1 });
    assert_eq!(gcs.value("slip_nis"), 20.0);
    station.interrupt();
}
