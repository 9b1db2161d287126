//! `posebridge init`: the files that it writes load, and a robot of each kind drives a lap with them.
#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers outside #[test] stop where the set-up is broken, and the errors are to be read"
)]

mod support;
#[path = "support/terminal.rs"]
mod terminal;

use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::Path;
use std::process::Stdio;

use posebridge::config::{BundledRobot, ROBOTS, RobotProfile};
use support::{RunningProgram, error_to_truth_m, posebridge, stdout_of};
use terminal::PseudoTerminal;

/// A lap of a small square of a robot with this geometry and this gyro, about ten seconds.
fn scenario(robot: BundledRobot) -> String {
    let of = RobotProfile::from_toml(robot.text).unwrap().robot;
    format!(
        "seed = 5\nsteering = \"estimate\"\n[path.square]\nside_m = 0.3\n[drive]\nlaps = 1\nspeed_m_per_s = 0.2\n\
         [robot]\nwheel_radius_m = {}\ntrack_width_m = {}\n[camera]\nrate_hz = 5.0\n\
         [gyro]\nsigma_deg_per_s = {}\nquantum_deg_per_s = {}\n",
        of.left_wheel_radius_m,
        of.track_width_m,
        of.noise.gyro_rad_per_s.to_degrees(),
        of.noise.gyro_resolution_rad_per_s.to_degrees(),
    )
}

fn init(folder: &Path, args: &[&str]) {
    stdout_of(posebridge(folder).arg("init").args(args));
    stdout_of(posebridge(folder).args(["config", "check", "--config", "posebridge.toml"]));
}

/// The lap's report must hold every source, and the estimate must be good.
fn check_report(folder: &Path, robot: &str, printed: &str) {
    for source in ["wheels (0)", "gyro (1)", "camera (3)"] {
        assert!(printed.contains(source), "{robot}: {printed}");
    }
    let off_m = error_to_truth_m(folder);
    println!("{robot}: off by {:.1} mm", 1e3 * off_m);
    assert!(off_m < 0.02, "{robot}: {off_m}");
}

/// A robot that is called over a serial port.
fn called(name: &str, kind: &str) {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let robot = BundledRobot::from_name(name).unwrap();
    std::fs::write(folder.join("small.toml"), scenario(robot)).unwrap();
    init(folder, &[name, "--link", "serial:brick.tty"]);
    let file = folder.join("posebridge.toml");
    // The simulated encoders count degrees: who has such a robot changes that line.
    let text = std::fs::read_to_string(&file).unwrap();
    let text = text.replace("ticks_per_turn = 1440.0", "ticks_per_turn = 360.0");
    std::fs::write(&file, text).unwrap();
    let mut sim = posebridge(folder);
    sim.args(["sim", "small.toml", "--brick", kind, "--listen", "pty:brick.tty"]);
    sim.args(["--truth", "truth.csv"]);
    let shares_link = kind == "mavlink";
    if !shares_link {
        sim.args(["--camera-listen", "tcp://127.0.0.1:0"]);
    }
    let mut brick = RunningProgram::start(&mut sim);
    if shares_link {
        brick.wait_for("brick.tty");
    } else {
        // A camera beside the robot is one block more in the file.
        let address = brick.listening_address("camera ");
        let mut options = OpenOptions::new();
        let mut file = options.append(true).open(&file).unwrap();
        writeln!(file, "\n[[link]]\nurl = \"tcp://{address}\"").unwrap();
    }
    let mut run = posebridge(folder);
    run.args(["run", "--config", "posebridge.toml", "--no-dashboard"]);
    run.args(["--until-silent", "2", "--out", "run"]);
    let printed = stdout_of(&mut run);
    brick.output();
    check_report(folder, name, &printed);
}

#[test]
fn an_nxt_drives_a_lap_with_its_file() {
    called("nxt-56mm", "nxt");
    called("nxt-43mm", "nxt");
}

#[test]
fn an_ev3_and_an_arduino_drive_a_lap_with_their_files() {
    called("ev3-educator", "ev3");
    called("arduino-2wd", "mavlink");
}

/// The hub's bridge calls the station; estimates leave at the interval of the robot's file.
#[test]
fn a_hub_that_calls_drives_a_lap_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let robot = BundledRobot::from_name("pybricks-spike").unwrap();
    std::fs::write(folder.join("small.toml"), scenario(robot)).unwrap();
    init(folder, &["pybricks-spike", "--listen", "tcp://127.0.0.1:0"]);
    let mut run = posebridge(folder);
    run.args(["run", "--config", "posebridge.toml", "--no-dashboard"]);
    run.args(["--until-silent", "2", "--out", "run"]);
    let mut station = RunningProgram::start(&mut run);
    let link = format!("tcp://{}", station.listening_address(""));
    let sim = ["sim", "small.toml", "--link", &link, "--truth", "truth.csv"];
    stdout_of(posebridge(folder).args(sim));
    check_report(folder, "pybricks-spike", &station.output());
}

#[test]
fn the_simulated_robot_drives_a_lap_with_its_file_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    init(folder, &["sim"]);
    let run = ["run", "--config", "posebridge.toml", "--no-dashboard", "--laps", "1"];
    let printed = stdout_of(posebridge(folder).args(run).args(["--out", "run"]));
    assert!(printed.contains("wheels (0)"), "{printed}");
    assert!(printed.contains("path error when steering by"), "{printed}");
}

#[test]
fn every_robot_has_a_file_that_loads_and_says_that_its_link_is_a_guess() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for robot in ROBOTS {
        init(folder, &[robot.name, "--force"]);
        let show = ["config", "print", "--config", "posebridge.toml"];
        let printed = stdout_of(posebridge(folder).args(show));
        let named = format!("robot.name = \"{}\"    # file", robot.name);
        assert!(printed.contains(&named), "{printed}");
        // What stands there as a comment only is still the default.
        let still = "record.part_max_minutes = 5    # default";
        assert!(printed.contains(still), "{printed}");
        let shown = stdout_of(posebridge(folder).args(["init", robot.name, "--out", "-"]));
        let (_, link) = shown.split_once("[[link]]\nurl = ").unwrap();
        let line = link.lines().next().unwrap();
        let says = ["a guess", "how this robot is usually reached"];
        assert!(says.iter().any(|words| line.contains(words)), "{line}");
    }
}

#[test]
fn a_file_that_is_there_is_not_touched_without_force() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let path = folder.join("posebridge.toml");
    std::fs::write(&path, "# mine\n").unwrap();
    let refused = posebridge(folder).args(["init", "sim"]).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "# mine\n");
    // Nor by a link that makes no sense.
    let wrong = ["init", "sim", "--force", "--link", "telnet://here"];
    let refused = posebridge(folder).args(wrong).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "# mine\n");
    init(folder, &["sim", "--force"]);
    let files = std::fs::read_dir(folder).unwrap().count();
    assert_eq!(files, 1, "nothing is left beside it");
}

/// Whoever sits at a terminal is asked.
#[test]
fn on_a_terminal_the_robot_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut terminal = PseudoTerminal::open();
    let mut device = OpenOptions::new();
    device.read(true).write(true);
    let open = || Stdio::from(device.open(terminal.device()).unwrap());
    let mut command = posebridge(folder.path());
    command.args(["init", "--link", "sim://square"]);
    let mut program = command.stdin(open()).stderr(open()).spawn().unwrap();
    terminal.wire.write_all(b"43mm\nnxt-43mm\n").unwrap();
    assert!(program.wait().unwrap().success());
    let text = std::fs::read_to_string(folder.path().join("posebridge.toml")).unwrap();
    assert!(text.contains("name = \"nxt-43mm\""), "{text}");
}
