//! Ground stations beside the program: they see the robot and its estimator, lose nothing of either, and get what they ask for.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::collections::BTreeMap;
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::time::Duration;

use posebridge_protocol::dialect::{Encoder, PayloadError, decode, ids};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind, WireVersion};
use posebridge_protocol::message::{
    AutopilotVersion, CommandAck, CommandLong, Heartbeat, Message, MessageInterval, OdometryPose, SetMessageInterval,
};
use posebridge_telemetry::{Address, TimeDelta, Timestamp};
use support::{RunningProgram, posebridge};

const ROBOT: Address = Address::new(1, 1);
const ESTIMATOR: Address = Address::new(1, 197);
const CAMERA: Address = Address::new(1, 100);
const GCS: Address = Address::new(255, 190);
/// MAV_RESULT of the answers.
const ACCEPTED: u8 = 0;
const UNSUPPORTED: u8 = 3;
/// A command of no definition.
const NO_COMMAND: u16 = 65_000;

/// Only a test that fails waits for so long.
const PATIENCE: Duration = Duration::from_secs(30);
/// So many datagrams come in about a minute: then what was waited for does not come any more.
const MOST_DATAGRAMS: usize = 6_000;

/// A ground station: it knows the wire, and nothing of the program.
struct GroundStation {
    socket: UdpSocket,
    station: Option<SocketAddr>,
    framer: Framer,
    encoder: Encoder,
    /// Of each sender the last number, frames, and those that are missing.
    senders: BTreeMap<Address, (u8, u32, u32)>,
    messages: Vec<(Address, Message)>,
    damaged: u32,
}

impl GroundStation {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.set_read_timeout(Some(PATIENCE)).expect("it can wait");
        Self {
            socket,
            station: None,
            framer: Framer::new(FramerConfig { transport: TransportKind::Datagram, ..FramerConfig::default() }),
            encoder: Encoder::new(WireVersion::V2),
            senders: BTreeMap::new(),
            messages: Vec::new(),
            damaged: 0,
        }
    }

    fn address(&self) -> SocketAddr {
        self.socket.local_addr().expect("it is bound")
    }

    fn send(&mut self, message: &Message) {
        let mut bytes = Vec::new();
        self.encoder.encode(GCS, message, &mut bytes);
        let station = self.station.expect("it was heard or named");
        self.socket.send_to(&bytes, station).expect("it is sent");
    }

    fn command(&mut self, target: Address, command: u16, first: u32) {
        let mut params = [0.0; 7];
        params[0] = first as f32;
        self.send(&Message::Command(CommandLong { target, command, params }));
    }

    /// Takes one datagram.
    fn receive(&mut self) {
        let mut buffer = [0; 2_048];
        let (length, from) = self.socket.recv_from(&mut buffer).expect("it arrives");
        self.station = Some(from);
        let (senders, said, damaged) = (&mut self.senders, &mut self.messages, &mut self.damaged);
        let mut sink = |scanned: FramerOutput<'_>| match scanned {
            FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame) => {
                let sender = senders.entry(frame.source);
                let (last, frames, lost) = sender.or_insert((frame.sequence.wrapping_sub(1), 0, 0));
                *lost += u32::from(frame.sequence.wrapping_sub(*last).wrapping_sub(1));
                *last = frame.sequence;
                *frames += 1;
                let message = match decode(&frame) {
                    // Before the first fix an ODOMETRY says that it is none.
                    Err(PayloadError::SenderFailed { .. }) => None,
                    other => other.expect("it makes sense"),
                };
                said.extend(message.map(|message| (frame.source, message)));
            }
            FramerOutput::Error(_) => *damaged += 1,
        };
        self.framer.push(Timestamp::ZERO, &buffer[..length], &mut sink);
    }

    /// Listens until somebody says what is waited for, from now on.
    fn wait_for(&mut self, what: &str, is_it: impl Fn(Address, &Message) -> bool) -> Message {
        let mut seen = self.messages.len();
        for _ in 0..MOST_DATAGRAMS {
            self.receive();
            for (from, message) in &self.messages[seen..] {
                if is_it(*from, message) {
                    return message.clone();
                }
            }
            seen = self.messages.len();
        }
        panic!("{what} does not come; heard: {:?}", self.senders);
    }

    /// Waits for the answer to a command.
    fn answer(&mut self, of: Address, command: u16) -> u8 {
        let is_it = |from, message: &Message| {
            from == of && matches!(message, Message::CommandAck(ack) if ack.command == command)
        };
        let answer = self.wait_for("an answer", is_it);
        let Message::CommandAck(CommandAck { result, target, .. }) = answer else {
            unreachable!("it was chosen so");
        };
        assert_eq!(target, Some(GCS));
        result
    }

    /// How many heartbeats somebody has said so far.
    fn beats_of(&self, who: Address) -> usize {
        let beats = self.messages.iter();
        beats.filter(|(from, said)| *from == who && matches!(said, Message::Heartbeat(_))).count()
    }
}

/// Who is there, with what they say of themselves.
fn expect_heartbeats_of_both(peer: &mut GroundStation) {
    for (who, vehicle_type, autopilot) in [(ROBOT, 10, 0), (ESTIMATOR, 18, 8)] {
        let beat =
            peer.wait_for("a heartbeat", |from, message| from == who && matches!(message, Message::Heartbeat(_)));
        let expected = Heartbeat { vehicle_type, autopilot, base_mode: 0, system_status: 4 };
        assert_eq!(beat, Message::Heartbeat(expected), "{who}");
    }
}

/// The estimate, each message from whom ground stations take it.
fn expect_estimate(peer: &mut GroundStation) {
    peer.wait_for("ATTITUDE of the robot", |from, message| {
        from == ROBOT && matches!(message, Message::Attitude { .. })
    });
    peer.wait_for("ODOMETRY", |from, message| {
        // The decoder takes MAV_FRAME_LOCAL_FRD for a floor of its own.
        from == ESTIMATOR
            && matches!(message, Message::Odometry(said)
                if matches!(said.pose, OdometryPose::Odom(_)) && said.covariance.is_some())
    });
    peer.wait_for("LOCAL_POSITION_NED", |from, message| {
        from == ESTIMATOR && matches!(message, Message::LocalPosition { .. })
    });
    peer.wait_for("ESTIMATOR_STATUS", |from, message| {
        from == ESTIMATOR && matches!(message, Message::EstimatorStatus(_))
    });
}

/// Commands and requests; `vehicle` is what becomes of those that the robot itself must answer if it can.
fn request_parameters(peer: &mut GroundStation, vehicle: u8) {
    for who in [ROBOT, ESTIMATOR] {
        peer.command(who, NO_COMMAND, 0);
        assert_eq!(peer.answer(who, NO_COMMAND), UNSUPPORTED, "{who}");
    }
    peer.command(ESTIMATOR, ids::COMMAND_REQUEST_MESSAGE, ids::AUTOPILOT_VERSION);
    assert_eq!(peer.answer(ESTIMATOR, ids::COMMAND_REQUEST_MESSAGE), ACCEPTED);
    let version = peer.wait_for("AUTOPILOT_VERSION", |from, message| {
        from == ESTIMATOR && matches!(message, Message::AutopilotVersion(_))
    });
    let Message::AutopilotVersion(AutopilotVersion { capabilities, .. }) = version else {
        unreachable!("it was chosen so");
    };
    // COMMAND_INT, PARAM_ENCODE_BYTEWISE, MAVLINK2.
    assert_eq!(capabilities, 8 + 16 + 8_192);
    peer.command(ROBOT, ids::COMMAND_REQUEST_MESSAGE, ids::AUTOPILOT_VERSION);
    assert_eq!(peer.answer(ROBOT, ids::COMMAND_REQUEST_MESSAGE), vehicle);
    peer.command(ESTIMATOR, ids::COMMAND_REQUEST_MESSAGE, 60_000);
    assert_eq!(peer.answer(ESTIMATOR, ids::COMMAND_REQUEST_MESSAGE), UNSUPPORTED);
}

/// The robot's attitude is slowed down, and the NIS, of which nothing came, is asked for.
fn sets_intervals(peer: &mut GroundStation) {
    let is_nis = |message: &Message| matches!(message, Message::NamedValue(_));
    assert!(peer.messages.iter().all(|(_, message)| !is_nis(message)));
    for (target, message_id, millis) in [(ROBOT, ids::ATTITUDE, 400), (ESTIMATOR, ids::NAMED_VALUE_FLOAT, 50)] {
        peer.send(&Message::SetMessageInterval(SetMessageInterval {
            target,
            message_id,
            interval: Some(TimeDelta::from_millis(millis)),
        }));
        let answer = peer.answer(target, ids::COMMAND_SET_MESSAGE_INTERVAL);
        assert_eq!(answer, ACCEPTED, "{target}");
    }
    peer.wait_for("NAMED_VALUE_FLOAT", |from, message| from == ESTIMATOR && is_nis(message));
    peer.command(ROBOT, ids::COMMAND_GET_MESSAGE_INTERVAL, ids::ATTITUDE);
    assert_eq!(peer.answer(ROBOT, ids::COMMAND_GET_MESSAGE_INTERVAL), ACCEPTED);
    let told = peer
        .wait_for("MESSAGE_INTERVAL", |from, message| from == ROBOT && matches!(message, Message::MessageInterval(_)));
    let expected = MessageInterval { message_id: 30, interval_micros: 400_000 };
    assert_eq!(told, Message::MessageInterval(expected));
    let seen = peer.messages.len();
    let beats = peer.beats_of(ESTIMATOR);
    while peer.beats_of(ESTIMATOR) < beats + 3 {
        peer.receive();
    }
    let attitudes = peer.messages[seen..]
        .iter()
        .filter(|(from, message)| *from == ROBOT && matches!(message, Message::Attitude { .. }));
    // Between two and three seconds at 2.5 Hz; at 10 Hz it would be 20 and more.
    assert!((4..=9).contains(&attitudes.count()));
}

fn has_lost_nothing(peer: &GroundStation) {
    assert_eq!(peer.damaged, 0);
    // The camera's answers to the station's time requests are not for a ground station; that must not look like a loss either.
    for who in [ROBOT, ESTIMATOR, CAMERA] {
        let (_, frames, lost) = peer.senders[&who];
        assert!(frames > 20, "{who}: {frames}");
        assert_eq!(lost, 0, "{who}: {frames} frames");
    }
    let (robot, estimator) = (peer.beats_of(ROBOT), peer.beats_of(ESTIMATOR));
    assert!(robot.abs_diff(estimator) <= 2, "{robot} and {estimator} heartbeats: one of them twice");
}

/// Beside a brick that speaks MAVLink itself: its frames and ours bear one address, and nobody can tell.
#[test]
fn a_brick_that_speaks_mavlink_and_its_estimator_are_seen_without_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    let mut peer = GroundStation::new();
    let gcs = format!("udp://{}", peer.address());
    let mut run = posebridge(folder.path());
    run.args(["run", "--link", "sim://square", "--gcs", &gcs, "--no-record"]);
    let _station = RunningProgram::start(&mut run);
    expect_heartbeats_of_both(&mut peer);
    expect_estimate(&mut peer);
    // The brick's own telemetry is passed on as well.
    peer.wait_for("PB_WHEEL_TICKS", |from, message| from == ROBOT && matches!(message, Message::WheelTicks(_)));
    request_parameters(&mut peer, UNSUPPORTED);
    sets_intervals(&mut peer);
    has_lost_nothing(&peer);
}

/// Beside a brick that speaks no MAVLink: the station is its voice.
#[test]
fn a_brick_that_speaks_no_mavlink_is_a_vehicle_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let mut brick = nxt(folder.path());
    let camera = format!("tcp://{}", brick.listening_address("camera "));
    let mut run = posebridge(folder.path());
    run.args(["run", "--link", "serial:brick.tty", "--brick", "nxt"]);
    run.args(["--link", &camera, "--robot", "robot.toml"]);
    run.args(["--gcs", "udp://:0", "--no-record"]);
    let mut station = RunningProgram::start(&mut run);
    let mut peer = GroundStation::new();
    let address = station.listening_address("");
    peer.station = Some(address.parse().expect("an address"));
    peer.send(&Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 }));
    expect_heartbeats_of_both(&mut peer);
    expect_estimate(&mut peer);
    request_parameters(&mut peer, ACCEPTED);
    sets_intervals(&mut peer);
    has_lost_nothing(&peer);
}

/// The simulated NXT with its camera; they drive as long as the test listens.
fn nxt(folder: &Path) -> RunningProgram {
    const SQUARE: &str = r#"
seed = 5
steering = "estimate"

[path.square]
side_m = 0.3

[drive]
laps = 20
speed_m_per_s = 0.2
"#;
    const ROBOT: &str = r#"
[robot]
adopt_description = false

[robot.nxt]
sensor = [{ port = 1, kind = "ht-gyro" }]
"#;
    std::fs::write(folder.join("small.toml"), SQUARE).expect("it is written");
    std::fs::write(folder.join("robot.toml"), ROBOT).expect("it is written");
    let mut sim = posebridge(folder);
    sim.args(["sim", "small.toml", "--brick", "nxt"]);
    sim.args(["--listen", "pty:brick.tty", "--camera-listen", "tcp://127.0.0.1:0"]);
    RunningProgram::start(&mut sim)
}
