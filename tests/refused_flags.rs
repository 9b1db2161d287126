//! A flag that has no meaning beside the others is refused: who gave it would believe that it did something.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::path::Path;

use support::posebridge;

/// A command, and the flags, each with its value, none of which may go with it. No file needs to exist.
const REFUSED: [(&str, &[&str]); 34] = [
    // Two sources.
    ("lab nxt-square --link tcp://127.0.0.1:9", &["--recording a.mcap", "--listen tcp://127.0.0.1:9", "--runs 3"]),
    ("lab wall --listen tcp://127.0.0.1:0", &["--scene a.toml", "--runs 3", "--steps 3", "--seed 3", "--recording a"]),
    // How a live robot is recorded, of a recording that is there.
    ("lab wall --recording a.mcap", LIVE),
    ("lab indirect --recording a.mcap", LIVE),
    ("lab nxt-square --recording a.mcap", LIVE),
    ("lab nxt-square --data a.csv", LIVE),
    ("lab thermometer --recording a.mcap", LIVE),
    ("identify rest --recording a.mcap", LIVE),
    ("identify straight --recording a.mcap", LIVE),
    ("identify delay --recording a.mcap", LIVE),
    ("calibrate rest a.mcap", LIVE),
    ("calibrate path a.mcap", LIVE),
    ("calibrate umbmark a.mcap", LIVE),
    ("calibrate umbmark --sim", LIVE),
    // What only a real robot has.
    ("lab indirect", &["--duration 3", "--judge start", "--set a=1"]),
    ("lab thermometer", &["--set a=1", "--duration 3"]),
    ("identify rest", &["--set a=1", "--duration 3"]),
    ("identify straight", &["--set a=1", "--config c.toml"]),
    ("identify delay", &["--set a=1", "--run r"]),
    ("identify step", &["--time-unit ms", "--run r", "--set a=1", "--channel range"]),
    // What only the simulation has.
    ("identify rest --recording a.mcap", &["--seed 2", "--sim a"]),
    ("identify step --recording a.csv", &["--seed 2", "--sim motor", "--set a=1", "--channel range"]),
    ("identify step --recording a.toml", &["--time-unit ms"]),
    ("identify wall --recording a.toml", &["--steps 3", "--seed 2", "--scene s.toml"]),
    ("lab wall --recording a.toml", &["--steps 3", "--runs 3", "--seed 2", "--profile wifi"]),
    ("lab thermometer --recording a.toml", &["--runs 20", "--seed 2"]),
    ("lab indirect --recording a.mcap", &["--runs 20", "--seed 2", "--scenario s.toml"]),
    ("calibrate umbmark a.mcap", &["--runs 2", "--seed 2"]),
    ("tune --recording a.toml", &["--runs 3", "--seed 2", "--sim camera-1hz"]),
    ("tune --sim camera-1hz", &["--run r", "--hold-out r", "--set a=1", "--fixes-from-truth 1", "--use-every 2"]),
    // Ways of a calibration.
    (
        "calibrate path a.mcap --online",
        &["--hold track", "--free track=1", "--against fixes", "--truth-sigma-m 1", "--try-on r"],
    ),
    (
        "calibrate path --segments a.csv",
        &["--set a=1", "--run r", "--use-every 2", "--against truth", "--unknown-start", "--try-on r", "--online"],
    ),
    ("calibrate umbmark --sim", &["--run r", "--set a=1", "--use-every 2", "--side-m 1"]),
    ("calibrate umbmark --ends a.csv --side-m 1", &["--run r", "--set a=1", "--use-every 2", "--seed 2", "--runs 2"]),
];

const LIVE: &[&str] = &["--duration 3", "--config c.toml"];

/// Exit code and talk.
fn exit_code_and_stderr(folder: &Path, command: &str) -> (Option<i32>, String) {
    let args = command.split(' ');
    let output = posebridge(folder).args(args).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn flags_that_do_not_go_together_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (command, flags) in REFUSED {
        for flag in flags {
            let command = format!("{command} {flag}");
            let (code, said) = exit_code_and_stderr(folder.path(), &command);
            assert_eq!(code, Some(2), "{command}: {said}");
            let name = flag.split(' ').next().unwrap();
            let is_told = ["cannot be used with", "were not provided", "belong", "changes", "choose"];
            let is_told = is_told.iter().any(|word| said.contains(word));
            assert!(is_told && said.contains(name), "{command}: {said}");
        }
    }
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 0, "what is refused leaves nothing behind");
}
