//! A ground station beside the program: it sees a robot that speaks no MAVLink and its estimator, and it tunes and commands a station.

use std::io::{Read as _, Write as _};
use std::net::{TcpStream, UdpSocket};
use std::path::Path;

use crate::support::mavlink::{GCS_HEARTBEAT, HEARTBEAT, MavlinkPeer, PATIENCE, wheel_ticks};
use crate::support::{RunningProgram, assert_replays, events_named, read_text, run, write_text};
use posebridge_estimator::PARAMS;
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    CommandAck, CommandLong, Heartbeat, Message, MessageInterval, OdometryPose, SetMessageInterval,
};
use posebridge_telemetry::{Address, TimeDelta};

const ROBOT: Address = Address::new(1, 1);
const ESTIMATOR: Address = Address::new(1, 197);
const ALL_OF_SYSTEM_1: Address = Address::new(1, 0);
const GCS: Address = Address::new(254, 190);

/// MAV_RESULT of the answers.
const ACCEPTED: u8 = 0;
const DENIED: u8 = 2;
const UNSUPPORTED: u8 = 3;

/// A command of no definition.
const NO_COMMAND: u16 = 65_000;
const PREFLIGHT_STORAGE: u16 = 245;
const LOGGING_START: u16 = 2_510;
const LOGGING_STOP: u16 = 2_511;
const CALIBRATION: u16 = 31_012;
const SOURCE: u16 = 31_013;
const CAMERA: f32 = 3.0;

/// So often among what it hears a ground station shows that it is there: the station forgets who is silent.
const DATAGRAMS_PER_HEARTBEAT: u32 = 20;

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

    fn set(&mut self, name: &str, value: f32) -> f32 {
        self.send(&Message::ParamSet { target: ESTIMATOR, name: name.to_owned(), value });
        self.value(name)
    }

    /// The largest of the position's sigmas in the next estimate for which `enough` holds.
    fn sigma_m_until(&mut self, enough: impl Fn(f64) -> bool) -> f64 {
        self.wait_for(|_, message| match message {
            Message::PlanarPose(pose) => {
                let sigma_m = pose.covariance[0].max(pose.covariance[3]).sqrt();
                enough(sigma_m).then_some(sigma_m)
            }
            _ => None,
        })
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

/// Sets, refuses, and switches the camera off and on: without it the robot knows less and less where it is.
fn tune_and_switch(gcs: &mut GroundStation) {
    gcs.send(&Message::ParamRequestList { target: ALL_OF_SYSTEM_1 });
    for (expected, row) in PARAMS.iter().enumerate() {
        let (name, value, count, index) = gcs.wait_for(|_, message| match message {
            Message::ParamValue { name, value, count, index } => Some((name.clone(), *value, *count, *index)),
            _ => None,
        });
        assert_eq!((name, value), (row.key.to_uppercase(), row.default as f32));
        assert_eq!((usize::from(count), usize::from(index)), (PARAMS.len(), expected));
    }
    assert_eq!(gcs.set("slip_nis", 20.0), 20.0);
    assert_eq!(gcs.set("slip_nis", 1e6), 20.0, "what stands");
    gcs.text("slip_nis 1000000.0 not in 4..100");
    let seen_m = gcs.sigma_m_until(|sigma_m| sigma_m < 0.02);
    assert_eq!(gcs.command(ESTIMATOR, SOURCE, &[CAMERA, 0.0]), ACCEPTED);
    gcs.sigma_m_until(|sigma_m| sigma_m > 2.0 * seen_m);
    assert_eq!(gcs.command(ESTIMATOR, CALIBRATION, &[0.0]), ACCEPTED);
    assert_eq!(gcs.command(ESTIMATOR, SOURCE, &[CAMERA, 1.0]), ACCEPTED);
    gcs.sigma_m_until(|sigma_m| sigma_m < 1.5 * seen_m);
    for (change, answer) in [(1.0, ACCEPTED), (2.0, ACCEPTED), (9.0, DENIED)] {
        assert_eq!(gcs.command(ESTIMATOR, CALIBRATION, &[change]), answer);
    }
}

/// Saves, goes back to what was saved, and begins a second recording.
fn save_and_record(gcs: &mut GroundStation) {
    assert_eq!(gcs.command(ESTIMATOR, PREFLIGHT_STORAGE, &[1.0]), ACCEPTED);
    assert_eq!(gcs.text("saved "), "saved parameters.toml in first");
    assert_eq!(gcs.set("slip_nis", 50.0), 50.0);
    assert_eq!(gcs.command(ESTIMATOR, PREFLIGHT_STORAGE, &[0.0]), ACCEPTED);
    assert_eq!(gcs.command(ESTIMATOR, LOGGING_STOP, &[]), ACCEPTED);
    assert_eq!(gcs.text("recorded "), "recorded recording.mcap in first");
    assert_eq!(gcs.command(ESTIMATOR, LOGGING_START, &[]), ACCEPTED);
    assert_eq!(gcs.text("recording "), "recording recording-2.mcap in first");
    gcs.sigma_m_until(|_| true);
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
    tune_and_switch(&mut gcs);
    save_and_record(&mut gcs);
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
        "source 3 (camera) is left out",
        "calibration frozen",
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

const ROUTED: &str = r#"
[[link]]
url = "udp://127.0.0.1:0"
listen = true

[[link]]
url = "tcp://127.0.0.1:0"
listen = true
outputs = []
"#;

/// Which frames go where is decided, and tested, in the station; here they pass through the real links.
#[test]
fn a_ground_station_commands_the_brick_through_the_station_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "two.toml", ROUTED);
    let run = ["run", "--config", "two.toml", "--out", "run", "--events", "live.txt"];
    let mut station = RunningProgram::posebridge(folder, &run);
    let brick = UdpSocket::bind("127.0.0.1:0").unwrap();
    brick.connect(station.listening_address("")).unwrap();
    brick.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut gcs = TcpStream::connect(station.listening_address("")).unwrap();
    gcs.set_read_timeout(Some(PATIENCE)).unwrap();
    let (mut brick_says, mut gcs_says) = (MavlinkPeer::new(ROBOT), MavlinkPeer::new(GCS));
    brick.send(&brick_says.frame(&HEARTBEAT)).unwrap();
    station.wait_for("robot 0/1/1 detected");
    gcs.write_all(&gcs_says.frame(&GCS_HEARTBEAT)).unwrap();
    station.wait_for("robot 1/254/190 detected");

    let command = gcs_says.frame(&Message::Command(CommandLong { target: ROBOT, command: 400, params: [1.0; 7] }));
    gcs.write_all(&command).unwrap();
    let mut buffer = [0; 2_048];
    loop {
        let length = brick.recv(&mut buffer).expect("it arrives");
        if buffer[..length] == command {
            break;
        }
    }
    let ack = brick_says.frame(&Message::CommandAck(CommandAck { command: 400, result: 0, target: Some(GCS) }));
    // A message of no dialect, and telemetry that is used as well.
    let unknown = vec![0xFD, 5, 0, 0, 9, 1, 1, 0x60, 0xEA, 0x00, 1, 0, 254, 0, 9, 0xAB, 0xCD];
    let ticks: Vec<Vec<u8>> = (0..20).map(|step| brick_says.frame(&wheel_ticks(step))).collect();
    let mut heard = Vec::new();
    for frame in [ack, unknown].into_iter().chain(ticks) {
        brick.send(&frame).unwrap();
        while !heard.windows(frame.len()).any(|window| window == frame) {
            let length = gcs.read(&mut buffer).expect("it arrives");
            assert!(length > 0, "the station hung up");
            heard.extend_from_slice(&buffer[..length]);
        }
    }
    // The first status block: the links have told of their health.
    station.wait_for("passed on to it");
    let tables = station.interrupt();
    for part in ["received on", "sent on", "link 1 254/190", "link 0 1/1"] {
        assert!(tables.contains(part), "`{part}` is missing:\n{tables}");
    }
    let events = assert_replays(folder, "run/recording.mcap", "live.txt");
    assert_eq!(events_named(&events, "observed").len(), 20);
}
