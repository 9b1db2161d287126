//! The program under test as a user would start it, in a folder of its own.

#![allow(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]
#![allow(dead_code, reason = "each test file uses its own part of this")]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

/// The repository's root.
pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The program, to be started in `folder`.
pub(crate) fn posebridge(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_posebridge"));
    command.current_dir(folder).env_remove("POSEBRIDGE_DATA").env_remove("POSEBRIDGE_LOG");
    command
}

/// Waits for the end of a program, which must be a good one, and returns what it printed.
pub(crate) fn stdout_of(command: &mut Command) -> String {
    let output = command.output().expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {said}", output.status);
    String::from_utf8(output.stdout).expect("stdout is text")
}

/// The events of an `--events` file that have this name, in their order.
pub(crate) fn events_named(text: &str, name: &str) -> Vec<serde_json::Value> {
    let events = text.lines().map(|line| serde_json::from_str(line).expect("an event is a line of JSON"));
    events.filter(|event: &serde_json::Value| event["event"] == name).collect()
}

/// The number behind the first `name` of a line, up to its unit or the end of its field.
pub(crate) fn number_after(line: &str, name: &str) -> f64 {
    let text = line.split(name).nth(1).expect("the field is there");
    let digits = text.split(['s', ')', ',', ' ']).next();
    let digits = digits.expect("it has a value");
    digits.parse().expect("it is a number")
}

/// A running program whose talk can be waited for; killed when dropped.
pub(crate) struct RunningProgram {
    child: Child,
    lines: BufReader<ChildStderr>,
    output: String,
}

impl RunningProgram {
    /// Starts a program.
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        let stderr = child.stderr.take().expect("stderr is piped");
        Self { child, lines: BufReader::new(stderr), output: String::new() }
    }

    /// Its process.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Reads what it says until a line holds `text`, and returns that line.
    pub(crate) fn wait_for(&mut self, text: &str) -> String {
        loop {
            let mut line = String::new();
            let read = self.lines.read_line(&mut line).expect("stderr is text");
            assert!(read > 0, "it ended before it said `{text}`; it said:\n{}", self.output);
            self.output.push_str(&line);
            if line.contains(text) {
                return line;
            }
        }
    }

    /// Reads what it says until `who` tells where it is listening, and returns the address.
    pub(crate) fn listening_address(&mut self, who: &str) -> String {
        let what = format!("{who}listening on ");
        let line = self.wait_for(&what);
        let (_, address) = line.split_once(&what).expect("it was waited for");
        address.trim().to_owned()
    }

    /// Kills it as `kill -9` does.
    pub(crate) fn kill(mut self) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it can be waited for");
    }

    /// Asks it to end, as Ctrl-C does, and returns its standard output.
    pub(crate) fn interrupt(mut self) -> String {
        self.send_interrupt();
        self.output()
    }

    /// Asks it to end, as Ctrl-C does, and returns its exit code and what it said since it was last listened to.
    pub(crate) fn interrupted(self) -> (Option<i32>, String) {
        let (code, _, said) = self.interrupted_with_output();
        (code, said)
    }

    /// The same, with its standard output before what it said.
    pub(crate) fn interrupted_with_output(mut self) -> (Option<i32>, String, String) {
        use std::io::Read as _;
        self.send_interrupt();
        let mut stdout = self.child.stdout.take().expect("stdout is piped");
        let (mut printed, mut said) = (String::new(), String::new());
        // Neither may fill up while the other one is read.
        std::thread::scope(|scope| {
            scope.spawn(|| self.lines.read_to_string(&mut said).expect("stderr is text"));
            stdout.read_to_string(&mut printed).expect("stdout is text");
        });
        let status = self.child.wait().expect("it can be waited for");
        (status.code(), printed, said)
    }

    fn send_interrupt(&self) {
        let pid = nix::unistd::Pid::from_raw(i32::try_from(self.child.id()).expect("a process id"));
        nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGINT).expect("it can be signalled");
    }

    /// Waits for its end and returns its standard output.
    pub(crate) fn output(&mut self) -> String {
        use std::io::Read as _;
        let mut text = String::new();
        let mut stdout = self.child.stdout.take().expect("stdout is piped");
        // What it still says must be read, or it would wait for us.
        std::thread::scope(|scope| {
            scope.spawn(|| self.lines.read_to_string(&mut self.output).expect("stderr is text"));
            stdout.read_to_string(&mut text).expect("stdout is text");
        });
        let status = self.child.wait().expect("it can be waited for");
        assert!(status.success(), "{status}; it said:\n{}", self.output);
        text
    }
}

impl Drop for RunningProgram {
    fn drop(&mut self) {
        // Already gone is as good.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// A short square whose brick runs 2000 ppm fast and whose 32-bit counter wraps on the way.
pub(crate) const SKEWED_SQUARE: &str = r#"
seed = 7
steering = "estimate"

[path.square]
side_m = 0.3

[drive]
laps = 1
speed_m_per_s = 0.2

[brick]
clock_skew_ppm = 2000.0
clock_start_micros = 4290967296
"#;

/// Of a descriptor: a robot at rest with a gyro, whose column in `wheels.csv` is `gyro`; [`WHEELS_CSV`] belongs behind it.
pub(crate) const GYRO_BESIDE_WHEELS: &str = r#"
name = "by-hand"
source = "written by this test"
licence = "-"
default_run = "rest"

[robot]
left_wheel_radius_m = 0.1
right_wheel_radius_m = 0.1
track_width_m = 0.2
ticks_per_turn = 360.0

[[runs]]
name = "rest"

[[gyro]]
file = "wheels"
turn_rate = "gyro"
"#;

/// Of a descriptor: wheels that count ticks, in a file `wheels.csv` with the columns `t_s`, `left` and `right`.
pub(crate) const WHEELS_CSV: &str = r#"
[files.wheels]
path = "wheels.csv"
header_lines = 1
time = { column = "t_s" }

[[wheels]]
file = "wheels"
counting = "absolute"
left = { column = "left", unit = "ticks" }
right = { column = "right", unit = "ticks" }
"#;

/// A simulated brick that waits to be called, and its URL.
pub(crate) fn listening_brick(folder: &Path, scenario: &str) -> (RunningProgram, String) {
    let path = folder.join("small.toml");
    std::fs::write(path, scenario).expect("the folder can be written");
    let sim = ["sim", "small.toml", "--listen", "tcp://127.0.0.1:0"];
    let mut brick = RunningProgram::start(posebridge(folder).args(sim));
    let address = brick.listening_address("");
    (brick, format!("tcp://{address}"))
}

/// How far off the run in `run/recording.mcap` was, against `truth.csv`: what was recorded is what happened, and the truth says how far off
/// that was.
pub(crate) fn error_to_truth_m(folder: &Path) -> f64 {
    let replay = ["replay", "run/recording.mcap"];
    let replay = replay.into_iter().chain(["--truth", "truth.csv", "--json"]);
    let replayed = stdout_of(posebridge(folder).args(replay));
    let replayed: serde_json::Value = serde_json::from_str(&replayed).expect("it prints JSON");
    let off_m = replayed["estimators"][0]["position_rms_m"].as_f64();
    off_m.expect("there is a truth")
}
