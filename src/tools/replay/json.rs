//! `replay --json`: one object, documented in docs/reports.md and stable.

use std::collections::BTreeMap;

use anyhow::Result;
use posebridge_report::SourceTally;
use posebridge_telemetry::TimeDelta;
use serde::Serialize;

use super::result::{FilterResult, ReplayResult};
use super::smooth::{SmoothedResult, SmoothedRun};
use crate::config::{CALIBRATION_KEYS, CalibrationEntry, CalibrationKey};
use crate::station::learned_calibration::LearnedCalibration;

#[derive(Serialize)]
struct Report<'a> {
    recording: &'a str,
    observations: u64,
    wall_seconds: f64,
    cpu_seconds: f64,
    recorded_seconds: f64,
    times_real_time: Option<f64>,
    changed: &'a [String],
    estimators: Vec<Estimator<'a>>,
    runs: &'a [String],
    bad_rows: u64,
    /// By run.
    smooth: Option<BTreeMap<&'a str, SmootherEntry<'a>>>,
}

#[derive(Serialize)]
struct SmootherEntry<'a> {
    position_rms_m: Option<f64>,
    position_max_m: Option<f64>,
    position_rms_uncorrected_m: Option<f64>,
    heading_rms_rad: Option<f64>,
    fixes_used: Option<usize>,
    fixes_left_out: Option<usize>,
    iterations: Option<u32>,
    seconds: f64,
    not_read: &'a BTreeMap<&'static str, u64>,
    reason: Option<String>,
}

#[derive(Serialize)]
struct Estimator<'a> {
    name: &'a str,
    /// Only where the recording has several robots.
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<&'a str>,
    position_rms_m: Option<f64>,
    position_max_m: Option<f64>,
    position_end_m: Option<f64>,
    position_rms_uncorrected_m: Option<f64>,
    heading_rms_rad: Option<f64>,
    anees: Option<f64>,
    sources: Vec<SourceEntry>,
    /// By run.
    calibration: Option<BTreeMap<&'a str, CalibrationEntries>>,
}

/// By key.
pub(super) type CalibrationEntries = BTreeMap<&'static str, CalibrationEntry>;

#[derive(Serialize)]
pub(super) struct SourceEntry {
    name: &'static str,
    used: u64,
    slip: u64,
    gated: u64,
    too_old: u64,
    malformed: u64,
    rebased: u64,
    reset_to: u64,
    unused: u64,
    mean_nis_per_dof: Option<f64>,
    degrees_of_freedom: u64,
    consistency: &'static str,
}

/// The object as one line of text.
///
/// # Errors
/// Never for finite figures; a figure that cannot be had is null.
pub(super) fn text(replayed: &ReplayResult, wall: TimeDelta, cpu: TimeDelta) -> Result<String> {
    let report = Report {
        recording: &replayed.recording,
        observations: replayed.observations,
        wall_seconds: wall.as_secs_f64(),
        cpu_seconds: cpu.as_secs_f64(),
        recorded_seconds: replayed.duration.as_secs_f64(),
        times_real_time: (wall > TimeDelta::ZERO).then(|| replayed.duration.as_secs_f64() / wall.as_secs_f64()),
        changed: &replayed.changed_settings,
        estimators: replayed.outcomes.iter().map(estimator).collect(),
        runs: &replayed.runs,
        bad_rows: replayed.bad_rows,
        smooth: smooth(&replayed.smoothed),
    };
    Ok(serde_json::to_string(&report)?)
}

fn estimator(outcome: &FilterResult) -> Estimator<'_> {
    let errors = &outcome.errors;
    Estimator {
        name: &outcome.name,
        robot: outcome.robot.as_deref(),
        position_rms_m: errors.position_rms_m,
        position_max_m: errors.position_max_m,
        position_end_m: errors.position_end_m,
        position_rms_uncorrected_m: outcome.position_rms_uncorrected_m,
        heading_rms_rad: errors.heading_rms_rad,
        anees: errors.anees,
        sources: outcome.sources.iter().map(source).collect(),
        calibration: calibration(&outcome.learned),
    }
}

/// What was found of each run; `None` if it was not asked for.
fn smooth(runs: &[SmoothedRun]) -> Option<BTreeMap<&str, SmootherEntry<'_>>> {
    let by_run = runs.iter().map(|run| (run.run.as_str(), smooth_of(run)));
    (!runs.is_empty()).then(|| by_run.collect())
}

fn smooth_of(run: &SmoothedRun) -> SmootherEntry<'_> {
    let found = run.result.as_ref().ok();
    let of_found = |count: fn(&SmoothedResult) -> usize| found.map(count);
    SmootherEntry {
        position_rms_m: run.errors.position_rms_m,
        position_max_m: run.errors.position_max_m,
        position_rms_uncorrected_m: run.uncorrected.position_rms_m,
        heading_rms_rad: run.errors.heading_rms_rad,
        fixes_used: of_found(|found| found.fixes_used),
        fixes_left_out: of_found(|found| found.fixes_skipped),
        iterations: found.map(|found| found.iterations),
        seconds: run.elapsed.as_secs_f64(),
        not_read: &run.ignored,
        reason: run.result.as_ref().err().map(ToString::to_string),
    }
}

/// What was learned in each run; `None` for an estimator that learns nothing.
fn calibration(runs: &[LearnedCalibration]) -> Option<BTreeMap<&str, CalibrationEntries>> {
    let entries = |learned: &LearnedCalibration| {
        let entry = |key: &CalibrationKey| (key.key, (key.read)(&learned.calibration).into());
        CALIBRATION_KEYS.iter().map(entry).collect()
    };
    let by_run = runs.iter().map(|run| (run.run.as_str(), entries(run)));
    (!runs.is_empty()).then(|| by_run.collect())
}

pub(super) fn source(tally: &SourceTally) -> SourceEntry {
    SourceEntry {
        name: tally.sensor.name(),
        used: tally.used + tally.reset_to,
        slip: tally.slip,
        gated: tally.gated,
        too_old: tally.too_old,
        malformed: tally.malformed,
        rebased: tally.rebased,
        reset_to: tally.reset_to,
        unused: tally.unused,
        mean_nis_per_dof: tally.mean_nis_per_dof(),
        degrees_of_freedom: tally.degrees_of_freedom(),
        consistency: tally.consistency().as_text(),
    }
}

#[cfg(test)]
mod tests {
    use posebridge_report::ErrorSummary;
    use posebridge_telemetry::{Calibration, SensorId, UncertainValue};

    use super::*;
    use crate::config::RobotFile;

    #[test]
    fn what_was_learned_stands_under_its_run_and_its_key() {
        let calibration =
            Calibration { track_scale: UncertainValue { value: 0.116, sigma: 0.004 }, ..Calibration::default() };
        let outcome = FilterResult {
            name: "pose".to_owned(),
            robot: None,
            errors: ErrorSummary::default(),
            position_rms_uncorrected_m: Some(0.0194),
            learned: vec![LearnedCalibration {
                run: "robot4".to_owned(),
                robot: RobotFile::default(),
                prior: Calibration::default(),
                calibration,
            }],
            sources: vec![SourceTally::new(SensorId::CAMERA)],
        };
        let json = serde_json::to_value(estimator(&outcome)).unwrap();
        let learned = &json["calibration"]["robot4"];
        assert_eq!(learned["track_scale"]["value"], 0.116);
        assert_eq!(learned["track_scale"]["sigma"], 0.004);
        assert_eq!(learned.as_object().unwrap().len(), CALIBRATION_KEYS.len());
        assert_eq!(json["position_rms_uncorrected_m"], 0.0194);
        assert_eq!(json["sources"][0]["consistency"], "undetermined");
        assert_eq!(json["sources"][0]["degrees_of_freedom"], 0);
    }
}
