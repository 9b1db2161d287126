//! The wall filter of paper 3: its model's numbers, its gains and gates, and what the corrected row does otherwise.

use nalgebra::{Matrix2, Vector2};
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::{RangeFilter, RangeFilterVariant};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    FusionOutcome, FusionRecord, Meters, MetersPerSecond, ObservationKind, RadiansPerSecond, ScalarEstimate, SensorId,
    Timestamp,
};

use crate::support::observe;
use crate::support::robot::config;

/// The paper's loop: 84 steps of 7.6 ms on average, 19 of them with a reading.
const STEP_S: f64 = 0.0076;
const STEPS: usize = 84;
const READINGS: usize = 19;

fn configured(process_sigma: f64) -> FilterConfig {
    let mut config = config();
    config.noise.wall_range_m = 0.02;
    config.params.wall_process_m = process_sigma;
    config
}

fn observe(filter: &mut RangeFilter, at_s: f64, observed: ObservationKind) -> FusionRecord {
    filter.observe(&observe::at_s(at_s, SensorId::RANGE, observed))
}

fn command(filter: &mut RangeFilter, at_s: f64, forward_m_per_s: f64) -> FusionRecord {
    let observed =
        ObservationKind::BodyVelocity { forward: MetersPerSecond(forward_m_per_s), turn: RadiansPerSecond(0.0) };
    observe(filter, at_s, observed)
}

fn range(filter: &mut RangeFilter, at_s: f64, range_m: f64) -> FusionRecord {
    observe(filter, at_s, ObservationKind::WallRange(Meters(range_m)))
}

fn at(filter: &RangeFilter, at_s: f64) -> ScalarEstimate {
    let found = filter.scalar_at(Timestamp::from_secs_f64(at_s));
    found.expect("it was given a reading")
}

fn is_reading(step: usize) -> bool {
    (step * READINGS) % STEPS < READINGS
}

#[test]
fn the_step_test_gives_the_papers_mass_and_drag() {
    let found = WallApproachModel::from_step_test(1.225, 0.997);
    assert!((found.drag_s_per_m - 0.816_33).abs() < 1e-5);
    assert!((found.mass_s2_per_m - 0.353_46).abs() < 1e-5);
    assert!((found.rate_per_s() - 2.309_5).abs() < 1e-4);
    let defaults = config().params;
    assert!((found.drag_s_per_m - defaults.wall_drag_s_per_m).abs() < 1e-5);
    assert!((found.mass_s2_per_m - defaults.wall_mass_s2_per_m).abs() < 1e-5);
}

#[test]
fn the_discrete_matrices_are_the_papers_and_the_exact_ones() {
    let model = WallApproachModel::from_step_test(1.225, 0.997);
    let close = |found: Matrix2<f64>, expected: Matrix2<f64>, limit: f64| {
        assert!((found - expected).amax() < limit, "{found} {expected}");
    };
    let euler = model.euler(STEP_S);
    close(euler.a, Matrix2::new(1.0, -0.0076, 0.0, 0.982_45), 5e-6);
    // The paper counts in millimetres.
    assert!((euler.b * 1e3 - Vector2::new(0.0, 21.501_6)).amax() < 5e-4);
    let exact = model.exact(STEP_S);
    close(exact.a, Matrix2::new(1.0, -0.007_534, 0.0, 0.982_601), 5e-7);
    assert!((exact.b * 1e3 - Vector2::new(-0.081_2, 21.314)).amax() < 5e-4);
}

/// Share of a reading in the distance, and the gate, in m, once they have settled: means over a pattern of readings.
fn settled_gain_and_gate(process_sigma: f64, is_reading: fn(usize) -> bool) -> (f64, f64) {
    let mut filter = RangeFilter::new(&configured(process_sigma), RangeFilterVariant::Paper);
    let (mut gain, mut gate, mut count) = (0.0, 0.0, 0.0);
    range(&mut filter, 0.0, 2.0);
    for step in 1..=20 * STEPS {
        let at_s = STEP_S * step as f64;
        command(&mut filter, at_s, 0.0);
        if !is_reading(step) {
            continue;
        }
        let before = at(&filter, at_s).value;
        let record = range(&mut filter, at_s, before + 0.01);
        if step > 10 * STEPS {
            gain += (at(&filter, at_s).value - before) / 0.01;
            gate += 3.0 * record.innovation_covariance[0][0].sqrt();
            count += 1.0;
        }
    }
    (gain / count, gate / count)
}

#[test]
fn gains_and_gates_are_those_of_the_papers_three_sigmas() {
    for (process_sigma, gain, gate_m) in [(0.05, 0.963, 0.312), (0.01, 0.620, 0.097), (0.5, 0.999_6, 3.011)] {
        let (found_gain, found_gate_m) = settled_gain_and_gate(process_sigma, |step| step.is_multiple_of(4));
        let (_, mean_gate_m) = settled_gain_and_gate(process_sigma, is_reading);
        println!(
            "sigma {process_sigma}: K {found_gain:.4}, gate {found_gate_m:.3} m with a reading in four steps, \
             {mean_gate_m:.3} m with 19 in 84"
        );
        assert!((found_gain - gain).abs() < 6e-4, "{found_gain}");
        assert!((found_gate_m / gate_m - 1.0).abs() < 0.005, "{found_gate_m}");
        assert!((1.0..1.1).contains(&(mean_gate_m / gate_m)), "{mean_gate_m}");
    }
}

#[test]
fn a_reading_beyond_the_gate_is_refused_and_one_within_the_least_gate_never() {
    for variant in [RangeFilterVariant::Paper, RangeFilterVariant::Corrected] {
        let mut config = configured(0.002);
        config.params.wall_gate_m = 0.2;
        let mut filter = RangeFilter::new(&config, variant);
        range(&mut filter, 0.0, 2.0);
        for step in 1..40 {
            range(&mut filter, 0.03 * f64::from(step), 2.0);
        }
        let before = at(&filter, 1.2);
        let refused = range(&mut filter, 1.2, 2.21);
        assert_eq!(refused.outcome, FusionOutcome::Gated, "{variant:?}");
        assert!(refused.nis > 9.0 && refused.degrees_of_freedom == 1);
        assert_eq!(at(&filter, 1.2), before);
        let used = range(&mut filter, 1.2, 2.19);
        assert!(used.nis > 9.0, "three sigmas alone would refuse it: {}", used.nis);
        assert_eq!(used.outcome, FusionOutcome::Accepted, "{variant:?}");
    }
}

/// The outcomes of readings that follow a long stand at 2 m, ten a second.
fn after_a_stand(variant: RangeFilterVariant, ranges_m: &[f64]) -> (Vec<FusionOutcome>, ScalarEstimate) {
    let mut filter = RangeFilter::new(&configured(0.002), variant);
    for step in 0..40 {
        range(&mut filter, 0.1 * f64::from(step), 2.0);
    }
    let mut at_s = 3.9;
    let outcomes = ranges_m.iter().map(|range_m| {
        at_s += 0.1;
        range(&mut filter, at_s, *range_m).outcome
    });
    let outcomes = outcomes.collect();
    (outcomes, at(&filter, at_s))
}

#[test]
fn a_gate_that_refuses_another_wall_lets_it_in_with_the_third_reading_that_agrees() {
    use FusionOutcome::{Accepted, Gated};
    for variant in [RangeFilterVariant::Paper, RangeFilterVariant::Corrected] {
        // Turned away, and driving at another wall with 1 m/s.
        let (outcomes, last) = after_a_stand(variant, &[4.5, 4.4, 4.3]);
        assert_eq!(outcomes, [Gated, Gated, Accepted], "{variant:?}");
        assert!((last.value - 4.3).abs() < 1e-9 && (last.rate_per_s + 1.0).abs() < 1e-9, "{last:?}");
        // Somebody walks by.
        let (outcomes, last) = after_a_stand(variant, &[0.8, 0.8, 2.0]);
        assert_eq!(outcomes, [Gated, Gated, Accepted], "{variant:?}");
        assert!((last.value - 2.0).abs() < 0.01, "{last:?}");
        // Readings that do not agree: the eighth is as good as any.
        let (outcomes, last) = after_a_stand(variant, &[4.5, 0.5, 4.5, 0.5, 4.5, 0.5, 4.5, 0.5]);
        assert_eq!(outcomes[..7], [Gated; 7], "{variant:?}");
        assert_eq!(outcomes[7], Accepted);
        assert!((last.value - 0.5).abs() < 1e-9, "{last:?}");
    }
}

#[test]
fn the_gate_is_at_three_standard_deviations() {
    for variant in [RangeFilterVariant::Paper, RangeFilterVariant::Corrected] {
        for (sigmas, verdict) in [(2.95, FusionOutcome::Accepted), (3.05, FusionOutcome::Gated)] {
            let mut config = configured(0.05);
            config.params.wall_gate_m = 0.0;
            let mut filter = RangeFilter::new(&config, variant);
            range(&mut filter, 0.0, 2.0);
            command(&mut filter, 0.1, 0.0);
            let predicted = at(&filter, 0.1);
            let s_m = predicted.sigma.hypot(0.02);
            let record = range(&mut filter, 0.1, predicted.value + sigmas * s_m);
            assert_eq!(record.outcome, verdict, "{variant:?} at {sigmas}");
        }
    }
}

#[test]
fn the_papers_matching_takes_a_reading_of_the_future_for_one_of_the_step() {
    let run = |variant| {
        let mut filter = RangeFilter::new(&configured(0.05), variant);
        range(&mut filter, 0.0, 3.0);
        for step in 1..200 {
            let at_s = 0.01 * f64::from(step);
            command(&mut filter, at_s, 1.1);
            if step % 10 == 0 {
                range(&mut filter, at_s, 3.0 - 1.1 * at_s);
            }
        }
        // 45 ms after the last step, and seen 45 ms further on.
        range(&mut filter, 2.035, 3.0 - 1.1 * 2.035);
        at(&filter, 1.99).value - (3.0 - 1.1 * 1.99)
    };
    let paper_m = run(RangeFilterVariant::Paper);
    let corrected_m = run(RangeFilterVariant::Corrected);
    assert!((-0.055..-0.04).contains(&paper_m), "{paper_m}");
    assert!(corrected_m.abs() < 0.01, "{corrected_m}");
}

#[test]
fn the_corrected_row_does_not_depend_on_how_often_it_predicts() {
    // Distance, and S of the last reading.
    let run = |variant, parts: u32| {
        let mut filter = RangeFilter::new(&configured(0.05), variant);
        range(&mut filter, 0.0, 2.0);
        let mut s_m2 = 0.0;
        for tenth in 0..10 {
            let start_s = 0.1 * f64::from(tenth);
            for part in 0..parts {
                let share = f64::from(part) / f64::from(parts);
                command(&mut filter, start_s + 0.1 * share, 0.8);
            }
            let record = range(&mut filter, start_s + 0.1, 1.95 - 0.05 * f64::from(tenth));
            s_m2 = record.innovation_covariance[0][0];
        }
        (at(&filter, 1.05).value, s_m2)
    };
    let (rare, often) = (run(RangeFilterVariant::Corrected, 1), run(RangeFilterVariant::Corrected, 20));
    assert!((rare.0 - often.0).abs() < 1e-6, "{rare:?} {often:?}");
    assert!((rare.1 / often.1 - 1.0).abs() < 1e-6, "{rare:?} {often:?}");
    let (rare, often) = (run(RangeFilterVariant::Paper, 1), run(RangeFilterVariant::Paper, 20));
    assert!(often.1 > 4.0 * rare.1, "noise per step: {rare:?} {often:?}");
}

#[test]
fn a_late_reading_is_used_at_its_own_time_by_the_corrected_row() {
    let mut filter = RangeFilter::new(&configured(0.01), RangeFilterVariant::Corrected);
    let truth_m = |at_s: f64| 3.0 - 1.1 * at_s;
    for step in 0..200 {
        let at_s = 0.01 * f64::from(step);
        command(&mut filter, at_s, 1.1);
        if step % 10 == 4 {
            range(&mut filter, at_s - 0.04, truth_m(at_s - 0.04));
        }
    }
    let error_m = at(&filter, 1.99).value - truth_m(1.99);
    assert!(error_m.abs() < 0.005, "{error_m}");
    let late = range(&mut filter, 1.93, truth_m(1.93));
    assert_eq!(late.outcome, FusionOutcome::TooOld, "60 ms is beyond the matching");
    let again = range(&mut filter, 1.90, truth_m(1.90));
    assert_eq!(again.outcome, FusionOutcome::Malformed, "it was used before");
}

#[test]
fn a_drive_train_that_is_faster_than_the_loop_leaves_numbers() {
    let mut config = configured(0.05);
    config.params.wall_mass_s2_per_m = 1e-4;
    let mut filter = RangeFilter::new(&config, RangeFilterVariant::Paper);
    range(&mut filter, 0.0, 2.0);
    for step in 1..1_000 {
        command(&mut filter, STEP_S * f64::from(step), 0.1);
    }
    let found = at(&filter, 7.6);
    assert!((found.rate_per_s + 0.1).abs() < 1e-3, "{found:?}");
    assert!(found.sigma.is_finite());
}
