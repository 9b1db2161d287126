//! `posebridge calibrate umbmark`: wheel difference and track from squares in both directions.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Result, anyhow, ensure};
use clap::Args;
use posebridge_analysis::calibration::CalibrationError;
use posebridge_analysis::calibration::free_path::FreePath;
use posebridge_analysis::calibration::umbmark::{
    Direction, SquareError, SquareRobot, SquareRun, Umbmark, square_error, umbmark,
};
use posebridge_analysis::calibration::umbmark_drives::{calibrate_squares, ends};
use posebridge_analysis::figures::{Axes, Curve, Plot, Shape, plot};
use posebridge_analysis::report::Table;
use posebridge_analysis::report::page::{Page, Part};
use posebridge_estimator::FilterConfig;
use posebridge_link::HostTimer;
use posebridge_telemetry::Calibration;
use serde_json::{Value, json};

use super::profile::{Calibrated, folded};
use super::source::{self, Drive, Watch};
use super::umbmark_source::{simulated, typed};
use crate::cli::DataFlags;
use crate::commands::lab::live::{LiveArgs, LiveRobot};
use crate::commands::lab::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};
use crate::config::{RobotFile, RobotProfile};
use crate::stderr::say;

/// A tape's or a tracker's sigma: only its being finite matters here.
const SEEN_SIGMA_M: f64 = 0.005;
/// What x and y say may lie apart by so much of what they say, before the drives are doubted.
const DOUBTFUL: f64 = 0.5;

/// What a person with a live robot is told to do.
const TASK: &str = "drive one square before the camera, back to where it began, in one direction, and stop there";

/// Flags of `calibrate umbmark`.
#[derive(Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("squares").required(true).multiple(true).args(["recordings", "link", "listen", "ends", "sim"]))]
pub struct UmbmarkArgs {
    /// Descriptors whose chosen runs are squares with a truth, and recordings (*.mcap), each of one square whose end a camera saw.
    #[arg(value_name = "RECORDING", conflicts_with_all = ["ends", "sim"])]
    pub recordings: Vec<PathBuf>,
    /// A live robot, for one more square.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// In place of a recording: a CSV table of the columns direction (cw or ccw), x_mm, y_mm: where the robot really was, ahead and to
    /// the left of its start, when it believed to be home.
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["sim", "real_robot", "run", "use_every", "settings"])]
    pub ends: Option<PathBuf>,
    /// In place of a recording: let the simulated robot drive.
    #[arg(long, conflicts_with_all = ["real_robot", "run", "use_every", "settings", "side_m"])]
    pub sim: bool,
    /// The robot of --ends: a profile with a [robot] table, the one by which the brick steered.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["recordings", "real_robot", "sim"])]
    pub robot: Option<PathBuf>,
    /// Length of a side, in metres; recorded drives tell it themselves.
    #[arg(long, value_name = "M")]
    pub side_m: Option<f64>,
    /// Simulated squares in each direction.
    #[arg(long, value_name = "N", default_value_t = 5, conflicts_with_all = ["recordings", "real_robot", "ends"], value_parser = clap::value_parser!(u32).range(1..=5))]
    pub runs: u32,
    /// Seed of the simulated robot, instead of its scenario's.
    #[arg(long, value_name = "N", conflicts_with_all = ["recordings", "real_robot", "ends"])]
    pub seed: Option<u64>,
    /// Write the robot as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// What the squares said, whatever their source.
struct Told {
    source: String,
    robot: RobotFile,
    side_m: f64,
    found: Umbmark,
    runs_before: Vec<SquareRun>,
    /// Recorded wheels can be reckoned anew.
    runs_after: Vec<SquareRun>,
    /// Squares that took no part, before and after.
    others: Option<[SquareError; 2]>,
    /// Of a simulated robot: its true track scale and wheel difference.
    truth: Option<[f64; 2]>,
}

/// Calibrates.
///
/// # Errors
/// There are no squares in both directions, a file or a flag makes no sense, or an output cannot be written.
pub(super) fn execute(args: &UmbmarkArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let folder = args.output.folder()?;
    let told = told(args)?;
    for line in told.doubts() {
        say(&format!("warning: {line}"));
    }
    if let Some(path) = &args.save {
        let found = told.calibration();
        let (robot, calibration) = folded(&told.robot, found).while_running()?;
        let calibrated = Calibrated {
            robot,
            calibration,
            source: told.source.clone(),
            by: "calibrate umbmark",
            remarks: told.lines(),
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.deliver(&folder, &told.outcome())
}

fn told(args: &UmbmarkArgs) -> Result<Told, Failure> {
    if let Some(side_m) = args.side_m
        && !(side_m > 0.0 && side_m.is_finite())
    {
        return Err(anyhow!("--side-m is {side_m}, must be more than zero")).at_start();
    }
    if let Some(path) = &args.ends {
        return of_typed(args, path).at_start();
    }
    if args.sim {
        return of_simulated(args).while_running();
    }
    let drives = drives(args)?;
    let Some(first) = drives.first() else {
        return Err(anyhow!("no run was chosen: see --run")).at_start();
    };
    let robots = drives.iter();
    let robots = robots.map(|drive| (drive.name.as_str(), &drive.config.geometry));
    source::same_robot(robots).at_start()?;
    let paths: Vec<FreePath> = drives
        .iter()
        .map(|drive| {
            let sights = drive.sights.iter().copied();
            FreePath::new(&drive.name, &drive.config, &drive.observations, sights)
        })
        .collect();
    let recorded =
        of_drives(&first.config, &paths, args.side_m).map_err(|error| advised(error, &drives)).while_running()?;
    Ok(Told { source: names(&drives), robot: first.robot.clone(), ..recorded })
}

/// The squares of all recordings, that of the live robot last.
fn drives(args: &UmbmarkArgs) -> Result<Vec<Drive>, Failure> {
    let watch = Watch { against: None, truth_sigma_m: SEEN_SIGMA_M };
    let robot = LiveRobot { file: None, settings: &args.data.settings };
    args.live.refuse_choice(&args.data)?;
    let live = args.live.record(&args.output, robot, TASK)?;
    let mut drives = Vec::new();
    for recording in args.recordings.iter().chain(&live) {
        drives.extend(source::load(recording, &args.data, watch)?.drives);
    }
    Ok(drives)
}

/// With what to do when a direction is missing: one recording is one square, unless a descriptor chooses several.
fn advised(error: anyhow::Error, drives: &[Drive]) -> anyhow::Error {
    let is_too_little = matches!(error.downcast_ref(), Some(CalibrationError::TooLittle { .. }));
    let are_seen = drives.iter().all(|drive| !drive.sights.is_empty());
    if !(is_too_little && are_seen) {
        return error;
    }
    error.context(format!(
        "squares in both directions are needed, each recorded by itself; so far: {}. Name all recordings, and add a live square by --link \
         or --listen with a new --out",
        names(drives)
    ))
}

fn names(drives: &[Drive]) -> String {
    let names: Vec<&str> = drives.iter().map(|drive| drive.name.as_str()).collect();
    names.join(", ")
}

fn of_typed(args: &UmbmarkArgs, path: &std::path::Path) -> Result<Told> {
    let robot = match &args.robot {
        Some(profile) => RobotProfile::read(profile)?.robot,
        None => RobotFile::default(),
    };
    ensure!(args.side_m.is_some(), "--ends needs --side-m: the length of a side of the square, in metres");
    let side_m = args.side_m.unwrap_or_default();
    let runs = typed(path)?;
    let square = SquareRobot { track_width_m: robot.geometry()?.track_width.0, side_m };
    Ok(Told {
        source: path.display().to_string(),
        found: umbmark(&runs, square)?,
        robot,
        side_m,
        runs_before: runs,
        runs_after: Vec::new(),
        others: None,
        truth: None,
    })
}

fn of_drives(config: &FilterConfig, paths: &[FreePath], side_m: Option<f64>) -> Result<Told> {
    let squares = calibrate_squares(config, paths, side_m)?;
    Ok(Told {
        source: String::new(),
        robot: RobotFile::default(),
        side_m: squares.side_m,
        found: squares.found,
        runs_before: squares.runs_before,
        runs_after: squares.runs_after,
        others: None,
        truth: None,
    })
}

fn of_simulated(args: &UmbmarkArgs) -> Result<Told> {
    let simulated = simulated(args.runs, args.seed)?;
    let squares = calibrate_squares(&simulated.config, &simulated.squares, Some(simulated.side_m))?;
    let error_of =
        |numbers| -> Result<SquareError> { Ok(square_error(&ends(&simulated.config, numbers, &simulated.others)?)?) };
    let others = [error_of(&squares.before)?, error_of(&squares.after)?];
    let (truth, told) = (simulated.true_geometry, simulated.config.geometry);
    let (left, right) = (truth.left_wheel_radius.0, truth.right_wheel_radius.0);
    Ok(Told {
        source: "the simulated robot".to_owned(),
        robot: simulated.robot,
        side_m: simulated.side_m,
        found: squares.found,
        runs_before: squares.runs_before,
        runs_after: squares.runs_after,
        others: Some(others),
        truth: Some([truth.track_width.0 / told.track_width.0 - 1.0, (right - left) / f64::midpoint(left, right)]),
    })
}

impl Told {
    fn calibration(&self) -> Calibration {
        let prior = &self.robot.calibration.radius_scale;
        Calibration {
            // A closed square does not see the mean wheel size.
            radius_scale: posebridge_telemetry::Known { value: 0.0, sigma: prior.sigma },
            radius_difference: self.found.radius_difference,
            track_scale: self.found.track_scale,
            ..Calibration::default()
        }
    }

    fn doubts(&self) -> Vec<String> {
        let largest = self.found.corner_rad.abs().max(self.found.bend_rad.abs());
        let mut doubts = Vec::new();
        if self.found.disagreement_rad > DOUBTFUL * largest.max(1e-4) {
            doubts.push(format!(
                "the ends along x and along y tell corners apart by {:.2} degrees: was one of them a square that ended elsewhere, or measured along another axis?",
                self.found.disagreement_rad.to_degrees()
            ));
        }
        doubts
    }

    fn lines(&self) -> Vec<String> {
        let Umbmark { track_scale, radius_difference, error, .. } = &self.found;
        let mut lines = vec![
            format!(
                "track_scale {:+.5} +- {:.5}, radius_difference {:+.5} +- {:.5}",
                track_scale.value, track_scale.sigma, radius_difference.value, radius_difference.sigma
            ),
            format!(
                "each corner turns {:+.3} degrees too far, each side bends to the left by {:+.3} degrees, squares of {:.2} m",
                -self.found.corner_rad.to_degrees(),
                self.found.bend_rad.to_degrees(),
                self.side_m
            ),
            format!("systematic error {:.1} mm, scatter {:.1} mm", 1e3 * error.systematic_m, 1e3 * error.scatter_m),
        ];
        if let Ok(after) = square_error(&self.runs_after) {
            lines.push(format!("the same squares reckoned anew: {:.1} mm", 1e3 * after.systematic_m));
        }
        if let Some([before, after]) = &self.others {
            lines.push(format!(
                "other squares: systematic error {:.1} mm before, {:.1} mm after: {:.1} times less",
                1e3 * before.systematic_m,
                1e3 * after.systematic_m,
                before.systematic_m / after.systematic_m
            ));
        }
        if let Some([track, difference]) = self.truth {
            lines.push(format!("the true ones: track_scale {track:+.5}, radius_difference {difference:+.5}"));
        }
        lines
    }

    fn outcome(&self) -> Outcome {
        Outcome { name: "calibrate-umbmark", page: self.page(), text: self.text(), json: self.json() }
    }

    fn text(&self) -> String {
        let mut text = format!("UMBmark: {}\n\n{}\n", self.source, self.table());
        for line in self.lines() {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{line}");
        }
        let found = &self.found;
        let _ = writeln!(
            text,
            "left wheel x {:.5}, right wheel x {:.5}, track x {:.5}",
            found.left_factor,
            found.right_factor,
            1.0 + found.track_scale.value
        );
        text
    }

    fn table(&self) -> String {
        let mut table = Table::new(["direction", "ahead mm", "left mm", "then", "then"]);
        for (index, run) in self.runs_before.iter().enumerate() {
            let then = self.runs_after.get(index);
            let cell =
                |metres: Option<f64>| metres.map_or_else(|| "-".to_owned(), |metres| format!("{:+.1}", 1e3 * metres));
            table.push([
                direction_name(run.direction).to_owned(),
                cell(Some(run.ahead_m)),
                cell(Some(run.left_m)),
                cell(then.map(|run| run.ahead_m)),
                cell(then.map(|run| run.left_m)),
            ]);
        }
        table.render()
    }

    fn page(&self) -> Page {
        Page {
            title: format!("UMBmark: {}", self.source),
            parts: vec![
                Part::Text("Where squares ended beside the place at which odometry believed them to end.".to_owned()),
                Part::Figure {
                    svg: self.picture(),
                    caption: "Two clouds away from home: a systematic error. Their size: chance.".to_owned(),
                },
                Part::List(self.lines()),
                Part::List(self.doubts()),
                Part::Lines(self.table()),
            ],
        }
    }

    fn picture(&self) -> String {
        let dots = |name: &str, runs: &[SquareRun], direction: Direction| {
            let ends = runs.iter().filter(|run| run.direction == direction);
            Curve { name: name.to_owned(), shape: Shape::Dots(ends.map(|run| (run.ahead_m, run.left_m)).collect()) }
        };
        let (cw, ccw) = (Direction::Clockwise, Direction::CounterClockwise);
        let mut curves =
            vec![dots("clockwise", &self.runs_before, cw), dots("counter-clockwise", &self.runs_before, ccw)];
        if !self.runs_after.is_empty() {
            curves.push(dots("clockwise, after", &self.runs_after, cw));
            curves.push(dots("counter-clockwise, after", &self.runs_after, ccw));
        }
        curves.push(Curve { name: "home".to_owned(), shape: Shape::Dots(vec![(0.0, 0.0)]) });
        plot(&Plot {
            title: format!("UMBmark: {}", self.source),
            key_figures: format!("systematic error {:.1} mm", 1e3 * self.found.error.systematic_m),
            axes: vec![Axes {
                x_name: "ahead [m]".to_owned(),
                y_name: "left [m]".to_owned(),
                height_px: 420.0,
                is_map: true,
                curves,
            }],
        })
    }

    fn json(&self) -> Value {
        let found = &self.found;
        json!({
            "source": self.source,
            "side_m": self.side_m,
            "track_scale": { "value": found.track_scale.value, "sigma": found.track_scale.sigma },
            "radius_difference": { "value": found.radius_difference.value, "sigma": found.radius_difference.sigma },
            "corner_rad": found.corner_rad,
            "bend_rad": found.bend_rad,
            "left_factor": found.left_factor,
            "right_factor": found.right_factor,
            "systematic_m": found.error.systematic_m,
            "scatter_m": found.error.scatter_m,
            "others": self.others.map(|errors| errors.map(|error| error.systematic_m)),
            "truth": self.truth,
            "doubts": self.doubts(),
        })
    }
}

const fn direction_name(direction: Direction) -> &'static str {
    match direction {
        Direction::Clockwise => "cw",
        Direction::CounterClockwise => "ccw",
    }
}
