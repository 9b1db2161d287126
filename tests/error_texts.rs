//! What a user reads when something is wrong: clear, with the key or the path, exit code 2. Snapshots of the texts.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

use support::{posebridge, root};

/// Runs the program, expects exit code 2 and nothing on stdout, and returns what it said.
fn refused(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stdout.is_empty());
    String::from_utf8(output.stderr).unwrap()
}

fn with_config(text: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("station.toml"), text).unwrap();
    refused(posebridge(folder.path()).args(["run", "--config", "station.toml"]))
}

fn with_args(args: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    refused(posebridge(folder.path()).args(args))
}

#[test]
fn wrong_configuration() {
    insta::assert_snapshot!("wrong_key", with_config("[robot]\ntrack_with_m = 0.112\n"));
    insta::assert_snapshot!("wrong_type", with_config("[robot]\ntrack_width_m = \"wide\"\n"));
    insta::assert_snapshot!("no_toml", with_config("[robot\n"));
    insta::assert_snapshot!("impossible_value", with_config("[robot]\ntrack_width_m = -0.1\n"));
    insta::assert_snapshot!("unknown_filter", with_config("[filter]\nname = \"kalmann\"\n"));
    insta::assert_snapshot!("unknown_tunable", with_config("[filter]\ngate = 0.99\n"));
    insta::assert_snapshot!("tunable_out_of_range", with_config("[filter]\ngate_prob = 3.0\n"));
    insta::assert_snapshot!(
        "unknown_output",
        with_config("[[link]]\nurl = \"sim://square\"\noutputs = [{ message = \"pose\" }]\n")
    );
    insta::assert_snapshot!("no_link", with_config("link = []\n"));
    insta::assert_snapshot!("dashboard_address", with_config("[dashboard]\nlisten = \"localhost\"\n"));
    insta::assert_snapshot!("plotjuggler_address", with_config("[plotjuggler]\naddress = \"localhost:9870\"\n"));
    insta::assert_snapshot!("no_terminal", with_args(&["run", "--tui"]));
    insta::assert_snapshot!("wrong_setting", with_args(&["run", "--set", "robot.track=1"]));
}

#[test]
fn wrong_calibration_noise_or_world() {
    insta::assert_snapshot!(
        "unknown_calibration",
        with_config("[robot.calibration]\ntrack_scal = { value = 0.0, sigma = 0.1 }\n")
    );
    insta::assert_snapshot!(
        "calibration_without_sigma",
        with_config("[robot.calibration]\ntrack_scale = { value = 0.1 }\n")
    );
    insta::assert_snapshot!(
        "calibration_out_of_range",
        with_config("[robot.calibration]\ntrack_scale = { value = 0.0, sigma = -0.1 }\n")
    );
    insta::assert_snapshot!("noise_out_of_range", with_config("[robot.noise]\nwall_range_m = 0.0\n"));
    insta::assert_snapshot!(
        "beacon_twice",
        with_config("[world]\nbeacons = [{ id = 1, x_m = 0.0, y_m = 0.0 }, { id = 1, x_m = 1.0, y_m = 0.0 }]\n")
    );
    insta::assert_snapshot!("wall_without_end", with_config("[[world.walls]]\nfrom = { x_m = 0.0, y_m = 0.0 }\n"));
    insta::assert_snapshot!("calibration_setting", with_args(&["run", "--set", "robot.calibration.track_scale=0.1"]));
}

#[test]
fn a_calibration_that_cannot_be_saved() {
    insta::assert_snapshot!(
        "nothing_learned_live",
        with_args(&["run", "--filter", "odometry", "--save-calibration", "robot.toml"])
    );
    let descriptor = root().join("config/recordings/optiodom.toml");
    let data = root().join("tests/data");
    let replay = ["replay", descriptor.to_str().unwrap(), "--data", data.to_str().unwrap()];
    let said = with_args(&[&replay[..], &["--save-calibration", "robot.toml"]].concat());
    insta::assert_snapshot!("calibration_of_several_runs", said);
    let said = with_args(&[&replay[..], &["--set", "filter.name=odometry"]].concat());
    insta::assert_snapshot!("filter_of_a_recording", said);
    let said = with_args(&[&replay[..], &["--set", "filter.slip_nis=1"]].concat());
    insta::assert_snapshot!("tunable_of_a_recording", said);
}

#[test]
fn missing_files() {
    insta::assert_snapshot!("no_config", with_args(&["run", "--config", "nowhere.toml"]));
    insta::assert_snapshot!("no_recording", with_args(&["replay", "nowhere.mcap"]));
    insta::assert_snapshot!("no_descriptor", with_args(&["replay", "nowhere.toml"]));
    insta::assert_snapshot!("no_scenario", with_args(&["sim", "nowhere.toml", "--listen", "tcp://127.0.0.1:0"]));
    insta::assert_snapshot!("unknown_scenario", with_args(&["sim", "hexagon", "--listen", "tcp://127.0.0.1:0"]));
    insta::assert_snapshot!("no_robot", with_args(&["run", "--robot", "nowhere.toml"]));
    let descriptor = root().join("config/recordings/lego-nxt-camera.toml");
    let said = with_args(&["replay", descriptor.to_str().unwrap(), "--data", "nowhere"]);
    insta::assert_snapshot!("no_data", said);
}

#[test]
fn damaged_files() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("noise.mcap"), b"this is no recording").unwrap();
    insta::assert_snapshot!("no_mcap", refused(posebridge(folder.path()).args(["replay", "noise.mcap"])));
    std::fs::write(folder.path().join("wrong.toml"), "name = \"x\"\nspeed = 3\n").unwrap();
    insta::assert_snapshot!("wrong_descriptor", refused(posebridge(folder.path()).args(["replay", "wrong.toml"])));
    std::fs::write(folder.path().join("scenario.toml"), "seed = 1\n[drive]\nlaps = \"two\"\n").unwrap();
    let mut sim = posebridge(folder.path());
    insta::assert_snapshot!(
        "wrong_scenario",
        refused(sim.args(["sim", "scenario.toml", "--listen", "tcp://127.0.0.1:0"]))
    );
}

#[test]
fn experiments_that_cannot_be() {
    insta::assert_snapshot!("unknown_accuracy_scenario", with_args(&["lab", "accuracy", "--scenario", "camera-5hz"]));
    insta::assert_snapshot!("no_accuracy_scenario", with_args(&["lab", "accuracy", "--scenario", "nowhere.toml"]));
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("wrong.toml"), "seed = 1\nrunz = 3\n").unwrap();
    let mut lab = posebridge(folder.path());
    insta::assert_snapshot!(
        "wrong_accuracy_scenario",
        refused(lab.args(["lab", "accuracy", "--scenario", "wrong.toml"]))
    );
    let said = with_args(&["lab", "accuracy", "--estimator", "kalmann"]);
    assert!(
        said.starts_with("posebridge: no estimator of a pose is called \"kalmann\"; there are odometry, "),
        "{said}"
    );
}

#[test]
fn links_that_cannot_be() {
    insta::assert_snapshot!("unknown_scheme", with_args(&["run", "--link", "usb://brick"]));
    insta::assert_snapshot!("unknown_link_option", with_args(&["run", "--link", "serial:///dev/ttyACM0?speed=9600"]));
    insta::assert_snapshot!("wrong_port", with_args(&["run", "--link", "tcp://127.0.0.1:99999"]));
}

#[test]
fn a_port_in_use_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let said = with_args(&["run", "--listen", &format!("tcp://127.0.0.1:{port}"), "--no-record"]);
    insta::assert_snapshot!("port_in_use", said.replace(&port, "PORT"));
}

#[test]
fn a_device_without_permission_is_named_with_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    open_to_all(folder.path());
    // A pseudo-terminal that belongs to somebody else: as root the program is run as nobody, else a device of root's is taken.
    let pty = nix::pty::openpty(None, None).expect("a pseudo-terminal");
    let path = nix::unistd::ttyname(&pty.slave).expect("its name");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    let program = folder.path().join("posebridge");
    // Copied by another process: a program that this one starts meanwhile would inherit the file, open for writing, and what is open
    // for writing cannot be run.
    let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_posebridge")).arg(&program).status();
    assert!(copied.unwrap().success());
    let mut command = Command::new(&program);
    command.current_dir(folder.path()).args(["run", "--no-record", "--link"]).arg(format!("serial:{}", path.display()));
    if nix::unistd::geteuid().is_root() {
        command.uid(NOBODY).gid(NOBODY);
    } else {
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o000)).unwrap();
    }
    let said = refused(&mut command).replace(&path.display().to_string(), "DEVICE");
    assert!(said.contains("DEVICE") && said.contains("permission denied"), "{said}");
    assert!(said.contains("group"), "it says what to do: {said}");
}

/// The user that owns nothing, on every Linux.
const NOBODY: u32 = 65_534;

fn open_to_all(folder: &Path) {
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o777)).unwrap();
}

#[test]
fn a_configuration_or_a_manual_that_cannot_be_made() {
    insta::assert_snapshot!("init_without_a_robot", with_args(&["init"]));
    insta::assert_snapshot!("init_unknown_robot", with_args(&["init", "nxt"]));
    insta::assert_snapshot!("init_wrong_link", with_args(&["init", "sim", "--link", "telnet://here"]));
    insta::assert_snapshot!("init_without_a_folder", with_args(&["init", "sim", "--out", "gone/posebridge.toml"]));
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("posebridge.toml"), "").unwrap();
    let refused_here = |args: &[&str]| refused(posebridge(folder.path()).args(args));
    insta::assert_snapshot!("init_there_already", refused_here(&["init", "sim"]));
    insta::assert_snapshot!("man_where_a_file_is", refused_here(&["man", "--out", "posebridge.toml"]));
}
