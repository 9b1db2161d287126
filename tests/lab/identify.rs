//! `posebridge identify`: what the simulator was told is found again, with sigmas that cover; tables, descriptors and real recordings.

use std::fmt::Write as _;
use std::path::Path;

use crate::support::{
    WHEELS_CSV, assert_refused, descriptor, json, named, number, posebridge, shared_data, write_text,
};
use posebridge_estimator::numerics::chi_square::chi_square_quantile;
use serde_json::Value;

fn identify(folder: &Path, args: &[&str]) -> Value {
    json(folder, &[&["identify"], args].concat())
}

/// The probability with which a sigma that is right lies outside the band of its mean square, on either side.
const OUTSIDE: f64 = 0.001;

/// Each experiment with the quantities that the simulator knows.
const SIMULATED: [(&[&str], &[&str]); 6] = [
    (&["step", "--sim", "motor"], &["gain", "dead time", "time constant 1", "mean lag"]),
    (&["step"], &["gain", "dead time", "time constant 1", "mean lag"]),
    (
        &["step", "--sim", "sheathed-thermometer"],
        &["gain", "dead time", "time constant 1", "time constant 2", "share 1", "mean lag"],
    ),
    (&["wall"], &["v_ss", "t90", "d", "m", "dt of the loop"]),
    (&["rest"], &["gyro_rad_per_s", "gyro_bias_walk_rad_per_s_sqrt_s"]),
    (&["delay"], &["delay of the camera"]),
];

/// Over five seeds, in every run that has the quantity: within a tenth, within three sigma, and the mean square of error over sigma
/// where that of a sigma that is right would be.
#[test]
fn what_the_simulator_was_told_is_found_again_and_the_sigmas_cover() {
    for (args, names) in SIMULATED {
        let folder = tempfile::tempdir().unwrap();
        let found = ["1", "2", "3", "4", "5"].map(|seed| identify(folder.path(), &[args, &["--seed", seed]].concat()));
        for name in names {
            let all = found.iter().flat_map(|found| found["quantities"].as_array().unwrap());
            let (mut squares, mut count) = (0.0, 0);
            for quantity in all.filter(|one| one["name"] == *name) {
                let [value, sigma, truth] = ["/value", "/sigma", "/truth"].map(|key| number(quantity, key));
                let error = value - truth;
                assert!(error.abs() < 0.1 * truth.abs() && error.abs() < 3.0 * sigma, "{args:?}: {quantity}");
                squares += (error / sigma).powi(2);
                count += 1;
            }
            assert!(count >= 5, "{args:?} {name}: {count}");
            let band = chi_square_quantile(count, OUTSIDE)..chi_square_quantile(count, 1.0 - OUTSIDE);
            assert!(
                band.contains(&squares),
                "{args:?} {name}: the sum of squares of error over sigma is {squares} of {count}"
            );
        }
        let page = folder.path().join(format!("identify-{}.html", args[0]));
        assert!(page.exists(), "{}", page.display());
    }
}

#[test]
fn ways_and_orders_are_told_apart_and_a_straight_run_is_as_rough_as_whole_counts() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let found = identify(folder, &["step"]);
    let runs = found["runs"].as_array().unwrap();
    for (run, told) in runs.iter().zip([["heating", "up"], ["cooling", "down"]]) {
        assert_eq!(["name", "way"].map(|key| run[key].as_str().unwrap()), told);
        assert_eq!(run["order"], 1, "{found}");
    }
    // 6 s and 7.5 s. The wheels of the simulated robot are alike both ways.
    assert_eq!(found["ways"]["differ"], true);
    assert_eq!(identify(folder, &["step", "--sim", "motor"])["ways"]["differ"], false);
    // One lag, forced, leaves more.
    let sheathed = |more: &[&str]| {
        let found = identify(folder, &[&["step", "--sim", "sheathed-thermometer"], more].concat());
        (number(&found, "/runs/0/order"), number(&found, "/runs/0/residual_rms"))
    };
    let (chosen, forced) = (sheathed(&[]), sheathed(&["--order", "1"]));
    assert_eq!((chosen.0, forced.0), (2.0, 1.0));
    assert!(forced.1 > 3.0 * chosen.1, "{chosen:?} {forced:?}");

    let rest = identify(folder, &["rest"]);
    let step = named(&rest["quantities"], "gyro_resolution_rad_per_s");
    assert!((number(step, "/value") - number(step, "/truth")).abs() < 1e-9, "{step}");
    let by_stamp = identify(folder, &["delay", "--by", "stamp"]);
    let [value, sigma] = ["value", "sigma"].map(|key| number(&by_stamp, &format!("/quantities/0/{key}")));
    assert!(value.abs() < 3.0 * sigma && sigma < 0.005, "{value} ± {sigma}");
    let straight = identify(folder, &["straight"]);
    // 0.08 m/s over 0.05 s on a radius of 28 mm: 8.185 counts of one degree. A share f of the intervals has one count more.
    let f = (0.08_f64 * 0.05 / 0.028).to_degrees().fract();
    let truth = (f * (1.0 - f)).sqrt() * 1.0_f64.to_radians() * 0.028 / 0.05;
    for wheel in ["left", "right"] {
        let quantity = named(&straight["quantities"], &format!("root of R, {wheel} wheel"));
        let off = number(quantity, "/value") - truth;
        assert!(off.abs() < 0.1 * truth && off.abs() < 3.0 * number(quantity, "/sigma"), "{quantity} {truth}");
    }
}

/// A sensor of a lag of 2 s that steps from 5 to 9 after 3 s, read ten times a second, as rows in milliseconds.
fn table() -> Vec<String> {
    let rows = (0..250_u32).map(|k| {
        let since_s = (0.1 * f64::from(k) - 3.0_f64).max(0.0);
        // No random noise: the last digit alone.
        let value = 5.0 + 4.0 * (1.0 - (-since_s / 2.0).exp());
        format!("7,{},{value:.2}", 1_000 + 100 * k)
    });
    ["sensor,millis,volts".to_owned()].into_iter().chain(rows).collect()
}

const COLUMNS: [&str; 7] = ["step", "--time-column", "millis", "--time-unit", "ms", "--value-column", "volts"];

/// Rows that change places change nothing, and that is said.
#[test]
fn a_plain_table_is_enough_and_its_rows_may_be_out_of_order() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut rows = table();
    write_text(folder, "volts.csv", &rows.join("\n"));
    let known = ["--recording", "volts.csv", "--onset", "2.5", "--input-step", "2"];
    let found = identify(folder, &[&COLUMNS[..], &known].concat());
    for (name, truth) in [("gain", 2.0), ("dead time", 0.5), ("time constant 1", 2.0), ("end", 9.0)] {
        let value = number(named(&found["quantities"], name), "/value");
        assert!((value / truth - 1.0).abs() < 0.02, "{name}: {value}");
    }
    rows.swap(20, 200);
    rows.push(rows[100].clone());
    write_text(folder, "mixed.csv", &rows.join("\n"));
    let of = |name: &str| {
        let args = [&["identify"], &COLUMNS[..], &["--recording", name, "--json"]].concat();
        let output = posebridge(folder).args(args).output().unwrap();
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        let quantities = found["quantities"].as_array().unwrap().iter();
        let values: Vec<Value> = quantities.map(|one| one["value"].clone()).collect();
        (values, String::from_utf8(output.stderr).unwrap())
    };
    let ((ordered, quiet), (mixed, told)) = (of("volts.csv"), of("mixed.csv"));
    assert_eq!(mixed, ordered);
    for note in ["were put into the order of `millis`", "1 samples are left out"] {
        assert!(told.contains(note) && !quiet.contains(note), "{quiet}{told}");
    }
}

#[test]
fn a_descriptor_of_a_robot_names_the_sensors_that_it_has() {
    // A wheel that is switched on after 5 s and speeds up to 100 ticks a second with a lag of 0.5 s, read twenty times a second.
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut wheels = String::from("t_s,left,right\n");
    for k in 0..300_u32 {
        let at_s = 0.05 * f64::from(k);
        let since_s = (at_s - 5.0).max(0.0);
        let ticks = 100.0 * (since_s - 0.5 * (1.0 - (-since_s / 0.5_f64).exp()));
        writeln!(wheels, "{at_s},{},{}", ticks.floor(), -ticks.floor()).unwrap();
    }
    write_text(folder, "wheels.csv", &wheels);
    let robot = "name = \"cart\"\nsource = \"here\"\nlicence = \"-\"\ndefault_run = \"a\"\n\n[robot]\nleft_wheel_radius_m = 0.03\n\
        right_wheel_radius_m = 0.03\ntrack_width_m = 0.1\nticks_per_turn = 360.0\n\n[[runs]]\nname = \"a\"\n";
    write_text(folder, "cart.toml", &(robot.to_owned() + WHEELS_CSV));
    let step = "identify step --recording cart.toml --data .";
    assert_refused(folder, &[(step, 2, &["run `a` holds no temperature", "left-wheel, right-wheel"])]);
    for (wheel, way) in [("left-wheel", "up"), ("right-wheel", "down")] {
        let found = identify(folder, &["step", "--recording", "cart.toml", "--data", ".", "--channel", wheel]);
        assert_eq!(found["runs"][0]["way"], way);
        let tau_s = number(named(&found["quantities"], "time constant 1"), "/value");
        assert!((tau_s / 0.5 - 1.0).abs() < 0.1, "{tau_s}");
    }
}

#[test]
fn recorded_thermometers_and_cars_are_identified() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let of = |what: &str, name: &str, more: &[&str]| {
        let args = [what, "--recording", &descriptor(name), "--data", data.to_str().unwrap()];
        identify(folder.path(), &[&args[..], more].concat())
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

#[test]
fn a_step_in_a_plain_table_needs_no_value_given_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A clean step in a plain table, with rest before it and a stop behind it: 1.1 m/s, 0.35 s.
    let mut table = String::from("time_ms,distance_mm,Motor Power\n");
    for step in 0..40_u32 {
        let at_s = 0.08 * f64::from(step);
        let since_s = (at_s - 0.6).clamp(0.0, 1.6);
        let way_m = 1.1 * (since_s - 0.35 * (1.0 - (-since_s / 0.35).exp()));
        let noise_m = [0.0, 0.004, -0.003, 0.002, -0.004][step as usize % 5];
        let motor = if at_s < 0.6 { 0 } else { 60 };
        writeln!(table, "{:.0},{:.1},{motor}", 1e3 * at_s, 1e3 * (2.0 - way_m + noise_m)).unwrap();
    }
    write_text(folder, "step.csv", &table);
    let step = identify(folder, &["wall", "--recording", "step.csv"]);
    let known = |name: &str| number(named(&step["quantities"], name), "/value");
    assert!((known("v_ss") / 1.1 - 1.0).abs() < 0.03 && (known("m") * 1.1 / 0.35 - 1.0).abs() < 0.06, "{step}");
    // The rows do not show when the command came: it lies between two of them, and the sigmas have to hold that.
    for (name, truth) in [("v_ss", 1.1), ("t90", 0.35 * std::f64::consts::LN_10)] {
        let sigma = number(named(&step["quantities"], name), "/sigma");
        assert!((known(name) - truth).abs() < 1.96 * sigma, "{name}: {step}");
    }
    assert!(
        (known("v_ss by lines") / 1.1 - 1.0).abs() < 0.1
            && (known("v_ss by finite differences") / 1.1 - 1.0).abs() < 0.1
    );
    // The same car standing still: the true reason.
    let still: String = (0..40).fold(String::from("time_s,distance_m\n"), |rows, row| {
        format!("{rows}{:.2},{:.3}\n", 0.1 * f64::from(row), 1.5 + 0.001 * f64::from(row % 3))
    });
    write_text(folder, "still.csv", &still);
    let reasons = ["no step is to be seen", "did the motors run?"];
    assert_refused(folder, &[("identify wall --recording still.csv", 1, &reasons)]);
}

#[test]
fn what_tells_nothing_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let still = String::from("t_s,volts\n") + &(0..99).fold(String::new(), |rows, k| format!("{rows}{k},1\n"));
    write_text(folder, "still.csv", &still);
    write_text(folder, "typed.csv", "t_s,volts\n1,2\n2,x\n");
    let past = "identify step --recording still.csv --onset 1e300";
    assert_refused(
        folder,
        &[
            ("identify rest --from 5 --to 4", 2, &["nothing lies between them"]),
            ("identify rest --to 2", 1, &["20 are the least"]),
            ("identify delay --most 0.1", 1, &["widen it with --most"]),
            ("identify straight --sim nowhere.toml", 2, &["nowhere.toml"]),
            ("identify step --recording none.csv", 2, &["none.csv"]),
            ("identify step --recording still.csv", 2, &["give --noise"]),
            ("identify step --recording still.csv --noise 0.1", 1, &["no step"]),
            ("identify step --recording typed.csv", 2, &["`typed.csv` line 3: `x` in column `volts` is no number"]),
            ("identify step --recording still.csv --value-column amps", 2, &["no column `amps`; it has: t_s, volts"]),
            (past, 2, &["the samples of `still.csv` end 98 s after the first"]),
            ("identify step --recording a.bag", 2, &["no descriptor"]),
            ("identify step --order 4", 2, &["4"]),
            ("identify step --noise=-1", 2, &["--noise"]),
            ("identify step --onset 1", 2, &["belong to a --recording"]),
            ("identify wall --scene nowhere.toml", 2, &["nowhere.toml"]),
        ],
    );
}
