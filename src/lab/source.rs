//! Runs of a descriptor, or a posebridge recording, which is one run.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_lab::calibration::free_path::{PositionFix, seconds};
use posebridge_recording::dataset::DatasetRun;
use posebridge_telemetry::{DriveGeometry, Fix, Observation, ObservationKind, Timestamp};

use crate::config::{Overlay, RobotFile};
use crate::flags::DataFlags;
use crate::lab::parallel::run_with_bar;
use crate::tools::dataset::{DataSet, RobotRun, report_bad_rows};
use crate::tools::own_recording::{self, ThermometerReadings};

/// What the robot is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum CalibrationReference {
    /// The fixes of the camera, also those that the descriptor withholds.
    Fixes,
    /// The recording's truth.
    Truth,
}

pub(super) struct SourceRun {
    pub(super) name: String,
    pub(super) robot: RobotFile,
    pub(super) config: FilterConfig,
    pub(super) observations: Vec<Observation>,
    /// Arrival of each observation in seconds, by the clock of the timestamps; `None` where it is unknown.
    pub(super) arrivals_s: Option<Vec<f64>>,
    /// Thermometers of a posebridge recording; those of a descriptor are among the observations.
    pub(super) thermometers: Vec<ThermometerReadings>,
    /// Truth and withheld fixes of a descriptor, without its observations.
    pub(super) dataset: DatasetRun,
}

/// The name of a recording or of a descriptor, and its runs.
pub(super) struct SourceRuns {
    pub(super) recording: String,
    pub(super) runs: Vec<SourceRun>,
}

/// Reads a recording, or the selected runs of a descriptor; without `--use-every` with all fixes.
pub(super) fn load(path: &Path, flags: &DataFlags) -> Result<SourceRuns> {
    if own_recording::is_own(path) {
        let run = SourceRun::of_recording(path, flags)?;
        return Ok(SourceRuns { recording: run.name.clone(), runs: vec![run] });
    }
    let flags = DataFlags { use_every: flags.use_every.or(Some(1)), ..flags.clone() };
    let data = DataSet::open(path, &flags)?;
    let loaded = run_with_bar(&data.runs, "runs read", |run| data.load(run, &flags))?;
    let runs = loaded.into_iter().map(|loaded| Ok(SourceRun::of_descriptor(loaded?))).collect::<Result<_>>()?;
    Ok(SourceRuns { recording: data.descriptor.name, runs })
}

/// Reads a recording, or one run of a descriptor: the named one, else the first that is selected.
pub(super) fn load_run(path: &Path, name: Option<&str>, flags: &DataFlags) -> Result<SourceRun> {
    if own_recording::is_own(path) {
        return SourceRun::of_recording(path, flags);
    }
    let data = DataSet::open(path, flags)?;
    let name = name.or(data.runs.first().map(String::as_str)).context("the descriptor has no run")?;
    Ok(SourceRun::of_descriptor(data.load(name, flags)?))
}

impl SourceRun {
    fn of_descriptor(loaded: RobotRun) -> Self {
        report_bad_rows(&loaded);
        let mut dataset = loaded.run;
        let timed = std::mem::take(&mut dataset.observations);
        Self {
            name: dataset.name.clone(),
            robot: loaded.robot,
            config: loaded.filter_config,
            observations: timed.iter().map(|timed| timed.observation).collect(),
            arrivals_s: Some(timed.iter().map(|timed| timed.arrival.as_secs_f64()).collect()),
            thermometers: Vec::new(),
            dataset,
        }
    }

    fn of_recording(path: &Path, flags: &DataFlags) -> Result<Self> {
        ensure!(
            flags.run.is_none() && flags.use_every.is_none(),
            "--run and --use-every choose from a descriptor's data; `{}` is a recording of ours",
            path.display()
        );
        let run = own_recording::read(path, Overlay { robot: None, settings: &flags.settings })?;
        let seconds = |arrivals: Vec<_>| arrivals.into_iter().map(Timestamp::as_secs_f64).collect();
        Ok(Self {
            name: run.name,
            robot: run.robot,
            config: run.config,
            observations: run.observations,
            arrivals_s: run.arrivals.map(seconds),
            thermometers: run.thermometers,
            dataset: DatasetRun::default(),
        })
    }

    /// External positions: of `reference`, else the fixes if there are any, withheld ones included, else the truth.
    pub(super) fn positions(
        &self,
        reference: Option<CalibrationReference>,
        truth_sigma_m: f64,
    ) -> (CalibrationReference, Vec<PositionFix>) {
        let fix_position = |at_s: f64, fix: &Fix, sigma_m: f64| PositionFix {
            at_s,
            position_m: [fix.position.x.0, fix.position.y.0],
            sigma_m,
            tag_m: [fix.tag_in_body.x.0, fix.tag_in_body.y.0],
        };
        let told_m = self.config.noise.fix_position_m;
        let used = self.observations.iter().filter_map(|observation| {
            let ObservationKind::Fix(fix) = observation.measurement else {
                return None;
            };
            let claimed = fix.covariance.map(|claimed| f64::midpoint(claimed.xx_m2, claimed.yy_m2).sqrt());
            Some(fix_position(seconds(observation.stamp), &fix, claimed.unwrap_or(told_m)))
        });
        let withheld =
            self.dataset.withheld.iter().map(|withheld| fix_position(seconds(withheld.time), &withheld.fix, told_m));
        let fixes: Vec<PositionFix> = used.chain(withheld).collect();
        let usual = if fixes.is_empty() { CalibrationReference::Truth } else { CalibrationReference::Fixes };
        match reference.unwrap_or(usual) {
            CalibrationReference::Fixes => (CalibrationReference::Fixes, fixes),
            CalibrationReference::Truth => {
                let truth = self.dataset.truth.iter().map(|truth| PositionFix {
                    at_s: seconds(truth.time),
                    position_m: [truth.position.x.0, truth.position.y.0],
                    sigma_m: truth_sigma_m,
                    tag_m: [0.0; 2],
                });
                (CalibrationReference::Truth, truth.collect())
            }
        }
    }
}

/// Relative tolerance of equal geometries: a brick describes itself in single precision.
const SAME_GEOMETRY_TOLERANCE: f64 = 1e-6;

/// Fails unless all drives, by name, have the same robot geometry.
pub(super) fn check_same_robot<'a>(drives: impl IntoIterator<Item = (&'a str, &'a DriveGeometry)>) -> Result<()> {
    let mut drives = drives.into_iter();
    let Some((first, geometry)) = drives.next() else {
        return Ok(());
    };
    let other = drives.find(|(_, other)| !is_same_geometry(geometry, other));
    if let Some((other, _)) = other {
        bail!(
            "`{first}` and `{other}` are described as different robots: choose the drives of one, of a descriptor's with --run"
        );
    }
    Ok(())
}

fn is_same_geometry(one: &DriveGeometry, other: &DriveGeometry) -> bool {
    let numbers = |of: &DriveGeometry| [of.left_wheel_radius.0, of.right_wheel_radius.0, of.track_width.0, of.tick.0];
    let mut pairs = numbers(one).into_iter().zip(numbers(other));
    pairs.all(|(one, other)| (one - other).abs() <= SAME_GEOMETRY_TOLERANCE * one.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Meters;

    #[test]
    fn a_robot_that_described_itself_in_single_precision_is_the_same_and_another_track_is_another_robot() {
        let configured = RobotFile::default().geometry().unwrap();
        let mut described = configured;
        described.left_wheel_radius = Meters(f64::from(configured.left_wheel_radius.0 as f32));
        described.track_width = Meters(f64::from(configured.track_width.0 as f32));
        assert!(check_same_robot([("a", &configured), ("b", &described)]).is_ok());
        let mut wider = configured;
        wider.track_width = Meters(1.001 * configured.track_width.0);
        let refused = check_same_robot([("a", &configured), ("b", &described), ("c", &wider)]);
        let refused = refused.unwrap_err().to_string();
        assert!(refused.starts_with("`a` and `c` are described"), "{refused}");
    }
}
