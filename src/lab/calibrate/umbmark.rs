//! `posebridge calibrate umbmark`: wheel difference and track from squares in both directions.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use posebridge_estimator::FilterConfig;
use posebridge_lab::calibration::CalibrationError;
use posebridge_lab::calibration::free_path::{FreePath, PositionFix, seconds};
use posebridge_lab::calibration::umbmark::{
    SquareCalibration, SquareDirection, SquareError, SquareRobot, SquareRun, Umbmark, calibrate_squares, closing_runs,
    estimate_umbmark, square_error,
};
use posebridge_link::HostTimer;
use posebridge_report::chart::{Axes, Curve, Plot};
use posebridge_report::quantity::{Format, Quantity, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_sim::montecarlo::{Course, Drive, Scenario};
use posebridge_telemetry::{ArenaMap, Calibration, Observation, StartPose, UncertainValue};
use serde_json::json;

use super::profile::{fold_into_geometry, save_profile};
use crate::config::{FilterSection, RobotFile, RobotProfile, filter_config};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::experiments::live::LiveArgs;
use crate::lab::source::{self, SourceRun};
use crate::tools::csv_table::CsvTable;
use crate::tools::experiment_output::OutputArgs;

/// Nominal sigma of a tape or tracker; the result does not depend on its value.
const OBSERVED_SIGMA_M: f64 = 0.005;
/// Ratio of the difference between the results from x and y to the results, above which the drives are suspect.
const SUSPECT_RATIO: f64 = 0.5;

const TASK: &str = "drive one square before the camera, back to where it began, in one direction, and stop there";

/// Flags of `calibrate umbmark`.
#[derive(Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("squares").required(true).multiple(true).args(["recordings", "link", "listen", "ends", "sim"]))]
pub struct UmbmarkArgs {
    /// Descriptors whose selected runs are squares with a ground truth, and recordings (*.mcap) of one square each whose end a
    /// camera saw.
    #[arg(value_name = "RECORDING", conflicts_with_all = ["ends", "sim"])]
    pub recordings: Vec<PathBuf>,
    /// A live robot, for one more square.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Instead of a recording: CSV table with the columns direction (cw or ccw), x_mm, y_mm: true position, forward and left of
    /// the start, when the odometry was back at the start.
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["sim", "real_robot", "run", "use_every", "settings"])]
    pub ends: Option<PathBuf>,
    /// Instead of a recording: use the simulated robot.
    #[arg(long, conflicts_with_all = ["real_robot", "run", "use_every", "settings", "side_m"])]
    pub sim: bool,
    /// Robot profile for --ends: the one that the robot steered by.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["recordings", "real_robot", "sim"])]
    pub robot: Option<PathBuf>,
    /// Length of a side, in metres. Recorded drives contain it.
    #[arg(long, value_name = "M")]
    pub side_m: Option<f64>,
    /// Number of simulated squares in each direction.
    #[arg(long, value_name = "N", default_value_t = 5, conflicts_with_all = ["recordings", "real_robot", "ends"], value_parser = clap::value_parser!(u32).range(1..=5))]
    pub runs: u32,
    /// Seed of the simulated robot. Default: that of its scenario.
    #[arg(long, value_name = "N", conflicts_with_all = ["recordings", "real_robot", "ends"])]
    pub seed: Option<u64>,
    /// Write a robot profile, for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

struct UmbmarkResult {
    source: String,
    robot: RobotFile,
    side_m: f64,
    result: Umbmark,
    runs_before: Vec<SquareRun>,
    /// Only for recorded wheels, which can be evaluated again.
    runs_after: Vec<SquareRun>,
    /// Validation squares, before and after.
    validation_errors: Option<[SquareError; 2]>,
    /// Of a simulated robot: its true track scale and wheel difference.
    truth: Option<[f64; 2]>,
}

pub(super) fn execute(args: &UmbmarkArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let folder = args.output.folder()?;
    let result = compute(args)?;
    let report = result.report();
    if let Some(path) = &args.save {
        let robot = fold_into_geometry(&result.robot, &result.calibration()).while_running()?;
        save_profile(path, &timer, &report, "calibrate umbmark", result.source, robot).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
}

fn compute(args: &UmbmarkArgs) -> Result<UmbmarkResult, Failure> {
    if let Some(side_m) = args.side_m
        && !(side_m > 0.0 && side_m.is_finite())
    {
        return Err(anyhow!("--side-m is {side_m}, must be more than zero")).before_start();
    }
    if let Some(path) = &args.ends {
        return from_table(args, path).before_start();
    }
    if args.sim {
        return from_simulation(args).while_running();
    }
    let drives = drives(args)?;
    let Some(first) = drives.first() else {
        return Err(anyhow!("no run was chosen: see --run")).before_start();
    };
    let robots = drives.iter();
    let robots = robots.map(|drive| (drive.name.as_str(), &drive.config.geometry));
    source::check_same_robot(robots).before_start()?;
    let paths: Vec<FreePath> = drives
        .iter()
        .map(|drive| FreePath::new(&drive.name, &drive.config, &drive.observations, positions(drive)))
        .collect();
    let squares = calibrate_squares(&first.config, &paths, args.side_m)
        .map_err(|error| with_advice(error.into(), &drives))
        .while_running()?;
    Ok(UmbmarkResult::new(names(&drives), first.robot.clone(), squares))
}

/// The squares of all recordings; that of the live robot is last.
fn drives(args: &UmbmarkArgs) -> Result<Vec<SourceRun>, Failure> {
    args.live.reject_data_flags(&args.data)?;
    let live = args.live.record(&args.output, None, &args.data.settings, TASK)?;
    let mut drives = Vec::new();
    for recording in args.recordings.iter().chain(&live) {
        drives.extend(source::load(recording, &args.data).before_start()?.runs);
    }
    Ok(drives)
}

fn positions(drive: &SourceRun) -> Vec<PositionFix> {
    drive.positions(None, OBSERVED_SIGMA_M).1
}

/// Adds advice to an error about a missing direction: one recording is one square, unless a descriptor selects several.
fn with_advice(error: anyhow::Error, drives: &[SourceRun]) -> anyhow::Error {
    let is_too_little = matches!(error.downcast_ref(), Some(CalibrationError::TooFewData { .. }));
    let has_fixes = drives.iter().all(|drive| !positions(drive).is_empty());
    if !(is_too_little && has_fixes) {
        return error;
    }
    error.context(format!(
        "squares in both directions are needed, each recorded by itself; so far: {}. Name all recordings, and add a live square by --link \
         or --listen with a new --out",
        names(drives)
    ))
}

fn names(drives: &[SourceRun]) -> String {
    let names: Vec<&str> = drives.iter().map(|drive| drive.name.as_str()).collect();
    names.join(", ")
}

fn from_table(args: &UmbmarkArgs, path: &Path) -> Result<UmbmarkResult> {
    let robot = match &args.robot {
        Some(profile) => RobotProfile::read(profile)?.robot,
        None => RobotFile::default(),
    };
    ensure!(args.side_m.is_some(), "--ends needs --side-m: the length of a side of the square, in metres");
    let side_m = args.side_m.unwrap_or_default();
    let runs = read_squares(path)?;
    let square = SquareRobot { track_width_m: robot.geometry()?.track_width.0, side_m };
    Ok(UmbmarkResult {
        source: path.display().to_string(),
        result: estimate_umbmark(&runs, square)?,
        robot,
        side_m,
        runs_before: runs,
        runs_after: Vec::new(),
        validation_errors: None,
        truth: None,
    })
}

/// Drives `args.runs` squares in each direction, and four times as many for validation.
fn from_simulation(args: &UmbmarkArgs) -> Result<UmbmarkResult> {
    let mut scenario = Scenario::from_toml(SCENARIO).context("the bundled squares")?;
    let Course::Laps(laps) = &mut scenario.path else { bail!("the bundled squares are no laps") };
    laps.laps = 2 * args.runs * 5;
    let (laps, step_s) = (*laps, scenario.step_s);
    if let Some(seed) = args.seed {
        scenario = scenario.with_seed(seed);
    }
    let drive = scenario.drive(0);
    let nominal = drive.prior.geometry;
    let robot = RobotFile {
        left_wheel_radius_m: nominal.left_wheel_radius.0,
        right_wheel_radius_m: nominal.right_wheel_radius.0,
        track_width_m: nominal.track_width.0,
        ..RobotFile::default()
    };
    let config = filter_config(&robot, &FilterSection::default(), ArenaMap::default())?;
    let rest_steps = (laps.rest_s / step_s).round() as usize;
    let steps = drive.truth.len().saturating_sub(1 + rest_steps);
    let lap_steps = steps / laps.laps as usize;
    ensure!(lap_steps > 0 && lap_steps * laps.laps as usize == steps, "the simulated laps are not alike");
    let firsts = (0..laps.laps as usize).map(|lap| rest_steps + lap * lap_steps);
    let mut paths: Vec<FreePath> =
        firsts.map(|first| cut_lap(&drive, &config, first, first + lap_steps)).collect::<Result<_>>()?;
    let others = paths.split_off(2 * args.runs as usize);
    let squares = calibrate_squares(&config, &paths, Some(laps.side_m))?;
    let error_of = |numbers| -> Result<SquareError> { Ok(square_error(&closing_runs(&config, numbers, &others)?)?) };
    let validation_errors = Some([error_of(&squares.before)?, error_of(&squares.after)?]);
    let truth = drive.true_geometry;
    let (left, right) = (truth.left_wheel_radius.0, truth.right_wheel_radius.0);
    let track = truth.track_width.0 / nominal.track_width.0 - 1.0;
    let truth = Some([track, (right - left) / f64::midpoint(left, right)]);
    let source = "the simulated robot".to_owned();
    Ok(UmbmarkResult { validation_errors, truth, ..UmbmarkResult::new(source, robot, squares) })
}

impl UmbmarkResult {
    fn new(source: String, robot: RobotFile, squares: SquareCalibration) -> Self {
        Self {
            source,
            robot,
            side_m: squares.side_m,
            result: squares.estimate,
            runs_before: squares.runs_before,
            runs_after: squares.runs_after,
            validation_errors: None,
            truth: None,
        }
    }

    fn calibration(&self) -> Calibration {
        let prior = &self.robot.calibration.radius_scale;
        Calibration {
            // A closed square does not see the mean wheel size.
            radius_scale: UncertainValue { value: 0.0, sigma: prior.sigma },
            radius_difference: self.result.radius_difference,
            track_scale: self.result.track_scale,
            ..Calibration::default()
        }
    }

    fn warning(&self) -> Option<String> {
        let largest = self.result.corner_rad.abs().max(self.result.bend_rad.abs());
        (self.result.disagreement_rad > SUSPECT_RATIO * largest.max(1e-4)).then(|| {
            format!(
                "the ends along x and along y tell corners apart by {:.2} degrees: was one of them a square that ended elsewhere, or measured along another axis?",
                self.result.disagreement_rad.to_degrees()
            )
        })
    }

    fn report(&self) -> Report {
        let found = &self.result;
        let scale = Format::new(Unit::None, 5).signed();
        let (degrees, mm) = (Format::new(Unit::Degrees, 3).signed(), Format::new(Unit::Millimetres, 1));
        let uncertain =
            |key, label, value: UncertainValue| Quantity::new(key, label, value.value, scale).with_sigma(value.sigma);
        let mut report = Report::new("calibrate-umbmark", format!("UMBmark: {}", self.source));
        report.values([
            uncertain("track_scale", "track width error", found.track_scale),
            uncertain("radius_difference", "wheel radius difference", found.radius_difference),
            Quantity::new("left_factor", "left wheel factor", found.left_factor, Format::new(Unit::None, 5)),
            Quantity::new("right_factor", "right wheel factor", found.right_factor, Format::new(Unit::None, 5)),
            Quantity::new("corner_rad", "turn missing at each corner", found.corner_rad, degrees),
            Quantity::new("bend_rad", "turn to the left on each side", found.bend_rad, degrees),
            Quantity::new("side_m", "side of the square", self.side_m, Format::new(Unit::Named("m"), 2)),
            Quantity::new("systematic_m", "systematic error", found.error.systematic_m, mm),
            Quantity::new("scatter_m", "scatter", found.error.scatter_m, mm),
            Quantity::optional(
                "",
                "systematic error after calibration",
                square_error(&self.runs_after).ok().map(|error| error.systematic_m),
                mm,
            ),
        ]);
        if let Some(errors) = &self.validation_errors {
            let [before, after] = errors.map(|error| error.systematic_m);
            report.values([
                Quantity::new("", "other squares before", before, mm),
                Quantity::new("", "other squares after", after, mm),
                Quantity::new("", "times less", before / after, Format::new(Unit::None, 1)),
            ]);
        }
        if let Some([track, difference]) = self.truth {
            report.values([
                Quantity::new("", "true track width error", track, scale),
                Quantity::new("", "true wheel radius difference", difference, scale),
            ]);
        }
        let warning = self.warning();
        if let Some(warning) = &warning {
            report.warning(warning);
        }
        report.paragraph("Where the squares ended, seen from where odometry expected them to end:");
        self.add_table(&mut report);
        report.chart(&self.plot(), "Two clouds away from home: a systematic error. Their size: chance.");
        report.data("source", json!(self.source));
        report.data("others", json!(self.validation_errors.map(|errors| errors.map(|error| error.systematic_m))));
        report.data("truth", json!(self.truth));
        report.data("doubts", json!(Vec::from_iter(warning)));
        report
    }

    fn add_table(&self, report: &mut Report) {
        let rows: Vec<(&SquareRun, Option<&SquareRun>)> =
            self.runs_before.iter().enumerate().map(|(index, run)| (run, self.runs_after.get(index))).collect();
        let mm = Format::new(Unit::Millimetres, 1).signed();
        let table = Table::of(&rows)
            .text("", "direction", |(run, _)| direction_name(run.direction).to_owned())
            .number("", "ahead", mm, |(run, _)| Some(run.ahead_m))
            .number("", "left", mm, |(run, _)| Some(run.left_m))
            .number("", "ahead after", mm, |(_, after)| after.map(|run| run.ahead_m))
            .number("", "left after", mm, |(_, after)| after.map(|run| run.left_m));
        report.table("", &table);
    }

    fn plot(&self) -> Plot {
        let dots = |name: &str, runs: &[SquareRun], direction: SquareDirection| {
            let ends = runs.iter().filter(|run| run.direction == direction);
            Curve::dots(name, ends.map(|run| (run.ahead_m, run.left_m)))
        };
        let (cw, ccw) = (SquareDirection::Clockwise, SquareDirection::CounterClockwise);
        let mut curves =
            vec![dots("clockwise", &self.runs_before, cw), dots("counter-clockwise", &self.runs_before, ccw)];
        if !self.runs_after.is_empty() {
            curves.push(dots("clockwise, after", &self.runs_after, cw));
            curves.push(dots("counter-clockwise, after", &self.runs_after, ccw));
        }
        curves.push(Curve::dots("home", vec![(0.0, 0.0)]));
        Plot::new(
            format!("UMBmark: {}", self.source),
            format!("systematic error {:.1} mm", 1e3 * self.result.error.systematic_m),
            vec![Axes::new("ahead [m]", "left [m]", 420.0, curves).with_equal_scales()],
        )
    }
}

const fn direction_name(direction: SquareDirection) -> &'static str {
    match direction {
        SquareDirection::Clockwise => "cw",
        SquareDirection::CounterClockwise => "ccw",
    }
}

/// The simulated squares; the file documents every number.
const SCENARIO: &str = include_str!("../../../config/calibrate/umbmark.toml");
/// Sigma of the simulation's ground truth: exact, but a sigma must be positive.
const EXACT_M: f64 = 1e-4;

/// Reads ends of squares, measured minus odometry, from the columns `direction` (cw or ccw), `x_mm`, `y_mm` and, if the odometry did
/// not end at the start, `odometry_x_mm`, `odometry_y_mm`.
fn read_squares(path: &Path) -> Result<Vec<SquareRun>> {
    let listing = CsvTable::read(path)?;
    let has_odometry = listing.has("odometry_x_mm") || listing.has("odometry_y_mm");
    let runs = listing.rows().map(|row| {
        let direction = match row.text("direction")? {
            "cw" => SquareDirection::Clockwise,
            "ccw" => SquareDirection::CounterClockwise,
            other => bail!("{}: `{other}` in column `direction` is neither cw nor ccw", row.location()),
        };
        let off = |measured: &str, odometry: &str| -> Result<f64> {
            let shown = if has_odometry { row.number(odometry)? } else { 0.0 };
            Ok(1e-3 * (row.number(measured)? - shown))
        };
        Ok(SquareRun { direction, ahead_m: off("x_mm", "odometry_x_mm")?, left_m: off("y_mm", "odometry_y_mm")? })
    });
    runs.collect()
}

fn cut_lap(drive: &Drive, config: &FilterConfig, first: usize, last: usize) -> Result<FreePath> {
    let start = drive.truth.get(first).ok_or_else(|| anyhow!("a simulated lap begins after its drive"))?;
    let config = FilterConfig {
        start: Some(StartPose { pose: *start, position_sigma_m: EXACT_M, heading_sigma_rad: EXACT_M }),
        ..config.clone()
    };
    let observations: Vec<Observation> = drive
        .arrivals
        .iter()
        .filter(|arrival| (first..=last).contains(&arrival.step))
        .map(|arrival| arrival.observation)
        .collect();
    let fixes = (first..=last).filter_map(|step| {
        let pose = drive.truth.get(step)?;
        Some(PositionFix {
            at_s: seconds(drive.time_at(step)),
            position_m: [pose.x.0, pose.y.0],
            sigma_m: EXACT_M,
            tag_m: [0.0; 2],
        })
    });
    let name = format!("steps {first} to {last}");
    Ok(FreePath::new(&name, &config, &observations, fixes))
}
