//! What a robot costs among few and among many: 50 and 500 robots behind one port, in virtual time.
//!
//! Each has a peer of its own, sends its wheels at 20 Hz and answers time requests; a camera beside it, which does so too, sends a fix each
//! second. The rows take turns, and the best round of each counts, so that another program on the machine decides little. Run with
//! `cargo bench -p posebridge-station --bench robots`; numbers behind `--` are other counts of robots, and without `--bench` it runs once and
//! briefly.
//!
//! CPU time is that of this thread, by the kernel, and includes the encoding of the robots' messages; heap is what the station holds more
//! than an empty one.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a benchmark stops when its set-up is broken, and prints its figures"
)]

#[path = "../tests/station/support/config.rs"]
mod config;

use posebridge_protocol::dialect::{self, Encoder};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, TimeSync, VisionFix, WheelTicks, WireStamp};
use posebridge_station::Station;
use posebridge_telemetry::{
    Address, EncoderTicks, Event, Heading, HostClock, Input, LinkState, Meters, Output, PeerId, TimeDelta, Timestamp,
};

use config::{LINK, at, config};

const COUNTS: [u32; 2] = [50, 500];
/// Between two messages of a robot's wheels.
const PERIOD_MS: i64 = 50;
/// A fix comes with every so manyth message of the wheels.
const FIX_EVERY: i64 = 20;
const WARM_UP_S: i64 = 5;
const MEASURED_S: i64 = 20;
const ROUNDS: usize = 5;
/// The largest cost per observation with the most robots, as a multiple of that with the fewest.
const BAR: f64 = 1.10;

fn main() {
    // Without `--bench` it only has to run.
    let is_bench = std::env::args().any(|argument| argument == "--bench");
    let (rounds, seconds) = if is_bench { (ROUNDS, MEASURED_S) } else { (1, 1) };
    let mut counts: Vec<u32> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    if counts.is_empty() {
        counts = COUNTS.to_vec();
    }
    let mut best = vec![f64::INFINITY; counts.len()];
    for _ in 0..rounds {
        for (best, count) in best.iter_mut().zip(&counts) {
            *best = best.min(cpu_per_observation_us(*count, seconds));
        }
    }
    println!("{:>7} {:>20} {:>12} {:>20}", "robots", "us per observation", "ratio", "heap KiB per robot");
    for (cost, count) in best.iter().zip(&counts) {
        println!("{count:>7} {cost:>20.2} {:>12.3} {:>20.1}", cost / best[0], heap_per_robot_kib(*count));
    }
    println!("a robot should cost at most {BAR} times as much among {} as among {}", COUNTS[1], COUNTS[0]);
}

fn cpu_per_observation_us(count: u32, seconds: i64) -> f64 {
    let mut load = StationLoad::new(count);
    load.run(WARM_UP_S);
    let before = load.observations;
    let started_ns = thread_cpu_ns();
    load.run(seconds);
    let spent_ns = thread_cpu_ns() - started_ns;
    assert_eq!(load.station.robots().len(), count as usize, "each is a robot");
    spent_ns as f64 * 1e-3 / (load.observations - before) as f64
}

/// What the station holds for a robot after its history is full.
fn heap_per_robot_kib(count: u32) -> f64 {
    let held = |count| {
        let mut load = None;
        let measured = allocation_counter::measure(|| {
            let mut running = StationLoad::new(count);
            running.run(WARM_UP_S + 5);
            load = Some(running);
        });
        measured.bytes_current as f64
    };
    (held(count) - held(0)) / f64::from(count) / 1_024.0
}

/// Nanoseconds that this thread has run, as Linux counts them.
fn thread_cpu_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("this is Linux");
    text.split_whitespace().next().and_then(|field| field.parse().ok()).expect("it begins with the time on a processor")
}

/// A station and its peers.
struct StationLoad {
    station: Station,
    robots: u32,
    encoders: Vec<Encoder>,
    step: i64,
    observations: u64,
    /// Time requests of the station without a reply yet.
    requests: Vec<i64>,
}

impl StationLoad {
    fn new(robots: u32) -> Self {
        let mut config = config();
        config.max_robots = robots as usize;
        config.brick_message_intervals.clear();
        let mut load = Self {
            station: Station::new(config, Timestamp::ZERO).expect("the configuration is good"),
            robots,
            encoders: (0..robots).map(|_| Encoder::new(WireVersion::V2)).collect(),
            step: 0,
            observations: 0,
            requests: Vec::new(),
        };
        load.handle(Timestamp::ZERO, &Input::Link { link: LINK, state: LinkState::Up });
        load
    }

    fn run(&mut self, seconds: i64) {
        for _ in 0..seconds * 1_000 / PERIOD_MS {
            self.step += 1;
            let now = at(self.step * PERIOD_MS);
            while let Some(due) = self.station.deadline().filter(|due| *due <= now) {
                self.handle(due, &Input::Tick);
            }
            let requests = std::mem::take(&mut self.requests);
            for robot in 0..self.robots {
                // They do not send all at once.
                let now = now + TimeDelta::from_micros(i64::from(robot) * 49_000 / i64::from(self.robots));
                for request_nanos in &requests {
                    for from in [robot_address(robot), camera_address(robot)] {
                        let answer_nanos = now.as_nanos() - 1_000_000 + ahead_nanos(robot);
                        let request_nanos = *request_nanos;
                        self.send(
                            now,
                            robot,
                            from,
                            &Message::TimeSync(TimeSync { answer_nanos, request_nanos, target: None }),
                        );
                    }
                }
                self.send_telemetry(now, robot);
            }
        }
    }

    fn send_telemetry(&mut self, now: Timestamp<HostClock>, robot: u32) {
        let shown_micros = ((now.as_nanos() + ahead_nanos(robot)) / 1_000) as u64;
        let counts = EncoderTicks(self.step * 4);
        let stamp = WireStamp::Micros64(shown_micros);
        let wheels = Message::WheelTicks(WheelTicks { stamp, left: counts, right: counts });
        self.send(now, robot, robot_address(robot), &wheels);
        if (self.step + i64::from(robot)) % FIX_EVERY != 0 {
            return;
        }
        for from in [robot_address(robot), camera_address(robot)] {
            let beat = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };
            self.send(now, robot, from, &Message::Heartbeat(beat));
        }
        let fix = VisionFix {
            stamp,
            x: Meters(self.step as f64 * 4.0 * 0.028 * std::f64::consts::PI / 180.0),
            y: Meters(0.0),
            heading: Some(Heading::from_rad(0.0)),
            covariance: None,
            reset_counter: 0,
            tag: None,
        };
        self.send(now, robot, camera_address(robot), &Message::VisionPosition(fix));
    }

    fn send(&mut self, now: Timestamp<HostClock>, robot: u32, from: Address, message: &Message) {
        let mut bytes = Vec::with_capacity(64);
        self.encoders[robot as usize].encode(from, message, &mut bytes);
        self.handle(now, &Input::Bytes { link: LINK, peer: PeerId(robot), bytes });
    }

    fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) {
        self.station.handle(now, input);
        let is_tick = matches!(input, Input::Tick);
        while let Some(output) = self.station.poll() {
            match output {
                Output::Event(Event::ObservationFused { .. }) => self.observations += 1,
                Output::Transmit { bytes, .. } if is_tick => self.requests.extend(request_in(now, &bytes)),
                Output::Event(_) | Output::Transmit { .. } | Output::Request(_) => {}
            }
        }
    }
}

/// The number of a time request.
fn request_in(now: Timestamp<HostClock>, bytes: &[u8]) -> Option<i64> {
    let mut request = None;
    Framer::new(FramerConfig::default()).push(now, bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found
            && let Ok(Some(Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, .. }))) =
                dialect::decode(&frame)
        {
            request = Some(request_nanos);
        }
    });
    request
}

/// There are fewer systems than robots.
fn robot_address(robot: u32) -> Address {
    Address::new(1 + (robot % 240) as u8, 1 + (robot / 240) as u8)
}

fn camera_address(robot: u32) -> Address {
    Address::new(1 + (robot % 240) as u8, 100 + (robot / 240) as u8)
}

/// What the clocks of a robot and its camera show at host zero.
fn ahead_nanos(robot: u32) -> i64 {
    10_000_000_000 + 1_000_000 * i64::from(robot)
}
