//! What goes wrong around a run must not go wrong in it: a dead terminal, a full disk, an old recording.

use std::fs::OpenOptions;
use std::process::Stdio;

use crate::support::{WHEELS_CSV, assert_refused, exit_code_and_stderr, posebridge, read_text, run, write_text};

#[test]
fn a_terminal_that_is_gone_does_not_stop_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut command = posebridge(folder.path());
    let output = command.args(["run", "--duration", "2", "--out", "run"]).stderr(Stdio::from(full)).output().unwrap();
    assert!(output.status.success(), "{:?}", output.status);
    assert!(String::from_utf8_lossy(&output.stdout).contains("estimate"), "the table is there");
}

#[test]
fn an_event_file_on_a_full_disk_is_named_and_the_exit_code_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (code, stderr) =
        exit_code_and_stderr(folder, &["run", "--duration", "1", "--out", "run", "--events", "/dev/full"]);
    assert!(code == Some(1) && stderr.contains("writing the event file"), "{code:?}: {stderr}");
    // So few events that all of them wait for the end.
    let runs =
        "name = \"short\"\nsource = \"-\"\nlicence = \"-\"\ndefault_run = \"one\"\n[robot]\n[[runs]]\nname = \"one\"\n";
    write_text(folder, "short.toml", &(runs.to_owned() + WHEELS_CSV));
    write_text(folder, "wheels.csv", "t_s,left,right\n0,0,0\n0.1,9,9\n");
    let replay = ["replay", "short.toml", "--filter", "odometry", "--events"];
    run(folder, &[&replay[..], &["events.txt"]].concat());
    assert!((1..8_000).contains(&read_text(folder, "events.txt").len()));
    let (code, stderr) = exit_code_and_stderr(folder, &[&replay[..], &["/dev/full"]].concat());
    assert!(code == Some(1) && stderr.contains("writing the events"), "{code:?}: {stderr}");
}

#[test]
fn a_recording_that_is_there_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::create_dir(folder.join("run")).unwrap();
    write_text(folder, "run/recording.mcap", "precious");
    assert_refused(folder, &[("run --duration 1 --out run", 2, &["creating the recording", "run/recording.mcap"])]);
    assert_eq!(read_text(folder, "run/recording.mcap"), "precious");
    assert!(folder.join("run/brick.tty").symlink_metadata().is_err(), "a dangling link");
}

#[test]
fn waypoints_lie_in_a_file_beside_their_scenario_and_folders_may_have_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::create_dir(folder.join("worlds")).unwrap();
    let scenario = "seed = 1\nsteering = \"estimate\"\n[path.waypoints]\nfile = \"triangle.csv\"\n";
    write_text(folder, "worlds/triangle.toml", scenario);
    write_text(folder, "worlds/triangle.csv", "x_m,y_m\n0,0\n0.5,0\n0.25,0.3\n");
    run(folder, &["run", "--link", "sim://worlds/triangle.toml", "--duration", "1", "--out", "what?&now"]);
    assert!(folder.join("what?&now/track.svg").exists());
    write_text(folder, "worlds/triangle.csv", "0,0\n0.5,zero\n");
    assert_refused(folder, &[("run --link sim://worlds/triangle.toml", 2, &["triangle.csv", "line 2"])]);
}
