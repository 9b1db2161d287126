//! That the crate needs no standard library, proven by the compiler: a program with a panic handler of its own can only be
//! built when nothing in it brings the standard library's.

use std::path::Path;
use std::process::{Command, Output};

use crate::support::folder;

/// The target of the issue: Cortex-M3, core only.
const BARE_METAL: &str = "thumbv7m-none-eabi";

/// A brick's program that uses everything.
const PROGRAM: &str = r#"
#![no_std]
use posebridge_brick::{Gyro, Link, Received, Receiver, RobotDescription, Sides, WheelTicks};

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! { loop {} }

unsafe extern "C" { fn uart_write(bytes: *const u8, count: usize); }

#[unsafe(no_mangle)]
pub extern "C" fn step(now_us: u32, left: i32, right: i32, rate: i32, byte: u8) -> u32 {
    let mut sink = |bytes: &[u8]| unsafe { uart_write(bytes.as_ptr(), bytes.len()) };
    let mut link = Link::new(1, 1);
    let mut gyro = Gyro::new();
    gyro.sample(now_us, rate);
    link.heartbeat(&mut sink);
    link.wheel_ticks(&WheelTicks { time_us: now_us, left, right, valid: Sides::BOTH }, &mut sink);
    if let Some(inertial) = gyro.take() { link.inertial(&inertial, &mut sink); }
    link.description(&RobotDescription { name: "bare", ..RobotDescription::default() }, &mut sink);
    let mut receiver = Receiver::new();
    receiver.push(byte);
    match receiver.poll() {
        Some(Received::Pose(pose)) => pose.time_us,
        Some(Received::TimeRequest(request)) => { link.answer_time(&request, now_us, &mut sink); 0 }
        None => 0,
    }
}
"#;

fn rustc() -> Command {
    Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()))
}

fn checked(output: &Output) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
}

/// Builds the crate and the program for a target, in a folder of the test's own.
fn build(name: &str, target: Option<&str>, program: &str) -> Output {
    let folder = folder(name);
    let library = folder.join("libposebridge_brick.rlib");
    let for_target = target.map(|name| format!("--target={name}"));
    let common = ["--edition=2024", "-Copt-level=s", "-Cpanic=abort"];
    let built = rustc()
        .args(common)
        .args(&for_target)
        .args(["--crate-type=rlib", "--crate-name=posebridge_brick", "-o"])
        .arg(&library)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs"))
        .output();
    checked(&built.unwrap());
    let source = folder.join("program.rs");
    std::fs::write(&source, program).unwrap();
    rustc()
        .args(common)
        .args(&for_target)
        .args(["--crate-type=staticlib", "-o"])
        .arg(folder.join("libprogram.a"))
        .arg("--extern")
        .arg(format!("posebridge_brick={}", library.display()))
        .arg(source)
        .output()
        .unwrap()
}

#[test]
fn a_program_without_the_standard_library_builds() {
    checked(&build("bare", None, PROGRAM));
}

/// The proof above proves something: with the standard library in it there are two panic handlers.
#[test]
fn the_same_program_with_the_standard_library_does_not_build() {
    let with_std = PROGRAM.replace("#![no_std]", "#![no_std]\nextern crate std;");
    let output = build("with-std", None, &with_std);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("panic_impl"), "{said}");
}

/// Where rustup has installed the target, the program builds for it; elsewhere the proof above stands for it.
#[test]
fn the_program_builds_for_a_cortex_m3_where_its_core_library_is_installed() {
    let output = rustc().args(["--print=target-libdir", "--target", BARE_METAL]).output().unwrap();
    let libraries = String::from_utf8(output.stdout).unwrap();
    if Path::new(libraries.trim()).is_dir() {
        checked(&build(BARE_METAL, Some(BARE_METAL), PROGRAM));
        println!("built for {BARE_METAL}");
    } else {
        println!(
            "{BARE_METAL} is not installed (`rustup target add {BARE_METAL}`): built for this machine without std"
        );
    }
}
