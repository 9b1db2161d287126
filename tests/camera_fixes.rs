//! A camera program in Python feeds fixes into a running station: the script of `examples/` as it stands, three processes, real time.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::io::{Read as _, Write as _};
use std::net::{TcpStream, UdpSocket};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use support::{RunningProgram, events_named, posebridge, root, stdout_of};

/// A square whose robot is not quite what its brick believes, with an overhead camera of 10 Hz and a few millimetres.
const SCENARIO: &str = r#"
seed = 7
steering = "estimate"

[path.square]
side_m = 0.5

[drive]
laps = 1
speed_m_per_s = 0.15

[errors]
radius_error = 0.005
radius_error_sigma = 0.0
radius_mismatch = 0.005
radius_mismatch_sigma = 0.0
track_error = -0.02
track_error_sigma = 0.0

[brick]
clock_skew_ppm = 500.0

[camera]
rate_hz = 10.0
position_sigma_m = 0.003
heading_sigma_deg = 0.5
"#;

/// What the script is late by: the time that a slow detector needs.
const SECONDS_LATE: &str = "0.15";

/// After so long without an answer a test has failed.
const DEADLINE: Duration = Duration::from_secs(20);

/// The script; killed when dropped.
struct CameraScript(Child);

impl Drop for CameraScript {
    fn drop(&mut self) {
        // Already gone is as good.
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn script(station: &str, images: &str) -> CameraScript {
    let mut python = Command::new("python3");
    python
        .arg(root().join("examples/camera_fixes.py"))
        .args([station, images, SECONDS_LATE])
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    CameraScript(python.spawn().expect("there is a Python"))
}

/// The address behind `what` in a line of several.
fn address_in(line: &str, what: &str) -> String {
    let behind = line.split(what).nth(1).expect("it was said");
    let end = behind.find(';').unwrap_or(behind.len());
    behind[..end].trim().to_owned()
}

fn brick(folder: &Path) -> (RunningProgram, String, String) {
    std::fs::write(folder.join("square.toml"), SCENARIO).expect("the folder can be written");
    let mut brick = RunningProgram::start(posebridge(folder).args([
        "sim",
        "square.toml",
        "--listen",
        "tcp://127.0.0.1:0",
        "--images-listen",
        "tcp://127.0.0.1:0",
        "--truth",
        "truth.csv",
    ]));
    let line = brick.wait_for("brick up");
    let own = address_in(&line, ", listening on ");
    let images = address_in(&line, "its images listening on ");
    (brick, own, images)
}

fn station(folder: &Path, brick: &str) -> (RunningProgram, String) {
    let config = format!(
        "[[link]]\nurl = \"tcp://{brick}\"\n\n[[link]]\nurl = \"udp://127.0.0.1:0\"\nlisten = true\nbrick = \"camera-json\"\n"
    );
    std::fs::write(folder.join("station.toml"), config).expect("the folder can be written");
    let mut station = RunningProgram::start(posebridge(folder).args([
        "run",
        "--config",
        "station.toml",
        "--out",
        "run",
        "--events",
        "events.txt",
    ]));
    let address = station.listening_address("");
    (station, address)
}

/// A camera over one of the two transports.
enum Sender {
    Udp(UdpSocket),
    Tcp(TcpStream, Vec<u8>),
}

impl Sender {
    fn to(scheme: &str, address: &str) -> Self {
        if scheme == "tcp" {
            let stream = TcpStream::connect(address).expect("the station listens");
            stream.set_read_timeout(Some(DEADLINE)).expect("it can wait");
            return Self::Tcp(stream, Vec::new());
        }
        let socket = UdpSocket::bind("127.0.0.1:0").expect("there is a port");
        socket.connect(address).expect("the station listens");
        socket.set_read_timeout(Some(DEADLINE)).expect("it can wait");
        Self::Udp(socket)
    }

    /// Over TCP in pieces of five bytes.
    fn send(&mut self, line: &str) {
        match self {
            Self::Udp(socket) => {
                socket.send(line.as_bytes()).expect("the station is there");
            }
            Self::Tcp(stream, _) => {
                for part in line.as_bytes().chunks(5) {
                    stream.write_all(part).expect("the station is there");
                }
            }
        }
    }

    /// Reads until a line has this key, and returns it.
    fn receive(&mut self, key: &str) -> Value {
        loop {
            let mut chunk = [0; 2_048];
            let bytes = match self {
                Self::Udp(socket) => {
                    let count = socket.recv(&mut chunk).expect("the station answers");
                    chunk[..count].to_vec()
                }
                Self::Tcp(stream, rest) => {
                    let count = stream.read(&mut chunk).expect("the station answers");
                    assert!(count > 0, "the station hung up");
                    rest.extend(&chunk[..count]);
                    let end = rest.iter().rposition(|byte| *byte == b'\n');
                    rest.drain(..end.map_or(0, |end| end + 1)).collect()
                }
            };
            for line in bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
                let said: Value = serde_json::from_slice(line).expect("it speaks JSON");
                if said.get(key).is_some() {
                    return said;
                }
            }
        }
    }
}

#[test]
fn over_udp_and_tcp_a_bad_line_is_answered_and_the_time_is_asked() {
    for scheme in ["udp", "tcp"] {
        let folder = tempfile::tempdir().unwrap();
        let config = format!("[[link]]\nurl = \"{scheme}://127.0.0.1:0\"\nlisten = true\nbrick = \"camera-json\"\n");
        std::fs::write(folder.path().join("station.toml"), config).unwrap();
        let mut station = RunningProgram::start(posebridge(folder.path()).args(["run", "--config", "station.toml"]));
        let address = station.listening_address("");
        let mut camera = Sender::to(scheme, &address);
        camera.send("{\"camera\": \"c\", \"x_m\": 1, \"y_m\": 2}\n");
        camera.send("{\"camera\": \"c\", \"x_m\": 1, \"y_m\": \"two\"}\n");
        let complaint = camera.receive("error");
        assert_eq!(complaint["key"], "y_m", "{scheme}");
        assert_eq!(complaint["line"], 2, "{scheme}");
        assert!(camera.receive("time_request")["time_request"].is_i64());
        station.interrupt();
    }
}

#[test]
fn a_script_of_a_few_lines_holds_the_pose_to_three_millimetres_through_150_ms() {
    let folder = tempfile::tempdir().unwrap();
    let (mut brick, own, images) = brick(folder.path());
    let (station, cameras) = station(folder.path(), &own);
    let _script = script(&cameras, &images);
    // Until the path is driven to its end.
    brick.output();
    station.interrupt();

    let json =
        stdout_of(posebridge(folder.path()).args(["replay", "run/recording.mcap", "--truth", "truth.csv", "--json"]));
    let scored: Value = serde_json::from_str(&json).unwrap();
    let number = |pointer: &str| scored.pointer(pointer).and_then(Value::as_f64);
    let rms_mm = 1e3 * number("/estimators/0/position_rms_m").unwrap();
    let heading_deg = number("/estimators/0/heading_rms_rad").unwrap().to_degrees();
    let sources = scored.pointer("/estimators/0/sources").unwrap();
    let mut sources = sources.as_array().unwrap().iter();
    let camera = sources.find(|source| source["name"] == "camera");
    let used = camera.unwrap()["used"].as_u64().unwrap();
    let events = std::fs::read_to_string(folder.path().join("events.txt")).unwrap();
    let aligned = events_named(&events, "camera_clock_aligned").len();
    println!(
        "{used} fixes, {aligned} of the camera's clock aligned; position {rms_mm:.2} mm rms, heading {heading_deg:.2} degrees rms"
    );
    assert!(used > 80, "{used} fixes were used");
    assert!(aligned > 10, "the script answers for its time");
    assert!(rms_mm <= 3.0, "{rms_mm} mm");
    assert!(events.contains("camera `overhead` is 1/100 here"));
}
