//! The age of estimates beside a terminal, a pipe, a page's reader or a disk that takes nothing, and beside cameras that misbehave.
//!
//! Two stations of the program, each with a robot that asks for an estimate and waits for it, take turns in one run; one of them has
//! the stall. Printed is the time from the counts to their estimate, and the ratio of both; above 1.10 at the 99th percentile the
//! run fails. `cargo bench --bench stalls`, and with a file system of its own that may be frozen (as root, Linux):
//!
//! ```text
//! truncate -s 256M disk.img && mkfs.ext4 -q disk.img && mkdir disk && mount -o loop disk.img disk
//! cargo bench --bench stalls -- --disk disk
//! ```

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a benchmark stops when its set-up is broken, prints its figures, and measures with the host's clock"
)]

#[path = "../tests/attacks/robot.rs"]
mod robot;
#[path = "../tests/support/mod.rs"]
mod support;

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use posebridge_sim::rendered_camera::encode_jpeg;
use robot::{Robot, Station, folder_file, full_pipe};

const ROUNDS: usize = 200;
const EXCHANGES_PER_ROUND: usize = 100;
const LARGEST_RATIO: f64 = 1.10;

/// A robot with its station, and what has to live as long.
struct Side {
    robot: Robot,
    station: Station,
    folder: PathBuf,
    ages: Vec<Duration>,
    stall: Option<Stall>,
}

/// What holds the stalled end open.
enum Stall {
    Pipes { _readers: [File; 2] },
    Terminal { _keyboard: File },
    Page { _stream: TcpStream },
    Disk(PathBuf),
}

impl Drop for Stall {
    fn drop(&mut self) {
        if let Self::Disk(folder) = self {
            fsfreeze("-u", folder);
        }
    }
}

fn fsfreeze(flag: &str, folder: &Path) {
    let status = Command::new("fsfreeze").arg(flag).arg(folder).status().expect("fsfreeze is installed");
    assert!(status.success(), "fsfreeze {flag} {}: it takes root and a file system of its own", folder.display());
}

impl Side {
    fn start(folder: PathBuf, flags: &[&str], output: [OwnedFd; 2], stall: Option<Stall>) -> Self {
        let robot = Robot::new();
        let [stdout, stderr] = output;
        let station = robot.start_station(&folder, flags, stderr, stdout);
        Self { robot, station, folder, ages: Vec::new(), stall }
    }

    fn control(folder: PathBuf, page: &str) -> Self {
        let output = files(&folder);
        Self::start(folder, &[page], output, None)
    }

    /// With a camera whose pictures are searched for tags.
    fn with_camera(folder: PathBuf, camera: BadCamera) -> Self {
        let source = format!("http://{}/", camera.serve());
        let output = files(&folder);
        Self::start(folder, &[NO_PAGE, "--camera", &source], output, None)
    }

    fn round(&mut self) {
        self.robot.chatter(2);
        for _ in 0..EXCHANGES_PER_ROUND {
            let begun = Instant::now();
            self.robot.drive(1);
            self.ages.push(begun.elapsed());
        }
    }

    /// The stream of the page, opened.
    fn open_page(&self) -> TcpStream {
        let printed = support::read_text(&self.folder, "messages.txt");
        let address = printed.split("http://").nth(1).and_then(|rest| rest.split(['/', ' ', '\n']).next());
        let address = address.expect("it says where its page is");
        let mut stream = TcpStream::connect(address).expect("loopback");
        let request = format!(
            "GET /v1/stream HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).expect("loopback");
        let mut status = [0; 12];
        stream.read_exact(&mut status).expect("it answers");
        assert_eq!(&status, b"HTTP/1.1 101");
        stream
    }
}

/// A network camera with 60 pictures a second.
#[derive(Clone, Copy)]
enum BadCamera {
    /// None of which can be decoded, 150 kB each.
    Garbage,
    /// Every fifth one cut off, 640 x 480 and 1280 x 720 in turn, a pause after each second, and the end of the connection after two.
    Restless,
}

impl BadCamera {
    fn serve(self) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
        let address = listener.local_addr().expect("an address");
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                // The other end may be gone.
                drop(self.send_pictures(stream.expect("loopback")));
            }
        });
        address
    }

    fn send_pictures(self, mut stream: TcpStream) -> std::io::Result<()> {
        let mut request = [0; 4_096];
        let _ = stream.read(&mut request)?;
        stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=next\r\n\r\n")?;
        let pictures = self.pictures();
        for (number, picture) in pictures.iter().cycle().enumerate() {
            if matches!(self, Self::Restless) && number % 120 == 60 {
                std::thread::sleep(Duration::from_millis(500));
            }
            if matches!(self, Self::Restless) && number == 120 {
                return Ok(());
            }
            write!(stream, "--next\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len())?;
            stream.write_all(picture)?;
            stream.write_all(b"\r\n")?;
            std::thread::sleep(Duration::from_millis(16));
        }
        Ok(())
    }

    fn pictures(self) -> Vec<Vec<u8>> {
        let Self::Restless = self else {
            // Begins as a JPEG picture does.
            return vec![[&[0xFF, 0xD8, 0xFF, 0xDB], vec![0x5A; 150_000].as_slice()].concat()];
        };
        let drawn = |number: u16| {
            let (width, height) = if number.is_multiple_of(2) { (640, 480) } else { (1280, 720) };
            let pixels: Vec<u8> = (0..u32::from(width) * u32::from(height)).map(|pixel| (pixel % 251) as u8).collect();
            let mut jpeg = encode_jpeg(&pixels, width, height, 80).expect("it fits");
            if number.is_multiple_of(5) {
                jpeg.truncate(jpeg.len() / 2);
            }
            jpeg
        };
        (0..10).map(drawn).collect()
    }
}

fn files(folder: &Path) -> [OwnedFd; 2] {
    ["tables.txt", "messages.txt"].map(|name| folder_file(folder, name))
}

const NO_PAGE: &str = "--no-dashboard";
const PAGE: &str = "--dashboard=127.0.0.1:0";

fn main() -> ExitCode {
    let disk = std::env::args().skip_while(|argument| argument != "--disk").nth(1).map(PathBuf::from);
    let scratch = tempfile::tempdir().expect("a temporary directory");
    let folder = |name: &str| {
        let folder = scratch.path().join(name);
        std::fs::create_dir(&folder).expect("it is new");
        folder
    };
    println!("{ROUNDS} rounds of {EXCHANGES_PER_ROUND} exchanges on each side, in turn; ages in microseconds\n");
    println!("{:28}  {:>7} {:>7}  {:>7} {:>7}  {:>9}", "", "p50", "p99", "stalled", "p99", "p99 ratio");
    let mut is_within = true;

    let [(out_reader, stdout), (error_reader, stderr)] = [full_pipe(), full_pipe()];
    let stall = Stall::Pipes { _readers: [out_reader, error_reader] };
    let stalled = Side::start(folder("pipes"), &[NO_PAGE], [stdout, stderr], Some(stall));
    is_within &= compare("full pipes", [Side::control(folder("pipes-control"), NO_PAGE), stalled]);

    let pty = nix::pty::openpty(None, None).expect("a terminal");
    let mut keyboard = File::from(pty.master);
    keyboard.write_all(b"\x13").expect("Ctrl-S");
    let terminal = folder("terminal");
    let output = [folder_file(&terminal, "tables.txt"), pty.slave];
    let stalled = Side::start(terminal, &[NO_PAGE], output, Some(Stall::Terminal { _keyboard: keyboard }));
    is_within &= compare("Ctrl-S", [Side::control(folder("terminal-control"), NO_PAGE), stalled]);

    let mut control = Side::control(folder("page-control"), PAGE);
    let mut stalled = Side::control(folder("page"), PAGE);
    for side in [&mut control, &mut stalled] {
        side.robot.drive(1);
    }
    let mut read = control.open_page();
    std::thread::spawn(move || std::io::copy(&mut read, &mut std::io::sink()));
    stalled.stall = Some(Stall::Page { _stream: stalled.open_page() });
    is_within &= compare("a page that reads nothing", [control, stalled]);

    for (name, camera) in [("a camera's garbage", BadCamera::Garbage), ("a restless camera", BadCamera::Restless)] {
        let control = Side::control(folder(&format!("{name}, control")), NO_PAGE);
        is_within &= compare(name, [control, Side::with_camera(folder(name), camera)]);
    }

    if let Some(disk) = disk {
        let control = Side::control(folder("disk-control"), NO_PAGE);
        let output = files(&folder("disk-output"));
        let mut stalled = Side::start(disk.clone(), &[NO_PAGE], output, None);
        stalled.robot.drive(100);
        fsfreeze("-f", &disk);
        stalled.stall = Some(Stall::Disk(disk));
        is_within &= compare("a frozen disk", [control, stalled]);
    }
    if is_within { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Lets both sides drive in turn and prints their ages; false if the stall makes them older.
fn compare(name: &str, mut sides: [Side; 2]) -> bool {
    for round in 0..=ROUNDS {
        for side in &mut sides {
            side.round();
            if round == 0 {
                // The first meets cold caches and a clock that is not yet aligned.
                side.ages.clear();
            }
        }
    }
    let [control, stalled] = sides.map(|mut side| {
        side.ages.sort_unstable();
        drop(side.stall);
        side.station.interrupt();
        drop(side.station);
        [side.ages[side.ages.len() / 2], side.ages[side.ages.len() * 99 / 100]].map(|age| age.as_secs_f64() * 1e6)
    });
    let ratio = stalled[1] / control[1];
    println!("{name:28}  {:7.0} {:7.0}  {:7.0} {:7.0}  {ratio:9.2}", control[0], control[1], stalled[0], stalled[1]);
    ratio <= LARGEST_RATIO
}
