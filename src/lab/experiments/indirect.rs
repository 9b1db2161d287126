//! `posebridge lab indirect`: the square of paper 4, by wheels alone and with the indirect filter.
//!
//! Every run is one round of the square, simulated or by a real robot; the rows differ in the sensors that the filter uses.
//! docs/lab/indirect.md is the lesson.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use posebridge_estimator::find_filter;
use posebridge_lab::end_errors::{
    EndErrorSummary, FilteredDrive, PairedDifference, TrackPoint, count_nearer, paired_difference, run_filter,
    summarise_ends,
};
use posebridge_report::chart::{Axes, Curve, Plot};
use posebridge_report::metrics::PoseError;
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_report::tables::NO_VALUE;
use posebridge_sim::montecarlo::{MAX_RUNS, Scenario};
use posebridge_telemetry::ObservationKind;
use serde_json::{Value, json};

use super::indirect_drive::{PAPER_END_M, draw_drive};
use super::indirect_map;
use super::recorded::{self, RecordedArgs, RobotDrive, RobotDrives};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::lab::drives::{self, drawn_config};
use crate::lab::parallel::run_with_bar;
use crate::tools::experiment_output::OutputArgs;

const SQUARE: &str = include_str!("../../../config/scenarios/lab/indirect.toml");

/// Flags of `lab indirect`.
#[derive(clap::Args, Clone, Debug)]
pub struct LabIndirectArgs {
    /// Robot, sensors and square, as a TOML file. Default: config/scenarios/lab/indirect.toml.
    #[arg(long, value_name = "FILE.toml", conflicts_with = "real_robot")]
    pub scenario: Option<PathBuf>,
    /// Number of rounds. Default: that of the scenario.
    #[arg(long, value_name = "N", conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_RUNS)))]
    pub runs: Option<u32>,
    /// Number of robots of the map: each has wheels and accelerometers of its own; 0 leaves the map out.
    #[arg(long, value_name = "N", default_value_t = 200, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(..=i64::from(MAX_RUNS)))]
    pub robots: u32,
    /// Base seed. Default: that of the scenario.
    #[arg(long, value_name = "N", conflicts_with = "real_robot")]
    pub seed: Option<u64>,
    /// A real robot.
    #[command(flatten)]
    pub real: RecordedArgs,
    /// Where the results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub fn execute(args: &LabIndirectArgs) -> Result<(), Failure> {
    if let Some(drives) = args.real.drives(&args.output, TASK, None)? {
        let found = drives.with_exit_stage(rounds_of(&drives))?;
        let folder = args.output.folder()?;
        return args.output.write_outcome(&folder, &recordings_report(&drives, &found));
    }
    let scenario = scenario(args).before_start()?;
    let runs = args.runs.unwrap_or(scenario.runs);
    let folder = args.output.folder()?;
    let found = drive_all(&scenario, runs).before_start()?;
    let mut report = scenario_report(&scenario, runs, &found);
    indirect_map::add_map(&mut report, &indirect_map::drive_robots(&scenario, args.robots).before_start()?);
    args.output.write_outcome(&folder, &report)
}

fn scenario(args: &LabIndirectArgs) -> Result<Scenario> {
    let scenario = match &args.scenario {
        None => Scenario::from_toml(SQUARE)?,
        Some(path) => drives::load_scenario(&path.to_string_lossy())?.1,
    };
    Ok(args.seed.map_or(scenario.clone(), |seed| scenario.with_seed(seed)))
}

const TASK: &str = "leave the robot standing for two seconds, then drive the closed square, and let it stand again";

/// Runs every row over every drive on all cores. Rows with sensors that a recording lacks are omitted.
fn rounds_of(drives: &RobotDrives) -> Result<RoundsResult> {
    for one in &drives.drives {
        ensure!(
            one.drive.contains(is_acceleration),
            "`{}` holds no accelerations of the wheels, and the indirect filter is about them: let the robot send INERTIAL with \
             both, or compare its wheels and gyro by `posebridge lab nxt-square --recording`",
            one.name
        );
    }
    let is_turn = |observed: &ObservationKind| matches!(observed, ObservationKind::TurnRate(_));
    let has_gyro = drives.drives.iter().all(|one| one.drive.contains(is_turn));
    if !has_gyro {
        print_line("no gyro in every recording: the rows with a gyro are left out");
    }
    let rows: Vec<FilterRow> =
        ROWS.into_iter().filter(|row| has_gyro || row.sensors != SensorSet::AccelerometersAndGyro).collect();
    let rounds = run_with_bar(&drives.drives, "drives", |one| recorded_round(one, &rows))?;
    let fixes = drives.drives.first().map(|one| one.drive.fix_track());
    Ok(evaluate(&rows, &rounds, fixes.unwrap_or_default()))
}

fn is_acceleration(observed: &ObservationKind) -> bool {
    matches!(observed, ObservationKind::WheelAccelerations { .. })
}

/// Runs every row over one drive; fixes are used only for its end.
fn recorded_round(one: &RobotDrive, rows: &[FilterRow]) -> Vec<FilteredDrive> {
    let courses = rows.iter().filter_map(|row| {
        let mut filter = (find_filter(row.filter)?.build)(&one.config);
        let accepts = |observed: &ObservationKind| row.sensors.accepts(observed);
        Some(one.drive.run_filter(filter.as_mut(), accepts))
    });
    courses.collect()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct FilterRow {
    filter: &'static str,
    sensors: SensorSet,
}

/// Sensors used besides the wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SensorSet {
    Wheels,
    Accelerometers,
    AccelerometersAndGyro,
}

impl SensorSet {
    const fn name(self) -> &'static str {
        match self {
            Self::Wheels => "wheels",
            Self::Accelerometers => "+ accelerometers",
            Self::AccelerometersAndGyro => "+ gyro",
        }
    }

    /// Whether an observation of this kind is used; all others, such as fixes, are not.
    const fn accepts(self, observed: &ObservationKind) -> bool {
        matches!(
            (observed, self),
            (ObservationKind::WheelAngles { .. }, _)
                | (ObservationKind::WheelAccelerations { .. }, Self::Accelerometers | Self::AccelerometersAndGyro)
                | (ObservationKind::TurnRate(_), Self::AccelerometersAndGyro)
        )
    }
}

/// In the order of the table; the first is the reference.
const ROWS: [FilterRow; 5] = [
    row("odometry", SensorSet::Wheels),
    row("indirect", SensorSet::Accelerometers),
    row("indirect-feedback", SensorSet::Accelerometers),
    row("indirect", SensorSet::AccelerometersAndGyro),
    row("indirect-feedback", SensorSet::AccelerometersAndGyro),
];

const fn row(filter: &'static str, sensors: SensorSet) -> FilterRow {
    FilterRow { filter, sensors }
}

struct RowResult {
    row: FilterRow,
    ends: Vec<Option<PoseError>>,
    summary: EndErrorSummary,
    /// Rounds that end nearer than with the wheels alone.
    nearer_than_wheels: usize,
    /// Rounds that end nearer than with the other feedback method on the same sensors.
    nearer_than_twin: Option<usize>,
    /// Reduction of the squared errors against the other method.
    gain_on_twin: Option<PairedDifference>,
    track: Vec<TrackPoint>,
}

struct RoundsResult {
    rows: Vec<RowResult>,
    /// True path of the first round; for a recording, the camera's positions.
    truth: Vec<TrackPoint>,
}

fn drive_all(scenario: &Scenario, runs: u32) -> Result<RoundsResult> {
    let jobs: Vec<u32> = (0..runs).collect();
    let rounds = run_with_bar(&jobs, "rounds", |run| round(scenario, *run))?;
    let first = draw_drive(scenario, 0);
    let truth = first.truth.iter().enumerate().map(|(step, pose)| TrackPoint {
        at_s: first.time_at(step).as_secs_f64(),
        x_m: pose.x.0,
        y_m: pose.y.0,
    });
    Ok(evaluate(&ROWS, &rounds, truth.collect()))
}

/// Summarises the rounds for each row; `truth` is the path of the first round by an independent instrument.
fn evaluate(selected: &[FilterRow], rounds: &[Vec<FilteredDrive>], truth: Vec<TrackPoint>) -> RoundsResult {
    let mut rows: Vec<RowResult> = Vec::new();
    for (index, row) in selected.iter().copied().enumerate() {
        let courses = rounds.iter().filter_map(|round| round.get(index));
        let ends: Vec<Option<PoseError>> = courses.map(|course| course.end).collect();
        let first = rounds.first().and_then(|round| round.get(index));
        let of = |rows: &[RowResult], matches: &dyn Fn(&FilterRow) -> bool| {
            let found = rows.iter().find(|found| matches(&found.row));
            found.map(|found| count_nearer(&ends, &found.ends))
        };
        rows.push(RowResult {
            row,
            summary: summarise_ends(&ends, PAPER_END_M),
            nearer_than_wheels: of(&rows, &|other| other.sensors == SensorSet::Wheels).unwrap_or(0),
            nearer_than_twin: of(&rows, &|other| is_twin(other, row)),
            gain_on_twin: rows
                .iter()
                .find(|found| is_twin(&found.row, row))
                .and_then(|twin| paired_difference(&ends, &twin.ends)),
            track: first.map_or_else(Vec::new, |course| course.track.clone()),
            ends,
        });
    }
    RoundsResult { rows, truth }
}

/// Whether another row uses the same sensors in the other filter.
fn is_twin(other: &FilterRow, row: FilterRow) -> bool {
    other.sensors == row.sensors && other.filter != row.filter
}

fn round(scenario: &Scenario, run: u32) -> Vec<FilteredDrive> {
    let drive = draw_drive(scenario, run);
    let config = drawn_config(&drive.prior);
    let Some(truth) = drive.truth.last().copied() else {
        return Vec::new();
    };
    let courses = ROWS.iter().filter_map(|row| {
        let mut filter = (find_filter(row.filter)?.build)(&config);
        let observations = drive.arrivals.iter().map(|arrival| &arrival.observation);
        let accepted = observations.filter(|observation| row.sensors.accepts(&observation.measurement));
        let course = run_filter(filter.as_mut(), accepted, truth);
        // Only the first round is drawn.
        let track = if run == 0 { course.track } else { Vec::new() };
        Some(FilteredDrive { track, ..course })
    });
    courses.collect()
}

fn scenario_report(scenario: &Scenario, runs: u32, found: &RoundsResult) -> Report {
    let headline = format!("End of {runs} rounds of the square, seed {}", scenario.seed);
    let mut report = report(headline, recorded::rerun_command(None), "true", found);
    report.data("seed", json!(scenario.seed));
    report.data("runs", json!(runs));
    report
}

fn recordings_report(drives: &RobotDrives, found: &RoundsResult) -> Report {
    let names = drives.names();
    let headline =
        format!("End of {} recorded drives ({}), judged by {}", names.len(), names.join(", "), drives.reference_name());
    let mut report = report(headline, drives.command(), "camera", found);
    report.data("recordings", json!(names));
    report.data("runs", json!(names.len()));
    report.data("judged_by", json!(drives.reference_name()));
    report
}

/// `truth` is the label of the reference in the figures.
fn report(headline: String, command: String, truth: &str, found: &RoundsResult) -> Report {
    let mut report = Report::new("lab-indirect", "The indirect Kalman filter on a square");
    report.background(
        "A robot drives round a square by its wheels, believes that it is back, and is not. What do two accelerometers know \
         about that, and what does it change to feed the error back?",
    );
    report.command(command);
    let median_m = |row: &&RowResult| row.summary.median_m;
    let is_fused = |row: &&RowResult| row.row.sensors != SensorSet::Wheels;
    let best = found.rows.iter().filter(is_fused).min_by(|one, other| median_m(one).total_cmp(&median_m(other)));
    if let Some((wheels, best)) = found.rows.iter().find(|row| !is_fused(row)).zip(best) {
        report.answer(format!(
            "At the end the wheels alone are {:.0} mm off (median); nearest is {} {}, {:.0} mm.",
            wheels.summary.median_m * 1e3,
            best.row.filter,
            best.row.sensors.name(),
            best.summary.median_m * 1e3
        ));
    }
    report.heading(headline);
    report.table("rows", &table(&found.rows));
    report.paragraph(format!(
        "p95: 95 % of the ends are below. Within: {:.1} cm in x, {:.0} cm in y, the end of the paper's fused run; the last number is in both. Nearer: rounds that end \
         nearer than the wheels alone, and than feed-forward from the same sensors. Better: mean squared error of feed-forward less \
         that of feedback.",
        100.0 * PAPER_END_M.0,
        100.0 * PAPER_END_M.1
    ));
    report.data("paper_end_m", json!({ "x": PAPER_END_M.0, "y": PAPER_END_M.1 }));
    let (tracks, times, ends) = (tracks(truth, found), over_time(truth, found), ends(found));
    report.chart(&tracks, tracks.title.as_str());
    report.chart(&times, times.title.as_str());
    report.chart(&ends, ends.title.as_str());
    report
}

fn table(rows: &[RowResult]) -> Table<'_, RowResult> {
    let metres = Format::new(Unit::Named("m"), 3);
    let is_fused = |row: &RowResult| row.row.sensors != SensorSet::Wheels;
    Table::of(rows)
        .text("filter", "filter", |row| row.row.filter.to_owned())
        .text("sensors", "sensors", |row| row.row.sensors.name().to_owned())
        .labels(2)
        .data("runs", |row| json!(row.summary.runs))
        .number("rms_x_m", "rms x", metres, |row| Some(row.summary.rms_m.0))
        .number("rms_y_m", "y", metres, |row| Some(row.summary.rms_m.1))
        .number("p95_x_m", "p95 x", metres, |row| Some(row.summary.p95_m.0))
        .number("p95_y_m", "y", metres, |row| Some(row.summary.p95_m.1))
        .number("median_m", "median", metres, |row| Some(row.summary.median_m))
        .number("anees", "NEES/3", Format::new(Unit::None, 2), |row| row.summary.anees)
        .count("within_x", "within x", |row| row.summary.within.0)
        .count("within_y", "y", |row| row.summary.within.1)
        .count("within_both", "both", |row| row.summary.within.2)
        .optional_count("", "nearer than wheels", move |row| is_fused(row).then_some(row.nearer_than_wheels))
        .data("nearer_than_wheels", |row| json!(row.nearer_than_wheels))
        .optional_count("nearer_than_feed_forward", "than feed-forward", |row| row.nearer_than_twin)
        .text("", "better by x / y cm2", |row| row.gain_on_twin.as_ref().map_or(NO_VALUE.to_owned(), gain_cm2))
        .data("better_than_feed_forward_m2", |row| json!(row.gain_on_twin.as_ref().map(gain_json)))
        .data("ends_m", |row| row.ends.iter().map(|end| json!(end.map(|end| [end.dx_m, end.dy_m]))).collect())
}

fn gain_cm2(gain: &PairedDifference) -> String {
    let of = |mean_m2: f64, sigma_m2: f64| format!("{:+.1}±{:.1}", 1e4 * mean_m2, 1e4 * sigma_m2);
    format!("{} / {}", of(gain.mean_m2.0, gain.sigma_m2.0), of(gain.mean_m2.1, gain.sigma_m2.1))
}

fn gain_json(gain: &PairedDifference) -> Value {
    json!({ "x": gain.mean_m2.0, "x_sigma": gain.sigma_m2.0, "y": gain.mean_m2.1, "y_sigma": gain.sigma_m2.1 })
}

/// Short enough for a legend.
fn name(found: &RowResult) -> String {
    let how = match found.row.filter {
        "indirect" => "forward",
        "indirect-feedback" => "feedback",
        other => other,
    };
    match found.row.sensors {
        SensorSet::Wheels => "wheels".to_owned(),
        SensorSet::Accelerometers => format!("{how} + acc."),
        SensorSet::AccelerometersAndGyro => format!("{how} + gyro"),
    }
}

/// The reference and then every row, each drawn by `place` and thinned.
fn curves_of(
    true_name: &str,
    found: &RoundsResult,
    thinned: impl Fn(Vec<(f64, f64)>) -> Vec<(f64, f64)>,
    place: impl Fn(&TrackPoint) -> (f64, f64),
) -> Vec<Curve> {
    let line = |name: String, track: &[TrackPoint]| Curve::line(name, thinned(track.iter().map(&place).collect()));
    let truth = (!found.truth.is_empty()).then(|| line(true_name.to_owned(), &found.truth));
    truth.into_iter().chain(found.rows.iter().map(|row| line(name(row), &row.track))).collect()
}

fn tracks(true_name: &str, found: &RoundsResult) -> Plot {
    let curves = curves_of(true_name, found, |track| track, |at| (at.x_m, at.y_m));
    let axes = Axes::new("x [m]", "y [m]", 560.0, curves).with_equal_scales();
    Plot::new("The first round: true and believed ways", "", vec![axes])
}

/// Between the points of X(t) and Y(t), s: four pixels of a round.
const TIME_STEP_S: f64 = 0.5;

/// The paper's figures of X(t) and Y(t).
fn over_time(true_name: &str, found: &RoundsResult) -> Plot {
    let thinned = |mut curve: Vec<(f64, f64)>| {
        let mut kept_s = f64::NEG_INFINITY;
        let last = curve.pop();
        curve.retain(|(at_s, _)| {
            let is_kept = at_s - kept_s >= TIME_STEP_S;
            kept_s = if is_kept { *at_s } else { kept_s };
            is_kept
        });
        curve.extend(last);
        curve
    };
    let x = curves_of(true_name, found, thinned, |at| (at.at_s, at.x_m));
    let y = curves_of(true_name, found, thinned, |at| (at.at_s, at.y_m));
    let axes = vec![Axes::new("", "X(t) [m]", 260.0, x), Axes::new("time [s]", "Y(t) [m]", 260.0, y)];
    Plot::new("The first round: X(t) and Y(t)", "", axes)
}

fn ends(found: &RoundsResult) -> Plot {
    let curves =
        found.rows.iter().map(|row| Curve::dots(name(row), row.ends.iter().flatten().map(|end| (end.dx_m, end.dy_m))));
    let axes = Axes::new("x [m]", "y [m]", 480.0, curves).with_equal_scales();
    Plot::new("Where the rounds end: believed minus true", "", vec![axes])
}
