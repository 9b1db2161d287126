//! A crowd on one UDP port of `posebridge run`, beside a bare echo under the same load.
//!
//! 500 robots send PB_WHEEL_TICKS twenty times a second to the program as a user starts it: a process of its own, with its recording and
//! its page. With `flood` 50 more peers send 2000 datagrams a second each, one half of them understood; with `silent` 4000 addresses send a
//! byte every five seconds. Run with `cargo bench --bench crowd -- [SECONDS] [flood] [silent]`.
//!
//! With `fleet=ROBOTS` so many robots are spread over four stations of a fleet, each a process without page and recording:
//! `cargo bench --features fleet --bench crowd -- 20 fleet=1000`. ROBOTS is 500, 1000, 2000, 2500 or 5000. Limits then hold for the stations
//! together.
//!
//! The age of an estimate is the time from before its telemetry is sent until the kernel has it for the robot. Exit code 1 if a robot
//! misses an estimate or gets another's, the kernel drops a datagram, or the 99th percentile of the age is above 5 ms.
//!
//! All robots share one socket here, with an address of 127.0.0.0/8 each, so that the load costs little beside the station.

#![expect(
    clippy::expect_used,
    clippy::print_stderr,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a benchmark stops when its set-up is broken, prints its figures, and measures with the host's clock"
)]

use std::io::{BufRead as _, BufReader, IoSlice, IoSliceMut};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::AsRawFd as _;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant, SystemTime};

use nix::libc::{in_addr, in_pktinfo};
use nix::sys::signal::{Signal, kill};
use nix::sys::socket::sockopt::{Ipv4PacketInfo, RcvBuf, ReceiveTimestampns};
use nix::sys::socket::{ControlMessage, ControlMessageOwned, MsgFlags, SockaddrIn, recvmsg, sendmsg, setsockopt};
use nix::unistd::Pid;
use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks, Timestamp};

const ROBOTS: u32 = 500;
const FLEET_STATIONS: usize = 4;
const PERIOD_MICROS: u32 = 50_000;
/// Robots send one after the other, some in each tick.
const TICK: Duration = Duration::from_millis(1);
const TICKS_PER_PERIOD: u32 = 50;
const FLOODING_PEERS: u32 = 50;
const FLOOD_PER_TICK: usize = 2;
const SILENT_PEERS: u32 = 4_000;
const SILENT_REST_TICKS: u32 = 5_000;
/// After the last telemetry.
const GRACE_TICKS: u32 = 500;
const WARM_UP_ROUNDS: u32 = 20;
/// Until every robot has an owner.
const FLEET_WARM_UP_ROUNDS: u32 = 100;
const MAX_ECHO_SECONDS: u32 = 15;
const MAX_P99: Duration = Duration::from_millis(5);
/// PB_PLANAR_POSE with its envelope.
const ESTIMATE_BYTES: usize = 64;

#[derive(Clone, Copy)]
struct Load {
    seconds: u32,
    has_flood: bool,
    has_silent: bool,
    /// Rounds whose missing estimates are counted apart.
    warm_up_rounds: u32,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |name: &str| arguments.iter().any(|argument| argument == name);
    if has("echo-server") {
        serve_echo();
    }
    let seconds = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(60);
    let in_fleet = arguments.iter().find_map(|argument| argument.strip_prefix("fleet=")?.parse().ok());
    let robots = in_fleet.unwrap_or(ROBOTS);
    let warm_up_rounds = if in_fleet.is_some() { FLEET_WARM_UP_ROUNDS } else { WARM_UP_ROUNDS };
    let load = Load { seconds, has_flood: has("flood"), has_silent: has("silent"), warm_up_rounds };
    let mut echo = vec![Server::start_echo()];
    let bare = Crowd::new(robots).run(Load { seconds: seconds.min(MAX_ECHO_SECONDS), ..load }, &echo);
    echo.iter_mut().for_each(Server::stop);
    let mut stations = if in_fleet.is_some() { Server::start_fleet() } else { vec![Server::start_station()] };
    let ours = Crowd::new(robots).run(load, &stations);
    stations.iter_mut().for_each(Server::stop);
    println!("{:<26} {:>12} {:>12}", "", "station", "bare echo");
    let row = |name: &str, read: &dyn Fn(&Outcome) -> String| {
        println!("{name:<26} {:>12} {:>12}", read(&ours), read(&bare));
    };
    row("datagrams sent", &|of| of.sent.to_string());
    row("datagrams of others", &|of| of.others.to_string());
    row("replies", &|of| of.received.iter().sum::<u32>().to_string());
    row("fewest for a robot", &|of| format!("{} of {}", of.fewest(), of.rounds));
    row("missed at first", &|of| of.missed(|round| round < warm_up_rounds).to_string());
    row("missed later", &|of| of.missed(|round| round >= warm_up_rounds).to_string());
    row("to another robot", &|of| of.misdirected.to_string());
    row("dropped by the kernel", &|of| of.kernel_drops.to_string());
    row("processor, % of one core", &|of| format!("{:.1}", of.cpu_share * 100.0));
    row("network, bytes per robot and s", &|of| format!("{:.0}", of.bytes_per_robot_and_s));
    row("memory, kB", &|of| of.memory_kb.to_string());
    for share in [0.5, 0.99, 1.0] {
        row(&format!("age p{:.0}, ms", share * 100.0), &|of| format!("{:.3}", of.age(share).as_secs_f64() * 1e3));
    }
    for share in [0.5, 0.99] {
        let ratio = ours.age(share).as_secs_f64() / bare.age(share).as_secs_f64();
        println!("station to echo, p{:<8.0} {ratio:>13.2}", share * 100.0);
    }
    let failures = ours.failures(in_fleet.map_or(0, |_| warm_up_rounds));
    for failure in &failures {
        println!("FAILED: {failure}");
    }
    if failures.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// The station or the echo, as a process.
struct Server {
    child: Child,
    address: SocketAddrV4,
    /// Reads what it says, which is not shown.
    messages: Option<std::thread::JoinHandle<()>>,
    folder: Option<tempfile::TempDir>,
}

impl Server {
    fn start_echo() -> Self {
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        Self::start(command.arg("echo-server"), None)
    }

    fn start_station() -> Self {
        let folder = tempfile::tempdir().expect("a scratch folder");
        let mut command = Command::new(env!("CARGO_BIN_EXE_posebridge"));
        command.args(["run", "--listen", "udp://127.0.0.1:0", "--out"]).arg(folder.path().join("run"));
        Self::start(&mut command, Some(folder))
    }

    /// Stations that are all connected with each other.
    fn start_fleet() -> Vec<Self> {
        let port = |_| {
            let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
            listener.local_addr().expect("its address").port()
        };
        let ports: Vec<u16> = (0..FLEET_STATIONS).map(port).collect();
        let start = |station: usize| {
            let folder = tempfile::tempdir().expect("a scratch folder");
            let mut command = Command::new(env!("CARGO_BIN_EXE_posebridge"));
            command.args(["run", "--listen", "udp://127.0.0.1:0", "--no-dashboard", "--no-record"]);
            command.args(["--set", "station.max_robots=5000", "--fleet", "crowd"]);
            command.args(["--set", &format!("fleet.station=station{station}")]);
            command.args(["--fleet-listen", &format!("tcp/127.0.0.1:{}", ports[station])]);
            for port in &ports[..station] {
                command.args(["--join", &format!("tcp/127.0.0.1:{port}")]);
            }
            command.arg("--out").arg(folder.path().join("run"));
            Self::start(&mut command, Some(folder))
        };
        (0..FLEET_STATIONS).map(start).collect()
    }

    fn start(command: &mut Command, folder: Option<tempfile::TempDir>) -> Self {
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().expect("a process");
        let mut lines = BufReader::new(child.stderr.take().expect("a pipe")).lines().map_while(Result::ok);
        let address = lines.find_map(|line| line.strip_prefix("listening on ")?.parse().ok());
        let address = address.expect("the server starts");
        let messages = std::thread::spawn(move || lines.for_each(drop));
        Self { child, address, messages: Some(messages), folder }
    }

    /// Ends the process; the station then prints its report.
    fn stop(&mut self) {
        let process = Pid::from_raw(self.child.id() as i32);
        kill(process, Signal::SIGINT).expect("it runs");
        self.child.wait().expect("it ends");
        self.messages.take().map(std::thread::JoinHandle::join).transpose().expect("it only reads");
        self.folder.take();
    }

    /// Processor time used so far.
    fn cpu(&self) -> Duration {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).expect("it runs");
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
        let ticks: u64 = fields[11..13].iter().map(|field| field.parse::<u64>().expect("a number")).sum();
        Duration::from_millis(ticks * 10)
    }

    fn memory_kb(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("its memory");
        line.trim().trim_end_matches(" kB").parse().expect("a number")
    }

    /// What the kernel says of the server's common socket: that it has no peer, unlike those of single peers.
    fn kernel_drops(&self) -> u64 {
        let table = std::fs::read_to_string("/proc/net/udp").expect("Linux");
        let local = format!(":{:04X}", self.address.port());
        let rows = table.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
        let rows = rows.filter(|row| row.len() > 12 && row[1].ends_with(&local) && row[2] == "00000000:0000");
        rows.map(|row| row[12].parse::<u64>().expect("a number")).sum()
    }
}

/// Answers each telemetry datagram with one as long as an estimate that begins with it.
fn serve_echo() -> ! {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a loopback socket");
    setsockopt(&socket, RcvBuf, &(4 << 20)).expect("a large buffer");
    eprintln!("listening on {}", socket.local_addr().expect("an address"));
    let mut buffer = [0; 512];
    loop {
        let (length, peer) = socket.recv_from(&mut buffer).expect("a datagram");
        if is_telemetry(&buffer[..length]) {
            socket.send_to(&buffer[..ESTIMATE_BYTES], peer).expect("the echo leaves");
        }
    }
}

/// The stamp that a datagram's message carries.
fn stamp_of(datagram: &[u8]) -> Option<u32> {
    let mut stamp = None;
    Framer::new(FramerConfig::default()).push(Timestamp::ZERO, datagram, &mut |scanned| {
        if let FramerOutput::Frame(frame) = scanned
            && let Ok(Some(Message::PlanarPose(_) | Message::WheelTicks(_))) = decode(&frame)
        {
            // Both begin with it.
            stamp = frame.payload.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
        }
    });
    stamp
}

fn is_telemetry(datagram: &[u8]) -> bool {
    datagram.first() == Some(&0xFD) && datagram.len() < ESTIMATE_BYTES && stamp_of(datagram).is_some()
}

struct Robot {
    encoder: Encoder,
    address: Address,
}

/// All peers, on one thread.
struct Crowd {
    socket: UdpSocket,
    robots: Vec<Robot>,
    floods: Vec<(UdpSocket, Vec<u8>)>,
    /// When each round's telemetry was sent, robot by robot.
    sent: Vec<Option<SystemTime>>,
    warm_up_rounds: u32,
    outcome: Outcome,
}

#[derive(Default)]
struct Outcome {
    rounds: u32,
    sent: u64,
    /// Of flooding and silent peers.
    others: u64,
    received: Vec<u32>,
    /// The round of each telemetry without an estimate.
    missed_rounds: Vec<u32>,
    misdirected: u64,
    kernel_drops: u64,
    cpu_share: f64,
    memory_kb: u64,
    /// On the loopback interface, of everything: telemetry, estimates, and what stations say to each other.
    bytes_per_robot_and_s: f64,
    ages: Vec<Duration>,
}

impl Outcome {
    fn fewest(&self) -> u32 {
        self.received.iter().copied().min().unwrap_or_default()
    }

    fn missed(&self, is_counted: impl Fn(u32) -> bool) -> usize {
        self.missed_rounds.iter().filter(|round| is_counted(**round)).count()
    }

    fn age(&self, share: f64) -> Duration {
        self.ages.get((self.ages.len().saturating_sub(1) as f64 * share) as usize).copied().unwrap_or_default()
    }

    /// `excused_rounds` at first may miss estimates.
    fn failures(&self, excused_rounds: u32) -> Vec<String> {
        let lacking = self.missed(|round| round >= excused_rounds);
        let p99 = self.age(0.99);
        [
            (lacking > 0, format!("{lacking} estimates are missing")),
            (self.misdirected > 0, format!("{} estimates went to another robot", self.misdirected)),
            (self.kernel_drops > 0, format!("the kernel dropped {} datagrams", self.kernel_drops)),
            (p99 > MAX_P99, format!("p99 of the age is {p99:?}, above {MAX_P99:?}")),
        ]
        .into_iter()
        .filter_map(|(has_failed, text)| has_failed.then_some(text))
        .collect()
    }
}

/// Bytes that were sent on the loopback interface since the computer started.
fn loopback_bytes() -> u64 {
    let table = std::fs::read_to_string("/proc/net/dev").expect("Linux");
    let row = table.lines().find_map(|line| line.trim().strip_prefix("lo:")).expect("a loopback interface");
    row.split_whitespace().nth(8).and_then(|bytes| bytes.parse().ok()).expect("a number")
}

fn robot_host(robot: u32) -> Ipv4Addr {
    Ipv4Addr::from_bits(Ipv4Addr::new(127, 1, 0, 1).to_bits() + robot)
}

fn silent_host(number: u32) -> Ipv4Addr {
    Ipv4Addr::from_bits(Ipv4Addr::new(127, 2, 0, 1).to_bits() + number)
}

impl Crowd {
    fn new(robots: u32) -> Self {
        let socket = UdpSocket::bind("0.0.0.0:0").expect("a socket");
        socket.set_nonblocking(true).expect("a socket that does not wait");
        setsockopt(&socket, RcvBuf, &(4 << 20)).expect("a large buffer");
        setsockopt(&socket, ReceiveTimestampns, &true).expect("times of arrival");
        setsockopt(&socket, Ipv4PacketInfo, &true).expect("addresses of arrival");
        let robot = |number: u32| Robot {
            encoder: Encoder::new(WireVersion::V2),
            address: Address::new(1 + (number % 250) as u8, 1 + (number / 250) as u8),
        };
        let flood = |number: u32| {
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
            socket.set_nonblocking(true).expect("a socket that does not wait");
            let mut datagram = vec![0x55; 200];
            if number % 2 == 1 {
                datagram.clear();
                let beat = Heartbeat { vehicle_type: 10, autopilot: 8, base_mode: 0, system_status: 4 };
                let from = Address::new(251, number as u8);
                Encoder::new(WireVersion::V2).encode(from, &Message::Heartbeat(beat), &mut datagram);
            }
            (socket, datagram)
        };
        Self {
            socket,
            robots: (0..robots).map(robot).collect(),
            floods: (0..FLOODING_PEERS).map(flood).collect(),
            sent: Vec::new(),
            warm_up_rounds: 0,
            outcome: Outcome { received: vec![0; robots as usize], ..Outcome::default() },
        }
    }

    fn robot_count(&self) -> u32 {
        self.robots.len() as u32
    }

    /// Each robot sends to one of the servers.
    fn run(mut self, load: Load, servers: &[Server]) -> Outcome {
        let ticks = load.seconds * 1_000;
        self.outcome.rounds = ticks / TICKS_PER_PERIOD;
        self.warm_up_rounds = load.warm_up_rounds;
        self.sent = vec![None; (self.outcome.rounds * self.robot_count()) as usize];
        let cpu = |servers: &[Server]| servers.iter().map(Server::cpu).sum::<Duration>();
        let (began, cpu_before, bytes_before) = (Instant::now(), cpu(servers), loopback_bytes());
        for tick in 0..ticks + GRACE_TICKS {
            if tick < ticks {
                self.send_telemetry(tick, servers);
            }
            // One in each tick, and then a rest.
            let silent = tick % SILENT_REST_TICKS;
            if load.has_silent && silent < SILENT_PEERS {
                self.send_from(silent_host(silent), &[0], servers[0].address);
                self.outcome.others += 1;
            }
            if load.has_flood {
                self.send_flood(servers[0].address.into());
            }
            self.receive();
            std::thread::sleep((began + TICK * (tick + 1)).saturating_duration_since(Instant::now()));
        }
        self.receive();
        let robots = self.robot_count();
        let missed = self.sent.iter().enumerate().filter(|(_, sent)| sent.is_some());
        self.outcome.missed_rounds = missed.map(|(index, _)| index as u32 / robots).collect();
        let mut outcome = self.outcome;
        outcome.ages.sort_unstable();
        let elapsed_s = began.elapsed().as_secs_f64();
        outcome.cpu_share = cpu(servers).saturating_sub(cpu_before).as_secs_f64() / elapsed_s;
        outcome.bytes_per_robot_and_s = (loopback_bytes() - bytes_before) as f64 / elapsed_s / f64::from(robots);
        outcome.memory_kb = servers.iter().map(Server::memory_kb).sum();
        outcome.kernel_drops = servers.iter().map(Server::kernel_drops).sum();
        outcome
    }

    fn send_telemetry(&mut self, tick: u32, servers: &[Server]) {
        let robots = self.robot_count();
        let per_tick = robots / TICKS_PER_PERIOD;
        let (round, first) = (tick / TICKS_PER_PERIOD, tick % TICKS_PER_PERIOD * per_tick);
        for robot in first..first + per_tick {
            let ticks = EncoderTicks(i64::from(round) * 5 + i64::from(robot));
            // Unique: it tells which telemetry an estimate answers.
            let stamp = WireStamp::Micros32(PERIOD_MICROS * (round + 20) + robot * (PERIOD_MICROS / robots));
            let message = Message::WheelTicks(WheelTicks { stamp, left: ticks, right: ticks });
            let Robot { encoder, address } = &mut self.robots[robot as usize];
            let mut frame = Vec::new();
            encoder.encode(*address, &message, &mut frame);
            self.sent[(round * robots + robot) as usize] = Some(SystemTime::now());
            self.send_from(robot_host(robot), &frame, servers[robot as usize % servers.len()].address);
            self.outcome.sent += 1;
        }
    }

    fn send_from(&self, host: Ipv4Addr, frame: &[u8], to: SocketAddrV4) {
        let source = in_addr { s_addr: u32::from_ne_bytes(host.octets()) };
        let from = in_pktinfo { ipi_ifindex: 0, ipi_spec_dst: source, ipi_addr: in_addr { s_addr: 0 } };
        let control = [ControlMessage::Ipv4PacketInfo(&from)];
        let to = SockaddrIn::from(to);
        let sent = sendmsg(self.socket.as_raw_fd(), &[IoSlice::new(frame)], &control, MsgFlags::empty(), Some(&to));
        sent.expect("the frame leaves");
    }

    fn send_flood(&mut self, to: SocketAddr) {
        for (socket, datagram) in &self.floods {
            for _ in 0..FLOOD_PER_TICK {
                self.outcome.others += u64::from(socket.send_to(datagram, to).is_ok());
            }
        }
    }

    /// Reads everything that has come.
    fn receive(&mut self) {
        let mut buffer = [0; 512];
        let mut control = nix::cmsg_space!(nix::sys::time::TimeSpec, in_pktinfo);
        loop {
            let mut parts = [IoSliceMut::new(&mut buffer)];
            let fd = self.socket.as_raw_fd();
            let Ok(received) = recvmsg::<SockaddrIn>(fd, &mut parts, Some(&mut control), MsgFlags::empty()) else {
                return;
            };
            let (mut arrival, mut host) = (None, None);
            for message in received.cmsgs().expect("room for all of them") {
                if let ControlMessageOwned::ScmTimestampns(time) = message {
                    arrival = Some(SystemTime::UNIX_EPOCH + Duration::from(time));
                } else if let ControlMessageOwned::Ipv4PacketInfo(info) = message {
                    host = Some(Ipv4Addr::from(info.ipi_addr.s_addr.to_ne_bytes()));
                }
            }
            let length = received.bytes;
            if let (Some(arrival), Some(host)) = (arrival, host) {
                self.record(&buffer[..length], host, arrival);
            }
        }
    }

    fn record(&mut self, datagram: &[u8], host: Ipv4Addr, arrival: SystemTime) {
        let Some(stamp) = stamp_of(datagram) else {
            return;
        };
        let robots = self.robot_count();
        let robot = stamp % PERIOD_MICROS / (PERIOD_MICROS / robots);
        let round = (stamp / PERIOD_MICROS).wrapping_sub(20);
        if host != robot_host(robot) {
            // What the station says while it knows one robot only is for all.
            self.outcome.misdirected += u64::from(round >= self.warm_up_rounds);
            return;
        }
        // The first estimate of a telemetry counts.
        let Some(sent) = self.sent.get_mut((round * robots + robot) as usize).and_then(Option::take) else {
            return;
        };
        self.outcome.received[robot as usize] += 1;
        self.outcome.ages.push(arrival.duration_since(sent).unwrap_or_default());
    }
}
