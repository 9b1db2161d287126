//! The brick SDK and the station: robots in C and in Python that are driven against the same station.
//! A board stands behind each robot as lines of text (brick/check/robot.c), time is virtual, and the clock of the robot is wrong
//! and wraps in the middle. That the SDKs make the right bytes is tested in brick/rust.

use std::f64::consts::TAU;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use posebridge::config::{Config, RobotStart};
use posebridge_station::Station;
use posebridge_telemetry::{Estimate, Event, Input, LinkId, LinkState, Output, PeerId, TimeDelta, Timestamp};

use crate::support::root;

/// What the robots describe: brick/check/robot.c.
const RADIUS_M: f64 = 0.0325;
const TRACK_M: f64 = 0.15;
const TICKS_PER_TURN: f64 = 1440.0;
/// The circle that is driven.
const SPEED_M_PER_S: f64 = 0.2;
const TURN_RAD_PER_S: f64 = 0.5;
const STEP_MS: i64 = 20;
const STEPS: i64 = 600;
/// The robot's clock at the beginning: it wraps after five seconds, and runs fast by so much.
const CLOCK_START_US: f64 = 4_289_967_296.0;
const CLOCK_RATE: f64 = 1.0005;
/// How long bytes are on their way to the station.
const DELAY: TimeDelta = TimeDelta::from_millis(3);

/// A robot's program, and the pipes that are its board.
struct Robot {
    program: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
}

/// What the robot believes: millimetres, milliradians, flags.
type OnboardEstimate = [i64; 4];

impl Robot {
    fn start(mut command: Command) -> Self {
        let mut program = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let to = program.stdin.take().unwrap();
        let from = BufReader::new(program.stdout.take().unwrap());
        Self { program, to, from }
    }

    /// One pass of the program at `time_s`; takes what came, returns what it sends.
    fn step(&mut self, time_s: f64, bytes: &[u8]) -> (Vec<u8>, OnboardEstimate) {
        let now_us = (CLOCK_START_US + 1e6 * CLOCK_RATE * time_s) as u64 as u32;
        let count = |speed_m_per_s: f64| (speed_m_per_s * time_s / RADIUS_M / TAU * TICKS_PER_TURN).floor() as i64;
        let left = count(SPEED_M_PER_S - 0.5 * TRACK_M * TURN_RAD_PER_S);
        let right = count(SPEED_M_PER_S + 0.5 * TRACK_M * TURN_RAD_PER_S);
        // By its own clock, which is fast, the robot turns slower.
        let rate = (1e6 * TURN_RAD_PER_S / CLOCK_RATE) as i64;
        write!(self.to, "{now_us} {left} {right} {rate} ").unwrap();
        for byte in bytes {
            write!(self.to, "{byte:02x}").unwrap();
        }
        writeln!(self.to, "{}", if bytes.is_empty() { "-" } else { "" }).unwrap();
        let mut line = String::new();
        self.from.read_line(&mut line).unwrap();
        let words: Vec<&str> = line.split_whitespace().collect();
        let sent = words[0].as_bytes().chunks(2);
        let sent = sent.map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap());
        let numbers: Vec<i64> = words[1..].iter().map(|word| word.parse().unwrap()).collect();
        (sent.collect(), numbers.try_into().unwrap())
    }

    fn end(mut self) {
        drop(self.to);
        assert!(self.program.wait().unwrap().success());
    }
}

/// What came of a drive.
struct DriveResult {
    estimate: Estimate,
    onboard_estimate: OnboardEstimate,
    alignments: usize,
}

/// Drives a robot for twelve seconds against the station.
fn drive(command: Command) -> DriveResult {
    let mut config = Config::default();
    config.robot.start =
        Some(RobotStart { x_m: 0.0, y_m: 0.0, heading_deg: 0.0, position_sigma_m: 0.001, heading_sigma_deg: 0.1 });
    let mut station = Station::new(config.station_config().unwrap(), Timestamp::ZERO).unwrap();
    let mut robot = Robot::start(command);
    let (mut to_robot, mut estimate, mut onboard_estimate) = (Vec::new(), None, OnboardEstimate::default());
    let mut alignments = 0;
    let link = LinkId(0);
    let up = Input::Link { link, state: LinkState::Up };
    station.handle(Timestamp::ZERO, &up);
    for step in 0..STEPS {
        let at = TimeDelta::from_millis(step * STEP_MS);
        let (bytes, believed) = robot.step(at.as_secs_f64(), &to_robot);
        onboard_estimate = believed;
        to_robot.clear();
        let peer = PeerId::default();
        let input = Input::Bytes { link, peer, bytes };
        for input in [&input, &Input::Tick] {
            station.handle(Timestamp::ZERO + at + DELAY, input);
            while let Some(output) = station.poll() {
                match output {
                    Output::Transmit { bytes, .. } => to_robot.extend(bytes),
                    Output::Event(Event::EstimateUpdated { estimate: new, .. }) => estimate = Some(new),
                    Output::Event(Event::BrickClockAligned { .. }) => alignments += 1,
                    Output::Event(_) | Output::Request(_) => {}
                }
            }
        }
    }
    robot.end();
    DriveResult { estimate: estimate.unwrap(), onboard_estimate, alignments }
}

/// Where the robot is at a step.
fn truth(step: i64) -> [f64; 3] {
    let turned = TURN_RAD_PER_S * TimeDelta::from_millis(step * STEP_MS).as_secs_f64();
    let radius = SPEED_M_PER_S / TURN_RAD_PER_S;
    [radius * turned.sin(), radius * (1.0 - turned.cos()), posebridge_telemetry::quantities::wrap_rad(turned)]
}

/// Drives a robot and holds its errors to their bars.
fn check(name: &str, command: Command) {
    let drive = drive(command);
    let [x, y, heading] = truth(STEPS - 1);
    let pose = drive.estimate.pose;
    let off_m = (pose.x.0 - x).hypot(pose.y.0 - y);
    let off_rad = (pose.heading.rad() - heading).abs();
    assert!(off_m < 0.005 && off_rad < 0.01, "{name}: {off_m} m, {off_rad} rad");
    assert!(drive.alignments > 20, "{name}: TIMESYNC was not answered");
    // What the robot has came with the step before: it is one step old.
    let [x, y, heading] = truth(STEPS - 2);
    let [x_mm, y_mm, heading_mrad, flags] = drive.onboard_estimate;
    let believed_off_m = (1e-3 * x_mm as f64 - x).hypot(1e-3 * y_mm as f64 - y);
    assert!(believed_off_m < 0.008, "{name}: {believed_off_m} m");
    assert!((1e-3 * heading_mrad as f64 - heading).abs() < 0.02, "{name}");
    assert_eq!(flags & 3, 3, "{name}");
    println!("{name}: off by {:.1} mm and {:.2} mrad, {} alignments", 1e3 * off_m, 1e3 * off_rad, drive.alignments);
}

#[test]
fn robots_in_c_and_python_are_heard_and_hear_where_they_are() {
    let folder = tempfile::tempdir().unwrap();
    check("C", compiled(&folder.path().join("robot")));
    let mut python = Command::new("python3");
    python.arg("-B").arg(root().join("brick/check/robot.py")).arg(root().join("brick/micropython"));
    check("Python", python);
}

fn compiled(program: &Path) -> Command {
    let output = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"])
        .arg(root().join("brick/c"))
        .arg(root().join("brick/check/robot.c"))
        .arg("-o")
        .arg(program)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    Command::new(program)
}
