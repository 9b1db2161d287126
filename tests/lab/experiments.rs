//! `posebridge lab`: one run of each experiment with its figures as JSON, its page and pictures, and what is said of wrong input.
//!
//! The recordings of real robots are read where POSEBRIDGE_DATA says they are; without it their figures are not looked at.

use std::path::Path;

use crate::support::{assert_refused, descriptor, json, named, number, read_text, root, run, shared_data, write_text};
use posebridge_estimator::numerics::statistics::quantile;
use serde_json::Value;

fn lab(folder: &Path, args: &[&str]) -> Value {
    json(folder, &[&["lab"], args].concat())
}

#[test]
fn accuracy_scores_filters_against_the_bound_and_the_smoother() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let kicks = lab(folder, &["accuracy", "--scenario", "kicks-camera-1hz", "--runs", "2"]);
    let scenario = named(&kicks["scenarios"], "kicks-camera-1hz");
    // A camera once a second: millimetres, where dead reckoning that is kicked is decimetres off.
    let rms_m = |name: &str| number(named(&scenario["estimators"], name), "/position_rms_m");
    assert!(rms_m("pose") < 0.02 && rms_m("odometry") > 0.05);
    assert!(number(named(&named(&scenario["estimators"], "pose")["sources"], "camera"), "/used") > 100.0);

    let args = ["--scenario", "camera-10hz", "--estimator", "pose", "--estimator", "smooth", "--runs", "2"];
    let report = lab(folder, &[&["accuracy"], &args[..]].concat());
    let [bound, pose, smooth] = ["bound_rms_m", "estimators/0/position_rms_m", "estimators/1/position_rms_m"]
        .map(|key| 1e3 * number(&report, &format!("/scenarios/0/{key}")));
    println!("pose {pose:.3} mm, smooth {smooth:.3} mm, bound {bound:.3} mm");
    assert!((0.9..1.2).contains(&(pose / bound)) && smooth < 0.85 && smooth < 0.7 * bound);
    let table = run(folder, &[&["lab", "accuracy"], &args[..]].concat());
    assert!(table.lines().any(|line| line == format!("bound: {bound:.2} mm rms")), "{table}");

    // What the bound leaves out, and why there is none.
    let args = ["accuracy", "--scenario", "kicks", "--scenario", "wpilib", "--estimator", "odometry", "--runs", "1"];
    let report = lab(folder, &args);
    assert_eq!(report["scenarios"][0]["bound_note"], "without the kicks");
    assert!(report["scenarios"][1]["bound_rms_m"].is_null());
    assert_eq!(report["scenarios"][1]["bound_note"], "the noise of the motion is not what a filter is told");
    // The first run of five is the one run of one, and another seed gives another.
    let kicks = ["accuracy", "--estimator", "odometry", "--scenario", "kicks"];
    let first =
        |more: &[&str]| number(&lab(folder, &[&kicks[..], more].concat()), "/scenarios/0/estimators/0/run_rms_m/0");
    assert_eq!(first(&["--runs", "5"]), first(&["--runs", "1"]));
    assert_ne!(first(&["--runs", "1"]), first(&["--runs", "1", "--seed", "2"]));
}

/// Without a start and without a camera there is no pose to smooth.
#[test]
fn accuracy_takes_a_file_and_names_the_runs_of_which_the_smoother_says_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = read_text(&root(), "config/scenarios/accuracy/no-camera.toml");
    let lost = text.replace("laps = 4", "laps = 1").replace("[told]", "[told]\nstart_is_unknown = true");
    write_text(folder, "lost.toml", &lost);
    let args = ["accuracy", "--scenario", "lost.toml", "--estimator", "smooth", "--runs", "2", "--out", "pictures"];
    let smooth = &lab(folder, &args)["scenarios"][0]["estimators"][0];
    assert_eq!((&smooth["refused_runs"][0]["run"], &smooth["refused_runs"][1]["run"]), (&0.into(), &1.into()));
    assert!(smooth["position_rms_m"].is_null());
    let reason = smooth["refused_runs"][0]["reason"].as_str().unwrap();
    let table = run(folder, &[&["lab"], &args[..]].concat());
    assert!(table.contains("\nlost: 2 runs, seed 1\nestimator"), "{table}");
    // A long line breaks between words.
    let note = format!("smooth: says nothing of 2 runs; of run 0: {reason}");
    assert!(table.replace('\n', " ").contains(&note), "{table}");
    assert!(read_text(folder, "pictures/lab-accuracy.svg").contains("lost: 2 runs"));
}

#[test]
fn indirect_ends_its_rounds_nearer_than_the_wheels_as_the_paper_says() {
    let folder = tempfile::tempdir().unwrap();
    let found = lab(folder.path(), &["indirect", "--runs", "200", "--robots", "60"]);
    let row = |filter: &str, sensors: &str| {
        let mut rows = found["rows"].as_array().unwrap().iter();
        rows.find(|row| row["filter"] == filter && row["sensors"] == sensors).unwrap()
    };
    let wheels = row("odometry", "wheels");
    let [forward, back] = ["indirect", "indirect-feedback"].map(|filter| row(filter, "+ accelerometers"));
    for fused in [forward, back] {
        println!("{fused}");
        for key in ["/median_m", "/rms_x_m", "/rms_y_m"] {
            assert!(number(fused, key) < number(wheels, key), "{key}: {fused}");
        }
        assert!(number(fused, "/nearer_than_wheels") > 120.0);
    }
    // 95 % of the rounds end within the paper's 23.5 cm and 32 cm.
    assert!(number(back, "/p95_x_m") <= 0.235 && number(back, "/p95_y_m") <= 0.32);
    // Fed back it is nearer, and knows how near.
    assert!((0.7..1.3).contains(&number(back, "/anees")) && number(forward, "/anees") > number(back, "/anees"));
    // Round by round, in means of squares and their sigmas: nearer in x, and in y no further off; with a gyro nearer in both.
    let better = |sensors: &str, axis: &str| {
        let gain = &row("indirect-feedback", sensors)["better_than_feed_forward_m2"];
        number(gain, &format!("/{axis}")) / number(gain, &format!("/{axis}_sigma"))
    };
    assert!(better("+ accelerometers", "x") > 2.0 && better("+ accelerometers", "y") > -2.0);
    assert!(better("+ gyro", "x") > 2.0 && better("+ gyro", "y") > 2.0);
    // Of 60 robots those are helped whose accelerometers know a turn better than their wheels do, and hardly any other.
    let ratios = found["ratios"].as_array().unwrap();
    let share = |row: &Value, key: &str| number(row, key) / number(row, "/robots");
    assert!(share(&ratios[0], "/helped") > 0.6 && share(&ratios[4], "/helped") < 0.3, "{ratios:?}");
    assert!(number(&found, "/boundary/right") >= 42.0, "{}", found["boundary"]);
    let scenario = read_text(&root(), "config/scenarios/lab/indirect.toml");
    write_text(folder.path(), "wrong.toml", &scenario.replace("tick_deg = 1.0", "tick_deg = 0.0"));
    assert_refused(folder.path(), &[("lab indirect --scenario wrong.toml", 2, &["wrong.toml", "tick_deg"])]);
}

#[test]
fn links_let_a_lap_be_steered_ten_times_better_than_by_odometry() {
    let folder = tempfile::tempdir().unwrap();
    let args = "links --profile usb --profile bluetooth-spp --loss 0,0.05 --delay-ms 0 --skew-ppm 2021 --runs 1";
    let found = lab(folder.path(), &args.split(' ').collect::<Vec<_>>());
    let pose = found["pose"].as_array().unwrap();
    assert_eq!(pose.len(), 4);
    for row in pose {
        assert!(number(row, "/position_rms_m") < 0.1 * number(row, "/odometry_rms_m"), "{row}");
    }
}

/// What each preset of the matrices gives, each reading of the odometry, and what stands beside the paper's filters.
fn assert_presets_and_outlook(report: &Value) {
    let rms_mm = |chain: &Value, name: &str| 1e3 * number(named(&chain["methods"], name), "/position_rms_m");
    let (printed, by_speeds, tuned, outlook) =
        (&report["settings"][0], &report["settings"][1], &report["settings"][2], &report["outlook"]);
    let raw = rms_mm(printed, "raw encoders");
    // Filtered angles follow the counts; integrated speeds miss what each reading corrects.
    assert!((rms_mm(printed, "wheel-kf, angles") / raw - 1.0).abs() < 0.05);
    assert!(rms_mm(by_speeds, "wheel-kf, speeds") > 2.0 * raw);
    // The most likely matrices are better for the speed that is observed, and worse for the position that is not.
    let speed = |chain: &Value, name: &str| number(named(&chain["methods"], name), "/forward_rms_m_per_s");
    assert!(speed(tuned, "wheel-kf, angles, tuned") < 0.3 * speed(printed, "wheel-kf, angles"));
    assert!(speed(tuned, "velocity-kf, tuned") < 0.95 * speed(printed, "velocity-kf"));
    assert!(rms_mm(tuned, "velocity-kf, tuned") > 1.2 * rms_mm(printed, "velocity-kf"));
    assert!(rms_mm(outlook, "ekf5-corrected") < 0.8 * rms_mm(printed, "ekf5"));
    assert!((rms_mm(outlook, "ukf5") / rms_mm(printed, "ekf5") - 1.0).abs() < 1e-3);
    assert!(rms_mm(outlook, "ekf5-camera") < 0.5 * rms_mm(printed, "ekf5"));
    for name in ["ekf5-camera-corrected", "ukf-all: all sensors"] {
        assert!(rms_mm(outlook, name) < 0.5 * rms_mm(outlook, "ekf5-camera"), "{name}");
    }
    // A compass whose deviation is a state does no harm.
    assert!(rms_mm(outlook, "ukf-all: all sensors") < 1.05 * rms_mm(outlook, "ekf5-camera-corrected"));
    for trial in report["recoveries"].as_array().unwrap() {
        let is_lost = trial["method"] == "ekf5-camera" && trial["start_error_deg"] == 150.0;
        assert_eq!(trial["recovered"], if is_lost { 0 } else { 40 }, "{trial}");
    }
}

#[test]
fn nxt_square_holds_the_papers_order_where_the_counters_are_as_noisy_as_r_says() {
    let folder = tempfile::tempdir().unwrap();
    let report = lab(folder.path(), &["nxt-square", "--runs", "40"]);
    // The share of drives in which a step of an order holds.
    let share = |order: &Value, step: usize| {
        number(order, &format!("/steps/{step}/holds")) / number(order, &format!("/steps/{step}/drives"))
    };
    let settings = report["settings"].as_array().unwrap();
    assert_eq!(settings.len(), 5);
    for setting in settings {
        assert!(number(setting, "/order/all_hold") < 20.0, "{}", setting["setting"]);
        // Without a gyro no filter knows more than the counters.
        assert!(share(&setting["order"], 0) < 0.6);
    }
    let reading = |name: &str| &named(&report["readings"], name)["order"];
    for name in ["noisy counters, turn rate", "noisy counters, forward speed, gentle"] {
        assert!(number(reading(name), "/all_hold") >= 38.0, "{name}");
        assert_eq!(reading(name)["drives"], 40);
    }
    // A late camera flatters what lags; a gyro that is better than the wheels is the only thing that helps for certain.
    let late = reading("late camera");
    assert!(share(late, 0) >= 0.95 && share(late, 2) < 0.95);
    assert!(share(reading("not calibrated, good gyro"), 2) >= 0.95);
    assert_presets_and_outlook(&report);
    // R of a counter is zero at rest, and a twelfth of a square degree on a straight run; the rest is steering.
    assert_eq!(number(&report, "/stop/counters_deg2/0"), 0.0);
    assert!((0.06..0.16).contains(&number(&report, "/straight/counters_deg2/0")));
    // 0.6 and a resolution of 1 degree/s: 0.36 + 1/12.
    assert!((0.25..0.75).contains(&number(&report, "/stop/gyro_deg2_per_s2")));
}

#[test]
fn nxt_square_reads_an_exported_drive_to_the_last_bit_and_names_the_faults_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let direct = lab(folder, &["nxt-square", "--runs", "1", "--seed", "7", "--export", "drive.csv"]);
    let read = lab(folder, &["nxt-square", "--data", "drive.csv"]);
    for key in ["outlook", "stop", "straight"] {
        assert_eq!(direct[key], read[key], "{key}");
    }
    // The tuned ones are tuned on other drives there, on the file here.
    for index in [0, 1, 4] {
        assert_eq!(direct["settings"][index], read["settings"][index]);
    }
    assert!(read["source"].as_str().unwrap().contains("drive.csv: 790 rows"), "{}", read["source"]);
    // Without truth and camera there are paths and nothing to judge them by.
    write_text(folder, "wheels.csv", "time_s,left_counts,right_counts\n0,0,0\n0.05,1,1\n");
    let table = run(folder, &["lab", "nxt-square", "--data", "wheels.csv"]);
    assert!(table.contains("neither camera nor truth"), "{table}");
    write_text(folder, "wrong.csv", "time_s,left_counts,right_counts\n0,0,0\n0.05,1,x\n");
    write_text(folder, "robot.toml", "[robot]\ntrack_width_m = -1\n");
    assert_refused(
        folder,
        &[
            ("lab nxt-square --data wrong.csv", 2, &["`wrong.csv`", "line 3", "column `right_counts`", "`x`"]),
            ("lab nxt-square --data nowhere.csv", 2, &["reading the sensor data `nowhere.csv`"]),
            ("lab nxt-square --data wheels.csv --robot robot.toml", 2, &["robot.toml", "track_width_m"]),
            ("lab nxt-square --data wheels.csv --runs 2", 2, &["--runs"]),
        ],
    );
}

/// Encoders alone cannot be bettered by a filter of encoders: on the recording they agree to a millimetre, and a camera helps.
#[test]
fn nxt_square_on_a_real_recording_makes_fixes_worth_three_times_as_much() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (robot, data) = (descriptor("lego-nxt-camera.toml"), data.to_str().unwrap().to_owned());
    let args = ["nxt-square", "--recording", &robot, "--data", &data, "--camera-every", "4"];
    let report = lab(folder.path(), &args);
    let rms_mm = |chain: &Value, name: &str| 1e3 * number(named(&chain["methods"], name), "/position_rms_m");
    let [raw, filtered] = ["raw encoders", "wheel-kf, angles"].map(|name| rms_mm(&report["settings"][0], name));
    // The data set's own dead reckoning with this track is 68.6 mm off, by other images.
    assert!((60.0..85.0).contains(&raw) && (raw - filtered).abs() < 1.0, "raw {raw:.1} mm, wheel-kf {filtered:.1} mm");
    for name in ["pose: and camera", "ekf5-camera", "ekf5-camera-corrected", "ukf-all: all sensors"] {
        let fused = rms_mm(&report["outlook"], name);
        assert!(fused < raw / 3.0, "{name}: {fused:.1} mm");
    }
    // The same without a table: each image between two readings of the wheels, at its own time.
    let filters = ["--filter", "odometry", "--filter", "ekf5-camera", "--filter", "ekf5-camera-corrected"];
    let replayed = json(folder.path(), &[&["replay", &robot, "--data", &data][..], &filters].concat());
    let [raw, camera, corrected] = ["odometry", "ekf5-camera", "ekf5-camera-corrected"]
        .map(|name| number(named(&replayed["estimators"], name), "/position_rms_m"));
    assert!(camera < raw / 3.0 && corrected < raw / 3.0, "{raw} {camera} {corrected}");
}

#[test]
fn wall_finds_the_papers_drive_and_stops_nearer_and_faster_with_the_filter() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let found = lab(folder, &["wall", "--steps", "20", "--runs", "100"]);
    // Per metre, the paper counts in millimetres: 8.1633e-4 and 3.5346e-4.
    for (of, share) in [("paper", 0.01), ("fit", 0.02)] {
        for (key, truth) in [("drag_s_per_m", 0.816_33), ("mass_s2_per_m", 0.353_46)] {
            let value = number(&found, &format!("/{of}/{key}"));
            assert!((value / truth - 1.0).abs() <= share, "{of} {key}: {value}");
        }
    }
    // One step alone knows how little it knows.
    let [one_sigma, all_sigma] =
        ["fit_of_first", "fit"].map(|fit| number(&found, &format!("/{fit}/drag_sigma_s_per_m")));
    assert!((number(&found, "/fit_of_first/drag_s_per_m") - 0.816_33).abs() < 3.5 * one_sigma);
    assert!(one_sigma > 3.0 * all_sigma);
    let row = |by: &str, most_pwm: f64| {
        let mut rows = found["approaches"].as_array().unwrap().iter();
        let is_row = |row: &&Value| {
            row["gains"] == "tuned" && row["on"] == "brick" && row["most_pwm"] == most_pwm && row["distance_by"] == by
        };
        rows.find(is_row).unwrap()
    };
    let line = row("line through two", 80.0);
    for name in ["range-kf", "range-kf-corrected"] {
        let filter = row(name, 255.0);
        println!("{name}: {filter}");
        assert_eq!(filter["stopped"], 100);
        assert!(number(filter, "/worst_error_m") <= 0.02, "{filter}");
        for key in ["/nearer_than_line", "/nearer_and_faster_than_line"] {
            assert!(number(filter, key) >= 95.0, "{filter}");
        }
        assert!(number(filter, "/mean_approach_m_per_s") > 1.1 * number(line, "/mean_approach_m_per_s"));
        assert!(number(filter, "/mean_time_s") < number(line, "/mean_time_s"));
    }
    for row in found["same_speeds"].as_array().unwrap().iter().filter(|row| row["distance_by"] == "range-kf") {
        assert_eq!((&row["within_20_mm"], &row["within_40_mm"]), (&100.into(), &100.into()), "{row}");
    }
    for kind in found["population"].as_array().unwrap() {
        let ratio = number(kind, "/ratio_to_line");
        assert!(ratio < 0.9 && number(kind, "/lost_to_line") <= 25.0, "{kind}");
        assert!(number(kind, "/ratio_to_best_line") < 1.05, "{kind}");
    }
    let gate = found["gate"].as_array().unwrap();
    assert_eq!((&gate[0]["refused"], &gate[gate.len() - 1]["refused"]), (&false.into(), &true.into()));
    assert!(found["validation"].as_array().is_some_and(|rows| !rows.is_empty()));

    let scene = read_text(&root(), "config/scenarios/lab/wall.toml");
    write_text(folder, "wrong.toml", &scene.replace("rise_90_s = 0.997", "rise_90_s = -1"));
    assert_refused(
        folder,
        &[
            ("lab wall --scene wrong.toml", 2, &["wrong.toml", "line 7", "rise_90_s", "-1"]),
            ("lab wall --profile carrier-pigeon", 2, &["carrier-pigeon", "bluetooth-spp"]),
            ("lab wall --run x", 2, &["--recording"]),
            ("lab wall --recording none.toml", 2, &["none.toml"]),
        ],
    );
}

/// Students' cars: every run is predicted better than by the line through two readings. The best of three lines is known in hindsight
/// only; against it there is a verdict.
#[test]
fn wall_on_recordings_of_real_cars_is_nearer_than_the_line_through_two_readings() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let tof_wall = descriptor("tof-wall.toml");
    let found = lab(folder.path(), &["wall", "--recording", &tof_wall, "--data", data.to_str().unwrap()]);
    let runs = found["runs"].as_array().unwrap();
    assert!(runs.len() >= 6 && runs.iter().any(|run| !run["against_theirs"].is_null()));
    for run in runs {
        let score = &run["against_line"];
        assert!(number(score, "/filter_rms_m") < number(score, "/other_rms_m"), "{}: {score}", run["name"]);
        assert!(run["against_best_line"]["verdict"].is_string(), "{run}");
        assert!(run["input_note"].as_str().is_some_and(|note| note.contains("motor")), "{run}");
    }
    let columns = format!("lab wall --recording {tof_wall} --data {} --kalman-column filtered", data.display());
    assert_refused(folder.path(), &[(&columns, 2, &["`filtered`"])]);
}

/// Asserts that a run was predicted faster than the sensor showed it, to each of these shares of the step.
fn assert_foretold(found: &Value, run: &str, shares: &[&str]) {
    for share in shares {
        let of = |what: &str| found["sections"]["predicted"][format!("{run}.{what}_{share}_percent_s")].as_f64();
        let (shown_s, predicted_s) = (of("shown"), of("predicted").unwrap());
        println!("{run}, {share} %: shown {shown_s:?} s, predicted {predicted_s} s");
        assert!(shown_s.is_none_or(|shown_s| predicted_s < shown_s), "{run} {share}");
    }
}

/// Asserts that the bound of each run holds its end at least at three of four instants, and that the median errors over the runs are
/// at most these: at a third of the settling time, and from there on.
fn assert_bounds(found: &Value, runs: &[&str], most: [f64; 2]) {
    let bounds = &found["sections"]["recorded_bounds"];
    let of = |run: &str, what: &str| bounds[format!("{run}.{what}")].as_f64().unwrap();
    for run in runs {
        assert!(of(run, "inside") >= 0.75, "{run}: {bounds}");
    }
    for (what, most) in ["error_at_third", "error_after_third"].into_iter().zip(most) {
        let errors: Vec<f64> = runs.iter().map(|run| of(run, what)).collect();
        let median = quantile(&errors, 0.5).unwrap();
        println!("{runs:?}: {what} {median}");
        assert!(median <= most, "{what}: {errors:?}");
    }
}

fn settled_s(found: &Value, run: &str) -> f64 {
    found["sections"]["predicted"][format!("{run}.predicted_5_percent_s")].as_f64().unwrap()
}

#[test]
fn thermometer_names_what_cannot_be_done() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_descriptor(folder, &["one", "idle"], 0.05);
    for name in ["one", "idle"] {
        write_text(folder, &format!("{name}.csv"), "t_s,celsius\n0,20\n1,20\n");
    }
    assert_refused(
        folder,
        &[
            (
                "lab thermometer --recording thermometers.toml --identify four",
                2,
                &["no such run; there are: one, idle"],
            ),
            ("lab thermometer --recording nowhere.toml", 2, &["nowhere.toml"]),
            ("lab thermometer --identify one", 2, &["--recording"]),
        ],
    );
}

/// A descriptor of runs that are each a file of seconds and degrees, with this noise.
fn write_descriptor(folder: &Path, runs: &[&str], sigma_k: f64) {
    let text = include_str!("../data/lab/thermometers.toml")
        .replace("FIRST_RUN", runs[0])
        .replace("ALL_RUNS", &format!("{runs:?}"))
        .replace("SIGMA_K", &sigma_k.to_string());
    write_text(folder, "thermometers.toml", &text);
}

/// Each device by the two others, where the order is the tool's own choice; and a probe by its other run of heating, by a second.
#[test]
fn thermometer_foretells_real_sensors() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let of = |name: &str, more: &[&str]| {
        let args = ["thermometer", "--recording", &descriptor(name), "--data", data.to_str().unwrap()];
        lab(folder.path(), &[&args, more].concat())
    };
    let devices = of("ds18b20-step.toml", &[]);
    let names = ["LG", "KM", "KiS"];
    for name in names {
        assert_foretold(&devices, name, &["10", "5", "2"]);
    }
    assert_bounds(&devices, &names, [1.5, 0.5]);
    for by in names {
        let one = of("ds18b20-step.toml", &["--identify", by]);
        let others: Vec<&str> = names.into_iter().filter(|name| *name != by).collect();
        assert_bounds(&one, &others, [1.5, 0.5]);
    }
    for [by, judged] in [["heating-20-56", "heating-21-76"], ["heating-21-76", "heating-20-56"]] {
        let probe = of("rtd-step.toml", &["--same-sensor", "--identify", by, "--predict", judged]);
        assert_foretold(&probe, judged, &["10", "5"]);
        assert_bounds(&probe, &[judged], [2.5, 1.0]);
    }
}

/// What one run of cooling is worth. There is but one, so that every second sample of it stands in for another run: the same dynamics,
/// other noise.
#[test]
fn thermometer_foretells_a_real_probe_that_cools_if_cooling_was_identified() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let log = read_text(&data, "rtd-step/rtd_log8.csv");
    for (first, name) in ["even", "odd"].into_iter().enumerate() {
        let rows = log.lines().skip(1 + first).step_by(2).map(|row| {
            let (at_s, volts) = row.split_once(',').unwrap();
            // The line of config/recordings/rtd-step.toml.
            format!("{at_s},{}\n", 3_077.120_671 * volts.parse::<f64>().unwrap() + 114.844_118)
        });
        write_text(folder, &format!("{name}.csv"), &("t_s,celsius\n".to_owned() + &rows.collect::<String>()));
    }
    write_descriptor(folder, &["even", "odd"], 1.2);
    let found = lab(folder, &["thermometer", "--same-sensor", "--recording", "thermometers.toml"]);
    for name in ["even", "odd"] {
        assert_foretold(&found, name, &["10", "5", "2"]);
        assert!(settled_s(&found, name) <= 2.0, "{name}");
        assert!(found["sections"]["recorded_bounds"][format!("{name}.inside")].as_f64().unwrap() > 0.9);
    }
}
