//! `posebridge calibrate path`: a robot from any recorded drive that was watched.

use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use posebridge_analysis::calibration::free_path::{
    AS_GIVEN, Entry, FreePath, PathCalibration, ReckonedError, Reckoning, UNKNOWNS, Unknown, calibrate_path, reckon,
    starting_heading,
};
use posebridge_estimator::FilterConfig;
use posebridge_link::HostTimer;
use posebridge_telemetry::{Calibration, Known};

use super::path_online;
use super::path_report::Report;
use super::profile::{Calibrated, folded};
use super::segments;
use super::source::{self, Against, Drive, Drives, Watch};
use crate::cli::DataFlags;
use crate::commands::lab::live::LiveArgs;
use crate::commands::lab::outcome::OutputArgs;
use crate::commands::{Failure, Stage};
use crate::config::{FilterSection, RobotFile, RobotProfile, filter_config};
use crate::own_recording;
use crate::stderr::say;

/// What an instrument's truth errs by if nobody says: its own millimetre, and a body that sways.
const TRUTH_SIGMA_M: f64 = 0.005;
/// The same for a person with a tape.
const TAPE_SIGMA_M: f64 = 0.01;

/// What a person with a live robot is told to do.
const TASK: &str = "drive about in the camera's sight, for a minute or two, with turns in both directions";

/// Flags of `calibrate path`.
#[derive(Args, Clone, Debug)]
pub struct PathArgs {
    /// A recording's descriptor (config/recordings/*.toml) or a recording (*.mcap).
    #[arg(required_unless_present_any = ["segments", "link", "listen"], group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data; without --use-every all fixes are taken.
    #[command(flatten)]
    pub data: DataFlags,
    /// In place of a recording: a CSV table of wheel distances and places measured with a tape (docs/lab/calibrate.md, section 3).
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["real_robot", "run", "use_every", "settings", "against", "unknown_start"])]
    pub segments: Option<PathBuf>,
    /// The robot of --segments: a profile with a [robot] table.
    #[arg(long, value_name = "FILE.toml", requires = "segments")]
    pub robot: Option<PathBuf>,
    /// What to compare with, instead of the fixes if there are any and else the truth.
    #[arg(long, value_enum)]
    pub against: Option<Against>,
    /// How well the truth is known, in metres: one standard deviation [default: 0.005, with --segments 0.01].
    #[arg(long, value_name = "M")]
    pub truth_sigma_m: Option<f64>,
    /// Take this number as given; may be repeated.
    #[arg(long = "hold", value_enum, value_name = "NUMBER")]
    pub held: Vec<Number>,
    /// Look for this number, which is held otherwise, up to about this far from its value: NUMBER=SIGMA, e.g. tag-forward=0.02.
    #[arg(long = "free", value_name = "NUMBER=SIGMA", value_parser = freed)]
    pub freed: Vec<(Number, f64)>,
    /// Nobody knows where the robot started, or how the camera's axes lie.
    #[arg(long)]
    pub unknown_start: bool,
    /// Try the result on the runs whose names begin so, which take no part in it; may be repeated.
    #[arg(long = "try-on", value_name = "PREFIX", conflicts_with_all = ["segments", "link", "listen"])]
    pub try_on: Vec<String>,
    /// Take what the filter `pose` has learned while it drove instead, of one run.
    #[arg(long, conflicts_with_all = ["segments", "try_on", "unknown_start", "held", "freed", "against", "truth_sigma_m"])]
    pub online: bool,
    /// Write the robot as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// A number of a robot, as people say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Number {
    /// Mean radius of the wheels.
    WheelRadius,
    /// Distance between the wheels.
    Track,
    /// Difference of the wheels' radii.
    WheelDifference,
    /// How late the camera is.
    Delay,
    /// Where the tag is, forward.
    TagForward,
    /// Where the tag is, to the left.
    TagLeft,
}

fn freed(text: &str) -> Result<(Number, f64), String> {
    use clap::ValueEnum as _;
    let (name, sigma) = text.split_once('=').ok_or("must be NUMBER=SIGMA, e.g. tag-forward=0.02")?;
    let number = Number::from_str(name, false).map_err(|_unknown| {
        let known = Number::value_variants().iter();
        let known: Vec<String> =
            known.filter_map(|number| Some(number.to_possible_value()?.get_name().to_owned())).collect();
        format!("`{name}` is none of {}", known.join(", "))
    })?;
    match sigma.parse::<f64>() {
        Ok(sigma) if sigma > 0.0 && sigma.is_finite() => Ok((number, sigma)),
        _ => Err(format!("`{sigma}` is not a number of more than zero")),
    }
}

/// Everything that a report tells.
pub(super) struct CalibratedPath {
    pub(super) recording: String,
    pub(super) against: &'static str,
    pub(super) robot: RobotFile,
    pub(super) calibrated: RobotFile,
    pub(super) left: Calibration,
    pub(super) found: PathCalibration,
    pub(super) runs: Vec<TriedRun>,
    pub(super) tried: Vec<TriedRun>,
}

/// A run by dead reckoning, before and after.
pub(super) struct TriedRun {
    pub(super) path: FreePath,
    pub(super) before: Reckoning,
    pub(super) after: Reckoning,
}

impl TriedRun {
    /// Errors before and after.
    pub(super) const fn errors(&self) -> [ReckonedError; 2] {
        [self.before.error, self.after.error]
    }
}

/// Calibrates.
///
/// # Errors
/// A recording or a flag makes no sense, what was driven does not suffice, or an output cannot be written.
pub(super) fn execute(args: &PathArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let mut args = args.clone();
    if args.live.is_asked() {
        let recording = args.live.or_named(None, &args.output, &args.data, TASK)?;
        args.recording = Some(recording);
    }
    let args = &args;
    if args.online {
        return path_online::execute(args, &timer);
    }
    let folder = args.output.folder()?;
    let material = Material::load(args)?;
    let found = calibrate_path(&material.config, &material.paths).while_running()?;
    let calibration = told(&material, found)?;
    let report = Report::of(&calibration);
    for line in report.findings() {
        say(&format!("warning: {line}"));
    }
    if let Some(path) = &args.save {
        let calibrated = Calibrated {
            robot: calibration.calibrated.clone(),
            calibration: calibration.left,
            source: calibration.recording.clone(),
            by: "calibrate path",
            remarks: report.remarks(),
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.deliver(&folder, &report.outcome())
}

/// The drives, and the robot that they share.
pub(super) struct Material {
    recording: String,
    against: &'static str,
    robot: RobotFile,
    config: FilterConfig,
    paths: Vec<FreePath>,
    /// What the result is tried on; none of it is among the `paths`.
    others: Vec<FreePath>,
}

impl Material {
    fn load(args: &PathArgs) -> Result<Self, Failure> {
        if let Some(file) = &args.segments {
            return of_segments(args, file).at_start();
        }
        let drives = load_drives(args, &args.data)?;
        let others = others(args)?;
        Self::of_drives(args, drives, &others).at_start()
    }

    fn of_drives(args: &PathArgs, mut drives: Drives, others: &[Drive]) -> Result<Self> {
        ensure!(!drives.drives.is_empty(), "`{}` holds no run", drives.recording);
        let is_other = |drive: &Drive| others.iter().any(|other| other.name == drive.name);
        drives.drives.retain(|drive| !is_other(drive));
        let Some(first) = drives.drives.first() else {
            bail!(
                "no run of `{}` is left to calibrate by: --try-on takes them all; choose others with --run",
                drives.recording
            )
        };
        let robots = drives.drives.iter().chain(others);
        source::same_robot(robots.map(|drive| (drive.name.as_str(), &drive.config.geometry)))?;
        let is_by_truth = |drive: &Drive| drive.against == Against::Truth;
        ensure!(
            args.truth_sigma_m.is_none() || drives.drives.iter().any(is_by_truth),
            "--truth-sigma-m is the sigma of a truth, but `{}` is compared with fixes, whose sigma is noise.fix_position_m",
            drives.recording
        );
        let robot = with_flags(args, &first.robot)?;
        let mut config = first.config.clone();
        config.calibration = robot.calibration()?;
        let against = match first.against {
            Against::Fixes => "fixes",
            Against::Truth => "truth",
        };
        Ok(Self {
            against,
            paths: paths_of(args, &drives.drives)?,
            others: paths_of(args, others)?,
            recording: drives.recording,
            robot,
            config,
        })
    }
}

fn watch(args: &PathArgs) -> Result<Watch> {
    let truth_sigma_m = args.truth_sigma_m.unwrap_or(TRUTH_SIGMA_M);
    ensure!(
        truth_sigma_m > 0.0 && truth_sigma_m.is_finite(),
        "--truth-sigma-m is {truth_sigma_m}, must be more than zero"
    );
    Ok(Watch { against: args.against, truth_sigma_m })
}

fn load_drives(args: &PathArgs, data: &DataFlags) -> Result<Drives, Failure> {
    let Some(recording) = &args.recording else {
        return Err(anyhow!("name a recording, or give --segments")).at_start();
    };
    source::load(recording, data, watch(args).at_start()?)
}

/// The runs that `--try-on` names, each once.
fn others(args: &PathArgs) -> Result<Vec<Drive>, Failure> {
    let mut others: Vec<Drive> = Vec::new();
    if let (Some(path), false) = (&args.recording, args.try_on.is_empty())
        && own_recording::is_own(path)
    {
        return Err(anyhow!("--try-on chooses from a descriptor's runs; `{}` is one drive", path.display())).at_start();
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

fn paths_of(args: &PathArgs, drives: &[Drive]) -> Result<Vec<FreePath>> {
    let is_ours = args.recording.as_deref().is_some_and(own_recording::is_own);
    let paths = drives.iter().map(|drive| {
        ensure!(
            !drive.sights.is_empty(),
            "run `{}` has no {}: nothing says where the robot was",
            drive.name,
            match drive.against {
                Against::Fixes if is_ours => "fixes (record it again where its camera sees it; docs/lab/calibrate.md)",
                Against::Fixes => "fixes (try --against truth)",
                Against::Truth => "truth (try --against fixes)",
            }
        );
        let mut config = drive.config.clone();
        if args.unknown_start {
            config.start = None;
        }
        let sights = drive.sights.iter().copied();
        Ok(FreePath::new(&drive.name, &config, &drive.observations, sights))
    });
    paths.collect()
}

fn of_segments(args: &PathArgs, file: &std::path::Path) -> Result<Material> {
    let robot = match &args.robot {
        Some(profile) => RobotProfile::read(profile)?.robot,
        None => RobotFile::default(),
    };
    let mut robot = with_flags(args, &robot)?;
    // A robot that is measured with a tape is one of which little is known.
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
    Ok(Material {
        recording: file.display().to_string(),
        against: "tape",
        config: filter_config(&robot, &FilterSection::default(), posebridge_telemetry::World::default())?,
        paths: segments::read(file, sigma_m)?,
        others: Vec::new(),
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
            Number::WheelRadius => &mut known.radius_scale,
            Number::Track => &mut known.track_scale,
            Number::WheelDifference => &mut known.radius_difference,
            Number::Delay => &mut known.fix_delay_s,
            Number::TagForward => &mut known.tag_forward_m,
            Number::TagLeft => &mut known.tag_left_m,
        };
        entry.sigma = sigma;
    }
    robot.calibration().context("--hold and --free")?;
    Ok(robot)
}

fn told(material: &Material, found: PathCalibration) -> Result<CalibratedPath, Failure> {
    let config = &material.config;
    let hypothesis = found.hypothesis();
    let mut base = material.robot.clone();
    base.left_wheel_radius_m *= hypothesis.travel_factor;
    base.right_wheel_radius_m *= hypothesis.travel_factor;
    base.track_width_m *= hypothesis.track_factor;
    let (calibrated, left) = folded(&base, as_calibration(config, &found)).while_running()?;
    let try_on = |path: &FreePath, heading_rad: Option<f64>| {
        let before = starting_heading(config, &found.before, path);
        let undone = path.under(&hypothesis);
        let after = heading_rad.unwrap_or(starting_heading(config, &found.after, &undone));
        // Where the heading is found it is no merit of the robot's new numbers.
        let before = if hypothesis == AS_GIVEN { heading_rad.unwrap_or(before) } else { before };
        TriedRun {
            before: reckon(config, &found.before, path, before),
            after: reckon(config, &found.after, &undone, after),
            path: path.clone(),
        }
    };
    let runs = material.paths.iter().zip(&found.headings_rad);
    let runs = runs.map(|(path, heading)| try_on(path, Some(*heading))).collect();
    let others = material.others.iter();
    let tried = others.map(|path| try_on(path, None)).collect();
    Ok(CalibratedPath {
        recording: material.recording.clone(),
        against: material.against,
        robot: material.robot.clone(),
        calibrated,
        left,
        runs,
        tried,
        found,
    })
}

/// What was found as the vocabulary has it; what was not looked for is as it was.
fn as_calibration(config: &FilterConfig, found: &PathCalibration) -> Calibration {
    let mut calibration = config.calibration;
    for unknown in UNKNOWNS {
        let Entry { after, .. } = found.entry(unknown);
        let place: &mut Known = match unknown {
            Unknown::RadiusScale => &mut calibration.radius_scale,
            Unknown::TrackScale => &mut calibration.track_scale,
            Unknown::RadiusDifference => &mut calibration.radius_difference,
            Unknown::FixDelay => &mut calibration.fix_delay_s,
            Unknown::TagForward => &mut calibration.tag_forward_m,
            Unknown::TagLeft => &mut calibration.tag_left_m,
        };
        *place = after;
    }
    calibration
}
