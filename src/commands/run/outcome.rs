//! What a run leaves for people: tables, pictures, what was learned.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_sim::{Simulation, Steering};
use posebridge_telemetry::Span;

use super::links::Driven;
use super::records::Recorded;
use super::session::Session;
use crate::cli::RunArgs;
use crate::collect::Collector;
use crate::config::{Config, Provenance};
use crate::learned::{learned_table, save};
use crate::report::run::{self as report, Truth};
use crate::stdout;
use crate::virtual_run;

/// Tables and pictures.
pub(super) fn finish(
    config: &Config,
    folder: &Path,
    collector: &Collector,
    driven: Option<Driven>,
    recorded: &Recorded,
) -> Result<()> {
    let mut title = "live run".to_owned();
    let mut truth = None;
    let mut other = None;
    let mut covered = None;
    if let Some(driven) = driven {
        title = format!("{}, seed {}", driven.name, driven.scenario.seed);
        if driven.is_whole {
            other = Some(steered_the_other_way(config, &driven)?);
        }
        truth = Some(Truth::of(&driven.simulation));
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
    stdout::print(&text)?;
    drawn.map(drop).context("not all pictures are drawn")
}

/// Prints and saves what the filter has learned about the robot.
pub(super) fn report_learned(args: &RunArgs, config: &Config, session: &Session) -> Result<()> {
    let learned = session.learned.as_ref();
    if let Some(learned) = learned {
        stdout::print(&learned_table(std::slice::from_ref(learned)))?;
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
fn steered_the_other_way(config: &Config, driven: &Driven) -> Result<Truth> {
    let other = match driven.scenario.steering {
        Steering::Odometry => Steering::Estimate,
        Steering::Estimate => Steering::Odometry,
    };
    let mut pipeline = config.pipeline()?;
    pipeline.links.retain(|link| link.id == driven.link);
    let run = virtual_run::run(driven.scenario.clone().with_steering(other), pipeline)?;
    Ok(Truth::of(&run.simulation))
}

/// What tables and pictures are made of, where it is not the whole run.
fn covered_by_tables(simulation: &Simulation) -> Option<String> {
    let first = simulation.truth().first()?;
    (first.world > Span::ZERO).then(|| {
        format!(
            "errors and pictures: the last {:.0} s of {:.0} s\n",
            (simulation.elapsed() - first.world).as_secs_f64(),
            simulation.elapsed().as_secs_f64()
        )
    })
}
