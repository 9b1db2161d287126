//! How fast telemetry logs are inspected and replayed, in CPU seconds, beside pymavlink on the same bytes in the same run.
//! The log is an hour of a rover: wheel ticks and gyro 50 times per second, a camera five times, heartbeats. It is inspected ten times in
//! one file, so that starting the program does not count, and replayed once. pymavlink reads the hour if `python3`, or the program that
//! POSEBRIDGE_PYTHON names, has it. Run with `cargo bench --bench tlog`.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a benchmark stops when its set-up is broken, and prints its figures"
)]

use std::path::Path;
use std::process::{Command, Stdio};

use nix::sys::resource::{UsageWho, getrusage};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{Heartbeat, Inertial, Message, VisionFix, WheelTicks, WireStamp};
use posebridge_recording::tlog::TlogWriter;
use posebridge_telemetry::{Address, EncoderTicks, Heading, Meters, Radians, RadiansPerSecond};

/// An hour.
const LENGTH_S: u64 = 3_600;
/// Steps per second.
const RATE_HZ: u64 = 50;
/// So many hours are inspected.
const HOURS: u64 = 10;
/// The date of the first record, microseconds since 1970.
const START_MICROS: u64 = 1_700_000_000_000_000;
const ROUNDS: usize = 5;
const ROBOT: Address = Address::new(1, 1);
/// MAV_COMP_ID_CAMERA.
const CAMERA: Address = Address::new(1, 100);

/// Counts what a telemetry log holds, as pymavlink's own tools read it.
const PYMAVLINK: &str = "import sys\n\
    from pymavlink import mavutil\n\
    log = mavutil.mavlink_connection(sys.argv[1])\n\
    count = 0\n\
    while log.recv_msg() is not None:\n\
    \x20   count += 1\n\
    print(count)\n";

fn main() {
    let folder = tempfile::tempdir().expect("a folder for the logs");
    let (hour, long) = (folder.path().join("hour.tlog"), folder.path().join("long.tlog"));
    let frames = write(&hour, 1);
    write(&long, HOURS);
    let size = |path: &Path| std::fs::metadata(path).expect("it was just written").len() as f64;
    let program = env!("CARGO_BIN_EXE_posebridge");
    let long_name = long.to_string_lossy().into_owned();
    let hour_name = hour.to_string_lossy().into_owned();
    let inspect = best_cpu_s(Command::new(program).args(["inspect", &long_name, "--json"]));
    let inspect_s = inspect.expect("posebridge runs");
    let rate = |bytes: f64, cpu_s: f64| bytes / cpu_s * 1e-6;
    println!(
        "posebridge inspect  {:8.1} MB/s  ({:.0} MB, {inspect_s:.3} s of CPU)",
        rate(size(&long), inspect_s),
        size(&long) * 1e-6
    );
    let replay = best_cpu_s(Command::new(program).args(["replay", &hour_name, "--json"]));
    let replay_s = replay.expect("posebridge runs");
    println!(
        "posebridge replay   {:8.0} times real time  ({frames} frames of an hour, {replay_s:.3} s of CPU)",
        LENGTH_S as f64 / replay_s
    );
    let python = std::env::var("POSEBRIDGE_PYTHON").unwrap_or_else(|_unset| "python3".to_owned());
    match best_cpu_s(Command::new(python).args(["-c", PYMAVLINK, &hour_name])) {
        Some(cpu_s) => println!(
            "pymavlink           {:8.1} MB/s  ({:.0} MB, {cpu_s:.3} s of CPU)",
            rate(size(&hour), cpu_s),
            size(&hour) * 1e-6
        ),
        None => println!("pymavlink is not there: python3 -m pip install pymavlink"),
    }
}

/// The least CPU time of some rounds, user and system, s; `None` if the program is not there or fails.
fn best_cpu_s(command: &mut Command) -> Option<f64> {
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut best: Option<f64> = None;
    for _ in 0..ROUNDS {
        let before_s = children_cpu_s();
        if !command.status().is_ok_and(|status| status.success()) {
            return None;
        }
        let cpu_s = children_cpu_s() - before_s;
        best = Some(best.map_or(cpu_s, |best| best.min(cpu_s)));
    }
    best
}

fn children_cpu_s() -> f64 {
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN).expect("the system counts");
    let seconds = |time: nix::sys::time::TimeVal| time.tv_sec() as f64 + 1e-6 * time.tv_usec() as f64;
    seconds(usage.user_time()) + seconds(usage.system_time())
}

/// Writes so many hours of a robot that drives a circle of 0.5 m at 0.2 m/s, and says how many frames there are.
fn write(path: &Path, hours: u64) -> u64 {
    let file = std::fs::File::create(path).expect("a log");
    let mut writer = TlogWriter::new(std::io::BufWriter::new(file));
    let mut encoder = Encoder::new(WireVersion::V2);
    let mut frame = Vec::new();
    let mut frames = 0;
    for step in 0..hours * LENGTH_S * RATE_HZ {
        for (micros, from, message) in messages(step) {
            frame.clear();
            encoder.encode(from, &message, &mut frame);
            let written = writer.record(START_MICROS + micros, &frame);
            written.expect("the disk takes it");
            frames += 1;
        }
    }
    writer.finish().expect("the disk takes it");
    frames
}

/// What is said in one step: when, by whom, what.
fn messages(step: u64) -> Vec<(u64, Address, Message)> {
    let micros = step * 1_000_000 / RATE_HZ;
    let turned_rad = 0.4 * micros as f64 * 1e-6;
    let mut messages =
        vec![(micros, ROBOT, wheel_ticks(micros, turned_rad)), (micros + 2_000, ROBOT, inertial(micros, turned_rad))];
    if step.is_multiple_of(10) {
        messages.push((micros + 4_000, CAMERA, fix(micros, turned_rad)));
    }
    if step.is_multiple_of(RATE_HZ) {
        messages.push((micros + 5_000, ROBOT, heartbeat(10, 0)));
        messages.push((micros + 6_000, CAMERA, heartbeat(30, 8)));
    }
    messages
}

/// 28 mm wheels on a track of 112 mm, counts of one degree.
fn wheel_ticks(micros: u64, turned_rad: f64) -> Message {
    let ticks = |radius_m: f64| EncoderTicks((turned_rad * radius_m / 0.028).to_degrees() as i64);
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(micros as u32),
        left: ticks(0.5 - 0.056),
        right: ticks(0.5 + 0.056),
    })
}

fn inertial(micros: u64, turned_rad: f64) -> Message {
    Message::Inertial(Inertial {
        stamp: WireStamp::Micros32(micros as u32),
        turn_rate: Some(RadiansPerSecond(0.4)),
        turn: Some(Radians(turned_rad)),
        wheel_accelerations: None,
    })
}

fn fix(micros: u64, turned_rad: f64) -> Message {
    Message::VisionPosition(VisionFix {
        stamp: WireStamp::Micros64(micros),
        x: Meters(0.5 * turned_rad.sin()),
        y: Meters(0.5 - 0.5 * turned_rad.cos()),
        heading: Some(Heading::from_rad(turned_rad)),
        covariance: None,
        reset_counter: 0,
        tag: None,
    })
}

/// MAV_TYPE and MAV_AUTOPILOT of minimal.xml.
fn heartbeat(vehicle_type: u8, autopilot: u8) -> Message {
    Message::Heartbeat(Heartbeat { vehicle_type, autopilot, base_mode: 0, system_status: 4 })
}
