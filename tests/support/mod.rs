//! The program under test as a user would start it, in a folder of its own.

#![allow(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]
#![allow(clippy::print_stdout, reason = "a test says which data it did not look at")]
#![allow(dead_code, reason = "each test file uses its own part of this")]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

pub(crate) mod mavlink;
pub(crate) mod terminal;
pub(crate) mod virtual_drive;

use std::io::{BufRead, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use posebridge::station::run_report::{SimulationTruth, errors};
use posebridge::virtual_station::VirtualRun;
use posebridge_telemetry::SensorId;
use serde_json::Value;

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

/// Waits for the end of a program, which must succeed, and returns its standard output.
pub(crate) fn stdout_of(command: &mut Command) -> String {
    let output = command.output().expect("the program starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}: {stderr}", output.status);
    String::from_utf8(output.stdout).expect("stdout is text")
}

/// Runs the program with these arguments, and returns its standard output.
pub(crate) fn run(folder: &Path, args: &[&str]) -> String {
    stdout_of(posebridge(folder).args(args))
}

/// The same with `--json`: the object that it prints.
pub(crate) fn json(folder: &Path, args: &[&str]) -> Value {
    let text = stdout_of(posebridge(folder).args(args).arg("--json"));
    serde_json::from_str(&text).expect("one JSON object")
}

/// Runs the program to its end, and returns its exit code and standard error.
pub(crate) fn exit_code_and_stderr(folder: &Path, args: &[&str]) -> (Option<i32>, String) {
    let output = posebridge(folder).args(args).output().expect("the program starts");
    (output.status.code(), String::from_utf8(output.stderr).expect("stderr is text"))
}

/// Each command line, split at spaces, must end with this exit code, print nothing, and say these words on standard error.
pub(crate) fn assert_refused(folder: &Path, cases: &[(&str, i32, &[&str])]) {
    for (command, code, words) in cases {
        let output = posebridge(folder).args(command.split(' ')).output().expect("the program starts");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(*code), "{command}: {stderr}");
        assert!(output.stdout.is_empty(), "{command}");
        for word in *words {
            assert!(stderr.contains(word), "{command}: `{word}` in {stderr}");
        }
    }
}

/// The errors of estimate and odometry of a virtual run, rms, in millimetres.
pub(crate) fn errors_mm(run: &VirtualRun) -> [f64; 2] {
    let (estimate, odometry) = errors(&run.collector, &SimulationTruth::from_simulation(&run.simulation));
    [estimate, odometry].map(|error| 1e3 * error.position_rms_m.expect("there are estimates"))
}

/// How many observations of a sensor a virtual run has used.
pub(crate) fn used(run: &VirtualRun, sensor: SensorId) -> u64 {
    let mut sources = run.collector.sources.iter();
    sources.find(|tally| tally.sensor == sensor).map_or(0, |tally| tally.used)
}

/// Where the recordings of others lie; `None` on a computer without them.
pub(crate) fn shared_data() -> Option<PathBuf> {
    let data = std::env::var_os("POSEBRIDGE_DATA").map(PathBuf::from);
    if data.is_none() {
        println!("POSEBRIDGE_DATA is not set: recordings of others were not looked at");
    }
    data
}

/// The path of a bundled descriptor of a recording.
pub(crate) fn descriptor(name: &str) -> String {
    root().join("config/recordings").join(name).display().to_string()
}

/// The path of the committed data.
pub(crate) fn committed_data() -> String {
    root().join("tests/data").display().to_string()
}

/// One committed run of a real robot with truth and without a camera.
pub(crate) const OPTIODOM_RUN: &str = "circular/250620202104/run-01";

/// A file of a folder as text.
pub(crate) fn read_text(folder: &Path, name: &str) -> String {
    std::fs::read_to_string(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Writes a file into a folder.
pub(crate) fn write_text(folder: &Path, name: &str, text: &str) {
    std::fs::write(folder.join(name), text).unwrap_or_else(|error| panic!("{name}: {error}"));
}

/// The number at a JSON pointer.
pub(crate) fn number(object: &Value, pointer: &str) -> f64 {
    let value = object.pointer(pointer).and_then(Value::as_f64);
    value.unwrap_or_else(|| panic!("{pointer} in {object:#}"))
}

/// The element of a JSON array that has this name.
pub(crate) fn named<'a>(array: &'a Value, name: &str) -> &'a Value {
    let mut elements = array.as_array().into_iter().flatten();
    elements.find(|one| one["name"] == name).unwrap_or_else(|| panic!("{name} in {array:#}"))
}

/// The events of an `--events` file that have this name, in their order.
pub(crate) fn events_named(text: &str, name: &str) -> Vec<Value> {
    let events = text.lines().map(|line| serde_json::from_str(line).expect("an event is a line of JSON"));
    events.filter(|event: &Value| event["event"] == name).collect()
}

/// Replays a recording, which must give the events of the live run bit for bit; returns them.
pub(crate) fn assert_replays(folder: &Path, recording: &str, live: &str) -> String {
    run(folder, &["replay", recording, "--events", "replayed.txt"]);
    let (live, replayed) = (read_text(folder, live), read_text(folder, "replayed.txt"));
    for (number, (live, replayed)) in live.lines().zip(replayed.lines()).enumerate() {
        assert_eq!(live, replayed, "event {number}");
    }
    assert_eq!(live.lines().count(), replayed.lines().count());
    live
}

/// A running program whose standard error can be waited for; killed when dropped.
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

    /// Starts `posebridge` in a folder with these arguments.
    pub(crate) fn posebridge(folder: &Path, args: &[&str]) -> Self {
        Self::start(posebridge(folder).args(args))
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
        self.send(Signal::SIGINT);
        self.output()
    }

    /// The same as the end of its terminal.
    pub(crate) fn hang_up(mut self) -> String {
        self.send(Signal::SIGHUP);
        self.output()
    }

    /// The same for a run that may end badly: exit code, standard output and what it said since it was last waited for.
    pub(crate) fn interrupted(mut self) -> (Option<i32>, String, String) {
        self.send(Signal::SIGINT);
        let heard = self.output.len();
        let (status, printed) = self.wait_for_end();
        (status.code(), printed, self.output.split_off(heard))
    }

    fn send(&self, signal: Signal) {
        let pid = Pid::from_raw(i32::try_from(self.child.id()).expect("a process id"));
        kill(pid, signal).expect("it can be signalled");
    }

    /// Waits for its end and returns its standard output.
    pub(crate) fn output(&mut self) -> String {
        let (status, text) = self.wait_for_end();
        assert!(status.success(), "{status}; it said:\n{}", self.output);
        text
    }

    fn wait_for_end(&mut self) -> (ExitStatus, String) {
        let mut text = String::new();
        let mut stdout = self.child.stdout.take().expect("stdout is piped");
        // Neither may fill up while the other one is read.
        std::thread::scope(|scope| {
            scope.spawn(|| self.lines.read_to_string(&mut self.output).expect("stderr is text"));
            stdout.read_to_string(&mut text).expect("stdout is text");
        });
        (self.child.wait().expect("it can be waited for"), text)
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
pub(crate) const SKEWED_SQUARE: &str = include_str!("../data/skewed-square.toml");

/// Of a descriptor: wheels that count ticks, in a file `wheels.csv` with the columns `t_s`, `left` and `right`.
pub(crate) const WHEELS_CSV: &str = include_str!("../data/wheels-csv.toml");

/// A simulated brick that waits to be called, and its URL.
pub(crate) fn listening_brick(folder: &Path, scenario: &str) -> (RunningProgram, String) {
    write_text(folder, "small.toml", scenario);
    let mut brick = RunningProgram::posebridge(folder, &["sim", "small.toml", "--listen", "tcp://127.0.0.1:0"]);
    let address = brick.listening_address("");
    (brick, format!("tcp://{address}"))
}
