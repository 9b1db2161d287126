//! `posebridge calibrate path`: calibrates a robot from any recorded drive with external positions.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::smoother::smooth;
use posebridge_lab::calibration::free_path::{
    AS_GIVEN, FreePath, PathCalibration, PathStart, PositionFix, TravelStep, UNKNOWNS, calibrate_path, dead_reckon,
    start_heading,
};
use posebridge_link::HostTimer;
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_telemetry::{Calibration, ObservationKind, UncertainValue};
use serde_json::{Value, json};

use super::path_report::{PathCalibrationResult, RunComparison};
use super::profile::{fold_into_geometry, save_profile};
use crate::config::{FilterSection, RobotFile, RobotProfile, filter_config, learnable_keys};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::experiments::live::LiveArgs;
use crate::lab::source::{self, CalibrationReference, SourceRun, SourceRuns};
use crate::station::learned_calibration::LearnedCalibration;
use crate::tools::csv_table::{CsvRow, CsvTable};
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;

/// Default sigma of ground truth: the instrument's millimetre, and a body that sways.
const TRUTH_SIGMA_M: f64 = 0.005;
const TAPE_SIGMA_M: f64 = 0.01;

const TASK: &str = "drive about in the camera's sight, for a minute or two, with turns in both directions";

pub(super) fn execute(args: &PathArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let mut args = args.clone();
    if args.live.is_requested() {
        let recording = args.live.or_named(None, &args.output, &args.data, TASK)?;
        args.recording = Some(recording);
    }
    let args = &args;
    if args.online {
        return execute_online(args, &timer);
    }
    let folder = args.output.folder()?;
    let material = PathDataset::load(args)?;
    let found = calibrate_path(&material.config, &material.paths).while_running()?;
    let calibration = build_result(material, found)?;
    let report = calibration.report();
    if let Some(path) = &args.save {
        let robot = (calibration.calibrated, calibration.residual);
        save_profile(path, &timer, &report, "calibrate path", calibration.recording, robot).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
}

struct PathDataset {
    recording: String,
    reference: &'static str,
    robot: RobotFile,
    config: FilterConfig,
    paths: Vec<FreePath>,
    /// Drives for validation, not among `paths`.
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

    fn from_drives(args: &PathArgs, mut drives: SourceRuns, others: &[SourceRun]) -> Result<Self> {
        ensure!(!drives.runs.is_empty(), "`{}` holds no run", drives.recording);
        let is_other = |drive: &SourceRun| others.iter().any(|other| other.name == drive.name);
        drives.runs.retain(|drive| !is_other(drive));
        let Some(first) = drives.runs.first() else {
            bail!(
                "no run of `{}` is left to calibrate by: --try-on takes them all; choose others with --run",
                drives.recording
            )
        };
        let robots = drives.runs.iter().chain(others);
        source::check_same_robot(robots.map(|drive| (drive.name.as_str(), &drive.config.geometry)))?;
        let compared = reference_positions(args, &drives.runs)?;
        let reference = compared[0].reference;
        ensure!(
            args.truth_sigma_m.is_none() || compared.iter().any(|run| run.reference == CalibrationReference::Truth),
            "--truth-sigma-m is the sigma of a truth, but `{}` is compared with fixes, whose sigma is noise.fix_position_m",
            drives.recording
        );
        let robot = with_flags(args, &first.robot)?;
        let mut config = first.config.clone();
        config.calibration = robot.calibration()?;
        Ok(Self {
            reference: match reference {
                CalibrationReference::Fixes => "fixes",
                CalibrationReference::Truth => "truth",
            },
            paths: free_paths(args, &drives.runs, compared)?,
            validation_paths: free_paths(args, others, reference_positions(args, others)?)?,
            recording: drives.recording,
            robot,
            config,
        })
    }
}

fn truth_sigma_m(args: &PathArgs, usual_m: f64) -> Result<f64> {
    let sigma_m = args.truth_sigma_m.unwrap_or(usual_m);
    ensure!(sigma_m > 0.0 && sigma_m.is_finite(), "--truth-sigma-m is {sigma_m}, must be more than zero");
    Ok(sigma_m)
}

fn load_drives(args: &PathArgs, data: &DataFlags) -> Result<SourceRuns, Failure> {
    let Some(recording) = &args.recording else {
        return Err(anyhow!("name a recording, or give --segments")).before_start();
    };
    if own_recording::is_own(recording) && args.against == Some(CalibrationReference::Truth) {
        let name = recording.display();
        return Err(anyhow!(
            "a recording of ours has no truth: leave --against away, and `{name}` is compared with its fixes"
        ))
        .before_start();
    }
    source::load(recording, data).before_start()
}

/// What one run is compared with.
struct ReferencePositions {
    reference: CalibrationReference,
    positions: Vec<PositionFix>,
}

/// Of each run, in their order.
fn reference_positions(args: &PathArgs, drives: &[SourceRun]) -> Result<Vec<ReferencePositions>> {
    let is_ours = args.recording.as_deref().is_some_and(own_recording::is_own);
    let wanted = args.against.or(is_ours.then_some(CalibrationReference::Fixes));
    let truth_sigma_m = truth_sigma_m(args, TRUTH_SIGMA_M)?;
    let compared = drives.iter().map(|drive| {
        let (reference, positions) = drive.positions(wanted, truth_sigma_m);
        ReferencePositions { reference, positions }
    });
    Ok(compared.collect())
}

/// The runs of `--try-on`, without duplicates.
fn load_validation_drives(args: &PathArgs) -> Result<Vec<SourceRun>, Failure> {
    let mut others: Vec<SourceRun> = Vec::new();
    if let (Some(path), false) = (&args.recording, args.try_on.is_empty())
        && own_recording::is_own(path)
    {
        return Err(anyhow!("--try-on chooses from a descriptor's runs; `{}` is one drive", path.display()))
            .before_start();
    }
    for prefix in &args.try_on {
        let flags = DataFlags { run: Some(prefix.clone()), ..args.data.clone() };
        for drive in load_drives(args, &flags)?.runs {
            if others.iter().all(|known| known.name != drive.name) {
                others.push(drive);
            }
        }
    }
    Ok(others)
}

fn free_paths(args: &PathArgs, drives: &[SourceRun], compared: Vec<ReferencePositions>) -> Result<Vec<FreePath>> {
    let is_ours = args.recording.as_deref().is_some_and(own_recording::is_own);
    let paths = drives.iter().zip(compared).map(|(drive, ReferencePositions { reference, positions })| {
        ensure!(
            !positions.is_empty(),
            "run `{}` has no {}: nothing says where the robot was",
            drive.name,
            match reference {
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
        Ok(FreePath::new(&drive.name, &config, &drive.observations, positions))
    });
    paths.collect()
}

fn load_segments(args: &PathArgs, file: &Path) -> Result<PathDataset> {
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
    let sigma_m = truth_sigma_m(args, TAPE_SIGMA_M)?;
    Ok(PathDataset {
        recording: file.display().to_string(),
        reference: "tape",
        config: filter_config(&robot, &FilterSection::default(), posebridge_telemetry::ArenaMap::default())?,
        paths: read_segments(file, sigma_m)?,
        validation_paths: Vec::new(),
        robot,
    })
}

/// Applies `--hold` and `--free` to the robot's priors.
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

fn build_result(material: PathDataset, found: PathCalibration) -> Result<PathCalibrationResult, Failure> {
    let config = &material.config;
    let hypothesis = found.hypothesis();
    let mut base = material.robot.clone();
    base.left_wheel_radius_m *= hypothesis.travel_factor;
    base.right_wheel_radius_m *= hypothesis.travel_factor;
    base.track_width_m *= hypothesis.track_factor;
    let (calibrated, left) = fold_into_geometry(&base, &to_calibration(config, &found)).while_running()?;
    let try_on = |path: &FreePath, heading_rad: Option<f64>| {
        let before = start_heading(config, &found.before, path);
        let undone = path.with_hypothesis(&hypothesis);
        let after = heading_rad.unwrap_or(start_heading(config, &found.after, &undone));
        // Where the heading is found it is no merit of the robot's new numbers.
        let before = if hypothesis == AS_GIVEN { heading_rad.unwrap_or(before) } else { before };
        RunComparison {
            reckoned: [
                dead_reckon(config, &found.before, path, before),
                dead_reckon(config, &found.after, &undone, after),
            ],
            path: path.clone(),
        }
    };
    let runs = material.paths.iter().zip(&found.headings_rad);
    let runs = runs.map(|(path, heading)| try_on(path, Some(*heading))).collect();
    let others = material.validation_paths.iter();
    let tried = others.map(|path| try_on(path, None)).collect();
    Ok(PathCalibrationResult {
        calibrated,
        residual: left,
        runs,
        validation_runs: tried,
        fit: found,
        recording: material.recording,
        reference: material.reference,
        robot: material.robot,
    })
}

fn to_calibration(config: &FilterConfig, found: &PathCalibration) -> Calibration {
    let mut calibration = config.calibration;
    for unknown in UNKNOWNS {
        *unknown.value_in(&mut calibration) = found.entry(unknown).after;
    }
    calibration
}

/// Flags of `calibrate path`.
#[derive(Args, Clone, Debug)]
pub struct PathArgs {
    /// Descriptor (config/recordings/*.toml) or recording (*.mcap).
    #[arg(required_unless_present_any = ["segments", "link", "listen"], group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data; without --use-every all fixes are used.
    #[command(flatten)]
    pub data: DataFlags,
    /// Instead of a recording: CSV table of wheel distances and positions measured with a tape (docs/lab/calibration.md, section
    /// 3).
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["real_robot", "run", "use_every", "settings", "against", "unknown_start"])]
    pub segments: Option<PathBuf>,
    /// Robot profile for --segments.
    #[arg(long, value_name = "FILE.toml", requires = "segments")]
    pub robot: Option<PathBuf>,
    /// Reference. Default: the fixes, or else the ground truth.
    #[arg(long, value_enum)]
    pub against: Option<CalibrationReference>,
    /// Accuracy of the reference: one standard deviation, in metres [default: 0.005, with --segments 0.01].
    #[arg(long, value_name = "M")]
    pub truth_sigma_m: Option<f64>,
    /// Keep this quantity fixed. Can be repeated.
    #[arg(long = "hold", value_enum, value_name = "NUMBER")]
    pub held: Vec<GeometryParameter>,
    /// Also estimate this quantity, with this prior sigma around its value: QUANTITY=SIGMA, e.g. tag-forward=0.02.
    #[arg(long = "free", value_name = "NUMBER=SIGMA", value_parser = freed)]
    pub freed: Vec<(GeometryParameter, f64)>,
    /// Start pose of the robot and axes of the camera are unknown.
    #[arg(long)]
    pub unknown_start: bool,
    /// Validate the result on the runs whose names begin with this text; they are not used for calibration. Can be repeated.
    #[arg(long = "try-on", value_name = "PREFIX", conflicts_with_all = ["segments", "link", "listen"])]
    pub try_on: Vec<String>,
    /// Use the calibration states of the filter `pose` over the whole of one run instead.
    #[arg(long, conflicts_with_all = ["segments", "try_on", "unknown_start", "held", "freed", "against", "truth_sigma_m"])]
    pub online: bool,
    /// Write a robot profile, for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// A number of a robot, as people say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum GeometryParameter {
    /// Mean radius of the wheels.
    WheelRadius,
    /// Distance between the wheels.
    Track,
    /// Difference of the wheels' radii.
    WheelDifference,
    /// Delay of the camera.
    Delay,
    /// Position of the tag, forward.
    TagForward,
    /// Position of the tag, to the left.
    TagLeft,
}

fn freed(text: &str) -> Result<(GeometryParameter, f64), String> {
    use clap::ValueEnum as _;
    let (name, sigma) = text.split_once('=').ok_or("must be NUMBER=SIGMA, e.g. tag-forward=0.02")?;
    let number = GeometryParameter::from_str(name, false).map_err(|_unknown| {
        let known = GeometryParameter::value_variants().iter();
        let known: Vec<String> =
            known.filter_map(|number| Some(number.to_possible_value()?.get_name().to_owned())).collect();
        format!("`{name}` is none of {}", known.join(", "))
    })?;
    match sigma.parse::<f64>() {
        Ok(sigma) if sigma > 0.0 && sigma.is_finite() => Ok((number, sigma)),
        _ => Err(format!("`{sigma}` is not a number of more than zero")),
    }
}

const FILTER: &str = "pose";

fn execute_online(args: &PathArgs, timer: &HostTimer) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let Some(recording) = &args.recording else {
        return Err(anyhow::anyhow!("--online needs a recording")).before_start();
    };
    let drives = source::load(recording, &args.data).before_start()?;
    let drive = single_drive(&drives.runs).before_start()?;
    let learned = learn(drive).while_running()?;
    let report = report(&drives.recording, &learned);
    if let Some(path) = &args.save {
        let robot = fold_into_geometry(&learned.robot, &learned.calibration).while_running()?;
        let source = format!("{}, {}", drives.recording, drive.name);
        save_profile(path, timer, &report, "calibrate path --online", source, robot).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
}

fn single_drive(drives: &[SourceRun]) -> Result<&SourceRun> {
    match drives {
        [drive] => Ok(drive),
        _ => bail!("--online takes what one run has taught, but {} are selected: choose one with --run", drives.len()),
    }
}

fn learn(drive: &SourceRun) -> Result<LearnedCalibration> {
    ensure!(
        drive.observations.iter().any(|one| is_absolute(&one.measurement)),
        "run `{}` has no fixes, landmarks, beacons, walls or compass: nothing tells the filter where it is",
        drive.name
    );
    let smoothed = smooth(&drive.config, &drive.observations).with_context(|| format!("run `{}`", drive.name))?;
    if let Some(shortfall) = smoothed.convergence.shortfall() {
        print_line(&format!("run {}: not converged: {shortfall}", drive.name));
    }
    Ok(LearnedCalibration {
        run: drive.name.clone(),
        robot: drive.robot.clone(),
        prior: drive.config.calibration,
        calibration: smoothed.calibration,
    })
}

const fn is_absolute(measurement: &ObservationKind) -> bool {
    matches!(
        measurement,
        ObservationKind::Fix(_)
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::CompassHeading(_)
    )
}

fn report(recording: &str, learned: &LearnedCalibration) -> Report {
    let mut report = Report::new("calibrate-path", format!("What the filter has learned: {recording}"));
    report.paragraph(format!("The calibration states of the filter `{FILTER}`, smoothed over run {}.", learned.run));
    let entries: Vec<(&str, UncertainValue, UncertainValue)> = learnable_keys()
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

/// As accurately as a person places a robot on its start point and aligns it with the start line.
const TAPE_START: PathStart = PathStart { pose: [0.0; 3], position_sigma_m: 0.01, heading_sigma_rad: 0.03 };

/// Reads a table of the columns `run`, `left_before_mm`, `left_after_mm`, `right_before_mm`, `right_after_mm`, `measured_x_mm` and
/// `measured_y_mm`: one row per part of a drive, in order. Every run begins at the origin with heading 0.
///
/// Each part gets a duration of one second: only the order matters.
fn read_segments(path: &Path, sigma_m: f64) -> Result<Vec<FreePath>> {
    let listing = CsvTable::read(path)?;
    let mut paths: Vec<FreePath> = Vec::new();
    for row in listing.rows() {
        let run = row.text("run")?;
        if paths.last().is_none_or(|path| path.name != run) {
            ensure!(
                paths.iter().all(|path| path.name != run),
                "{}: run `{run}` begins again; its rows must stand together",
                row.location()
            );
            paths.push(FreePath {
                name: run.to_owned(),
                start: TAPE_START,
                steps: Vec::new(),
                fixes: vec![PositionFix { at_s: 0.0, position_m: [0.0; 2], sigma_m, tag_m: [0.0; 2] }],
            });
        }
        let Some(path) = paths.last_mut() else {
            continue;
        };
        add_segment(path, &row, sigma_m)?;
    }
    ensure!(!paths.is_empty(), "`{}` has a first line and no rows", path.display());
    Ok(paths)
}

fn add_segment(path: &mut FreePath, row: &CsvRow<'_>, sigma_m: f64) -> Result<()> {
    let metres = |column: &str| row.number(column).map(|mm| mm * 1e-3);
    let from_s = path.steps.len() as f64;
    path.steps.push(TravelStep {
        from_s,
        until_s: from_s + 1.0,
        travel: WheelTravel {
            left_m: metres("left_after_mm")? - metres("left_before_mm")?,
            right_m: metres("right_after_mm")? - metres("right_before_mm")?,
        },
    });
    path.fixes.push(PositionFix {
        at_s: from_s + 1.0,
        position_m: [metres("measured_x_mm")?, metres("measured_y_mm")?],
        sigma_m,
        tag_m: [0.0; 2],
    });
    Ok(())
}
