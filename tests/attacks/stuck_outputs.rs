//! Terminals, pipes and disks that take nothing. The robot asks for an estimate and waits for it before it sends the next counts, so a
//! station that waits for anything else never ends the drive.

use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::process::Child;

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::unistd::Pid;
use posebridge_protocol::message::{Message, TextPart};
use posebridge_telemetry::Address;

use crate::support::mavlink::{MavlinkPeer, PATIENCE, wheel_ticks};
use crate::support::{events_named, posebridge};

/// A robot on UDP at a station whose messages nobody reads.
struct Robot {
    socket: UdpSocket,
    peer: MavlinkPeer,
    step: u32,
}

impl Robot {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.set_read_timeout(Some(PATIENCE)).expect("it can wait");
        Self { socket, peer: MavlinkPeer::new(Address::new(1, 1)), step: 0 }
    }

    /// Starts a station that calls this robot, and waits for its first datagram.
    fn start_station(&self, folder: &Path, more: &[&str], stderr: OwnedFd, stdout: OwnedFd) -> Station {
        let link = format!("udp://{}", self.socket.local_addr().expect("an address"));
        let mut command = posebridge(folder);
        command.args(["run", "--link", &link, "--out", "run", "--no-dashboard"]).args(more);
        let station = Station(command.stdout(stdout).stderr(stderr).spawn().expect("the program starts"));
        let (_, address) = self.socket.recv_from(&mut [0; 2_048]).expect("it calls");
        self.socket.connect(address).expect("an address");
        station
    }

    /// Sends counts and waits for the estimate, `steps` times.
    fn drive(&mut self, steps: u32) {
        for _ in 0..steps {
            self.step += 1;
            let frame = self.peer.frame(&wheel_ticks(self.step));
            self.socket.send(&frame).expect("it is sent");
            let mut buffer = [0; 2_048];
            loop {
                let length = self.socket.recv(&mut buffer).expect("an estimate comes");
                let heard = self.peer.decode(&buffer[..length]);
                if heard.iter().any(|(_, message)| matches!(message, Message::PlanarPose(_))) {
                    break;
                }
            }
        }
    }

    /// Texts that a station prints, each another one.
    fn chatter(&mut self, texts: u32) {
        for number in 0..texts {
            let text = format!("wheel {number} slips");
            let text = Message::StatusText { severity: 4, text, part: TextPart::default() };
            let frame = self.peer.frame(&text);
            self.socket.send(&frame).expect("it is sent");
            // So that none is lost on the way: the station answers, then it has read them.
            if number.is_multiple_of(50) {
                self.drive(1);
            }
        }
    }
}

/// A pipe that takes no byte until its other end is read.
fn full_pipe() -> (File, OwnedFd) {
    let (reader, writer) = nix::unistd::pipe().expect("a pipe");
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).expect("it is open");
    while nix::unistd::write(&writer, &[b'\n'; 4_096]).is_ok() {}
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::empty())).expect("it is open");
    (File::from(reader), writer)
}

/// All that comes until the writer's end is closed; a terminal ends with an error.
fn read_to_end(source: &mut File) -> String {
    let (mut text, mut buffer) = (Vec::new(), [0; 4_096]);
    while let Ok(length @ 1..) = source.read(&mut buffer) {
        text.extend_from_slice(&buffer[..length]);
    }
    String::from_utf8_lossy(&text).into_owned()
}

/// Killed when dropped.
struct Station(Child);

impl Station {
    fn interrupt(&self) {
        let pid = Pid::from_raw(i32::try_from(self.0.id()).expect("a process id"));
        kill(pid, Signal::SIGINT).expect("it can be signalled");
    }
}

impl Drop for Station {
    fn drop(&mut self) {
        // Already gone is as good.
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

#[test]
fn a_full_pipe_on_stdout_and_stderr_costs_no_estimate_and_what_was_dropped_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (mut said, stderr) = full_pipe();
    let (mut printed, stdout) = full_pipe();
    let mut robot = Robot::new();
    let mut station = robot.start_station(folder.path(), &[], stderr, stdout);
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
    let stdout = OwnedFd::from(File::create(folder.path().join("tables.txt")).unwrap());
    let mut robot = Robot::new();
    let mut station = robot.start_station(folder.path(), &[], pty.slave, stdout);
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
    let [stdout, stderr] =
        ["tables.txt", "messages.txt"].map(|name| OwnedFd::from(File::create(folder.path().join(name)).unwrap()));
    let mut robot = Robot::new();
    let mut station = robot.start_station(folder.path(), &["--events", "events"], stderr, stdout);
    // Its events fill the pipe ten times over.
    robot.drive(1_000);
    station.interrupt();
    let events = read_to_end(&mut events);
    assert!(station.0.wait().unwrap().success());
    assert_eq!(events_named(&events, "estimated").len(), 1_000);
}
