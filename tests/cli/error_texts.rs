//! What a user reads when something is wrong: clear, with the key or the path, exit code 2. Eight texts in full, one of each kind.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

use crate::support::{assert_refused, committed_data, descriptor, exit_code_and_stderr, write_text};

/// What the program says when it refuses to start.
fn refusal(folder: &Path, args: &[&str]) -> String {
    let (code, stderr) = exit_code_and_stderr(folder, args);
    assert_eq!(code, Some(2), "{stderr}");
    stderr
}

/// Each wrong configuration, and what must be named.
const CONFIGURATIONS: [(&str, &[&str]); 15] = [
    ("[robot]\ntrack_width_m = \"wide\"\n", &["`station.toml`", "line 2, column 17", "\"wide\"", "f64"]),
    ("[robot\n", &["`station.toml`", "line 1, column 7", "unclosed table"]),
    ("[filter]\nname = \"kalmann\"\n", &["`filter.name` is `kalmann`", "odometry, pose, wheel-kf"]),
    ("[filter]\ngate = 0.99\n", &["`[filter]`", "`gate`"]),
    ("[filter]\ngate_prob = 3.0\n", &["`gate_prob` is 3", "0.5 to 0.999999"]),
    (
        "[[link]]\nurl = \"sim://square\"\noutputs = [{ message = \"pose\" }]\n",
        &["link 0", "`pose`", "planar_pose, odometry"],
    ),
    ("link = []\n", &["there is no link", "--link URL"]),
    ("[dashboard]\nlisten = \"localhost\"\n", &["`dashboard.listen` is `localhost`", "127.0.0.1:4680"]),
    ("[plotjuggler]\naddress = \"localhost:9870\"\n", &["`plotjuggler.address` is `localhost:9870`"]),
    ("[robot.calibration]\ntrack_scal = { value = 0.0, sigma = 0.1 }\n", &["line 2", "`track_scal`", "`track_scale`"]),
    ("[robot.calibration]\ntrack_scale = { value = 0.1 }\n", &["line 2", "missing field `sigma`"]),
    ("[robot.calibration]\ntrack_scale = { value = 0.0, sigma = -0.1 }\n", &["track_scale.sigma` is -0.1", "0 to 0.5"]),
    ("[robot.noise]\nwall_range_m = 0.0\n", &["`robot.noise.wall_range_m` is 0"]),
    ("[world]\nbeacons = [{ id = 1, x_m = 0.0, y_m = 0.0 }, { id = 1, x_m = 1.0, y_m = 0.0 }]\n", &["id 1", "twice"]),
    ("[[world.walls]]\nfrom = { x_m = 0.0, y_m = 0.0 }\n", &["line 1", "missing field `to`"]),
];

#[test]
fn a_wrong_configuration_is_named_with_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let with_config = |text: &str| {
        write_text(folder.path(), "station.toml", text);
        refusal(folder.path(), &["run", "--config", "station.toml"])
    };
    insta::assert_snapshot!("wrong_key", with_config("[robot]\ntrack_with_m = 0.112\n"));
    insta::assert_snapshot!("impossible_value", with_config("[robot]\ntrack_width_m = -0.1\n"));
    for (text, words) in CONFIGURATIONS {
        let said = with_config(text);
        for word in words {
            assert!(said.contains(word), "{text}: `{word}` in {said}");
        }
    }
}

#[test]
fn wrong_arguments_and_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "noise.mcap", "this is no recording");
    write_text(folder, "wrong.toml", "name = \"x\"\nspeed = 3\n");
    write_text(folder, "scenario.toml", "seed = 1\n[drive]\nlaps = \"two\"\n");
    write_text(folder, "accuracy.toml", "seed = 1\nrunz = 3\n");
    write_text(folder, "posebridge.toml", "");
    let (lego, optiodom, data) = (descriptor("lego-nxt-camera.toml"), descriptor("optiodom.toml"), committed_data());
    let snapshot = |name: &str, command: &str| {
        insta::assert_snapshot!(name, refusal(folder, &command.split(' ').collect::<Vec<_>>()));
    };
    snapshot("no_mcap", "replay noise.mcap");
    snapshot("wrong_scenario", "sim scenario.toml --listen tcp://127.0.0.1:0");
    snapshot("unknown_scheme", "run --link usb://brick");
    snapshot("unknown_accuracy_scenario", "lab accuracy --scenario camera-5hz");
    snapshot("init_there_already", "init sim");
    let replay = format!("replay {optiodom} --data {data}");
    assert_refused(
        folder,
        &[
            ("run --tui", 2, &["--tui", "no terminal"]),
            ("run --set robot.track=1", 2, &["`--set robot.track=1`", "`track`"]),
            ("run --set robot.calibration.track_scale=0.1", 2, &["robot.calibration.track_scale=0.1", "value, sigma"]),
            ("run --filter odometry --save-calibration r.toml", 2, &["--save-calibration", "`odometry` learns no"]),
            (&format!("{replay} --save-calibration r.toml"), 2, &["--save-calibration", "--run"]),
            (&format!("{replay} --set filter.name=odometry"), 2, &["`filter.name`", "--filter"]),
            (&format!("{replay} --set filter.slip_nis=1"), 2, &["`slip_nis` is 1", "4 to 100"]),
            ("run --config nowhere.toml", 2, &["configuration `nowhere.toml`"]),
            ("replay nowhere.mcap", 2, &["recording `nowhere.mcap`"]),
            ("replay nowhere.toml", 2, &["descriptor `nowhere.toml`"]),
            ("replay wrong.toml", 2, &["descriptor `wrong.toml`", "line 2", "`speed`"]),
            ("sim nowhere.toml --listen tcp://127.0.0.1:0", 2, &["scenario `nowhere.toml`"]),
            ("sim hexagon --listen tcp://127.0.0.1:0", 2, &["\"hexagon\"", "square, circle"]),
            ("run --robot nowhere.toml", 2, &["robot from `nowhere.toml`"]),
            (&format!("replay {lego} --data nowhere"), 2, &["`nowhere`", "encoders.csv", "--data"]),
            ("lab accuracy --scenario nowhere.toml", 2, &["scenario `nowhere.toml`"]),
            ("lab accuracy --scenario accuracy.toml", 2, &["`accuracy.toml`", "line 2", "`runz`"]),
            (
                "lab accuracy --estimator kalmann",
                2,
                &["no estimator of a pose is called \"kalmann\"; there are odometry, "],
            ),
            ("run --link serial:///dev/ttyACM0?speed=9600", 2, &["link 0", "no option `speed`", "baud, dtr, rate"]),
            ("run --link tcp://127.0.0.1:99999", 2, &["port `99999`", "0 to 65535"]),
            ("init", 2, &["name the robot", "arduino-2wd", "nxt-56mm"]),
            ("init nxt", 2, &["no robot `nxt`", "nxt-43mm"]),
            ("init sim --link telnet://here", 2, &["link 0 `telnet://here`", "`telnet`"]),
            ("init sim --out gone/posebridge.toml", 2, &["cannot write `gone/posebridge.toml`"]),
            ("man --out posebridge.toml", 2, &["cannot make the folder `posebridge.toml`"]),
        ],
    );
}

#[test]
fn a_port_in_use_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let url = format!("tcp://127.0.0.1:{port}");
    let said = refusal(folder.path(), &["run", "--listen", &url, "--no-record"]);
    insta::assert_snapshot!("port_in_use", said.replace(&port, "PORT"));
}

#[test]
fn a_device_without_permission_is_named_with_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
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
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains(path.to_str().unwrap()) && said.contains("permission denied"), "{said}");
    assert!(said.contains("group"), "it says what to do: {said}");
}

/// The user that owns nothing, on every Linux.
const NOBODY: u32 = 65_534;
