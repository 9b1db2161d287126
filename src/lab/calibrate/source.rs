//! Drives for a calibration: runs of a descriptor, or a posebridge recording.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_lab::calibration::free_path::{PositionFix, seconds};
use posebridge_telemetry::{DriveGeometry, Observation, ObservationKind};

use crate::config::{Overlay, RobotFile};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::parallel::run_with_bar;
use crate::tools::dataset::{DataSet, report_bad_rows};
use crate::tools::own_recording::{self, ThermometerReadings};

/// What the robot is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum CalibrationReference {
    /// The fixes of the camera, also those that the descriptor withholds.
    Fixes,
    /// The recording's truth.
    Truth,
}

pub(crate) struct CalibrationDrive {
    pub(crate) name: String,
    pub(crate) robot: RobotFile,
    pub(crate) config: FilterConfig,
    pub(crate) observations: Vec<Observation>,
    /// Thermometers of a posebridge recording; those of a descriptor are among the observations.
    pub(crate) thermometers: Vec<ThermometerReadings>,
    pub(crate) references: Vec<PositionFix>,
    pub(crate) reference: CalibrationReference,
}

pub(crate) struct CalibrationDrives {
    pub(crate) recording: String,
    pub(crate) drives: Vec<CalibrationDrive>,
}

/// Source of the external positions, and their accuracy.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReferenceSettings {
    /// `None`: fixes if there are any.
    pub(crate) reference: Option<CalibrationReference>,
    pub(crate) truth_sigma_m: f64,
}

/// Relative tolerance of equal geometries: a brick describes itself in single precision.
const SAME_GEOMETRY_TOLERANCE: f64 = 1e-6;

/// Fails unless all drives, by name, have the same robot geometry.
pub(crate) fn check_same_robot<'a>(drives: impl IntoIterator<Item = (&'a str, &'a DriveGeometry)>) -> Result<()> {
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

pub(crate) fn load(
    recording: &Path,
    flags: &DataFlags,
    watch: ReferenceSettings,
) -> Result<CalibrationDrives, Failure> {
    if !own_recording::is_own(recording) {
        let flags = DataFlags { use_every: flags.use_every.or(Some(1)), ..flags.clone() };
        return load_descriptor(recording, &flags, watch);
    }
    load_recording(recording, flags, watch).before_start()
}

fn load_descriptor(path: &Path, flags: &DataFlags, watch: ReferenceSettings) -> Result<CalibrationDrives, Failure> {
    let data = DataSet::open(path, flags).before_start()?;
    let loaded = run_with_bar(&data.runs, "runs read", |run| data.load(run, flags)).before_start()?;
    let mut drives = Vec::new();
    for loaded in loaded {
        let loaded = loaded.before_start()?;
        report_bad_rows(&loaded);
        let observations: Vec<Observation> = loaded.run.observations.iter().map(|timed| timed.observation).collect();
        let fixes = fix_references(&observations, &loaded.filter_config);
        let withheld = loaded.run.withheld.iter().map(|withheld| PositionFix {
            at_s: seconds(withheld.time),
            position_m: [withheld.fix.position.x.0, withheld.fix.position.y.0],
            sigma_m: loaded.filter_config.noise.fix_position_m,
            tag_m: [withheld.fix.tag_in_body.x.0, withheld.fix.tag_in_body.y.0],
        });
        let fixes: Vec<PositionFix> = fixes.into_iter().chain(withheld).collect();
        let truth = loaded.run.truth.iter().map(|truth| PositionFix {
            at_s: seconds(truth.time),
            position_m: [truth.position.x.0, truth.position.y.0],
            sigma_m: watch.truth_sigma_m,
            tag_m: [0.0; 2],
        });
        let against = watch.reference.unwrap_or(if fixes.is_empty() {
            CalibrationReference::Truth
        } else {
            CalibrationReference::Fixes
        });
        drives.push(CalibrationDrive {
            name: loaded.run.name.clone(),
            robot: loaded.robot,
            config: loaded.filter_config,
            references: match against {
                CalibrationReference::Fixes => fixes,
                CalibrationReference::Truth => truth.collect(),
            },
            observations,
            thermometers: Vec::new(),
            reference: against,
        });
    }
    Ok(CalibrationDrives { recording: data.descriptor.name, drives })
}

fn load_recording(path: &Path, flags: &DataFlags, watch: ReferenceSettings) -> Result<CalibrationDrives> {
    ensure!(
        watch.reference != Some(CalibrationReference::Truth),
        "a recording of ours has no truth: leave --against away, and `{}` is compared with its fixes",
        path.display()
    );
    ensure!(
        flags.run.is_none() && flags.use_every.is_none(),
        "--run and --use-every choose from a descriptor's data, not from a recording of ours"
    );
    let overlay = Overlay { robot: None, settings: &flags.settings };
    let run = own_recording::read(path, overlay)?;
    Ok(CalibrationDrives {
        recording: run.name.clone(),
        drives: vec![CalibrationDrive {
            name: run.name,
            robot: run.robot,
            references: fix_references(&run.observations, &run.config),
            config: run.config,
            observations: run.observations,
            thermometers: run.thermometers,
            reference: CalibrationReference::Fixes,
        }],
    })
}

fn fix_references(observations: &[Observation], config: &FilterConfig) -> Vec<PositionFix> {
    let fixes = observations.iter().filter_map(|observation| {
        let ObservationKind::Fix(fix) = observation.measurement else {
            return None;
        };
        let claimed = fix.covariance.map(|claimed| f64::midpoint(claimed.xx_m2, claimed.yy_m2).sqrt());
        Some(PositionFix {
            at_s: seconds(observation.stamp),
            position_m: [fix.position.x.0, fix.position.y.0],
            sigma_m: claimed.unwrap_or(config.noise.fix_position_m),
            tag_m: [fix.tag_in_body.x.0, fix.tag_in_body.y.0],
        })
    });
    fixes.collect()
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
