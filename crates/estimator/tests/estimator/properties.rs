//! For any input in any order: what cannot be used is refused with a reason and changes nothing, and estimates stay
//! sound. All kinds of observation, all states, random sequences from a fixed seed.

use std::f64::consts::PI;

use nalgebra::DMatrix;
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::{CORE_STATES, LARGE_STATES, SMALL_STATES};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{Estimate, FusionOutcome, Observation, SensorId, TimeDelta};
use proptest::prelude::*;

use crate::support::any::{AnyMeasurement, any_observation, cases, damages, learning_everything, of, without_learning};
use crate::support::score::assert_positive;

/// Estimates of the last second and of the next, each in enough digits to distinguish any two numbers, and the calibration.
struct FilterReadout {
    estimates: Vec<Option<String>>,
    learned: String,
}

fn readout<const N: usize>(filter: &PoseFilter<N>, about: &Observation) -> FilterReadout {
    let instants = (-10..=10).map(|k| about.stamp + TimeDelta::from_millis(k * 100));
    FilterReadout {
        // What is missing for a pose may change by what is not used.
        estimates: instants
            .map(|stamp| filter.estimate_at(stamp).map(|found| format!("{:?}", Estimate { missing: None, ..found })))
            .collect(),
        learned: format!("{:?}", filter.calibration()),
    }
}

/// Compares two such texts. An estimate of an instant may be dropped, because even an observation that is not used
/// moves the end of the history, and the first of all gives the filter its first instant.
fn assert_unchanged(before: &FilterReadout, after: &FilterReadout, what: &str) {
    assert_eq!(before.learned, after.learned, "{what}");
    for (before, after) in before.estimates.iter().zip(&after.estimates) {
        if before.is_some() && after.is_some() {
            assert_eq!(before, after, "{what}");
        }
    }
    let newest = before.estimates.last().and_then(Option::as_ref);
    assert!(newest.is_none() || after.estimates.last() == Some(&newest.cloned()), "{what}");
}

const fn leaves_all_as_it_was(verdict: FusionOutcome) -> bool {
    matches!(verdict, FusionOutcome::Malformed | FusionOutcome::TooOld | FusionOutcome::Gated | FusionOutcome::Unused)
}

fn assert_state_sound<const N: usize>(filter: &PoseFilter<N>) {
    let state = filter.state();
    let p = DMatrix::from_iterator(N, N, state.covariance.iter().copied());
    assert_positive("state", &p, 1e-9);
    assert!(state.mean.iter().all(|value| value.is_finite()));
    let heading_rad = state.pose.heading_rad;
    assert!(heading_rad > -PI && heading_rad <= PI, "{heading_rad}");
    assert!(state.forward.variance >= 0.0 && state.turn.variance >= 0.0);
}

fn resets<const N: usize>(filter: &PoseFilter<N>) -> u8 {
    filter.state().status.reset_counter
}

/// Gives a sequence to the filter, with damaged copies, doubles and latecomers in between.
fn play_anything<const N: usize>(config: &FilterConfig, steps: &[(i64, SensorId, AnyMeasurement)]) {
    let mut filter = PoseFilter::<N>::new(config);
    let mut millis = 10_000;
    for (step_ms, sensor, measurement) in steps {
        millis += step_ms;
        let observation = of(millis, *sensor, measurement.0);
        let before = readout(&filter, &observation);
        let resets_before = resets(&filter);
        let record = filter.observe(&observation);
        assert!(record.nis >= 0.0 && record.nis.is_finite(), "{record:?}");
        assert!(record.log_likelihood.is_finite(), "{record:?}");
        assert!(!record.outcome.reason().is_empty());
        let after = readout(&filter, &observation);
        // A late one that is refused may let a later one move the pose.
        let has_moved = resets(&filter) != resets_before;
        if leaves_all_as_it_was(record.outcome) && !has_moved {
            let what = format!("{:?}: {observation:?}", record.outcome);
            assert_unchanged(&before, &after, &what);
        }
        let again = filter.observe(&observation).outcome;
        assert!(leaves_all_as_it_was(again), "{again:?} twice: {observation:?}");
        let twice = readout(&filter, &observation);
        assert_unchanged(&after, &twice, &format!("twice: {observation:?}"));
        for damaged in damages(&observation) {
            let verdict = filter.observe(&damaged).outcome;
            assert!(matches!(verdict, FusionOutcome::Malformed | FusionOutcome::TooOld), "{verdict:?}: {damaged:?}");
            let still = readout(&filter, &observation);
            assert_unchanged(&after, &still, &format!("{damaged:?}"));
        }
        assert_state_sound(&filter);
        let latest = filter.latest_time().map(|latest| latest + TimeDelta::from_millis(300));
        if let Some(estimate) = latest.and_then(|latest| filter.estimate_at(latest)) {
            let published = estimate.covariance;
            assert_positive("published", &DMatrix::from_fn(5, 5, |row, column| published[row][column]), 1e-9);
        }
    }
}

proptest! {
    #![proptest_config(cases(40, 20_260_103))]

    #[test]
    fn with_every_state_any_input_is_used_soundly_or_refused(
        steps in prop::collection::vec(any_observation(), 1..60),
        has_start in any::<bool>(),
        has_students_t in any::<bool>(),
    ) {
        let mut config = learning_everything();
        config.start = config.start.filter(|_| has_start);
        config.params.student_dof = if has_students_t { 4.0 } else { 0.0 };
        play_anything::<LARGE_STATES>(&config, &steps);
        play_anything::<SMALL_STATES>(&config, &steps);
    }

    #[test]
    fn with_known_constants_any_input_is_used_soundly_or_refused(
        steps in prop::collection::vec(any_observation(), 1..100),
        has_start in any::<bool>(),
    ) {
        let mut config = without_learning();
        config.start = config.start.filter(|_| has_start);
        play_anything::<CORE_STATES>(&config, &steps);
    }
}
