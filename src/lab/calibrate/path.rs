//! `posebridge calibrate path`: a robot from any recorded drive that was watched.

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_lab::calibration::free_path::{
    AS_GIVEN, CalibrationUnknown, FreePath, PathCalibration, UNKNOWNS, UnknownEstimate, calibrate_path, dead_reckon,
    start_heading,
};
use posebridge_link::HostTimer;
use posebridge_telemetry::{Calibration, UncertainValue};

use super::path_args::{GeometryParameter, PathArgs};
use super::path_online;
use super::path_report::{PathCalibrationResult, RunComparison};
use super::profile::{CalibratedProfile, fold_into_geometry};
use super::segments;
use super::source::{self, CalibrationDrive, CalibrationDrives, CalibrationReference, ReferenceSettings};
use crate::config::{FilterSection, RobotFile, RobotProfile, filter_config};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::tools::own_recording;

/// The default error of an instrument's truth: its own millimetre, and a body that sways.
const TRUTH_SIGMA_M: f64 = 0.005;
/// The same for a person with a tape.
const TAPE_SIGMA_M: f64 = 0.01;

/// The instructions for a person with a live robot.
const TASK: &str = "drive about in the camera's sight, for a minute or two, with turns in both directions";

/// Calibrates.
///
/// # Errors
/// A recording or a flag makes no sense, what was driven does not suffice, or an output cannot be written.
pub(super) fn execute(args: &PathArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let mut args = args.clone();
    if args.live.is_requested() {
        let recording = args.live.or_named(None, &args.output, &args.data, TASK)?;
        args.recording = Some(recording);
    }
    let args = &args;
    if args.online {
        return path_online::execute(args, &timer);
    }
    let folder = args.output.folder()?;
    let material = PathDataset::load(args)?;
    let found = calibrate_path(&material.config, &material.paths).while_running()?;
    let calibration = build_result(&material, found)?;
    let report = calibration.report();
    if let Some(path) = &args.save {
        let calibrated = CalibratedProfile {
            robot: calibration.calibrated,
            calibration: calibration.residual,
            source: calibration.recording,
            method: "calibrate path",
            remarks: vec![report.text()],
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
}

/// The drives, and the robot that they share.
pub(super) struct PathDataset {
    recording: String,
    reference: &'static str,
    robot: RobotFile,
    config: FilterConfig,
    paths: Vec<FreePath>,
    /// What the result is tried on; none of it is among the `paths`.
    validation_paths: Vec<FreePath>,
}

impl PathDataset {
    fn load(args: &PathArgs) -> Result<Self, Failure> {
        if let Some(file) = &args.segments {
            return load_segments(args, file).before_start();
        }
        let drives = load_drives(args, &args.data)?;
        let others = load_validation_drives(args)?;
        Self::from_drives(args, drives, &others).before_start()
    }

    fn from_drives(args: &PathArgs, mut drives: CalibrationDrives, others: &[CalibrationDrive]) -> Result<Self> {
        ensure!(!drives.drives.is_empty(), "`{}` holds no run", drives.recording);
        let is_other = |drive: &CalibrationDrive| others.iter().any(|other| other.name == drive.name);
        drives.drives.retain(|drive| !is_other(drive));
        let Some(first) = drives.drives.first() else {
            bail!(
                "no run of `{}` is left to calibrate by: --try-on takes them all; choose others with --run",
                drives.recording
            )
        };
        let robots = drives.drives.iter().chain(others);
        source::check_same_robot(robots.map(|drive| (drive.name.as_str(), &drive.config.geometry)))?;
        let is_by_truth = |drive: &CalibrationDrive| drive.reference == CalibrationReference::Truth;
        ensure!(
            args.truth_sigma_m.is_none() || drives.drives.iter().any(is_by_truth),
            "--truth-sigma-m is the sigma of a truth, but `{}` is compared with fixes, whose sigma is noise.fix_position_m",
            drives.recording
        );
        let robot = with_flags(args, &first.robot)?;
        let mut config = first.config.clone();
        config.calibration = robot.calibration()?;
        let against = match first.reference {
            CalibrationReference::Fixes => "fixes",
            CalibrationReference::Truth => "truth",
        };
        Ok(Self {
            reference: against,
            paths: free_paths(args, &drives.drives)?,
            validation_paths: free_paths(args, others)?,
            recording: drives.recording,
            robot,
            config,
        })
    }
}

fn reference_settings(args: &PathArgs) -> Result<ReferenceSettings> {
    let truth_sigma_m = args.truth_sigma_m.unwrap_or(TRUTH_SIGMA_M);
    ensure!(
        truth_sigma_m > 0.0 && truth_sigma_m.is_finite(),
        "--truth-sigma-m is {truth_sigma_m}, must be more than zero"
    );
    Ok(ReferenceSettings { reference: args.against, truth_sigma_m })
}

fn load_drives(args: &PathArgs, data: &DataFlags) -> Result<CalibrationDrives, Failure> {
    let Some(recording) = &args.recording else {
        return Err(anyhow!("name a recording, or give --segments")).before_start();
    };
    source::load(recording, data, reference_settings(args).before_start()?)
}

/// The runs that `--try-on` names, each once.
fn load_validation_drives(args: &PathArgs) -> Result<Vec<CalibrationDrive>, Failure> {
    let mut others: Vec<CalibrationDrive> = Vec::new();
    if let (Some(path), false) = (&args.recording, args.try_on.is_empty())
        && own_recording::is_own(path)
    {
        return Err(anyhow!("--try-on chooses from a descriptor's runs; `{}` is one drive", path.display()))
            .before_start();
    }
    for prefix in &args.try_on {
        let flags = DataFlags { run: Some(prefix.clone()), ..args.data.clone() };
        for drive in load_drives(args, &flags)?.drives {
            if others.iter().all(|known| known.name != drive.name) {
                others.push(drive);
            }
        }
    }
    Ok(others)
}

fn free_paths(args: &PathArgs, drives: &[CalibrationDrive]) -> Result<Vec<FreePath>> {
    let is_ours = args.recording.as_deref().is_some_and(own_recording::is_own);
    let paths = drives.iter().map(|drive| {
        ensure!(
            !drive.references.is_empty(),
            "run `{}` has no {}: nothing says where the robot was",
            drive.name,
            match drive.reference {
                CalibrationReference::Fixes if is_ours =>
                    "fixes (record it again where its camera sees it; docs/lab/calibration.md)",
                CalibrationReference::Fixes => "fixes (try --against truth)",
                CalibrationReference::Truth => "truth (try --against fixes)",
            }
        );
        let mut config = drive.config.clone();
        if args.unknown_start {
            config.start = None;
        }
        let sights = drive.references.iter().copied();
        Ok(FreePath::new(&drive.name, &config, &drive.observations, sights))
    });
    paths.collect()
}

fn load_segments(args: &PathArgs, file: &std::path::Path) -> Result<PathDataset> {
    let robot = match &args.robot {
        Some(profile) => RobotProfile::read(profile)?.robot,
        None => RobotFile::default(),
    };
    let mut robot = with_flags(args, &robot)?;
    // Little is known about a robot that is measured with a tape.
    let wide = &mut robot.calibration;
    for (entry, sigma) in
        [(&mut wide.radius_scale, 0.2), (&mut wide.radius_difference, 0.05), (&mut wide.track_scale, 0.5)]
    {
        if entry.sigma > 0.0 {
            entry.sigma = sigma;
        }
    }
    let sigma_m = args.truth_sigma_m.unwrap_or(TAPE_SIGMA_M);
    ensure!(sigma_m > 0.0 && sigma_m.is_finite(), "--truth-sigma-m is {sigma_m}, must be more than zero");
    Ok(PathDataset {
        recording: file.display().to_string(),
        reference: "tape",
        config: filter_config(&robot, &FilterSection::default(), posebridge_telemetry::ArenaMap::default())?,
        paths: segments::read(file, sigma_m)?,
        validation_paths: Vec::new(),
        robot,
    })
}

/// The robot with what `--hold` and `--free` say of its priors.
fn with_flags(args: &PathArgs, robot: &RobotFile) -> Result<RobotFile> {
    let mut robot = robot.clone();
    let held = args.held.iter().map(|number| (*number, 0.0));
    for (number, sigma) in held.chain(args.freed.iter().copied()) {
        let known = &mut robot.calibration;
        let entry = match number {
            GeometryParameter::WheelRadius => &mut known.radius_scale,
            GeometryParameter::Track => &mut known.track_scale,
            GeometryParameter::WheelDifference => &mut known.radius_difference,
            GeometryParameter::Delay => &mut known.fix_delay_s,
            GeometryParameter::TagForward => &mut known.tag_forward_m,
            GeometryParameter::TagLeft => &mut known.tag_left_m,
        };
        entry.sigma = sigma;
    }
    robot.calibration().context("--hold and --free")?;
    Ok(robot)
}

fn build_result(material: &PathDataset, found: PathCalibration) -> Result<PathCalibrationResult, Failure> {
    let config = &material.config;
    let hypothesis = found.hypothesis();
    let mut base = material.robot.clone();
    base.left_wheel_radius_m *= hypothesis.travel_factor;
    base.right_wheel_radius_m *= hypothesis.travel_factor;
    base.track_width_m *= hypothesis.track_factor;
    let (calibrated, left) = fold_into_geometry(&base, to_calibration(config, &found)).while_running()?;
    let try_on = |path: &FreePath, heading_rad: Option<f64>| {
        let before = start_heading(config, &found.before, path);
        let undone = path.with_hypothesis(&hypothesis);
        let after = heading_rad.unwrap_or(start_heading(config, &found.after, &undone));
        // Where the heading is found it is no merit of the robot's new numbers.
        let before = if hypothesis == AS_GIVEN { heading_rad.unwrap_or(before) } else { before };
        RunComparison {
            before: dead_reckon(config, &found.before, path, before),
            after: dead_reckon(config, &found.after, &undone, after),
            path: path.clone(),
        }
    };
    let runs = material.paths.iter().zip(&found.headings_rad);
    let runs = runs.map(|(path, heading)| try_on(path, Some(*heading))).collect();
    let others = material.validation_paths.iter();
    let tried = others.map(|path| try_on(path, None)).collect();
    Ok(PathCalibrationResult {
        recording: material.recording.clone(),
        reference: material.reference,
        robot: material.robot.clone(),
        calibrated,
        residual: left,
        runs,
        validation_runs: tried,
        fit: found,
    })
}

/// What was found as the vocabulary has it; what was not looked for is as it was.
fn to_calibration(config: &FilterConfig, found: &PathCalibration) -> Calibration {
    let mut calibration = config.calibration;
    for unknown in UNKNOWNS {
        let UnknownEstimate { after, .. } = found.entry(unknown);
        let place: &mut UncertainValue = match unknown {
            CalibrationUnknown::RadiusScale => &mut calibration.radius_scale,
            CalibrationUnknown::TrackScale => &mut calibration.track_scale,
            CalibrationUnknown::RadiusDifference => &mut calibration.radius_difference,
            CalibrationUnknown::FixDelay => &mut calibration.fix_delay_s,
            CalibrationUnknown::TagForward => &mut calibration.tag_forward_m,
            CalibrationUnknown::TagLeft => &mut calibration.tag_left_m,
        };
        *place = after;
    }
    calibration
}
