//! The vector file, and the four that answer its commands: this crate, C, MicroPython's module, NXC's encoder.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use posebridge_brick::{
    Battery, Gyro, Inertial, InertialParts, Link, PlanarPose, Received, Receiver, RobotDescription, Sides, WheelTicks,
};

/// A line of the vector file.
pub(crate) struct Vector {
    pub(crate) command: String,
    pub(crate) expected: String,
}

/// The folder `brick`.
pub(crate) fn brick() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

pub(crate) fn vectors() -> Vec<Vector> {
    let text = std::fs::read_to_string(brick().join("vectors/vectors.txt")).unwrap();
    let lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let vectors: Vec<Vector> = lines
        .map(|line| {
            let (command, expected) = line.split_once(" = ").unwrap();
            Vector { command: command.to_owned(), expected: expected.to_owned() }
        })
        .collect();
    assert!(vectors.len() > 50, "the vector file is cut off");
    vectors
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

pub(crate) fn unhex(text: &str) -> Vec<u8> {
    let pairs = text.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

/// What this crate makes of a command.
pub(crate) fn rust_answer(command: &str) -> String {
    let words: Vec<&str> = command.split(' ').collect();
    let (name, rest) = words.split_first().unwrap();
    if *name == "receive" {
        return receive(rest);
    }
    let number = |place: usize| rest[place].parse::<i64>().unwrap();
    let mut link = Link::continued(number(1) as u8, number(2) as u8, number(0) as u8);
    let mut wire = Vec::new();
    let mut sink = |bytes: &[u8]| wire.extend_from_slice(bytes);
    match *name {
        "heartbeat" => link.heartbeat(&mut sink),
        "wheel_ticks" => link.wheel_ticks(
            &WheelTicks {
                time_us: number(3) as u32,
                left: number(4) as i32,
                right: number(5) as i32,
                valid: Sides(number(6) as u8),
            },
            &mut sink,
        ),
        "inertial" => link.inertial(
            &Inertial {
                time_us: number(3) as u32,
                turn_urad: number(4) as i32,
                turn_rate: number(5) as i16,
                accel_left: number(6) as i16,
                accel_right: number(7) as i16,
                valid: InertialParts(number(8) as u8),
            },
            &mut sink,
        ),
        "battery" => {
            link.battery(&Battery { millivolts: number(3) as u16, percent: u8::try_from(number(4)).ok() }, &mut sink);
        }
        "description" => describe(&mut link, &rest[3..], &mut sink),
        "gyro" => {
            let inertial = integrate(&rest[3..]);
            link.inertial(&inertial, &mut sink);
        }
        other => panic!("unknown command {other}"),
    }
    hex(&wire)
}

fn describe(link: &mut Link, words: &[&str], sink: &mut impl FnMut(&[u8])) {
    let number = |place: usize| f32::from_bits(u32::from_str_radix(words[place], 16).unwrap());
    let name = match words[6] {
        "-" => Vec::new(),
        digits => unhex(digits),
    };
    let robot = RobotDescription {
        left_wheel_radius_m: number(0),
        right_wheel_radius_m: number(1),
        track_width_m: number(2),
        ticks_per_turn: number(3),
        gyro_sigma_rad_per_s: number(4),
        gyro_resolution_rad_per_s: number(5),
        name: str::from_utf8(&name).unwrap(),
    };
    link.description(&robot, sink);
}

fn integrate(words: &[&str]) -> Inertial {
    let numbers: Vec<i64> = words.iter().map(|word| word.parse().unwrap()).collect();
    let mut now_us = numbers[0] as u32;
    let mut gyro = Gyro::new();
    for sample in numbers[1..].chunks(2) {
        now_us = now_us.wrapping_add(sample[0] as u32);
        gyro.sample(now_us, sample[1] as i32);
    }
    gyro.take().unwrap()
}

fn receive(words: &[&str]) -> String {
    let now_us = words[0].parse().unwrap();
    let mut link = Link::new(words[1].parse().unwrap(), words[2].parse().unwrap());
    let mut receiver = Receiver::new();
    let mut found = Vec::new();
    for byte in unhex(words[3]) {
        receiver.push(byte);
        while let Some(received) = receiver.poll() {
            match received {
                Received::Pose(pose) => found.push(pose_text(&pose)),
                Received::TimeRequest(request) => {
                    let mut sink = |bytes: &[u8]| found.push(format!("answer {}", hex(bytes)));
                    link.answer_time(&request, now_us, &mut sink);
                }
            }
        }
    }
    if found.is_empty() {
        return "nothing".to_owned();
    }
    found.join(" ")
}

fn pose_text(pose: &PlanarPose) -> String {
    let numbers = [pose.x_m, pose.y_m, pose.heading_rad, pose.forward_speed_m_per_s, pose.turn_rate_rad_per_s];
    let bits: Vec<String> =
        numbers.iter().chain(&pose.covariance).map(|number| format!("{:08x}", number.to_bits())).collect();
    let rest =
        [pose.fix_age_ms.into(), pose.reset_counter.into(), pose.flags.into(), pose.epoch].map(|n: u32| n.to_string());
    format!("pose {} {} {}", pose.time_us, bits.join(" "), rest.join(" "))
}

/// The C header behind its driver, compiled by the system's compiler.
pub(crate) fn c_driver(folder: &Path) -> Command {
    compiled(folder, "driver.c")
}

/// NXC's encoder, compiled as C.
pub(crate) fn nxc_driver(folder: &Path) -> Command {
    compiled(folder, "nxc_driver.c")
}

/// MicroPython's module behind its driver, run by Python 3.
pub(crate) fn python_driver() -> Command {
    let mut python = Command::new("python3");
    python.arg("-B").arg(brick().join("check/driver.py")).arg(brick().join("micropython"));
    python
}

fn compiled(folder: &Path, source: &str) -> Command {
    let program = folder.join(source.replace('.', "_"));
    let output = Command::new(compiler())
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"])
        .arg("-I")
        .arg(brick().join("c"))
        .arg("-I")
        .arg(brick().join("nxc"))
        .arg(brick().join("check").join(source))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    Command::new(program)
}

fn compiler() -> &'static str {
    let found = ["cc", "gcc", "clang"].into_iter().find(|name| {
        let status = Command::new(name).arg("--version").stdout(Stdio::null()).status();
        status.is_ok_and(|status| status.success())
    });
    found.expect("none of cc, gcc, clang starts: install gcc to check the brick SDK")
}

/// One answer for each command.
pub(crate) fn answers(driver: &mut Command, commands: &[String]) -> Vec<String> {
    let mut child = driver.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    let text = format!("{}\n", commands.join("\n"));
    let writer = std::thread::spawn(move || input.write_all(text.as_bytes()));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    assert!(output.status.success(), "a driver failed: {driver:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    let answers: Vec<String> = text.lines().map(str::to_owned).collect();
    assert_eq!(answers.len(), commands.len(), "{driver:?}");
    answers
}

/// A folder of this test's own below Cargo's for tests.
pub(crate) fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}
