//! The end of a run: the result in a few lines, tables of errors, two figures, and the estimated calibration.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_report::metrics::{PathError, errors_of_estimates, errors_of_track, path_error, summarise};
use posebridge_report::tables::{RobotErrors, RobotRow, robots_table, run_table, source_table, wrapped};
use posebridge_report::{
    ErrorSummary, FIGURES, FilterVerdict, PoseTrack, RunAnswer, RunLayers, RunRow, TimedPose, source_verdicts,
};
use posebridge_sim::{Simulation, Steering, TruthSample};
use posebridge_telemetry::{Arena, Point2, TimeDelta};

use super::args::RunArgs;
use super::event_collector::{EventCollector, MAX_INTERPOLATION_GAP};
use super::learned_calibration::{LearnedCalibration, learned_table, save_all};
use super::link_report;
use super::links::FinishedSimulation;
use super::per_robot::PerRobot;
use super::session::Session;
use crate::config::{Config, Provenance};
use crate::console::{colour, print_result};
use crate::flags::DetailFlags;
use crate::virtual_station;

pub struct SimulationTruth {
    pub track: PoseTrack,
    pub odometry: PoseTrack,
    pub path: Vec<Point2<Arena>>,
    pub path_error: PathError,
    pub steering: Steering,
}

impl SimulationTruth {
    pub fn from_simulation(simulation: &Simulation) -> Self {
        let samples = simulation.truth();
        let positions: Vec<Point2<Arena>> = samples.iter().map(|sample| sample.pose.origin()).collect();
        let track = |pose: fn(&TruthSample) -> posebridge_telemetry::Pose<Arena>| {
            PoseTrack::new(
                samples.iter().map(|sample| TimedPose { time: sample.brick_time, pose: pose(sample) }),
                MAX_INTERPOLATION_GAP,
            )
        };
        Self {
            track: track(|sample| sample.pose),
            odometry: track(|sample| sample.odometry),
            path: simulation.path().to_vec(),
            path_error: path_error(&positions, simulation.path()),
            steering: simulation.scenario().steering,
        }
    }
}

/// Errors of the estimate and of the brick's odometry.
pub fn errors(collector: &EventCollector, truth: &SimulationTruth) -> (ErrorSummary, ErrorSummary) {
    let estimate = summarise(&errors_of_estimates(collector.estimates.items(), &truth.track));
    let odometry = summarise(&errors_of_track(&truth.odometry, &truth.track));
    (estimate, odometry)
}

pub const BRICK_ODOMETRY: &str = "the brick's odometry";

/// The error table of a run with known truth; `other` is the same world with the other steering.
fn table(collector: &EventCollector, truth: &SimulationTruth, other: Option<&SimulationTruth>) -> String {
    let (estimate, odometry) = errors(collector, truth);
    let compared: Vec<(&str, ErrorSummary)> = collector
        .compared
        .iter()
        .map(|compared| (compared.name, summarise(&errors_of_estimates(compared.estimates.items(), &truth.track))))
        .collect();
    let mut rows =
        vec![RunRow { name: BRICK_ODOMETRY, errors: &odometry }, RunRow { name: "estimate", errors: &estimate }];
    rows.extend(compared.iter().map(|(name, errors)| RunRow { name, errors }));
    let mut text = run_table(&rows);
    // Writing to a String cannot fail.
    let _ = writeln!(text, "\npath error when steering by     rms mm    max mm");
    for run in other.into_iter().chain([truth]) {
        let name = match run.steering {
            Steering::Odometry => BRICK_ODOMETRY,
            Steering::Estimate => "the estimate",
        };
        let millimetres = |metres: Option<f64>| metres.map_or_else(|| "-".to_owned(), |m| format!("{:.1}", m * 1e3));
        let PathError { rms_m, max_m, .. } = run.path_error;
        let _ = writeln!(text, "  {name:<28} {:>8}  {:>8}", millimetres(rms_m), millimetres(max_m));
    }
    text
}

/// With more robots the calibrations are not printed line by line.
const MAX_LEARNED_TABLES: usize = 4;

/// Prints the result first, then tables, then the files; draws the pictures.
pub(super) fn finish(args: &RunArgs, config: &Config, session: &Session) -> Result<()> {
    let folder = &session.folder;
    let robots = robots_of(&session.collectors, &session.simulations);
    let mut text = if let [robot] = robots.as_slice() {
        one_robot(args.detail, config, robot, &session.learned)?
    } else {
        several_robots(args.detail, &robots)
    };
    text += "\n";
    text += &learned_text(&session.learned);
    text += "\n";
    let drawn = draw(folder, &robots);
    for picture in drawn.iter().flatten() {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "picture    {}", picture.display());
    }
    let recorded = &session.recorded;
    for (recording, kept) in &recorded.inputs {
        let (file, inputs) = (recording.display(), kept.inputs);
        let parts = match kept.parts {
            ..=1 => String::new(),
            parts => format!(", {parts} parts"),
        };
        let _ = writeln!(text, "recording  {file} ({inputs} inputs{parts})");
    }
    if let Some(tlog) = &recorded.tlog {
        let (path, frames) = (tlog.path.display(), tlog.records);
        let _ = writeln!(text, "tlog       {path} ({frames} frames)");
    }
    if let Some(bag) = &recorded.bag {
        let (path, messages) = (bag.path.display(), bag.records);
        let _ = writeln!(text, "ros2       {path} ({messages} messages)");
    }
    if let Some((recording, _)) = recorded.inputs.first() {
        let recording = recording.display();
        let _ = writeln!(text, "report     posebridge report {recording}");
    }
    print_result(&text)?;
    drawn.map(drop).context("not all pictures are drawn")
}

/// The constants that were learned, for few robots one by one.
fn learned_text(learned: &[LearnedCalibration]) -> String {
    if learned.len() <= MAX_LEARNED_TABLES {
        return learned_table(learned);
    }
    format!("learned    of {} robots: `posebridge replay RECORDING --json` lists it\n", learned.len())
}

struct RobotOutcome<'r> {
    label: String,
    collector: &'r EventCollector,
    simulation: Option<&'r FinishedSimulation>,
    truth: Option<SimulationTruth>,
}

impl RobotOutcome<'_> {
    fn row(&self) -> RobotRow {
        let errors = self.truth.as_ref().map(|truth| {
            let (estimate, odometry) = errors(self.collector, truth);
            RobotErrors { odometry, estimate }
        });
        RobotRow {
            label: self.label.clone(),
            observations: self.collector.observations,
            estimates: self.collector.estimates.pushed() as u64,
            errors,
        }
    }
}

/// The robots of the session, or the unseen one, each with its simulation if it has one.
fn robots_of<'r>(
    collectors: &'r PerRobot<EventCollector>,
    simulations: &'r [FinishedSimulation],
) -> Vec<RobotOutcome<'r>> {
    let robots = collectors.entries().iter().map(|entry| {
        let simulation = simulations.iter().find(|one| one.robot.is_none() || one.robot == entry.robot);
        RobotOutcome {
            label: entry.label.clone(),
            collector: &entry.value,
            simulation,
            truth: simulation.map(|one| SimulationTruth::from_simulation(&one.simulation)),
        }
    });
    robots.collect()
}

fn one_robot(
    detail: DetailFlags,
    config: &Config,
    robot: &RobotOutcome<'_>,
    learned: &[LearnedCalibration],
) -> Result<String> {
    let RobotOutcome { collector, simulation, truth, .. } = robot;
    let errors = truth.as_ref().map(|truth| errors(collector, truth));
    let mut text = answer_text(
        collector,
        errors.as_ref().map_or(&ErrorSummary::default(), |(estimate, _)| estimate),
        errors.as_ref().map(|(_, odometry)| (BRICK_ODOMETRY, odometry)),
        learned.first(),
    );
    text += "\n";
    if let (Some(simulated), Some(truth)) = (simulation, truth) {
        let complete = simulated.is_complete.then(|| simulate_other_steering(config, simulated));
        let other = complete.transpose()?;
        text += &covered_by_tables(&simulated.simulation).unwrap_or_default();
        text += &table(collector, truth, other.as_ref());
        text += "\n";
    }
    if detail.verbose {
        text += &source_table(&collector.sources);
        text += "\n";
    }
    text += &links_text(detail, collector);
    Ok(text)
}

/// Pose, verdict and what was learned, or the state of a filter of another quantity.
pub fn answer_text(
    collector: &EventCollector,
    errors: &ErrorSummary,
    baseline: Option<(&str, &ErrorSummary)>,
    learned: Option<&LearnedCalibration>,
) -> String {
    let answer = RunAnswer {
        errors,
        baseline,
        last: collector.estimates.items().last(),
        quantity: collector.quantity_steps_text(),
        verdict: FilterVerdict::new(errors, 1, source_verdicts(&collector.sources)),
        learned: learned.map(LearnedCalibration::learned_keys).unwrap_or_default(),
    };
    answer.text(colour())
}

fn links_text(detail: DetailFlags, collector: &EventCollector) -> String {
    let links = collector.links.iter();
    if detail.verbose {
        return link_report::tables(links) + "\n";
    }
    links
        .map(|(id, report)| wrapped(&format!("{:<11}", format!("link {id}")), &link_report::condition(report)))
        .collect()
}

fn several_robots(detail: DetailFlags, robots: &[RobotOutcome<'_>]) -> String {
    let rows: Vec<RobotRow> = robots.iter().map(RobotOutcome::row).collect();
    let mut text = robots_table(&rows) + "\n";
    if let Some(first) = robots.first() {
        text += &links_text(detail, first.collector);
        let covered = first.simulation.and_then(|simulated| covered_by_tables(&simulated.simulation));
        text += &covered.unwrap_or_default();
    }
    text
}

/// Draws every figure of the first robot into a folder; returns the paths.
fn draw(folder: &Path, robots: &[RobotOutcome<'_>]) -> Result<Vec<PathBuf>> {
    let Some(RobotOutcome { label, collector, simulation, truth }) = robots.first() else {
        return Ok(Vec::new());
    };
    let mut title = simulation.map_or_else(
        || "live run".to_owned(),
        |simulated| format!("{}, seed {}", simulated.name, simulated.scenario.seed),
    );
    if robots.len() > 1 {
        title = format!("{title}, robot {label}");
    }
    let truth = truth.as_ref();
    let compared = collector.compared_tracks();
    let layers = RunLayers {
        compared: &compared,
        title: &title,
        ideal: truth.map_or(&[], |truth| &truth.path),
        truth: truth.map(|truth| &truth.track),
        odometry: truth.map(|truth| &truth.odometry),
        estimates: collector.estimates.items(),
        fixes: collector.fixes.items(),
        ..RunLayers::default()
    };
    let drawn = FIGURES.iter().map(|figure| {
        let path = folder.join(format!("{}.svg", figure.name));
        std::fs::write(&path, (figure.render)(&layers)).with_context(|| format!("writing `{}`", path.display()))?;
        Ok(path)
    });
    drawn.collect()
}

pub(super) fn save_learned(args: &RunArgs, config: &Config, session: &Session) -> Result<()> {
    let learned = &session.learned;
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    ensure!(!learned.is_empty(), "nothing was observed, so there is no calibration to save");
    let provenance = Provenance {
        utc_micros: session.timer.utc_start(),
        source: format!("live run, {}", session.folder.display()),
        filter: config.filter.name.clone(),
    };
    save_all(path, learned, &provenance)
}

/// The same world, steered by odometry if the run steered by the estimate, and vice versa.
fn simulate_other_steering(config: &Config, driven: &FinishedSimulation) -> Result<SimulationTruth> {
    let other = match driven.scenario.steering {
        Steering::Odometry => Steering::Estimate,
        Steering::Estimate => Steering::Odometry,
    };
    let mut station_config = config.station_config()?;
    station_config.links.retain(|link| link.id == driven.link);
    let run = virtual_station::run(driven.scenario.clone().with_steering(other), station_config)?;
    Ok(SimulationTruth::from_simulation(&run.simulation))
}

/// Describes the part that tables and figures cover, if not the whole run.
fn covered_by_tables(simulation: &Simulation) -> Option<String> {
    let first = simulation.truth().first()?;
    (first.sim_time > TimeDelta::ZERO).then(|| {
        format!(
            "errors and pictures: the last {:.0} s of {:.0} s\n",
            (simulation.elapsed() - first.sim_time).as_secs_f64(),
            simulation.elapsed().as_secs_f64()
        )
    })
}
