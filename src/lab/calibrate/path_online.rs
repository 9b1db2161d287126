//! `calibrate path --online`: what the filter `pose` has learned while the robot drove, as it would have live.

use anyhow::{Result, bail, ensure};
use posebridge_estimator::find_filter;
use posebridge_link::HostTimer;
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_telemetry::{ObservationKind, UncertainValue};
use serde_json::json;

use super::path_args::PathArgs;
use super::profile::{CalibratedProfile, fold_into_geometry};
use super::source::{self, CalibrationDrive, ReferenceSettings};
use crate::config::CALIBRATION_KEYS;
use crate::exit::{ExitStage, Failure};
use crate::station::learned_calibration::{LearnedCalibration, learned_table};
use crate::tools::experiment_output::ExperimentOutcome;

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
    if let Some(path) = &args.save {
        let (robot, calibration) = fold_into_geometry(&learned.robot, learned.calibration).while_running()?;
        let calibrated = CalibratedProfile {
            robot,
            calibration,
            source: format!("{}, {}", drives.recording, drive.name),
            method: "calibrate path --online",
            remarks: vec![learned_table(std::slice::from_ref(&learned))],
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.write_outcome(&folder, &outcome(&drives.recording, &learned))
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

fn outcome(recording: &str, learned: &LearnedCalibration) -> ExperimentOutcome {
    let text = format!("{recording}, on line\n\n{}", learned_table(std::slice::from_ref(learned)));
    let entries = CALIBRATION_KEYS.iter().map(|entry| {
        let UncertainValue { value, sigma } = (entry.read)(&learned.calibration);
        (entry.key.to_owned(), json!({ "value": value, "sigma": sigma }))
    });
    ExperimentOutcome {
        name: "calibrate-path",
        page: ReportPage {
            title: format!("What the filter has learned: {recording}"),
            blocks: vec![
                ReportBlock::Text("The calibration states of the filter `pose` at the end of the run.".to_owned()),
                ReportBlock::PreformattedText(text.clone()),
            ],
        },
        json: json!({
            "recording": recording,
            "run": learned.run,
            "online": entries.collect::<serde_json::Map<String, serde_json::Value>>(),
        }),
        text,
    }
}
