//! The program between a brick, a camera and a ground station: each gets what is meant for it, byte for byte.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::io::{Read as _, Write as _};
use std::net::{TcpStream, UdpSocket};
use std::time::Duration;

use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{CommandAck, CommandLong, Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks};
use support::{RunningProgram, events_named, posebridge, stdout_of};

const BRICK: Address = Address::new(1, 1);
const CAMERA: Address = Address::new(2, 100);
const GCS: Address = Address::new(254, 190);

/// Only a test that fails waits for so long.
const PATIENCE: Duration = Duration::from_secs(30);

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

const CONFIG: &str = r#"
[[link]]
url = "udp://127.0.0.1:0"
listen = true

[[link]]
url = "udp://127.0.0.1:0"
listen = true
outputs = []

[[link]]
url = "tcp://127.0.0.1:0"
listen = true
outputs = []
"#;

/// A participant's sequence numbers.
struct FrameSource(Address, Encoder);

impl FrameSource {
    fn new(address: Address) -> Self {
        Self(address, Encoder::new(WireVersion::V2))
    }

    fn frame(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.1.encode(self.0, message, &mut bytes);
        bytes
    }
}

fn socket(station: &str) -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
    socket.connect(station).expect("an address");
    socket.set_read_timeout(Some(PATIENCE)).expect("it can wait");
    socket
}

/// Everything that arrives up to and with `last`.
fn datagrams_until(socket: &UdpSocket, last: &[u8]) -> Vec<Vec<u8>> {
    let mut heard = Vec::new();
    let mut buffer = [0; 2_048];
    while heard.last().is_none_or(|datagram| datagram != last) {
        let length = socket.recv(&mut buffer).expect("it arrives");
        heard.push(buffer[..length].to_vec());
    }
    heard
}

/// Reads until the bytes hold `wanted`.
fn read_until(stream: &mut TcpStream, heard: &mut Vec<u8>, wanted: &[u8]) {
    let mut buffer = [0; 2_048];
    while !holds(heard, wanted) {
        let length = stream.read(&mut buffer).expect("it arrives");
        assert!(length > 0, "the station hung up");
        heard.extend_from_slice(&buffer[..length]);
    }
}

fn holds(bytes: &[u8], wanted: &[u8]) -> bool {
    bytes.windows(wanted.len()).any(|window| window == wanted)
}

#[test]
fn a_ground_station_commands_the_brick_through_the_station_and_nobody_else_hears_it() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("three.toml"), CONFIG).unwrap();
    let mut station = RunningProgram::start(posebridge(folder.path()).args([
        "run",
        "--config",
        "three.toml",
        "--out",
        "run",
        "--events",
        "live.txt",
    ]));
    let brick = socket(&station.listening_address(""));
    let camera = socket(&station.listening_address(""));
    let mut gcs = TcpStream::connect(station.listening_address("")).unwrap();
    gcs.set_read_timeout(Some(PATIENCE)).unwrap();
    let (mut brick_says, mut camera_says, mut gcs_says) =
        (FrameSource::new(BRICK), FrameSource::new(CAMERA), FrameSource::new(GCS));

    brick.send(&brick_says.frame(&HEARTBEAT)).unwrap();
    station.wait_for("robot 0/1/1 detected");
    camera.send(&camera_says.frame(&HEARTBEAT)).unwrap();
    station.wait_for("robot 1/2/100 detected");
    gcs.write_all(&gcs_says.frame(&HEARTBEAT)).unwrap();
    station.wait_for("robot 2/254/190 detected");

    let command = gcs_says.frame(&Message::Command(CommandLong { target: BRICK, command: 400, params: [1.0; 7] }));
    gcs.write_all(&command).unwrap();
    datagrams_until(&brick, &command);

    let mut heard = Vec::new();
    let ack = brick_says.frame(&Message::CommandAck(CommandAck { command: 400, result: 0, target: Some(GCS) }));
    brick.send(&ack).unwrap();
    read_until(&mut gcs, &mut heard, &ack);

    // A message of no dialect, and telemetry that is used as well.
    let unknown = [0xFD, 5, 0, 0, 9, 1, 1, 0x60, 0xEA, 0x00, 1, 0, 254, 0, 9, 0xAB, 0xCD];
    brick.send(&unknown).unwrap();
    read_until(&mut gcs, &mut heard, &unknown);
    for frame in telemetry(&mut brick_says) {
        brick.send(&frame).unwrap();
        read_until(&mut gcs, &mut heard, &frame);
    }

    let marker = gcs_says.frame(&HEARTBEAT);
    gcs.write_all(&marker).unwrap();
    let at_camera = datagrams_until(&camera, &marker);
    assert!(at_camera.contains(&unknown.to_vec()));
    assert!(!at_camera.contains(&command) && !at_camera.contains(&ack));
    assert!(!holds(&heard, &marker), "nobody hears himself");

    // The first line of the status block: five seconds have passed, and the links have told of their health.
    station.wait_for("passed on to it");
    let tables = station.interrupt();
    for part in ["received on", "sent on", "link 2 254/190", "link 0 1/1"] {
        assert!(tables.contains(part), "`{part}` is missing:\n{tables}");
    }
    replays_bit_for_bit(folder.path());
}

/// A second of wheel ticks at 20 Hz.
fn telemetry(brick: &mut FrameSource) -> Vec<Vec<u8>> {
    let ticks = (0..20_u32).map(|k| {
        brick.frame(&Message::WheelTicks(WheelTicks {
            stamp: WireStamp::Micros32(5_000_000 + k * 50_000),
            left: EncoderTicks(0),
            right: EncoderTicks(0),
        }))
    });
    ticks.collect()
}

fn replays_bit_for_bit(folder: &std::path::Path) {
    stdout_of(posebridge(folder).args(["replay", "run/recording.mcap", "--events", "replayed.txt"]));
    let lines = |name: &str| std::fs::read_to_string(folder.join(name)).expect("events");
    let (live, replayed) = (lines("live.txt"), lines("replayed.txt"));
    assert_eq!(events_named(&live, "observed").len(), 20);
    assert!(live == replayed, "live:\n{live}\nreplayed:\n{replayed}");
}
