//! From the last byte of a telemetry frame to the estimate's datagram, beside a bare echo of the same sizes.
//!
//! A brick on a loopback UDP socket sends PB_WHEEL_TICKS and waits for PB_PLANAR_POSE; the station is the program's own station loop with its
//! recorder, its observer and a ground station on a second UDP link attached, which gets what such programs show. The echo answers each
//! datagram with one as long as the estimate, on a runtime of the same kind. Both take turns in one run, so that a busy machine
//! slows both. A second station runs six more filters beside the one that sends, which must not delay the estimate. Run with
//! `cargo bench --bench latency`.
//!
//! Most of what is measured is the wake-up of a sleeping thread by the kernel; the ratio is what the station adds.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a benchmark stops when its set-up is broken, prints its figures, and measures with the host's clock"
)]

use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use posebridge::config::{AtInstant, Config, FilterSection, LinkSection, OutputSection, RecordingLimits};
use posebridge::exit::DeferredErrors;
use posebridge::station::link_log::LinkLog;
use posebridge::station::live_status::LiveView;
use posebridge::station::observer::Observer;
use posebridge::station::recorder::Recorder;
use posebridge::station::requests::RequestHandler;
use posebridge::station::setup::SetupChecklists;
use posebridge::station::station_loop::{StationLoop, StopConditions};
use posebridge::station::watchdog::{OnStall, Watchdog};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkOpenConfig, LinkSet, LinkUrl};
use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_recording::container::RecordingHeader;
use posebridge_station::Station;
use posebridge_telemetry::{Address, EncoderTicks, LinkId, Timestamp};
use tokio_util::sync::CancellationToken;

/// How fast a brick talks, and for how long.
#[derive(Clone, Copy)]
struct TelemetryRate {
    /// Between two of its frames. The exchange below keeps it, so that history, clock and caches see it.
    period_micros: u32,
    rounds: usize,
    exchanges_per_round: usize,
}

/// 100 Hz is what the quickest weak bricks reach (EV3, Arduino-class); 1 kHz shows what a crowd on one link meets.
const TELEMETRY_RATES: [TelemetryRate; 2] = [
    TelemetryRate { period_micros: 10_000, rounds: 10, exchanges_per_round: 100 },
    TelemetryRate { period_micros: 1_000, rounds: 20, exchanges_per_round: 500 },
];
/// Those of the papers that use wheels, for the station that compares.
const COMPARED: [&str; 6] = ["odometry", "wheel-kf", "velocity-kf", "ekf5", "ukf5", "indirect"];
/// PB_PLANAR_POSE with its envelope.
const ESTIMATE_BYTES: usize = 64;

fn main() {
    TELEMETRY_RATES.into_iter().for_each(measure);
}

fn measure(pace: TelemetryRate) {
    let stop = CancellationToken::new();
    let many = start_echo(Threads::Many);
    let one = start_echo(Threads::One);
    let ground = GroundStation::new();
    let (station, thread) = start_station(stop.clone(), ground.address, &[]);
    let (comparing, comparing_thread) = start_station(stop.clone(), ground.address, &COMPARED);
    let mut brick = Brick::new(ground, pace);
    let [mut ours, mut compared, mut bare, mut bare_one] = [const { Vec::new() }; 4];
    for round in 0..=pace.rounds {
        let station_round = brick.exchange_with(station, ExpectedReply::Estimate);
        let comparing_round = brick.exchange_with(comparing, ExpectedReply::Estimate);
        let echo_round = brick.exchange_with(many, ExpectedReply::Anything);
        let one_round = brick.exchange_with(one, ExpectedReply::Anything);
        // The first round warms caches and fills the filter's history.
        if round > 0 {
            ours.extend(station_round);
            compared.extend(comparing_round);
            bare.extend(echo_round);
            bare_one.extend(one_round);
        }
    }
    stop.cancel();
    for thread in [thread, comparing_thread] {
        thread.join().expect("a station's thread ends");
    }
    println!("\na frame each {} us", pace.period_micros);
    report([&mut ours, &mut compared, &mut bare, &mut bare_one]);
    println!("{} exchanges each; {} datagrams reached the ground station", ours.len(), brick.ground.heard);
    assert!(brick.ground.heard >= ours.len(), "the ground station must be served as well");
}

fn report(samples: [&mut [Duration]; 4]) {
    println!("{:<34} {:>9} {:>9}", "telemetry to estimate, UDP", "p50 us", "p99 us");
    let names = [
        "station, recorder and output",
        "the same, six filters compared",
        "bare echo, multi-threaded runtime",
        "bare echo, one thread",
    ];
    let mut samples = samples.into_iter();
    let told = names.map(|name| {
        let sample = samples.next().expect("a sample for each name");
        sample.sort_unstable();
        let micros = |share: f64| sample[((sample.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e6;
        let [p50, p99] = [micros(0.5), micros(0.99)];
        println!("{name:<34} {p50:>9.1} {p99:>9.1}");
        [p50, p99]
    });
    let [station, comparing, many, one] = told;
    for (name, of, to) in [
        ("six compared to none", comparing, station),
        ("station to the first echo", station, many),
        ("station to the second", station, one),
    ] {
        println!("{name:<34} {:>9.2} {:>9.2}", of[0] / to[0], of[1] / to[1]);
    }
}

/// Which datagram ends an exchange.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ExpectedReply {
    Estimate,
    Anything,
}

/// A program on another link that takes what the station shows.
struct GroundStation {
    socket: UdpSocket,
    address: SocketAddr,
    heard: usize,
}

impl GroundStation {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a loopback socket");
        socket.set_nonblocking(true).expect("a socket that does not wait");
        let address = socket.local_addr().expect("an address");
        Self { socket, address, heard: 0 }
    }

    fn read(&mut self) {
        let mut buffer = [0; 512];
        while self.socket.recv(&mut buffer).is_ok() {
            self.heard += 1;
        }
    }
}

struct Brick {
    pace: TelemetryRate,
    ground: GroundStation,
    socket: UdpSocket,
    encoder: Encoder,
    micros: u32,
    ticks: i64,
}

impl Brick {
    fn new(ground: GroundStation, pace: TelemetryRate) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a loopback socket");
        socket.set_read_timeout(Some(Duration::from_secs(5))).expect("a time limit");
        Self { pace, ground, socket, encoder: Encoder::new(WireVersion::V2), micros: 0, ticks: 0 }
    }

    fn exchange_with(&mut self, peer: SocketAddr, wanted: ExpectedReply) -> Vec<Duration> {
        (0..self.pace.exchanges_per_round).map(|_| self.exchange(peer, wanted)).collect()
    }

    fn exchange(&mut self, peer: SocketAddr, wanted: ExpectedReply) -> Duration {
        let round_began = Instant::now();
        self.micros = self.micros.wrapping_add(self.pace.period_micros);
        self.ticks += 1;
        let message = Message::WheelTicks(WheelTicks {
            stamp: WireStamp::Micros32(self.micros),
            left: EncoderTicks(self.ticks),
            right: EncoderTicks(self.ticks),
        });
        let mut frame = Vec::new();
        self.encoder.encode(Address::new(1, 1), &message, &mut frame);
        let mut buffer = [0; 512];
        let sent = Instant::now();
        self.socket.send_to(&frame, peer).expect("the frame leaves");
        let elapsed = loop {
            let (length, from) = self.socket.recv_from(&mut buffer).expect("an answer within five seconds");
            let elapsed = sent.elapsed();
            if from == peer && (wanted == ExpectedReply::Anything || is_estimate(&buffer[..length])) {
                break elapsed;
            }
        };
        // Idle time, as on a real link: the station must be woken.
        let period = Duration::from_micros(u64::from(self.pace.period_micros));
        while round_began.elapsed() < period {
            std::hint::spin_loop();
        }
        self.ground.read();
        elapsed
    }
}

fn is_estimate(datagram: &[u8]) -> bool {
    let mut found = false;
    Framer::new(FramerConfig::default()).push(Timestamp::ZERO, datagram, &mut |scanned| {
        if let FramerOutput::Frame(frame) = scanned {
            found |= matches!(decode(&frame), Ok(Some(Message::PlanarPose(_))));
        }
    });
    found
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime")
}

/// On which kind of runtime an echo runs.
#[derive(Clone, Copy)]
enum Threads {
    /// As a task of a runtime with worker threads, as most servers are written.
    Many,
    /// On a runtime of its own thread, as the station's station loop runs.
    One,
}

fn start_echo(threads: Threads) -> SocketAddr {
    let (tell, told) = std::sync::mpsc::sync_channel(1);
    std::thread::spawn(move || match threads {
        Threads::Many => {
            let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
            runtime.block_on(runtime.spawn(echo(tell))).expect("the echo ends");
        }
        Threads::One => runtime().block_on(echo(tell)),
    });
    told.recv().expect("the echo starts")
}

async fn echo(tell: std::sync::mpsc::SyncSender<SocketAddr>) {
    let socket = tokio::net::UdpSocket::bind("127.0.0.1:0").await.expect("a loopback socket");
    tell.send(socket.local_addr().expect("an address")).expect("somebody waits");
    let mut buffer = [0; 512];
    while let Ok((_, peer)) = socket.recv_from(&mut buffer).await {
        socket.send_to(&buffer[..ESTIMATE_BYTES], peer).await.expect("the echo leaves");
    }
}

fn start_station(
    stop: CancellationToken,
    ground: SocketAddr,
    compared: &'static [&'static str],
) -> (SocketAddr, std::thread::JoinHandle<()>) {
    let (tell, told) = std::sync::mpsc::sync_channel(1);
    let thread = std::thread::Builder::new().name("station".to_owned());
    let thread = thread.spawn(move || {
        let folder = format!("posebridge-latency-{}-{}", std::process::id(), compared.len());
        let folder = std::env::temp_dir().join(folder);
        std::fs::create_dir_all(&folder).expect("a scratch folder");
        runtime().block_on(async {
            let (mut station_loop, address) = start_station_loop(&folder.join("latency.mcap"), ground, compared).await;
            tell.send(address).expect("somebody waits");
            station_loop.run(&StopConditions { stop, at: None, silence: None, progress: None }).await;
            let StationLoop { recorder, observer, .. } = station_loop;
            recorder.map(Recorder::finish).transpose().expect("the recording is whole");
            observer.finish().expect("the observer ends");
        });
        std::fs::remove_dir_all(&folder).expect("the scratch folder goes");
    });
    let thread = thread.expect("a thread");
    (told.recv().expect("the station starts"), thread)
}

/// What a ground station shows of a robot.
fn shown() -> Vec<OutputSection> {
    ["odometry", "local_position", "attitude", "estimator_status"]
        .map(|message| OutputSection { message: message.to_owned(), interval_ms: 0, at: AtInstant::Observed })
        .to_vec()
}

/// The program's own station loop on a loopback UDP port, with recorder and observer, and a link to a ground station.
async fn start_station_loop(
    recording: &std::path::Path,
    ground: SocketAddr,
    compared: &[&str],
) -> (StationLoop, SocketAddr) {
    let timer = HostTimer::start();
    let (brick, ground) = ("udp://127.0.0.1:0", format!("udp://{ground}"));
    let to_ground = LinkSection { outputs: Some(shown()), ..LinkSection::new(&ground) };
    let from_brick = LinkSection { listen: true, ..LinkSection::new(brick) };
    let compare = compared.iter().map(|name| (*name).to_owned()).collect();
    let filter = FilterSection { compare, ..FilterSection::default() };
    let config = Config { links: vec![to_ground, from_brick], filter, ..Config::default() };
    let port = |id, url: &str, role| {
        let url = LinkUrl::parse(url).expect("a URL");
        let id = LinkId(id);
        Link::new(LinkOpenConfig { id, url, role }, timer)
    };
    let mut ports = LinkSet::new(vec![port(0, &ground, ConnectRole::Dial), port(1, brick, ConnectRole::Listen)]);
    ports.try_open_all().await.expect("the link opens");
    let address = ports.iter().nth(1).and_then(Link::local_address).expect("an address");
    let recorder = Recorder::start(recording, &RecordingHeader::default(), RecordingLimits::default());
    let station_loop = StationLoop {
        station: Station::new(config.station_config().expect("a station"), Timestamp::ZERO).expect("a station"),
        links: ports,
        timer,
        recorder: Some(recorder.expect("a recorder")),
        tlog: None,
        bag: None,
        observer: Observer::start(None, LiveView::silent()).expect("an observer"),
        dashboard: None,
        setup: SetupChecklists::default(),
        failures: DeferredErrors::default(),
        input_count: 0,
        fleet: None,
        ros2: None,
        signing: None,
        requests: RequestHandler::new(
            recording.with_extension("folder"),
            timer,
            config.clone(),
            config,
            Some(recording.to_owned()),
        ),
        truth: Vec::new(),
        first_pose: None,
        watchdog: Watchdog::start(timer, OnStall::Tell).expect("a watchdog"),
        link_log: LinkLog::default(),
    };
    (station_loop, address)
}
