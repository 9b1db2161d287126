//! What the lesson of the slow thermometer promises, section by section.

use posebridge_lab::identification::lesson::{BoundRun, LessonSection, SECTIONS, bound_run, bounds_section};

const SEED: u64 = 1;

fn number(sections: &[LessonSection], name: &str, value: &str) -> Option<f64> {
    let section = sections.iter().find(|section| section.name == name).unwrap();
    println!("{name}.{value} = {:?}", section.value(value));
    section.value(value)
}

/// Numbers with what they are by the theory, and how far they may be off.
const NEAR: [(&str, &str, f64, f64); 17] = [
    ("worked_example", "three_samples", 3.0, 5e-7),
    ("worked_example", "two_samples_known_q", 3.0, 5e-7),
    ("worked_example", "three_samples_known_q", 3.0, 5e-7),
    ("three_ways", "recursive_difference", 0.0, 1e-9),
    ("three_ways", "kalman_difference", 0.0, 1e-9),
    ("start", "first_difference", 0.0, 0.0),
    ("start", "sixth_error_k", 0.0, 1.0),
    ("noise_gain", "after_2", 3.61, 0.006),
    ("noise_gain", "after_3", 1.87, 0.006),
    ("noise_gain", "after_5", 0.927, 0.006),
    ("noise_gain", "after_10", 0.440, 0.006),
    ("noise_gain", "after_20", 0.258, 0.006),
    ("orders", "lag_1_error_sigmas", 0.0, 3.5),
    ("orders", "lag_2_error_sigmas", 0.0, 3.5),
    ("both_ways", "by_heating_expected_s", 2.0, 0.1),
    ("both_ways", "by_cooling_expected_s", 2.6, 0.1),
    ("trend", "constant_inside", 0.0, 0.0),
];

/// Of each section the first number is less than so many times the second.
const LESS: [(&str, &str, f64, &str); 9] = [
    ("load_cell", "predicted_2_percent_s", 0.1, "shown_2_percent_s"),
    // With uncertain lags it is earlier than the reading on other data, and in the end nearer than with wrong ones.
    ("other_data", "other_estimated_5_percent_s", 1.0, "other_shown_5_percent_s"),
    ("other_data", "other_estimated_2_percent_s", 1.0, "other_certain_2_percent_s"),
    ("other_data", "data_certain_5_percent_s", 0.3, "data_shown_5_percent_s"),
    ("other_data", "same_certain_5_percent_s", 0.3, "same_shown_5_percent_s"),
    // Each way has its own time constant.
    ("both_ways", "by_cooling_5_percent_s", 1.0, "by_heating_5_percent_s"),
    // A trend is missed with confidence unless the quantity may walk; then a change is followed closer than the sensor shows it.
    ("trend", "constant_sigma_k", 0.05, "constant_error_k"),
    ("walking", "walking_error_k", 0.6, "shown_error_k"),
    ("walking", "walking_error_k", 1.0, "constant_error_k"),
];

#[test]
fn every_section_has_the_numbers_that_its_text_promises() {
    let sections: Vec<LessonSection> = SECTIONS.iter().map(|make| make(SEED)).collect();
    let value = |section: &str, name: &str| number(&sections, section, name).unwrap();
    for (section, name, expected, band) in NEAR {
        assert!((value(section, name) - expected).abs() <= band, "{section}.{name}");
    }
    for (section, less, factor, more) in LESS {
        assert!(value(section, less) < factor * value(section, more), "{section}.{less}");
    }
    assert_eq!(value("orders", "order"), 2.0);
    assert_eq!(sections.iter().find(|section| section.name == "three_ways").unwrap().rows.len(), 4);
    assert!(value("trend", "walking_error_k") < 0.5 && value("trend", "walking_inside") > 0.85);
    // Two sensors know more than either.
    for count in [3, 5, 10, 20] {
        let sigma = |name: &str| value("several_sensors", &format!("{name}_sigma_after_{count}_k"));
        assert!(sigma("both") < sigma("fast").min(sigma("slow")));
    }
    // Rounding counts as noise of its digit. Forty runs know a standard deviation to a ninth; rounding is not quite white.
    for digit in ["0", "0.0625", "0.5", "1"] {
        let [error, claimed] = ["error", "sigma"].map(|of| value("quantised", &format!("digit_{digit}_{of}_k")));
        assert!((0.5..1.6).contains(&(error / claimed)), "{digit}: {error} {claimed}");
    }
    // With lags that are a third wrong the bound holds if they are estimated, and does not if they are taken for certain.
    let settled = |method: &str, factor: f64| {
        number(&sections, "mismatch", &format!("{method}_5_percent_s_at_{factor}")).unwrap_or(f64::INFINITY)
    };
    for factor in [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3] {
        assert!(settled("estimated", factor) < settled("shown", factor));
    }
    assert!(settled("estimated", 1.0) < 0.5 * settled("shown", 1.0));
    for factor in [0.7, 0.8, 1.2, 1.3] {
        let inside = |method: &str| value("mismatch", &format!("{method}_inside_at_{factor}"));
        assert!(inside("estimated") > inside("certain") + 0.2, "{factor}");
    }
}

/// 1000 runs: the bound of known dynamics holds at its rate, that of dynamics taken for known does not, and that of uncertain ones
/// holds more often.
#[test]
fn the_bounds_hold_at_their_rate() {
    let runs: Vec<BoundRun> = (0..1_000).map(|run| bound_run(7_000_000 + run)).collect();
    let section = [bounds_section(&runs)];
    let value = |name: &str| number(&section, "bounds", name).unwrap();
    for time_constants in ["0.5", "1", "2"] {
        let rate = value(&format!("known_rate_at_{time_constants}"));
        assert!((rate - 0.95).abs() <= value("half_width"), "{time_constants}: {rate}");
        // Wider than needed for a sensor without a fault.
        let rate = value(&format!("identified_rate_at_{time_constants}"));
        assert!(rate > 0.95, "{time_constants}: {rate}");
    }
    assert!(value("taken_for_known_rate_at_1") < 0.8);
}
