//! Recordings of ours as runs to tune on.

use std::path::Path;

use anyhow::{Result, ensure};
use posebridge_recording::dataset::{DatasetRun, WithheldFix};
use posebridge_telemetry::{Observation, ObservationKind};

use super::args::TuneArgs;
use super::run::{RunReference, RunSet, TuneRun};
use crate::config::{Overlay, RobotFile};
use crate::tools::own_recording;

/// How a recording is called among the runs: its path as it was given.
pub(super) fn name_of(path: &Path) -> String {
    path.display().to_string()
}

/// The recording as one run. With --use-every the fixes in between are what it is scored on.
///
/// # Errors
/// It cannot be read, it holds no observation, or --fixes-from-truth asks for a truth, which a live robot does not have.
pub(super) fn load(args: &TuneArgs, path: &Path, set: RunSet) -> Result<(TuneRun, RobotFile)> {
    let name = name_of(path);
    ensure!(
        args.fixes_from_truth.is_none(),
        "`{name}` has no truth for --fixes-from-truth: recordings of ours are tuned by the fixes of their camera"
    );
    let overlay = Overlay { robot: None, settings: &args.settings };
    let own = own_recording::read(path, overlay)?;
    let (observations, withheld) = split(&own.observations, args.use_every.unwrap_or(1));
    let run = DatasetRun { name: name.clone(), withheld, ..DatasetRun::default() };
    let run = TuneRun { name, set, observations, config: own.config, reference: RunReference::Recorded(Box::new(run)) };
    Ok((run, own.robot))
}

/// What the filter is shown, and the fixes that are kept from it: of `every` fixes all but the first; all with zero.
fn split(observations: &[Observation], every: usize) -> (Vec<Observation>, Vec<WithheldFix>) {
    let mut shown = Vec::new();
    let mut withheld = Vec::new();
    let mut fixes = 0_usize;
    for observation in observations {
        let ObservationKind::Fix(fix) = observation.measurement else {
            shown.push(*observation);
            continue;
        };
        if every > 0 && fixes.is_multiple_of(every) {
            shown.push(*observation);
        } else {
            withheld.push(WithheldFix { time: observation.stamp, fix });
        }
        fixes += 1;
    }
    withheld.sort_by_key(|withheld| withheld.time);
    (shown, withheld)
}
