//! `posebridge identify`: what the simulator was told is found again, with sigmas that cover.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::fmt::Write as _;
use std::path::Path;

use posebridge_estimator::numerics::chi_square::chi_square_quantile;
use serde_json::Value;
use support::{posebridge, root, stdout_of};

fn object(folder: &Path, args: &[&str]) -> Value {
    let text = stdout_of(posebridge(folder).arg("identify").args(args).arg("--json"));
    serde_json::from_str(&text).unwrap()
}

fn identify(folder: &Path, args: &[&str]) -> Vec<Value> {
    let object = object(folder, args);
    object["quantities"].as_array().unwrap().clone()
}

/// The probability with which a sigma that is right lies outside the band of its mean square, on either side.
const OUTSIDE: f64 = 0.001;

/// Each of these numbers over five seeds, in every run that has it: within a tenth, within three sigma, and the mean square of error over
/// sigma where that of a sigma that is right would be.
fn holds(args: &[&str], names: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let found: Vec<Vec<Value>> = ["1", "2", "3", "4", "5"]
        .iter()
        .map(|seed| identify(folder.path(), &[args, &["--seed", seed]].concat()))
        .collect();
    for name in names {
        let all = found.iter().flatten().filter(|one| one["name"] == *name);
        let (mut squares, mut count, mut worst) = (0.0, 0, 0.0_f64);
        for quantity in all {
            let number = |key: &str| quantity[key].as_f64().unwrap();
            let (value, sigma, truth) = (number("value"), number("sigma"), number("truth"));
            let error = value - truth;
            assert!(error.abs() < 0.1 * truth.abs(), "{quantity}");
            assert!(error.abs() < 3.0 * sigma, "{quantity}");
            squares += (error / sigma).powi(2);
            worst = worst.max(error.abs() / truth.abs());
            count += 1;
        }
        assert!(count >= 5, "{name}: {count}");
        let quantile = |p: f64| chi_square_quantile(count, p);
        assert!(
            (quantile(OUTSIDE)..quantile(1.0 - OUTSIDE)).contains(&squares),
            "{name}: the mean square of error over sigma is {} of {count}, the worst error {worst} of the truth",
            squares / count as f64
        );
    }
}

#[test]
fn time_constant_and_dead_time_of_the_motor_are_those_of_the_simulator() {
    let names = ["gain", "dead time", "time constant 1", "mean lag"];
    holds(&["step", "--sim", "motor"], &names);
}

#[test]
fn a_thermometer_of_one_lag_is_that_of_the_simulator_each_way_by_its_own() {
    let names = ["gain", "dead time", "time constant 1", "mean lag"];
    holds(&["step"], &names);
    let folder = tempfile::tempdir().unwrap();
    let found = object(folder.path(), &["step"]);
    let runs = found["runs"].as_array().unwrap();
    let told: Vec<[&str; 2]> = runs.iter().map(|run| ["name", "way"].map(|key| run[key].as_str().unwrap())).collect();
    assert_eq!(told, [["heating", "up"], ["cooling", "down"]]);
    assert!(runs.iter().all(|run| run["order"] == 1), "{found}");
    // 6 s and 7.5 s.
    assert_eq!(found["ways"]["differ"], true);
    for picture in ["identify-step-1.svg", "identify-step-2.svg", "identify-step.html"] {
        assert!(folder.path().join(picture).exists(), "{picture}");
    }
    // The wheels of the simulated robot are alike both ways.
    let motor = object(folder.path(), &["step", "--sim", "motor"]);
    assert_eq!(motor["ways"]["differ"], false);
}

#[test]
fn a_thermometer_of_two_lags_is_told_from_one_and_its_lags_are_found() {
    let args = ["step", "--sim", "sheathed-thermometer"];
    holds(&args, &["gain", "dead time", "time constant 1", "time constant 2", "share 1", "mean lag"]);
    // One lag, forced, has no truth to be held against and leaves more.
    let folder = tempfile::tempdir().unwrap();
    let rms = |more: &[&str]| {
        let found = object(folder.path(), &[&args[..], more].concat());
        let run = &found["runs"][0];
        (run["order"].as_u64().unwrap(), run["residual_rms"].as_f64().unwrap())
    };
    let (chosen, forced) = (rms(&[]), rms(&["--order", "1"]));
    assert_eq!((chosen.0, forced.0), (2, 1));
    assert!(forced.1 > 3.0 * chosen.1, "{chosen:?} {forced:?}");
}

#[test]
fn the_drive_of_the_car_before_a_wall_is_that_of_the_simulator() {
    holds(&["wall"], &["v_ss", "t90", "d", "m", "dt of the loop"]);
    let folder = tempfile::tempdir().unwrap();
    let found = object(folder.path(), &["wall", "--steps", "3"]);
    assert_eq!(found["experiment"], "identify-wall");
    assert!(folder.path().join("identify-wall.svg").exists());
}

/// A sensor of a lag of 2 s that steps from 5 to 9 after 3 s, read ten times a second, as a table in milliseconds.
fn table(folder: &Path) {
    let mut table = String::from("sensor,millis,volts\n");
    for k in 0..250_u32 {
        let at_s = 0.1 * f64::from(k);
        let since_s = (at_s - 3.0_f64).max(0.0);
        // No random noise: the last digit alone.
        let value = 5.0 + 4.0 * (1.0 - (-since_s / 2.0).exp());
        writeln!(table, "7,{},{value:.2}", 1_000 + 100 * k).unwrap();
    }
    std::fs::write(folder.join("volts.csv"), table).unwrap();
}

#[test]
fn a_plain_table_is_enough() {
    let folder = tempfile::tempdir().unwrap();
    table(folder.path());
    let columns = ["--time-column", "millis", "--time-unit", "ms", "--value-column", "volts"];
    let known = ["--onset", "2.5", "--input-step", "2"];
    let args = [&["step", "--recording", "volts.csv"][..], &columns, &known].concat();
    let found = identify(folder.path(), &args);
    let value = |name: &str| {
        let one = found.iter().find(|quantity| quantity["name"] == name);
        one.unwrap()["value"].as_f64().unwrap()
    };
    for (name, truth) in [("gain", 2.0), ("dead time", 0.5), ("time constant 1", 2.0), ("end", 9.0)] {
        assert!((value(name) / truth - 1.0).abs() < 0.02, "{name}: {}", value(name));
    }
}

/// Rows that change places change nothing, and somebody says so.
#[test]
fn rows_out_of_order_are_put_into_it() {
    let folder = tempfile::tempdir().unwrap();
    table(folder.path());
    let text = std::fs::read_to_string(folder.path().join("volts.csv")).unwrap();
    let mut rows: Vec<&str> = text.lines().collect();
    rows.swap(20, 200);
    rows.push(rows[100]);
    std::fs::write(folder.path().join("mixed.csv"), rows.join("\n")).unwrap();
    let of = |name: &str| {
        let args = [
            "identify",
            "step",
            "--json",
            "--time-column",
            "millis",
            "--time-unit",
            "ms",
            "--value-column",
            "volts",
            "--recording",
            name,
        ];
        let output = posebridge(folder.path()).args(args).output().unwrap();
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        let values = found["quantities"].as_array().unwrap().iter();
        let values: Vec<Value> = values.map(|one| one["value"].clone()).collect();
        (values, String::from_utf8(output.stderr).unwrap())
    };
    let (ordered, said) = of("volts.csv");
    assert!(!said.contains("order") && !said.contains("left out"), "{said}");
    let (mixed, said) = of("mixed.csv");
    assert_eq!(mixed, ordered);
    assert!(said.contains("were put into the order of `millis`") && said.contains("1 samples are left out"), "{said}");
}

#[test]
fn a_descriptor_of_a_robot_names_the_sensors_that_it_has() {
    // A wheel that is switched on after 5 s and speeds up to 100 ticks a second with a lag of 0.5 s, read twenty times a second.
    let folder = tempfile::tempdir().unwrap();
    let mut wheels = String::from("t_s,left,right\n");
    for k in 0..300_u32 {
        let at_s = 0.05 * f64::from(k);
        let since_s = (at_s - 5.0).max(0.0);
        let ticks = 100.0 * (since_s - 0.5 * (1.0 - (-since_s / 0.5_f64).exp()));
        writeln!(wheels, "{at_s},{},{}", ticks.floor(), -ticks.floor()).unwrap();
    }
    std::fs::write(folder.path().join("wheels.csv"), wheels).unwrap();
    let robot = "name = \"cart\"\nsource = \"here\"\nlicence = \"-\"\ndefault_run = \"a\"\n\n[robot]\nleft_wheel_radius_m = 0.03\n\
        right_wheel_radius_m = 0.03\ntrack_width_m = 0.1\nticks_per_turn = 360.0\n\n[[runs]]\nname = \"a\"\n";
    let text = robot.to_owned() + support::WHEELS_CSV;
    std::fs::write(folder.path().join("cart.toml"), text).unwrap();
    let step = ["step", "--recording", "cart.toml", "--data", "."];
    let refused = posebridge(folder.path()).arg("identify").args(step).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2));
    assert!(said.contains("run `a` holds no temperature") && said.contains("left-wheel, right-wheel"), "{said}");
    for (wheel, way) in [("left-wheel", "up"), ("right-wheel", "down")] {
        let args = [&step[..], &["--channel", wheel]].concat();
        let found = object(folder.path(), &args);
        assert_eq!(found["runs"][0]["way"], way);
        let tau = found["quantities"].as_array().unwrap().iter();
        let tau = tau.clone().find(|quantity| quantity["name"] == "time constant 1").unwrap();
        let tau_s = tau["value"].as_f64().unwrap();
        assert!((tau_s / 0.5 - 1.0).abs() < 0.1, "{tau}");
    }
}

#[test]
fn recorded_thermometers_and_cars_are_identified() {
    let Some(data) = std::env::var_os("POSEBRIDGE_DATA") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let of = |what: &str, name: &str, more: &[&str]| {
        let descriptor = root().join("config/recordings").join(name);
        let args = [what, "--recording", descriptor.to_str().unwrap(), "--data", data.to_str().unwrap()];
        object(folder.path(), &[&args[..], more].concat())
    };
    let value = |found: &Value, run: &str, name: &str| {
        let mut all = found["quantities"].as_array().unwrap().iter();
        let one = all.find(|one| one["of"] == run && one["name"] == name);
        one.unwrap()["value"].as_f64().unwrap()
    };
    // README of the data: heating and cooling differ, cooling takes longer.
    let probe = of("step", "rtd-step.toml", &[]);
    assert_eq!(probe["ways"]["differ"], true, "{probe}");
    let lag = |run: &str| value(&probe, run, "mean lag");
    let heating = [lag("heating-20-56"), lag("heating-21-76")];
    assert!((heating[0] / heating[1] - 1.0).abs() < 0.1, "{heating:?}");
    let cooling = lag("cooling-55-21");
    assert!(heating.iter().all(|one| cooling > 1.1 * one), "{cooling}");
    // README of the data: one exponential does not fit, two do; for KM 0.47 exp(-t/5.2) + 0.53 exp(-t/24).
    let ice = of("step", "ds18b20-step.toml", &[]);
    for run in ice["runs"].as_array().unwrap() {
        assert!(run["order"].as_u64().unwrap() >= 2, "{run}");
    }
    let expected = 0.47 * 5.2 + 0.53 * 24.0;
    let found = value(&ice, "KM", "mean lag");
    assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
    let car = of("wall", "tof-wall.toml", &["--run", "robotA-120"]);
    let steady = value(&car, "robotA-120-step", "v_ss");
    assert!((2.5..4.5).contains(&steady), "{steady}");
}

/// Every quantity with a truth and a sigma, over five seeds: within a tenth, within three sigma, and most within two.
fn covers(what: &str, names: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let (mut all, mut within_two) = (0, 0);
    for seed in ["1", "2", "3", "4", "5"] {
        let found = identify(folder.path(), &[what, "--seed", seed]);
        for name in names {
            let quantity = found.iter().find(|quantity| quantity["name"] == *name).unwrap();
            let number = |key: &str| quantity[key].as_f64().unwrap();
            let (value, sigma, truth) = (number("value"), number("sigma"), number("truth"));
            assert!((value - truth).abs() < 0.1 * truth, "{name}, seed {seed}: {value}, true {truth}");
            assert!((value - truth).abs() < 3.0 * sigma, "{name}, seed {seed}: {value} ± {sigma}, true {truth}");
            within_two += i32::from((value - truth).abs() < 2.0 * sigma);
            all += 1;
        }
    }
    assert!(within_two * 10 >= all * 8, "{within_two} of {all} within two sigma");
    assert!(folder.path().join(format!("identify-{what}.html")).exists());
}

#[test]
fn noise_and_bias_walk_of_a_gyro_at_rest_are_those_of_the_simulator() {
    covers("rest", &["gyro_rad_per_s", "gyro_bias_walk_rad_per_s_sqrt_s"]);
    let folder = tempfile::tempdir().unwrap();
    let found = identify(folder.path(), &["rest"]);
    let step = found.iter().find(|quantity| quantity["name"] == "gyro_resolution_rad_per_s").unwrap();
    let (value, truth) = (step["value"].as_f64().unwrap(), step["truth"].as_f64().unwrap());
    assert!((value - truth).abs() < 1e-9, "{value} {truth}");
}

#[test]
fn the_delay_of_a_camera_is_that_of_the_simulator() {
    covers("delay", &["delay of the camera"]);
}

#[test]
fn by_its_stamps_the_simulated_camera_is_not_late() {
    let folder = tempfile::tempdir().unwrap();
    let found = identify(folder.path(), &["delay", "--by", "stamp"]);
    let (value, sigma) = (found[0]["value"].as_f64().unwrap(), found[0]["sigma"].as_f64().unwrap());
    assert!(value.abs() < 3.0 * sigma && sigma < 0.005, "{value} ± {sigma}");
}

#[test]
fn the_speed_of_a_straight_run_is_as_rough_as_whole_counts_make_it() {
    let folder = tempfile::tempdir().unwrap();
    let found = identify(folder.path(), &["straight"]);
    // 0.08 m/s over 0.05 s on a radius of 28 mm: 8.185 counts of one degree. A share f of the intervals has one count more.
    let f = (0.08_f64 * 0.05 / 0.028).to_degrees().fract();
    let truth = (f * (1.0 - f)).sqrt() * 1.0_f64.to_radians() * 0.028 / 0.05;
    for wheel in ["left", "right"] {
        let name = format!("root of R, {wheel} wheel");
        let quantity = found.iter().find(|quantity| quantity["name"] == name.as_str()).unwrap();
        let (value, sigma) = (quantity["value"].as_f64().unwrap(), quantity["sigma"].as_f64().unwrap());
        assert!((value - truth).abs() < 0.1 * truth && (value - truth).abs() < 3.0 * sigma, "{value} {truth}");
    }
}

#[test]
fn what_tells_nothing_says_why() {
    let folder = tempfile::tempdir().unwrap();
    for (args, code, wanted) in [
        (vec!["rest", "--from", "5", "--to", "4"], 2, "nothing lies between them"),
        (vec!["rest", "--to", "2"], 1, "20 are the least"),
        (vec!["delay", "--most", "0.1"], 1, "widen it with --most"),
        (vec!["straight", "--sim", "nowhere.toml"], 2, "nowhere.toml"),
    ] {
        refused(folder.path(), &args, code, wanted);
    }
}

/// Ends with this exit code and says this.
fn refused(folder: &Path, args: &[&str], code: i32, wanted: &str) {
    let mut command = posebridge(folder);
    let output = command.arg("identify").args(args).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
    assert!(said.contains(wanted), "{args:?}: {said}");
}

#[test]
fn a_step_that_tells_nothing_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let still = String::from("t_s,volts\n") + &(0..99).fold(String::new(), |rows, k| format!("{rows}{k},1\n"));
    std::fs::write(folder.path().join("still.csv"), still).unwrap();
    std::fs::write(folder.path().join("typed.csv"), "t_s,volts\n1,2\n2,x\n").unwrap();
    for (args, code, wanted) in [
        (vec!["step", "--recording", "none.csv"], 2, "none.csv"),
        (vec!["step", "--recording", "still.csv"], 2, "give --noise"),
        (vec!["step", "--recording", "still.csv", "--noise", "0.1"], 1, "no step"),
        (vec!["step", "--recording", "typed.csv"], 2, "`typed.csv` line 3: `x` in column `volts` is no number"),
        (
            vec!["step", "--recording", "still.csv", "--value-column", "amps"],
            2,
            "has no column `amps`; it has: t_s, volts",
        ),
        (
            vec!["step", "--recording", "still.csv", "--onset", "1e300"],
            2,
            "the samples of `still.csv` end 98 s after the first",
        ),
        (vec!["step", "--recording", "a.bag"], 2, "no descriptor"),
        (vec!["step", "--order", "4"], 2, "4"),
        (vec!["step", "--noise=-1"], 2, "--noise"),
        (vec!["step", "--onset", "1"], 2, "belong to a --recording"),
        (vec!["step", "--from", "5", "--to", "4"], 2, "nothing lies"),
        (vec!["wall", "--scene", "nowhere.toml"], 2, "nowhere.toml"),
    ] {
        refused(folder.path(), &args, code, wanted);
    }
}
