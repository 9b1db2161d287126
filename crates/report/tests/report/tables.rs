//! The tables, letter by letter.

use posebridge_report::colour::Colour;
use posebridge_report::tables::{EstimatorRow, RunRow, estimator_table, run_table, source_table};
use posebridge_report::{ErrorSummary, FilterVerdict, RunAnswer, tally_sources};
use posebridge_telemetry::{FusionOutcome, SensorId};

use crate::record;

fn odometry() -> ErrorSummary {
    ErrorSummary {
        samples: 1_200,
        position_rms_m: Some(0.292),
        position_max_m: Some(0.6123),
        position_end_m: Some(0.598),
        heading_rms_rad: Some(0.1),
        ..ErrorSummary::default()
    }
}

fn estimate() -> ErrorSummary {
    ErrorSummary {
        samples: 1_199,
        dropped: 1,
        position_rms_m: Some(0.01),
        position_max_m: Some(0.0345),
        position_end_m: Some(0.0061),
        heading_rms_rad: Some(0.008),
        anees: Some(1.15),
        ..ErrorSummary::default()
    }
}

#[test]
fn the_end_of_a_run() {
    let table = run_table(&[
        RunRow { name: "brick's own odometry", errors: &odometry() },
        RunRow { name: "estimate", errors: &estimate() },
    ]);
    insta::assert_snapshot!(table);
}

#[test]
fn a_run_without_truth() {
    let table = run_table(&[RunRow { name: "estimate", errors: &ErrorSummary::default() }]);
    insta::assert_snapshot!(table);
}

#[test]
fn estimators_against_each_other() {
    let boaster = ErrorSummary { anees: Some(4.1), ..estimate() };
    let broken = ErrorSummary { refused_covariances: 3, dropped: 0, position_max_m: Some(1e300), ..estimate() };
    let row = |name, errors| EstimatorRow { name, errors, runs: 20, sources: &[] };
    let table = estimator_table(&[
        row("pose", &estimate()),
        row("ekf5", &boaster),
        row("größe", &broken),
        row("wheel-kf", &odometry()),
    ]);
    insta::assert_snapshot!(table);
}

#[test]
fn the_answer_has_pose_verdict_and_what_was_learned_in_80_columns() {
    let (errors, odometry) = (estimate(), odometry());
    let answer = |errors, baseline| RunAnswer {
        errors,
        baseline,
        last: None,
        quantity: None,
        verdict: FilterVerdict::new(errors, 1, Vec::new()),
        learned: vec!["radius_scale", "radius_difference", "track_scale", "gyro_scale", "backlash_rad"],
    };
    let text = answer(&errors, Some(("the brick's own odometry", &odometry))).text(Colour::Plain);
    insta::assert_snapshot!(text);
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    let worse = answer(&odometry, Some(("wheels", &errors))).text(Colour::Ansi);
    assert!(worse.contains("29.2 times worse than wheels"), "{worse}");
    assert!(worse.contains("\x1b[33mtoo little data\x1b[0m"), "{worse}");
}

#[test]
fn sources() {
    let records = [
        record(SensorId::WHEELS, FusionOutcome::Accepted, 2.2),
        record(SensorId::CAMERA, FusionOutcome::Accepted, 40.0),
        record(SensorId::CAMERA, FusionOutcome::Gated, 400.0),
        record(SensorId::CAMERA, FusionOutcome::TooOld, 0.0),
        record(SensorId(42), FusionOutcome::Unused, 0.0),
    ];
    insta::assert_snapshot!(source_table(&tally_sources(&records)));
}
