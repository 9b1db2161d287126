//! `calibrate path --online`: what the filter `pose` has learned while the robot drove, as it would have live.

use anyhow::{Result, bail, ensure};
use posebridge_estimator::find_filter;
use posebridge_link::HostTimer;
use posebridge_report::report::{Format, Report, Table, Unit};
use posebridge_telemetry::{ObservationKind, UncertainValue};
use serde_json::{Value, json};

use super::path_args::PathArgs;
use super::profile::{CalibratedProfile, fold_into_geometry};
use super::source::{self, CalibrationDrive, ReferenceSettings};
use crate::config::CALIBRATION_KEYS;
use crate::exit::{ExitStage, Failure};
use crate::station::learned_calibration::LearnedCalibration;

/// The filter that learns.
const FILTER: &str = "pose";

/// Runs the filter over the run and reports.
///
/// # Errors
/// The recording makes no sense, holds more than one run or no fixes, or an output cannot be written.
pub(super) fn execute(args: &PathArgs, timer: &HostTimer) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let Some(recording) = &args.recording else {
        return Err(anyhow::anyhow!("--online needs a recording")).before_start();
    };
    let watch = ReferenceSettings { reference: Some(source::CalibrationReference::Fixes), truth_sigma_m: 1.0 };
    let drives = source::load(recording, &args.data, watch)?;
    let drive = single_drive(&drives.drives).before_start()?;
    let learned = learn(drive).while_running()?;
    let report = report(&drives.recording, &learned);
    if let Some(path) = &args.save {
        let (robot, calibration) = fold_into_geometry(&learned.robot, learned.calibration).while_running()?;
        let calibrated = CalibratedProfile {
            robot,
            calibration,
            source: format!("{}, {}", drives.recording, drive.name),
            method: "calibrate path --online",
            remarks: vec![report.text()],
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
}

fn single_drive(drives: &[CalibrationDrive]) -> Result<&CalibrationDrive> {
    match drives {
        [drive] => Ok(drive),
        _ => bail!("--online takes what one run has taught, but {} are selected: choose one with --run", drives.len()),
    }
}

fn learn(drive: &CalibrationDrive) -> Result<LearnedCalibration> {
    let fixes = |observed: &ObservationKind| matches!(observed, ObservationKind::Fix(_));
    ensure!(
        drive.observations.iter().any(|one| fixes(&one.measurement)),
        "run `{}` has no fixes: on line the filter learns from them alone",
        drive.name
    );
    let Some(entry) = find_filter(FILTER) else { bail!("there is no filter `{FILTER}`") };
    let mut filter = (entry.build)(&drive.config);
    for observation in &drive.observations {
        filter.observe(observation);
    }
    let Some(calibration) = filter.calibration() else { bail!("the filter `{FILTER}` has learned nothing") };
    Ok(LearnedCalibration {
        run: drive.name.clone(),
        robot: drive.robot.clone(),
        prior: drive.config.calibration,
        calibration,
    })
}

fn report(recording: &str, learned: &LearnedCalibration) -> Report {
    let mut report = Report::new("calibrate-path", format!("What the filter has learned: {recording}"));
    report.paragraph(format!("The calibration states of the filter `{FILTER}` at the end of run {}.", learned.run));
    let entries: Vec<(&str, UncertainValue, UncertainValue)> = CALIBRATION_KEYS
        .iter()
        .map(|entry| (entry.key, (entry.read)(&learned.calibration), (entry.read)(&learned.prior)))
        .collect();
    // What had no uncertainty before was not learned.
    let shown: Vec<_> = entries.iter().filter(|(.., before)| before.sigma > 0.0).collect();
    let five = Format::new(Unit::None, 5).signed();
    let table = Table::of(&shown)
        .text("", "number", |(key, ..)| (*key).to_owned())
        .uncertain("", "learned", five, |(_, after, _)| Some(after.value), |(_, after, _)| Some(after.sigma))
        .uncertain("", "before", five, |(.., before)| Some(before.value), |(.., before)| Some(before.sigma));
    report.table("", &table);
    let online = entries
        .iter()
        .map(|(key, after, _)| ((*key).to_owned(), json!({ "value": after.value, "sigma": after.sigma })));
    report.data("recording", json!(recording));
    report.data("run", json!(learned.run));
    report.data("online", Value::Object(online.collect()));
    report
}
