//! The table of metrics, and the way from estimates and tracks to numbers.

mod records;
mod sample_run;

use posebridge_report::metrics::{deviations_from_path, errors_of_estimates, errors_of_track};
use posebridge_report::{METRICS, MetricInputs, summarise, tally_sources};
use posebridge_telemetry::{FusionOutcome, SensorId};
use records::record;

#[test]
fn names_are_unique_carry_their_unit_and_say_what_they_mean() {
    for (index, metric) in METRICS.iter().enumerate() {
        let suffix = format!("_{}", metric.unit);
        assert!(metric.unit == "1" || metric.name.ends_with(&suffix), "{}", metric.name);
        assert!(metric.doc.ends_with('.'), "{}", metric.name);
        assert!(METRICS[..index].iter().all(|other| other.name != metric.name));
    }
}

#[test]
fn no_metric_invents_a_value() {
    for metric in METRICS {
        assert_eq!((metric.compute)(&MetricInputs::default()), None, "{}", metric.name);
    }
}

#[test]
fn every_metric_has_a_finite_value_on_a_whole_run() {
    let scene = sample_run::two_laps(7);
    let layers = scene.layers("a whole run");
    let errors = errors_of_estimates(layers.estimates, &scene.truth);
    let positions: Vec<_> = scene.truth.samples().iter().map(|s| s.pose.origin()).collect();
    let record = record(SensorId::CAMERA, FusionOutcome::Accepted, 3.0);
    let evidence = MetricInputs {
        errors: &errors,
        path_deviations_m: &deviations_from_path(&positions, layers.ideal),
        tallies: &tally_sources([&record]),
    };
    for metric in METRICS {
        let value = (metric.compute)(&evidence).unwrap();
        assert!(value.is_finite() && value > 0.0, "{}: {value}", metric.name);
    }
}

#[test]
fn the_estimate_of_the_scene_is_as_good_as_it_claims_and_its_odometry_is_not() {
    let scene = sample_run::two_laps(7);
    let estimate = summarise(&errors_of_estimates(&scene.estimates, &scene.truth));
    let odometry = summarise(&errors_of_track(&scene.odometry, &scene.truth));
    assert_eq!(estimate.samples, scene.estimates.len());
    // The errors are drawn from the claim with 1500 correlated samples: one part in three is a wide margin.
    assert!((estimate.anees.unwrap() - 1.0).abs() < 0.33, "{estimate:?}");
    assert_eq!(odometry.anees, None);
    assert!(odometry.position_rms_m > estimate.position_rms_m.map(|rms_m| 10.0 * rms_m));
}

#[test]
fn an_estimate_without_a_valid_position_is_not_judged_and_one_without_a_heading_in_part() {
    let scene = sample_run::two_laps(7);
    let mut estimates = scene.estimates[..2].to_vec();
    estimates[0].validity.position = false;
    estimates[1].validity.heading = false;
    let errors = errors_of_estimates(&estimates, &scene.truth);
    assert_eq!(errors.len(), 1);
    assert_eq!((errors[0].heading_rad, errors[0].covariance), (None, None));
}
