//! From estimates and tracks to numbers.

use posebridge_report::metrics::{errors_of_estimates, errors_of_track};
use posebridge_report::summarise;

use crate::sample_run;

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
