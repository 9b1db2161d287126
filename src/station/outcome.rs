//! What a run leaves for people: tables, pictures, what was learned.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_sim::{Simulation, Steering};
use posebridge_telemetry::TimeDelta;

use super::args::RunArgs;
use super::event_collector::EventCollector;
use super::learned_calibration::{learned_table, save};
use super::links::FinishedSimulation;
use super::run_outputs::RecordedFiles;
use super::run_report::{self as report, SimulationTruth};
use super::session::Session;
use crate::config::{Config, Provenance};
use crate::console::print_result;
use crate::virtual_station;

/// Tables and pictures.
pub(super) fn finish(
    config: &Config,
    folder: &Path,
    collector: &EventCollector,
    driven: Option<FinishedSimulation>,
    recorded: &RecordedFiles,
) -> Result<()> {
    let mut title = "live run".to_owned();
    let mut truth = None;
    let mut other = None;
    let mut covered = None;
    if let Some(driven) = driven {
        title = format!("{}, seed {}", driven.name, driven.scenario.seed);
        if driven.is_complete {
            other = Some(simulate_other_steering(config, &driven)?);
        }
        truth = Some(SimulationTruth::from_simulation(&driven.simulation));
        covered = covered_by_tables(&driven.simulation);
    }
    let mut text = report::sources(collector) + "\n" + &report::links(collector) + "\n";
    if let Some(covered) = covered {
        text += &covered;
    }
    if let Some(truth) = &truth {
        text += &report::table(collector, truth, other.as_ref());
        text += "\n";
    }
    let drawn = report::draw(folder, &title, collector, truth.as_ref());
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

/// Prints and saves what the filter has learned about the robot.
pub(super) fn report_learned(args: &RunArgs, config: &Config, session: &Session) -> Result<()> {
    let learned = session.learned.as_ref();
    if let Some(learned) = learned {
        print_result(&learned_table(std::slice::from_ref(learned)))?;
    }
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    let learned = learned.context("nothing was observed, so there is no calibration to save")?;
    let provenance = Provenance {
        utc_micros: session.timer.utc_start(),
        source: format!("live run, {}", session.folder.display()),
        filter: config.filter.name.clone(),
    };
    save(path, learned, &provenance)
}

/// The same world, steered by the brick's own odometry where the run steered by the estimate, and the other way round.
fn simulate_other_steering(config: &Config, driven: &FinishedSimulation) -> Result<SimulationTruth> {
    let other = match driven.scenario.steering {
        Steering::Odometry => Steering::Estimate,
        Steering::Estimate => Steering::Odometry,
    };
    let mut pipeline = config.station_config()?;
    pipeline.links.retain(|link| link.id == driven.link);
    let run = virtual_station::run(driven.scenario.clone().with_steering(other), pipeline)?;
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
