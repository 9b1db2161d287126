//! `posebridge tune`: wrong noise is found out without truth, held-out runs agree, and the profile goes back into `replay`.
//!
//! Recordings of others are read where POSEBRIDGE_DATA says they are; without it only the committed set is looked at.

use std::path::Path;

use crate::support::{assert_refused, committed_data, descriptor, json, number, read_text, shared_data, write_text};
use serde_json::Value;

fn tune(folder: &Path, args: &[&str]) -> Value {
    json(folder, &[&["tune"], args].concat())
}

/// Sum of the log-likelihoods and root mean square position error of the held-out runs.
fn held_out(scores: &Value) -> (f64, f64) {
    let runs: Vec<&Value> = scores.as_array().unwrap().iter().filter(|run| run["held_out"] == true).collect();
    let squares: f64 = runs.iter().map(|run| run["position_rms_m"].as_f64().unwrap().powi(2)).sum();
    let likelihood = runs.iter().map(|run| run["log_likelihood"].as_f64().unwrap()).sum();
    (likelihood, (squares / runs.len() as f64).sqrt())
}

/// Whoever is asked to tune leaves nobody worse off: the held-out score improves or stays.
fn assert_kept(tuned: &Value) {
    let (before, after) = (held_out(&tuned["before"]), held_out(&tuned["after"]));
    println!("{}: {before:?} to {after:?}", tuned["kept"]);
    assert!(after.0 >= before.0 && after.1 <= before.1, "{before:?} {after:?}");
}

#[test]
fn from_ten_times_wrong_noise_it_comes_within_a_tenth_of_the_true_noise() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--sim", "camera-1hz", "--runs", "2", "--start-factor", "10"];
    let tuned = tune(folder.path(), &args);
    let (given, before, after) = (held_out(&tuned["as_given"]), held_out(&tuned["before"]), held_out(&tuned["after"]));
    assert!(after.1 < 1.1 * given.1, "{after:?} against {given:?}");
    assert!(before.1 > 1.2 * given.1, "ten times wrong must hurt, or this shows nothing: {before:?}");
    assert!(after.0 > before.0);
    assert_eq!((&tuned["settled"], &tuned["is_tuned"]), (&Value::from(true), &Value::from(true)));
    assert!(folder.path().join("tune.html").exists() && folder.path().join("tune.svg").exists());
}

/// Kicks are no noise: numbers that explain them are likelier and steer no better.
#[test]
fn numbers_that_miss_unseen_positions_by_more_are_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--sim", "kicks-camera-1hz", "--runs", "2", "--out-profile", "kicks.toml"];
    let tuned = tune(folder.path(), &args);
    assert_eq!(tuned["is_tuned"], false);
    assert_eq!(tuned["after"], tuned["before"]);
    let kept = tuned["kept"].as_str().unwrap();
    assert!(kept.starts_with("the numbers to start from"), "{kept}");
    let parameters = tuned["parameters"].as_array().unwrap();
    assert!(parameters.iter().all(|key| key["after"] == key["before"]));
    assert!(parameters.iter().any(|key| key["at_maximum"] != key["before"]));
    let profile: toml::Table = toml::from_str(&read_text(folder.path(), "kicks.toml")).unwrap();
    assert_eq!(profile["tuned"]["kept"].as_str(), Some(kept));
}

#[test]
fn held_out_runs_of_a_recording_get_no_worse_and_the_profile_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (recording, data) = (descriptor("optiodom.toml"), committed_data());
    let set = "circular/250620202104/run-0";
    let held = [4, 5, 6].map(|run| format!("{set}{run}"));
    let mut args = vec!["--recording", &recording, "--data", &data, "--fixes-from-truth", "1", "--run", set];
    args.extend(held.iter().flat_map(|name| ["--hold-out", name]));
    let tuned = tune(folder, &[&args[..], &["--out-profile", "p.toml"]].concat());
    assert_kept(&tuned);
    assert_eq!(tuned["is_tuned"], true);
    let after = number(&tuned, "/parameters/0/after");
    assert!(after > 0.0);
    let profile = read_text(folder, "p.toml");
    let table: toml::Table = toml::from_str(&profile).unwrap();
    let key = tuned["parameters"][0]["key"].as_str().unwrap().replace("noise.", "");
    let written = table["robot"]["noise"][&key].as_float().unwrap();
    // serde_json reads numbers to within one digit of the last place.
    assert!((written / after - 1.0).abs() < 1e-14);
    // That the profile is really used: another track width gives another path.
    write_text(folder, "q.toml", &profile.replace("track_width_m = 0.2", "track_width_m = 0.25"));
    let [by_p, by_q] = ["p.toml", "q.toml"].map(|robot| {
        let replay = ["replay", &recording, "--data", &data, "--filter", "pose", "--robot", robot];
        number(&json(folder, &replay), "/estimators/0/position_rms_m")
    });
    assert_ne!(by_p, by_q);
}

#[test]
fn whatever_is_tuned_on_the_held_out_score_improves_or_stays() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (neato, optiodom) = (descriptor("neato-gyro-camera.toml"), descriptor("optiodom.toml"));
    let from_truth = ["--fixes-from-truth", "1"];
    for (recording, more, run, held_out) in [
        (&neato, &[][..], "square", &["rotate_slip_a"][..]),
        (&neato, &[], "rotate_slip_a", &["square"]),
        (&optiodom, &from_truth, "circular", &["square/2312", "free"]),
        (&optiodom, &from_truth, "square/2312", &["circular", "free"]),
        (&optiodom, &from_truth, "free", &["circular", "square"]),
    ] {
        let mut args = vec!["--recording", recording, "--data", data.to_str().unwrap(), "--run", run];
        args.extend(more);
        args.extend(held_out.iter().flat_map(|name| ["--hold-out", name]));
        assert_kept(&tune(folder.path(), &args));
    }
}

#[test]
fn what_cannot_be_tuned_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let optiodom = format!("tune --recording {} --data {}", descriptor("optiodom.toml"), committed_data());
    assert_refused(
        folder.path(),
        &[
            ("tune --sim camera-1hz --param noise.nonsense", 2, &["`noise.nonsense` cannot be tuned"]),
            ("tune --sim nowhere", 2, &["nowhere"]),
            ("tune --sim camera-1hz --filter dynamic", 2, &["no filter of a pose is called `dynamic`"]),
            (&format!("{optiodom} --run nothing"), 2, &["no run begins with `nothing`"]),
            (&format!("{optiodom} --run circular --hold-out circular"), 2, &["no run is left to tune on"]),
            (&optiodom, 1, &["--fixes-from-truth"]),
            ("tune --sim camera-1hz --filter odometry", 1, &["the filter `odometry` held no observation"]),
        ],
    );
}
