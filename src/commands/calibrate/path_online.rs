//! `calibrate path --online`: what the filter `pose` has learned while the robot drove, as it would have live.

use anyhow::{Result, bail, ensure};
use posebridge_analysis::report::page::{Page, Part};
use posebridge_estimator::filter_named;
use posebridge_link::HostTimer;
use posebridge_telemetry::{Known, Observed};
use serde_json::json;

use super::path::PathArgs;
use super::profile::{Calibrated, folded};
use super::source::{self, Drive, Watch};
use crate::commands::lab::outcome::Outcome;
use crate::commands::{Failure, Stage};
use crate::config::CALIBRATION_KEYS;
use crate::learned::{Learned, learned_table};

/// The filter that learns.
const FILTER: &str = "pose";

/// Runs the filter over the run and reports.
///
/// # Errors
/// The recording makes no sense, holds more than one run or no fixes, or an output cannot be written.
pub(super) fn execute(args: &PathArgs, timer: &HostTimer) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let Some(recording) = &args.recording else {
        return Err(anyhow::anyhow!("--online needs a recording")).at_start();
    };
    let watch = Watch { against: Some(source::Against::Fixes), truth_sigma_m: 1.0 };
    let drives = source::load(recording, &args.data, watch)?;
    let drive = only(&drives.drives).at_start()?;
    let learned = learn(drive).while_running()?;
    if let Some(path) = &args.save {
        let (robot, calibration) = folded(&learned.robot, learned.calibration).while_running()?;
        let calibrated = Calibrated {
            robot,
            calibration,
            source: format!("{}, {}", drives.recording, drive.name),
            by: "calibrate path --online",
            remarks: vec![learned_table(std::slice::from_ref(&learned))],
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.deliver(&folder, &outcome(&drives.recording, &learned))
}

fn only(drives: &[Drive]) -> Result<&Drive> {
    match drives {
        [drive] => Ok(drive),
        _ => bail!("--online takes what one run has taught, but {} are selected: choose one with --run", drives.len()),
    }
}

fn learn(drive: &Drive) -> Result<Learned> {
    let fixes = |observed: &Observed| matches!(observed, Observed::Fix(_));
    ensure!(
        drive.observations.iter().any(|one| fixes(&one.observed)),
        "run `{}` has no fixes: on line the filter learns from them alone",
        drive.name
    );
    let Some(entry) = filter_named(FILTER) else { bail!("there is no filter `{FILTER}`") };
    let mut filter = (entry.build)(&drive.config);
    for observation in &drive.observations {
        filter.observe(observation);
    }
    let Some(calibration) = filter.calibration() else { bail!("the filter `{FILTER}` has learned nothing") };
    Ok(Learned { run: drive.name.clone(), robot: drive.robot.clone(), prior: drive.config.calibration, calibration })
}

fn outcome(recording: &str, learned: &Learned) -> Outcome {
    let text = format!("{recording}, on line\n\n{}", learned_table(std::slice::from_ref(learned)));
    let entries = CALIBRATION_KEYS.iter().map(|entry| {
        let Known { value, sigma } = (entry.read)(&learned.calibration);
        (entry.key.to_owned(), json!({ "value": value, "sigma": sigma }))
    });
    Outcome {
        name: "calibrate-path",
        page: Page {
            title: format!("What the filter has learned: {recording}"),
            parts: vec![
                Part::Text("The calibration states of the filter `pose` at the end of the run.".to_owned()),
                Part::Lines(text.clone()),
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
