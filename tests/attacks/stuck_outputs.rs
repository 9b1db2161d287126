//! Terminals, pipes and disks that take nothing.

use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::stat::Mode;

use crate::robot::{Robot, folder_file, full_pipe};
use crate::support::events_named;

/// All that comes until the writer's end is closed; a terminal ends with an error.
fn read_to_end(source: &mut File) -> String {
    let (mut text, mut buffer) = (Vec::new(), [0; 4_096]);
    while let Ok(length @ 1..) = source.read(&mut buffer) {
        text.extend_from_slice(&buffer[..length]);
    }
    String::from_utf8_lossy(&text).into_owned()
}

#[test]
fn a_full_pipe_on_stdout_and_stderr_costs_no_estimate_and_what_was_dropped_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (mut said, stderr) = full_pipe();
    let (mut printed, stdout) = full_pipe();
    let mut robot = Robot::new();
    let mut station = robot.start_station(folder.path(), &["--no-dashboard"], stderr, stdout);
    robot.drive(1);
    robot.chatter(2_000);
    robot.drive(100);
    let reader = std::thread::spawn(move || read_to_end(&mut said));
    robot.drive(100);
    station.interrupt();
    let tables = read_to_end(&mut printed);
    assert!(station.0.wait().unwrap().success());
    let said = reader.join().unwrap();
    assert!(said.contains("messages are missing here"), "{said}");
    assert!(tables.contains("filter     "), "{tables}");
}

/// XOFF and XON, which a terminal makes of Ctrl-S and Ctrl-Q.
const CTRL_S: &[u8] = b"\x13";
const CTRL_Q: &[u8] = b"\x11";

#[test]
fn ctrl_s_on_the_terminal_costs_no_estimate_and_what_was_dropped_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let pty = nix::pty::openpty(None, None).unwrap();
    let mut keyboard = File::from(pty.master);
    keyboard.write_all(CTRL_S).unwrap();
    let stdout = folder_file(folder.path(), "tables.txt");
    let mut robot = Robot::new();
    let mut station = robot.start_station(folder.path(), &["--no-dashboard"], pty.slave, stdout);
    robot.drive(1);
    robot.chatter(2_000);
    robot.drive(100);
    keyboard.write_all(CTRL_Q).unwrap();
    let mut screen = keyboard.try_clone().unwrap();
    let reader = std::thread::spawn(move || read_to_end(&mut screen));
    robot.drive(100);
    station.interrupt();
    assert!(station.0.wait().unwrap().success());
    let screen = reader.join().unwrap();
    assert!(screen.contains("messages are missing here"), "{screen}");
}

#[test]
fn an_event_file_that_nobody_reads_costs_no_estimate_and_lacks_nothing_that_was_queued() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events");
    nix::unistd::mkfifo(&path, Mode::S_IRWXU).unwrap();
    let mut events = OpenOptions::new().read(true).custom_flags(OFlag::O_NONBLOCK.bits()).open(&path).unwrap();
    fcntl(&events, FcntlArg::F_SETFL(OFlag::empty())).unwrap();
    let [stdout, stderr] = ["tables.txt", "messages.txt"].map(|name| folder_file(folder.path(), name));
    let mut robot = Robot::new();
    let mut station = robot.start_station(folder.path(), &["--no-dashboard", "--events", "events"], stderr, stdout);
    // Its events fill the pipe ten times over.
    robot.drive(1_000);
    station.interrupt();
    let events = read_to_end(&mut events);
    assert!(station.0.wait().unwrap().success());
    assert_eq!(events_named(&events, "estimated").len(), 1_000);
}
