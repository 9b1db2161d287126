//! What a run leaves for people: tables, pictures, what was learned.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_report::tables::{RobotErrors, RobotRow, robots_table};
use posebridge_sim::{Simulation, Steering};
use posebridge_telemetry::TimeDelta;

use super::args::RunArgs;
use super::event_collector::EventCollector;
use super::learned_calibration::{learned_table, save_all};
use super::links::FinishedSimulation;
use super::per_robot::PerRobot;
use super::run_outputs::RecordedFiles;
use super::run_report::{self as report, SimulationTruth};
use super::session::Session;
use crate::config::{Config, Provenance};
use crate::console::print_result;
use crate::virtual_station;

/// Of more robots what was learned is not printed line by line.
const MAX_LEARNED_TABLES: usize = 4;

/// Tables and pictures.
pub(super) fn finish(
    config: &Config,
    folder: &Path,
    collectors: &PerRobot<EventCollector>,
    simulations: &[FinishedSimulation],
    recorded: &RecordedFiles,
) -> Result<()> {
    let robots = robots_of(collectors, simulations);
    let mut text = String::new();
    if let [robot] = robots.as_slice() {
        text += &one_robot(config, robot)?;
    } else {
        text += &several_robots(&robots);
    }
    let drawn = draw(folder, &robots);
    for picture in drawn.iter().flatten() {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "picture    {}", picture.display());
    }
    for (recording, kept) in &recorded.inputs {
        let (file, inputs) = (recording.display(), kept.inputs);
        let parts = match kept.parts {
            ..=1 => String::new(),
            parts => format!(", {parts} parts"),
        };
        let _ = writeln!(text, "recording  {file} ({inputs} inputs{parts})");
    }
    if let Some(tlog) = &recorded.tlog {
        let (path, frames) = (tlog.path.display(), tlog.frames);
        let _ = writeln!(text, "tlog       {path} ({frames} frames)");
    }
    if let Some((recording, _)) = recorded.inputs.first() {
        let recording = recording.display();
        let _ = writeln!(text, "report     posebridge report {recording}");
    }
    print_result(&text)?;
    drawn.map(drop).context("not all pictures are drawn")
}

/// A robot when the run is over.
struct RobotOutcome<'r> {
    label: String,
    collector: &'r EventCollector,
    simulation: Option<&'r FinishedSimulation>,
    truth: Option<SimulationTruth>,
}

impl RobotOutcome<'_> {
    fn row(&self) -> RobotRow {
        let errors = self.truth.as_ref().map(|truth| {
            let (estimate, odometry) = report::errors(self.collector, truth);
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

/// The robots that were heard, or the one that was not, each with its simulation if it has one.
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

fn one_robot(config: &Config, robot: &RobotOutcome<'_>) -> Result<String> {
    let RobotOutcome { collector, simulation, truth, .. } = robot;
    let mut text = report::sources(collector) + "\n" + &report::links(collector) + "\n";
    if let (Some(simulated), Some(truth)) = (simulation, truth) {
        let complete = simulated.is_complete.then(|| simulate_other_steering(config, simulated));
        let other = complete.transpose()?;
        text += &covered_by_tables(&simulated.simulation).unwrap_or_default();
        text += &report::table(collector, truth, other.as_ref());
        text += "\n";
    }
    Ok(text)
}

fn several_robots(robots: &[RobotOutcome<'_>]) -> String {
    let rows: Vec<RobotRow> = robots.iter().map(RobotOutcome::row).collect();
    let mut text = robots_table(&rows) + "\n";
    if let Some(first) = robots.first() {
        text += &(report::links(first.collector) + "\n");
        let covered = first.simulation.and_then(|simulated| covered_by_tables(&simulated.simulation));
        text += &covered.unwrap_or_default();
    }
    text
}

/// Pictures of a robot alone, or of the first of several.
fn draw(folder: &Path, robots: &[RobotOutcome<'_>]) -> Result<Vec<PathBuf>> {
    let Some(robot) = robots.first() else {
        return Ok(Vec::new());
    };
    let mut title = robot.simulation.map_or_else(
        || "live run".to_owned(),
        |simulated| format!("{}, seed {}", simulated.name, simulated.scenario.seed),
    );
    if robots.len() > 1 {
        title = format!("{title}, robot {}", robot.label);
    }
    report::draw(folder, &title, robot.collector, robot.truth.as_ref())
}

/// Prints and saves what the filters have learned about the robots.
pub(super) fn report_learned(args: &RunArgs, config: &Config, session: &Session) -> Result<()> {
    let learned = &session.learned;
    if learned.len() <= MAX_LEARNED_TABLES {
        print_result(&learned_table(learned))?;
    } else {
        print_result(&format!(
            "learned    of {} robots: `posebridge replay RECORDING --json` lists it\n",
            learned.len()
        ))?;
    }
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

/// The same world, steered by the brick's own odometry where the run steered by the estimate, and the other way round.
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

/// What tables and pictures are made of, where it is not the whole run.
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
