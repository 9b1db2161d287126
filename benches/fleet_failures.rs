//! What robots notice of failures in a fleet: three stations as processes and thirty robots that all of them hear.
//!
//! Run with `cargo bench --features fleet --bench fleet_failures`. The station that serves most robots is killed, then frozen, then cut
//! off from the others, each time with a return; the network between stations is a set of relays here that can be cut. Printed for
//! each step: the longest time that a robot was without an estimate, over all robots, the stations that serve a robot at its end, and
//! estimates of a lower epoch than the robot had before, on the wire and after the robot's own check. Exit code 1 if a time is above its
//! limit, a robot ends without exactly one owner, or one accepts an estimate of an earlier owner.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a benchmark stops when its set-up is broken, prints its figures, and measures with the host's clock"
)]

use std::collections::BTreeSet;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use posebridge_fleet::{Epoch, EpochFence, FenceDecision};
use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks, Timestamp};

const STATIONS: usize = 3;
const ROBOTS: usize = 30;
const PERIOD_MS: u64 = 50;
/// At the end of a step, whose estimates say who serves a robot.
const SETTLED_MS: u64 = 1_000;

const ROBOT_HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

fn main() -> ExitCode {
    let folder = tempfile::tempdir().expect("a scratch folder");
    let mut fleet = StationGroup::start(folder.path());
    let mut robots = RobotGroup::new();
    robots.run(&fleet, 30_000, RobotGroup::all_served);
    println!(
        "{:<34} {:>10} {:>10} {:>8} {:>10} {:>8} {:>8}",
        "step", "median, s", "longest, s", "limit, s", "one owner", "lower", "accepted"
    );
    let mut is_good = true;
    let mut step = |name: &str, limit_ms: u64, robots: &mut RobotGroup, fleet: &StationGroup, duration_ms: u64| {
        let begun_ms = robots.now_ms();
        robots.run(fleet, duration_ms, |_| false);
        let outcome = robots.outcome_since(begun_ms);
        let [median_s, longest_s] =
            [outcome.gaps_ms[ROBOTS / 2], outcome.gaps_ms[ROBOTS - 1]].map(|ms| ms as f64 / 1e3);
        println!(
            "{name:<34} {median_s:>10.3} {longest_s:>10.3} {:>8.1} {:>7} of {ROBOTS} {:>8} {:>8}",
            limit_ms as f64 / 1e3,
            outcome.with_one_owner,
            outcome.lower_on_wire,
            outcome.lower_accepted
        );
        is_good &= outcome.gaps_ms[ROBOTS - 1] <= limit_ms && outcome.lower_accepted == 0;
        outcome.with_one_owner == ROBOTS
    };
    let mut ends = Vec::new();
    ends.push(step("nothing happens", 500, &mut robots, &fleet, 5_000));
    for round in 1..=2 {
        let (victim, owned) = robots.busiest();
        fleet.kill(victim);
        ends.push(step(&format!("{round}. kill -9 of the owner of {owned}"), 500, &mut robots, &fleet, 6_000));
        fleet.restart(victim);
        ends.push(step("  it is started again", 500, &mut robots, &fleet, 6_000));
        let (victim, owned) = robots.busiest();
        fleet.signal(victim, Signal::SIGSTOP);
        ends.push(step(&format!("{round}. SIGSTOP of the owner of {owned}"), 2_500, &mut robots, &fleet, 6_000));
        fleet.signal(victim, Signal::SIGCONT);
        ends.push(step("  SIGCONT", 500, &mut robots, &fleet, 8_000));
        let (victim, owned) = robots.busiest();
        fleet.set_network(victim, Network::Cut);
        // Both sides hear the robots: the cut-off owner goes on, and another one takes over.
        step(&format!("{round}. the owner of {owned} is cut off"), 2_500, &mut robots, &fleet, 8_000);
        fleet.set_network(victim, Network::Whole);
        ends.push(step("  it is connected again", 500, &mut robots, &fleet, 8_000));
    }
    fleet.stop();
    if !ends.iter().all(|has_one| *has_one) {
        println!("FAILED: a robot had no owner, or two, at the end of a step");
        is_good = false;
    }
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// The stations, and the relays between each two of them.
struct StationGroup {
    stations: Vec<Process>,
    relays: Vec<Relay>,
}

struct Process {
    child: Child,
    args: Vec<String>,
    robots_at: SocketAddr,
}

/// A TCP connection between two stations that can be cut without being closed.
struct Relay {
    between: [usize; 2],
    is_cut: Arc<AtomicBool>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Network {
    Whole,
    Cut,
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a port").port()
}

impl StationGroup {
    fn start(folder: &Path) -> Self {
        let ports: Vec<u16> = (0..STATIONS).map(|_| free_port()).collect();
        let mut relays = Vec::new();
        let mut stations = Vec::new();
        for (station, port) in ports.iter().enumerate() {
            let mut args: Vec<String> = ["run", "--no-dashboard", "--fleet", "class"].map(str::to_owned).to_vec();
            args.extend(["--fleet-listen".to_owned(), format!("tcp/127.0.0.1:{port}")]);
            args.extend(["--set".to_owned(), format!("fleet.station=station{station}")]);
            args.extend(["--listen".to_owned(), "udp://127.0.0.1:0".to_owned()]);
            for (other, port) in ports.iter().enumerate().take(station) {
                let is_cut = Arc::new(AtomicBool::new(false));
                let relay = start_relay(*port, Arc::clone(&is_cut));
                relays.push(Relay { between: [other, station], is_cut });
                args.extend(["--join".to_owned(), format!("tcp/127.0.0.1:{relay}")]);
            }
            args.extend(["--out".to_owned(), folder.join(format!("station{station}")).display().to_string()]);
            stations.push(Process::start(args));
        }
        Self { stations, relays }
    }

    fn signal(&self, station: usize, signal: Signal) {
        kill(self.stations[station].pid(), signal).expect("it runs");
    }

    fn kill(&mut self, station: usize) {
        self.signal(station, Signal::SIGKILL);
        self.stations[station].child.wait().expect("it ends");
    }

    fn restart(&mut self, station: usize) {
        let mut args = self.stations[station].args.clone();
        let folder = args.last_mut().expect("the folder");
        folder.push_str("-again");
        // Robots go on sending where they sent before.
        let address = self.stations[station].robots_at;
        for argument in &mut args {
            if argument.starts_with("udp://") {
                *argument = format!("udp://{address}");
            }
        }
        let mut child = spawn(&args);
        let stderr = child.stderr.take().expect("a pipe");
        std::thread::spawn(move || BufReader::new(stderr).lines().map_while(Result::ok).for_each(drop));
        self.stations[station] = Process { child, args, robots_at: address };
    }

    fn set_network(&self, station: usize, network: Network) {
        for relay in self.relays.iter().filter(|relay| relay.between.contains(&station)) {
            relay.is_cut.store(network == Network::Cut, Ordering::Relaxed);
        }
    }

    fn stop(&mut self) {
        for station in 0..STATIONS {
            self.signal(station, Signal::SIGINT);
        }
        for process in &mut self.stations {
            process.child.wait().expect("it ends");
        }
    }
}

impl Process {
    /// Waits until it listens.
    fn start(args: Vec<String>) -> Self {
        let mut child = spawn(&args);
        let mut lines = BufReader::new(child.stderr.take().expect("a pipe")).lines().map_while(Result::ok);
        let robots_at = lines.find_map(|line| line.strip_prefix("listening on ")?.parse().ok()).expect("it listens");
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, args, robots_at }
    }

    fn pid(&self) -> Pid {
        Pid::from_raw(self.child.id() as i32)
    }
}

fn spawn(args: &[String]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_posebridge"));
    command.args(args).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command.spawn().expect("a process")
}

/// Starts a relay to a port of this computer; returns its own.
fn start_relay(to: u16, is_cut: Arc<AtomicBool>) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("its address").port();
    std::thread::spawn(move || {
        for near in listener.incoming().map_while(Result::ok) {
            if is_cut.load(Ordering::Relaxed) {
                continue;
            }
            let Ok(far) = TcpStream::connect(("127.0.0.1", to)) else { continue };
            for (from, to) in [(&near, &far), (&far, &near)] {
                let (from, to) = (from.try_clone().expect("a handle"), to.try_clone().expect("a handle"));
                let is_cut = Arc::clone(&is_cut);
                std::thread::spawn(move || copy(from, to, &is_cut));
            }
        }
    });
    port
}

/// Copies until one end closes. What is read while the relay is cut is lost, and with it the connection.
fn copy(mut from: TcpStream, mut to: TcpStream, is_cut: &AtomicBool) {
    let mut buffer = vec![0; 65_536];
    let mut was_cut = false;
    while let Ok(read @ 1..) = from.read(&mut buffer) {
        was_cut |= is_cut.load(Ordering::Relaxed);
        if !was_cut && to.write_all(&buffer[..read]).is_err() {
            break;
        }
    }
    // The other direction ends with it.
    drop(to.shutdown(std::net::Shutdown::Both));
}

struct Reception {
    at_ms: u64,
    station: usize,
    is_lower: bool,
    is_accepted: bool,
}

struct Robot {
    socket: UdpSocket,
    address: Address,
    encoder: Encoder,
    framer: Framer,
    fence: EpochFence,
    highest: u32,
    received: Vec<Reception>,
}

struct RobotGroup {
    begun: Instant,
    robots: Vec<Robot>,
    tick: u64,
}

struct Outcome {
    /// The longest of each robot, sorted.
    gaps_ms: Vec<u64>,
    with_one_owner: usize,
    lower_on_wire: usize,
    lower_accepted: usize,
}

impl RobotGroup {
    fn new() -> Self {
        let robot = |number: usize| {
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
            socket.set_nonblocking(true).expect("a socket that does not wait");
            Robot {
                socket,
                address: Address::new(number as u8 + 1, 1),
                encoder: Encoder::new(WireVersion::V2),
                framer: Framer::new(FramerConfig::default()),
                fence: EpochFence::default(),
                highest: 0,
                received: Vec::new(),
            }
        };
        Self { begun: Instant::now(), robots: (0..ROBOTS).map(robot).collect(), tick: 0 }
    }

    fn now_ms(&self) -> u64 {
        self.begun.elapsed().as_millis() as u64
    }

    /// Drives for a time, or until `is_done`.
    fn run(&mut self, fleet: &StationGroup, duration_ms: u64, is_done: impl Fn(&Self) -> bool) {
        let end_ms = self.now_ms() + duration_ms;
        while self.now_ms() < end_ms && !is_done(self) {
            self.tick += 1;
            let now_ms = self.now_ms();
            for (number, robot) in self.robots.iter_mut().enumerate() {
                if (self.tick + number as u64).is_multiple_of(PERIOD_MS) {
                    robot.send(fleet, (self.tick + number as u64) / PERIOD_MS);
                }
                robot.receive(fleet, now_ms);
            }
            std::thread::sleep(
                (self.begun + Duration::from_millis(self.tick)).saturating_duration_since(Instant::now()),
            );
        }
    }

    fn all_served(&self) -> bool {
        self.robots.iter().all(|robot| robot.received.iter().filter(|one| one.is_accepted).count() > 20)
    }

    /// The station that serves most robots, and how many.
    fn busiest(&self) -> (usize, usize) {
        let last = self.robots.iter().filter_map(|robot| robot.received.iter().rev().find(|one| one.is_accepted));
        let mut counts = [0; STATIONS];
        last.for_each(|reception| counts[reception.station] += 1);
        let busiest = (0..STATIONS).max_by_key(|station| counts[*station]).unwrap_or(0);
        (busiest, counts[busiest])
    }

    fn outcome_since(&self, begun_ms: u64) -> Outcome {
        let now_ms = self.now_ms();
        let mut gaps_ms: Vec<u64> = self.robots.iter().map(|robot| robot.longest_gap(begun_ms, now_ms)).collect();
        gaps_ms.sort_unstable();
        let settled_ms = now_ms - SETTLED_MS;
        let count = |is_counted: &dyn Fn(&Reception) -> bool| {
            let all = self.robots.iter().flat_map(|robot| &robot.received);
            all.filter(|one| one.at_ms >= begun_ms && is_counted(one)).count()
        };
        Outcome {
            gaps_ms,
            with_one_owner: self.robots.iter().filter(|robot| robot.owners(settled_ms).len() == 1).count(),
            lower_on_wire: count(&|one| one.is_lower),
            lower_accepted: count(&|one| one.is_lower && one.is_accepted),
        }
    }
}

impl Robot {
    fn send(&mut self, fleet: &StationGroup, step: u64) {
        let ticks = EncoderTicks(4 * step as i64);
        let stamp = WireStamp::Micros32(5_000_000 + step as u32 * (PERIOD_MS as u32 * 1_000));
        let mut frame = Vec::new();
        if step.is_multiple_of(20) {
            self.encoder.encode(self.address, &ROBOT_HEARTBEAT, &mut frame);
        }
        let wheels = Message::WheelTicks(WheelTicks { stamp, left: ticks, right: ticks });
        self.encoder.encode(self.address, &wheels, &mut frame);
        for station in &fleet.stations {
            // A station that is dead refuses it.
            drop(self.socket.send_to(&frame, station.robots_at));
        }
    }

    fn receive(&mut self, fleet: &StationGroup, now_ms: u64) {
        let mut buffer = [0; 2_048];
        let mut failures = 0;
        while failures < STATIONS {
            let (len, from) = match self.socket.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => return,
                // What a dead station refused.
                Err(_) => {
                    failures += 1;
                    continue;
                }
            };
            let Some(station) = fleet.stations.iter().position(|station| station.robots_at == from) else { continue };
            let mut epochs = Vec::new();
            self.framer.push(Timestamp::ZERO, &buffer[..len], &mut |output| {
                if let FramerOutput::Frame(frame) = output
                    && let Ok(Some(Message::PlanarPose(pose))) = decode(&frame)
                {
                    epochs.push(pose.epoch);
                }
            });
            for number in epochs {
                let epoch = Epoch::new(number).expect("an estimate of a fleet has an epoch");
                let is_accepted =
                    self.fence.check(Timestamp::from_millis(now_ms as i64), epoch) == FenceDecision::Accepted;
                let is_lower = number < self.highest;
                self.highest = self.highest.max(number);
                self.received.push(Reception { at_ms: now_ms, station, is_lower, is_accepted });
            }
        }
    }

    /// The longest time without an accepted estimate that ends after `begun_ms`, in which it begins.
    fn longest_gap(&self, begun_ms: u64, now_ms: u64) -> u64 {
        let accepted: Vec<u64> = self.received.iter().filter(|one| one.is_accepted).map(|one| one.at_ms).collect();
        let times: Vec<u64> = accepted.into_iter().chain([now_ms]).filter(|at_ms| *at_ms + 1_000 >= begun_ms).collect();
        times.windows(2).filter(|pair| pair[1] >= begun_ms).map(|pair| pair[1] - pair[0]).max().unwrap_or(u64::MAX)
    }

    /// The stations whose estimates it accepted since then.
    fn owners(&self, since_ms: u64) -> BTreeSet<usize> {
        self.received.iter().filter(|one| one.is_accepted && one.at_ms >= since_ms).map(|one| one.station).collect()
    }
}
