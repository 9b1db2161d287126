//! Runs of the real program: their events are those of their replay, what they print, and what they survive: a killed brick or station,
//! a dead terminal, a full disk, an old recording, `kill -9`.

use std::collections::BTreeSet;
use std::fs::OpenOptions;
use std::net::TcpListener;
use std::path::Path;
use std::process::Stdio;

use crate::support::mavlink::MavlinkPeer;
use crate::support::{
    RunningProgram, SKEWED_SQUARE, WHEELS_CSV, assert_refused, assert_replays, events_named, exit_code_and_stderr,
    json, posebridge, read_text, run, write_text,
};
use posebridge_protocol::message::Message;
use posebridge_recording::container::{RecordingReader, read_truth};
use posebridge_telemetry::{Address, Input};
use serde_json::Value;

#[test]
fn a_run_over_a_pseudo_terminal_replays_bit_for_bit_with_a_skewed_and_wrapping_clock() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "skewed.toml", SKEWED_SQUARE);
    let args = ["run", "--link", "sim://skewed.toml", "--laps", "1", "--out", "run", "--events", "live.txt", "--tlog"];
    let compared = "odometry,wheel-kf,velocity-kf,ekf5,ukf5,indirect,pose";
    run(folder, &[&args[..], &["--compare", compared]].concat());
    let live = assert_replays(folder, "run/recording.mcap", "live.txt");

    // The comparison must have had something to compare: fixes that were used across the wrap, and a clock known to be fast.
    let fused = events_named(&live, "fused");
    let used = fused.iter().filter(|event| event["kind"] == "fix" && event["outcome"] == "accepted");
    assert!(used.count() > 40);
    let filters = events_named(&live, "compared_estimated");
    let filters: BTreeSet<&str> = filters.iter().filter_map(|event| event["filter"].as_str()).collect();
    assert!(filters.into_iter().eq(["ekf5", "indirect", "odometry", "ukf5", "velocity-kf", "wheel-kf"]));
    let last_clock = events_named(&live, "robot_clock_aligned").pop().expect("clocks were aligned");
    let skew_ppm = last_clock["skew_ppm"].as_f64().unwrap();
    assert!((skew_ppm - 2000.0).abs() < 300.0, "{skew_ppm} ppm");
    assert!(events_named(&live, "robot_restarted").is_empty());
    // The telemetry log beside the recording holds both directions.
    let [log, recording] = ["run/recording.tlog", "run/recording.mcap"].map(|name| json(folder, &["inspect", name]));
    let frames_of = |inspected: &Value, component: u64| {
        let mut sources = inspected["sources"].as_array().unwrap().iter();
        sources.find(|source| source["component"] == component).unwrap()["frames"].as_u64().unwrap()
    };
    assert_eq!(log["bytes_outside"], 0);
    assert_eq!(frames_of(&log, 1), frames_of(&recording, 1), "what the brick sent");
    assert!(frames_of(&log, 197) > 10, "what the station sent");
    let [ours, theirs] = [&log, &recording].map(|of| of["first_utc_micros"].as_u64().unwrap());
    assert!(ours.abs_diff(theirs) < 2_000_000, "{ours} {theirs}");
    assert!(chunks_that_are_not_frames(&folder.join("run/recording.mcap")) > 0);
}

/// Chunks of the recording that hold more or less than one frame: the boundaries are those of the reads.
fn chunks_that_are_not_frames(path: &Path) -> usize {
    let bytes = std::fs::read(path).unwrap();
    RecordingReader::open(&bytes)
        .unwrap()
        .filter(|item| match item {
            Ok((_, Input::Bytes { bytes, .. })) => usize::from(bytes[1]) + 12 != bytes.len(),
            _ => false,
        })
        .count()
}

/// The number behind the first `name` of a line, up to its unit or the end of its field.
fn number_after(line: &str, name: &str) -> f64 {
    let text = line.split(name).nth(1).expect("the field is there");
    let digits = text.split(['s', ')', ',', ' ']).next();
    let digits = digits.expect("it has a value");
    digits.parse().expect("it is a number")
}

#[test]
fn each_second_has_a_line_of_errors_and_an_interrupted_run_ends_with_tables() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "skewed.toml", SKEWED_SQUARE);
    let mut run = RunningProgram::posebridge(folder, &["run", "--link", "sim://skewed.toml", "--out", "run"]);
    for number in 0..7 {
        let line = run.wait_for("odometry ");
        // The first fix has come by the fourth second.
        if number > 3 {
            assert!((0.0..2.0).contains(&number_after(&line, "odometry ")), "{line}");
            assert!((0.0..0.1).contains(&number_after(&line, "estimate ")), "{line}");
        }
    }
    let tables = run.interrupt();
    for part in ["the brick's odometry", "path error", "track.svg"] {
        assert!(tables.contains(part), "{tables}");
    }
    // The result comes first, live and in replay.
    let replayed = crate::support::run(folder, &["replay", "run/recording.mcap"]);
    for text in [&tables, &replayed] {
        let head: Vec<&str> = text.lines().take(5).collect();
        let head = head.join(" ");
        assert!(head.contains(" mm off (rms)") && head.contains("filter     "), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    }
    let samples = read_truth(&std::fs::read(folder.join("run/recording.mcap")).unwrap()).unwrap();
    assert!(samples.len() > 7 * 15, "{} samples of the truth", samples.len());
    assert!(samples.windows(2).all(|pair| pair[0].time < pair[1].time), "in order, once each");
}

fn brick(folder: &Path) -> RunningProgram {
    let sim = ["sim", "square", "--listen", "pty:brick.tty", "--laps", "50"];
    let mut brick = RunningProgram::posebridge(folder, &sim);
    brick.wait_for("brick up");
    brick
}

fn station(folder: &Path, name: &str) -> RunningProgram {
    let events = format!("{name}.txt");
    let run = ["run", "--link", "serial:brick.tty", "--out", name, "--events", &events];
    let mut station = RunningProgram::posebridge(folder, &run);
    station.wait_for("robot 0/1/1 detected");
    station
}

#[test]
fn a_killed_brick_comes_back_and_the_station_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let first = brick(folder.path());
    let mut station = station(folder.path(), "run");
    station.wait_for("fix accepted");
    first.kill();
    station.wait_for("link 0 DOWN");
    let _second = brick(folder.path());
    station.wait_for("robot 0/1/1 restarted");
    station.wait_for("fix accepted");
    station.interrupt();
    let events = read_text(folder.path(), "run.txt");
    // On a busy machine it is back after five seconds: then it is seen before it is known to have restarted.
    let seen = events_named(&events, "robot_seen");
    let of_robot = seen.iter().filter(|event| event["robot"]["component"] == 1);
    assert_eq!(of_robot.count(), 2, "{seen:#?}");
    let states = events_named(&events, "link");
    assert_eq!(states.len(), 3, "one event per change of state: {states:#?}");
}

#[test]
fn a_killed_station_comes_back_and_the_brick_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let _brick = brick(folder.path());
    let mut first = station(folder.path(), "first");
    // The first line of the status block: five seconds have passed.
    first.wait_for("fix accepted");
    first.kill();
    let mut second = station(folder.path(), "second");
    second.wait_for("fix accepted");
    let table = second.interrupt();
    assert!(table.contains("filter     "), "{table}");
    let events = read_text(folder.path(), "second.txt");
    let brick_s = 1e-9 * events_named(&events, "observed")[0]["robot_ns"].as_f64().unwrap();
    // Its clock began at 5 s and was not restarted with the station.
    assert!(brick_s > 9.0, "{brick_s}");
}

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

/// Between two flushes of a recording whose flushes lie a second apart from its beginning on.
const KILL_AT_S: f64 = 2.4;

/// The test is the brick: the station's requests for the time carry the station's own clock, so the test knows at what time of the session
/// it kills.
#[test]
fn a_killed_run_leaves_a_recording_that_replays_up_to_a_second_before() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let link = format!("tcp://{}", listener.local_addr().unwrap());
    let station = RunningProgram::posebridge(folder, &["run", "--link", &link, "--out", "run"]);
    let (mut link, _) = listener.accept().unwrap();
    let killed_at_s = MavlinkPeer::new(Address::new(1, 1)).wait_for(&mut link, |message| match message {
        Message::TimeSync(request) => Some(request.request_nanos as f64 * 1e-9).filter(|now_s| *now_s >= KILL_AT_S),
        _ => None,
    });
    station.kill();

    let bytes = std::fs::read(folder.join("run/recording.mcap")).unwrap();
    let inputs = RecordingReader::open(&bytes).expect("its header is whole");
    let last = inputs.map(|input| input.expect("every whole record is good").0).max();
    let recorded_to_s = last.expect("something was recorded").as_secs_f64();
    println!("killed at {killed_at_s:.2} s or later, recorded up to {recorded_to_s:.2} s");
    assert!(recorded_to_s > killed_at_s - 1.0, "{recorded_to_s} {killed_at_s}");
    // Nobody knows where the robot was: the figures are null, not zero.
    let estimator = &json(folder, &["replay", "run/recording.mcap"])["estimators"][0];
    assert_eq!(estimator["name"], "pose");
    for figure in ["position_rms_m", "position_max_m", "position_end_m", "heading_rms_rad", "anees"] {
        assert!(estimator[figure].is_null(), "{estimator}");
    }
}
