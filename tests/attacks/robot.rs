//! A robot that asks for an estimate and waits for it before it sends the next counts, so a station that waits for anything else never
//! ends the drive.

use std::fs::File;
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::Child;

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use posebridge_protocol::message::{Message, TextPart};
use posebridge_telemetry::Address;

use crate::support::mavlink::{MavlinkPeer, PATIENCE, wheel_ticks};
use crate::support::posebridge;

/// A robot on UDP.
pub(crate) struct Robot {
    socket: UdpSocket,
    peer: MavlinkPeer,
    step: u32,
}

impl Robot {
    pub(crate) fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.set_read_timeout(Some(PATIENCE)).expect("it can wait");
        Self { socket, peer: MavlinkPeer::new(Address::new(1, 1)), step: 0 }
    }

    /// Starts a station that calls this robot, and waits for its first datagram.
    pub(crate) fn start_station(&self, folder: &Path, more: &[&str], stderr: OwnedFd, stdout: OwnedFd) -> Station {
        let link = format!("udp://{}", self.socket.local_addr().expect("an address"));
        let mut command = posebridge(folder);
        command.args(["run", "--link", &link, "--out", "run"]).args(more);
        let station = Station(command.stdout(stdout).stderr(stderr).spawn().expect("the program starts"));
        let (_, address) = self.socket.recv_from(&mut [0; 2_048]).expect("it calls");
        self.socket.connect(address).expect("an address");
        station
    }

    /// Sends counts and waits for the estimate, `steps` times.
    pub(crate) fn drive(&mut self, steps: u32) {
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

    pub(crate) fn say(&mut self, text: &str) {
        let text = Message::StatusText { severity: 4, text: text.to_owned(), part: TextPart::default() };
        let frame = self.peer.frame(&text);
        self.socket.send(&frame).expect("it is sent");
    }

    /// Texts that a station prints, each another one.
    pub(crate) fn chatter(&mut self, texts: u32) {
        for number in 0..texts {
            self.say(&format!("wheel {number} slips"));
            // So that none is lost on the way: the station answers, then it has read them.
            if number.is_multiple_of(50) {
                self.drive(1);
            }
        }
    }
}

/// Killed when dropped.
pub(crate) struct Station(pub(crate) Child);

impl Station {
    pub(crate) fn interrupt(&self) {
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

/// A new file for what a program prints.
pub(crate) fn folder_file(folder: &Path, name: &str) -> OwnedFd {
    OwnedFd::from(File::create(folder.join(name)).expect("the folder is ours"))
}

/// A pipe that takes no byte until its other end is read.
pub(crate) fn full_pipe() -> (File, OwnedFd) {
    let (reader, writer) = nix::unistd::pipe().expect("a pipe");
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).expect("it is open");
    while nix::unistd::write(&writer, &[b'\n'; 4_096]).is_ok() {}
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::empty())).expect("it is open");
    (File::from(reader), writer)
}
