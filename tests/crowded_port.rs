//! Five hundred peers on one UDP port, of which one is silent and one has gone mad, through the engine with a framer for each.
//!
//! With real sockets in real time: the mad one sends as fast as a thread can. The robots speak in rounds and wait for the end of
//! each, so that it is never they who are too fast. `crates/link/tests/flood.rs` has the same for the link alone, and
//! `crates/station/tests/peers.rs` for the engine alone.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and pick the events that they are about"
)]

use std::collections::BTreeSet;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use posebridge::config::load_text;
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_station::Station;
use posebridge_telemetry::{
    Address, EncoderTicks, Event, HostClock, Input, LinkHealth, LinkId, LinkState, Observation, ObservationKind,
    Output, RobotId, SourceHealth, Timestamp,
};

const ROBOTS: u32 = 498;
const ROUNDS: u32 = 20;
/// Datagrams of garbage that have to be there before the robots begin.
const HEAD_START: u64 = 5_000;
const LINK: LinkId = LinkId(0);
/// By so many frames the sequence numbers of two robots with one address differ.
const AHEAD: u32 = 60;
/// Bytes of a datagram of garbage; those of the robots are shorter.
const GARBAGE: usize = 200;
/// Where the counts of each robot's wheels begin: so many behind those of the robot before it.
const COUNTS_PER_ROBOT: u32 = 1_000;

fn socket() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").expect("a free port")
}

/// Two robots share each address, for eight bits of system ids run out.
fn address(robot: u32) -> Address {
    Address::new(2 + (robot % 249) as u8, 1)
}

/// A robot with a socket of its own.
struct Robot {
    number: u32,
    socket: UdpSocket,
    encoder: Encoder,
}

impl Robot {
    /// Of two robots with one address the second has spoken elsewhere before: its sequence numbers are others.
    fn new(number: u32) -> Self {
        let mut encoder = Encoder::new(WireVersion::V2);
        for _ in 0..AHEAD * (number / 249) {
            encoder.encode(address(number), &HEARTBEAT, &mut Vec::new());
        }
        Self { number, socket: socket(), encoder }
    }

    /// A datagram with a heartbeat and with its wheels, which no other robot has turned so far.
    fn speak(&mut self, to: SocketAddr, round: u32) {
        let mut datagram = Vec::new();
        let count = i64::from(self.number * COUNTS_PER_ROBOT + round);
        let wheels = Message::WheelTicks(WheelTicks {
            stamp: WireStamp::Micros32(1_000_000 + round * 1_000),
            left: EncoderTicks(count),
            right: EncoderTicks(-count),
        });
        for message in [&HEARTBEAT, &wheels] {
            let from = address(self.number);
            self.encoder.encode(from, message, &mut datagram);
        }
        let sent = self.socket.send_to(&datagram, to);
        assert_eq!(sent.expect("loopback"), datagram.len());
    }
}

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

/// Sends as fast as it can until told to stop: what would be ODOMETRY of 2/1, as whole as the datagram, but for its checksum.
fn rave(to: SocketAddr, stop: &AtomicBool) {
    let mad = socket();
    let mut garbage = [0x55_u8; GARBAGE];
    garbage[..10].copy_from_slice(&[0xFD, (GARBAGE - 12) as u8, 0, 0, 0, 2, 1, 0x4B, 0x01, 0x00]);
    while !stop.load(Ordering::Relaxed) {
        garbage[4] = garbage[4].wrapping_add(1);
        // A full buffer is its own fault.
        drop(mad.send_to(&garbage, to));
    }
}

/// Each robot sends once per round; the next round begins when all of this one were heard.
fn speak(to: SocketAddr, stop: &AtomicBool, heard: &AtomicU64) {
    let mut robots: Vec<Robot> = (0..ROBOTS).map(Robot::new).collect();
    for round in 0..ROUNDS {
        for robot in &mut robots {
            robot.speak(to, round);
        }
        let wanted = u64::from(ROBOTS * (round + 1));
        while heard.load(Ordering::Relaxed) < wanted && !stop.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
    }
}

/// A port with its engine.
struct TestStation {
    port: Link,
    timer: HostTimer,
    station: Station,
    health: LinkHealth,
    sources: Vec<SourceHealth>,
    observations: Vec<(RobotId, Observation)>,
    garbage: u64,
    /// Datagrams of robots, for the thread that sends them.
    good: Arc<AtomicU64>,
}

impl TestStation {
    async fn open() -> Self {
        let url = "udp://127.0.0.1:0";
        let text = format!("[[link]]\nurl = \"{url}\"\nlisten = true\n");
        let config = load_text("test", &text, &[]).expect("a configuration");
        let config = config.config.station_config().expect("a configuration");
        let port = LinkOpenConfig { id: LINK, url: url.parse().expect("a link"), role: ConnectRole::Listen };
        let timer = HostTimer::start();
        let mut station = Self {
            port: Link::new(port, timer),
            timer,
            station: Station::new(config, Timestamp::ZERO).expect("a configuration"),
            health: LinkHealth::default(),
            sources: Vec::new(),
            observations: Vec::new(),
            garbage: 0,
            good: Arc::default(),
        };
        station.port.try_open().await.expect("a free port");
        station
    }

    fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) {
        self.station.handle(now, input);
        while let Some(output) = self.station.poll() {
            match output {
                Output::Event(Event::ObservationAligned { robot, observation, .. }) => {
                    self.observations.push((robot, observation));
                }
                Output::Event(Event::Health { health, sources, .. }) => (self.health, self.sources) = (health, sources),
                _ => {}
            }
        }
    }

    /// The next thing that happens; garbage is the engine's business like everything else.
    async fn step(&mut self) {
        let due = self.station.deadline().expect("health is told for ever");
        let (link, state) = (LINK, LinkState::Up);
        let mut is_good = false;
        let (now, input) = tokio::select! {
            event = self.port.next_event() => match event {
                LinkEvent::Bytes { peer, arrival, bytes } => {
                    is_good = bytes.len() < GARBAGE;
                    self.garbage += u64::from(!is_good);
                    (arrival, Input::Bytes { link, peer, bytes })
                }
                LinkEvent::Up { at, .. } => (at, Input::Link { link, state }),
                other => panic!("{other:?} on loopback"),
            },
            () = self.timer.sleep_until(due) => (self.timer.now(), Input::Tick),
        };
        self.handle(now, &input);
        self.good.fetch_add(u64::from(is_good), Ordering::Relaxed);
    }

    /// Goes on until it is enough; gives up after 30 seconds, and what is missing then is told by the assertions.
    async fn run(&mut self, is_enough: impl Fn(&Self) -> bool) {
        let all = async {
            while !is_enough(self) {
                self.step().await;
            }
        };
        drop(tokio::time::timeout(Duration::from_secs(30), all).await);
    }
}

#[tokio::test(flavor = "current_thread")]
async fn of_five_hundred_peers_a_mad_one_costs_nobody_a_frame() {
    let mut station = TestStation::open().await;
    let address_of_station = station.port.local_address().expect("it listens");
    let silent = socket();
    silent.connect(address_of_station).expect("loopback");
    let stop = Arc::new(AtomicBool::new(false));
    let mad = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || rave(address_of_station, &stop)
    });
    station.run(|station| station.garbage >= HEAD_START).await;
    let begun = station.timer.now();
    let good = Arc::clone(&station.good);
    let senders = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || speak(address_of_station, &stop, &good)
    });
    let datagrams = u64::from(ROBOTS * ROUNDS);
    station.run(|station| station.good.load(Ordering::Relaxed) >= datagrams).await;
    let secs = (station.timer.now() - begun).as_secs_f64();
    stop.store(true, Ordering::Relaxed);
    mad.join().expect("it only sends");
    senders.join().expect("they only send");
    station.run(|station| station.health.frames_in >= 2 * datagrams).await;

    let health = station.health;
    println!(
        "{} frames of {ROBOTS} robots in {secs:.3} s beside {} datagrams of garbage: {} checksum errors, {} lost",
        health.frames_in, station.garbage, health.checksum_errors, health.frames_lost
    );
    assert_eq!(health.frames_in, 2 * datagrams);
    assert_eq!(health.frames_lost, 0);
    assert!(health.checksum_errors >= HEAD_START);
    assert_eq!(station.sources, expected_sources());
    assert_eq!(station.port.port_counts().peers, ROBOTS + 1, "the silent one is not known");
    check_observations(&station);
}

fn expected_sources() -> Vec<SourceHealth> {
    let source = |robot| SourceHealth { source: address(robot), frames: u64::from(4 * ROUNDS), lost: 0 };
    (0..249).map(source).collect()
}

/// As many robots are followed as there is room for, each by the counts of its own wheels.
fn check_observations(station: &TestStation) {
    let tick_rad = station.station.geometry().tick.0;
    let mut followed = BTreeSet::new();
    for (robot, observation) in &station.observations {
        let ObservationKind::WheelAngles { left, right } = observation.measurement else {
            panic!("nobody has sent {observation:?}");
        };
        let counts = (left.0 / tick_rad).round() as u32;
        assert_eq!((right.0 / tick_rad).round(), -f64::from(counts));
        assert_eq!(address(counts / COUNTS_PER_ROBOT), robot.address, "{robot} was given somebody else's counts");
        followed.insert(*robot);
    }
    assert_eq!(followed.len(), 64, "the limit of robots");
    assert!(station.observations.len() >= 64 * (ROUNDS - 1) as usize, "{}", station.observations.len());
}
