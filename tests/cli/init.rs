//! `posebridge init`: the files that it writes load, and a robot of each kind drives a lap with them, in virtual time.

use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::Path;
use std::process::Stdio;

use crate::support::terminal::PseudoTerminal;
use crate::support::virtual_drive::record_drive;
use crate::support::{RunningProgram, assert_refused, errors_mm, posebridge, read_text, run, used, write_text};
use posebridge::config::{BundledRobot, LinkSection, RobotProfile, load_text};
use posebridge::virtual_station;
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::{SensorId, TimeDelta};

/// A lap of a small square of a robot with this geometry and this gyro.
fn scenario(robot: BundledRobot, personality: &str) -> Scenario {
    let of = RobotProfile::from_toml(robot.text).unwrap().robot;
    let text = format!(
        "seed = 5\nsteering = \"estimate\"\n[path.square]\nside_m = 0.3\n[drive]\nlaps = 1\nspeed_m_per_s = 0.2\n\
         [robot]\nwheel_radius_m = {}\ntrack_width_m = {}\n[camera]\nrate_hz = 5.0\n[brick]\npersonality = \"{personality}\"\n\
         [gyro]\nsigma_deg_per_s = {}\nquantum_deg_per_s = {}\n",
        of.left_wheel_radius_m,
        of.track_width_m,
        of.noise.gyro_rad_per_s.to_degrees(),
        of.noise.gyro_resolution_rad_per_s.to_degrees(),
    );
    Scenario::from_toml(&text).unwrap()
}

fn init(folder: &Path, args: &[&str]) {
    run(folder, &[&["init"], args].concat());
    run(folder, &["config", "check", "--config", "posebridge.toml"]);
}

#[test]
fn a_robot_of_each_kind_drives_a_lap_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    for (name, personality) in [
        ("nxt-56mm", "nxt"),
        ("nxt-43mm", "nxt"),
        ("ev3-educator", "ev3"),
        ("arduino-2wd", "mavlink"),
        ("pybricks-spike", "mavlink"),
        ("sim", "mavlink"),
    ] {
        // Without a link it is guessed from the ports of this computer.
        let guessed = run(folder.path(), &["init", name, "--out", "-"]);
        let (_, link) = guessed.split_once("[[link]]\nurl = ").unwrap();
        let words = ["a guess", "how this robot is usually reached"];
        assert!(words.iter().any(|words| link.lines().next().unwrap().contains(words)), "{guessed}");
        init(folder.path(), &[name, "--force", "--link", "serial:brick.tty"]);
        // The simulated encoders count degrees: who has such a robot changes that line.
        let text = read_text(folder.path(), "posebridge.toml");
        let text = text.replace("ticks_per_turn = 1440.0", "ticks_per_turn = 360.0");
        let scenario = scenario(BundledRobot::from_name(name).unwrap(), personality);
        let mut config = load_text("posebridge.toml", &text, &[]).unwrap().config.with_camera_of(&scenario);
        if personality != "mavlink" {
            // A camera beside the robot is one block more in the file.
            config.links.push(LinkSection::new("tcp://camera:5760"));
        }
        let driven = virtual_station::run(scenario, config.station_config().unwrap()).unwrap();
        assert!(driven.simulation.is_finished(), "{name}");
        for sensor in [SensorId::WHEELS, SensorId::GYRO, SensorId::CAMERA] {
            assert!(used(&driven, sensor) > 10, "{name}: {sensor:?}");
        }
        let [off_mm, _] = errors_mm(&driven);
        println!("{name}: off by {off_mm:.1} mm");
        assert!(off_mm < 20.0, "{name}: {off_mm}");
    }
}

#[test]
fn a_file_that_is_there_is_not_touched_without_force() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "posebridge.toml", "# mine\n");
    // Nor by a link that makes no sense.
    assert_refused(folder, &[("init sim", 2, &["there already"]), ("init sim --force --link telnet://here", 2, &[])]);
    assert_eq!(read_text(folder, "posebridge.toml"), "# mine\n");
    init(folder, &["sim", "--force"]);
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 1, "nothing is left beside it");
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
    let text = read_text(folder.path(), "posebridge.toml");
    assert!(text.contains("name = \"nxt-43mm\""), "{text}");
}

/// A person moves the robot of this seed.
fn by_hand(personality: &str) -> String {
    format!(
        "seed = 6\n[brick]\npersonality = \"{personality}\"\n[path.by-hand]\n[drive]\nrest_s = 6.5\npause_s = 1.5\n\
         speed_m_per_s = 0.5\nturn_rate_rad_per_s = 3.0\n[camera]\nis_present = false\n"
    )
}

/// The written file is that of the simulated robot, which drives a lap with it.
fn assert_measured(folder: &Path, file: &str, personality: &str) {
    run(folder, &["config", "check", "--config", file]);
    let mut config = load_text(file, &read_text(folder, file), &[]).unwrap().config;
    let truth = Simulation::new(Scenario::from_toml(&by_hand(personality)).unwrap()).true_geometry_m();
    let robot = &config.robot;
    let found = [robot.left_wheel_radius_m, robot.right_wheel_radius_m, robot.track_width_m];
    for (found, truth) in found.into_iter().zip(truth) {
        assert!((found / truth - 1.0).abs() < 0.02, "{file}: {found} for {truth}");
    }
    let lap = format!(
        "seed = 6\n[path.square]\nside_m = 0.3\n[drive]\nspeed_m_per_s = 0.2\n[brick]\npersonality = \"{personality}\"\n"
    );
    let scenario = Scenario::from_toml(&lap).unwrap();
    config = config.with_camera_of(&scenario);
    if personality != "mavlink" {
        config.links.push(LinkSection::new("tcp://camera:5760"));
    }
    let driven = virtual_station::run(scenario, config.station_config().unwrap()).unwrap();
    let [off_mm, _] = errors_mm(&driven);
    assert!(off_mm < 20.0, "{file}: {off_mm}");
}

#[test]
fn the_guide_measures_a_robot_of_each_protocol_on_a_pseudo_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let guides = ["mavlink", "nxt", "ev3", "line"].map(|personality| {
        write_text(folder, &format!("{personality}.scenario.toml"), &by_hand(personality));
        let device = format!("{personality}.tty");
        let (scenario, port) = (format!("{personality}.scenario.toml"), format!("pty:{device}"));
        let mut brick = RunningProgram::posebridge(folder, &["sim", &scenario, "--listen", &port]);
        brick.wait_for(&device);
        let mut guide = posebridge(folder);
        guide.args(["init", "--guide", "--probe", "--yes", "--listen-for", "2", "--rest-s", "1"]);
        guide.args(["--link", &format!("serial:{device}"), "--out", &format!("{personality}.toml")]);
        (personality, brick, guide.stderr(Stdio::piped()).spawn().unwrap())
    });
    for (personality, brick, guide) in guides {
        let output = guide.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{personality}: {said}");
        assert!(said.lines().all(|line| line.chars().count() <= 80 || line.contains(".t")), "{said}");
        brick.kill();
        assert_measured(folder, &format!("{personality}.toml"), personality);
    }
}

#[test]
fn the_motions_are_found_in_a_recording_and_in_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = Scenario::from_toml(&by_hand("mavlink")).unwrap();
    record_drive(&folder.join("hand.mcap"), scenario, TimeDelta::from_millis(500));
    let ranges = ["--motions", "wheel=6-8.9,straight=9-12.4,turn=12.4-17"];
    for (file, more) in [("found.toml", &[][..]), ("named.toml", &ranges)] {
        run(folder, &[&["init", "--from", "hand.mcap", "--rest-s", "1", "--out", file], more].concat());
        assert_measured(folder, file, "mavlink");
    }
    // What a board with columns printed, kept in a file.
    let mut simulation = Simulation::new(Scenario::from_toml(&by_hand("line")).unwrap());
    let mut table = b"time_ms,left,right,gyro_dps\n".to_vec();
    while !simulation.is_finished() {
        simulation.step();
        table.extend(std::iter::from_fn(|| simulation.poll()).flatten());
    }
    std::fs::write(folder.join("hand.csv"), &table).unwrap();
    run(folder, &["init", "--from", "hand.csv", "--rest-s", "1", "--out", "table.toml", "--link", "serial:board.tty"]);
    assert_measured(folder, "table.toml", "line");
    // It rounds its gyro to whole degrees per second.
    let table = read_text(folder, "table.toml");
    assert!(table.contains("gyro_resolution_rad_per_s = 0.01745 "), "{table}");
    // Two laps of a square: its wheels do not roll equally far at any time that could be one metre straight on.
    record_drive(&folder.join("square.mcap"), Scenario::bundled("square").unwrap(), TimeDelta::from_millis(500));
    write_text(folder, "commas.csv", "time_ms;left;right;gyro\n0;1;2;0,707\n20;3;4;0,707\n");
    write_text(folder, "sparse.csv", "time_ms,left,right,cam_x,cam_y\n0,1,2,,\n20,3,4,0.5,0.5\n");
    assert_refused(
        folder,
        &[
            (
                "init --guide --yes --wait-s 0.1 --link serial:none.tty --out a.toml",
                1,
                &["did not come up within 0.1 s"],
            ),
            ("init --from square.mcap --out a.toml", 1, &["they did not roll equally far", "--motions wheel=2-6"]),
            ("init --from commas.csv --out a.toml", 1, &["line 2: `0,707` has a decimal comma; write `0.707`"]),
            ("init --from sparse.csv --out a.toml", 1, &["line 2: cell 4 is empty"]),
            ("init --from hand.mcap --motions wheel=9-12 --out a.toml", 1, &["--motions wheel: both wheels counted"]),
            ("init --from hand.mcap --motions wheel=12-9 --out a.toml", 2, &["such as wheel=2-6"]),
            ("init --from found.toml --out a.toml", 1, &["--from reads a recording or a table"]),
            ("init --from hand.csv --columns time_ms,left_ticks --out a.toml", 1, &["a line has 4 numbers"]),
        ],
    );
}
