//! `posebridge sim`: the simulated brick as a process of its own.
//!
//! It waits on a link for a station, or calls one, drives its path and writes the truth to a file if asked. The truth never
//! goes over the link.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_link::HostTimer;
use posebridge_sim::{Scenario, Simulation, Steering};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::run::Signals;
use super::{Failure, Stage, station_link};
use crate::cli::{SimArgs, StationLink, SteerBy};
use crate::link_target::load_scenario;
use crate::stderr::say;
use crate::tasks::sim_brick::drive;
use crate::truth_file;

/// Runs the brick until its path ends or somebody stops it.
///
/// # Errors
/// The scenario or the link makes no sense, or the truth cannot be written.
pub fn execute(args: &SimArgs) -> Result<(), Failure> {
    let scenario = scenario(args).at_start()?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .at_start()?;
    let simulation = runtime.block_on(brick(simulation(scenario, args), &args.link))?;
    if let Some(path) = &args.truth {
        write_truth(path, &simulation).while_running()?;
    }
    Ok(())
}

fn scenario(args: &SimArgs) -> Result<Scenario> {
    let mut scenario = load_scenario(&args.scenario)?;
    if let Some(seed) = args.seed {
        scenario = scenario.with_seed(seed);
    }
    if let Some(laps) = args.laps {
        scenario = scenario.with_laps(laps);
    }
    if let Some(steer) = args.steer {
        scenario = scenario.with_steering(match steer {
            SteerBy::Odometry => Steering::Odometry,
            SteerBy::Estimate => Steering::Estimate,
        });
    }
    Ok(scenario)
}

/// The world; without a file for its truth it keeps none, so that it may run for days.
fn simulation(scenario: Scenario, args: &SimArgs) -> Simulation {
    let simulation = Simulation::new(scenario);
    if args.truth.is_some() {
        simulation
    } else {
        simulation.without_history()
    }
}

async fn brick(mut simulation: Simulation, link: &StationLink) -> Result<Simulation, Failure> {
    let timer = HostTimer::start();
    let mut signals = Signals::listen().at_start()?;
    let mut port = station_link::port(link, timer).at_start()?;
    let place = station_link::open(link, &mut port).await.at_start()?;
    say(&format!(
        "brick up, seed {}, {place}",
        simulation.scenario().seed
    ));
    let stop = CancellationToken::new();
    let (progress, _) = watch::channel(0.0);
    tokio::select! {
        () = drive(&mut simulation, &mut port, timer, &stop, &progress) => {}
        () = signals.received() => {}
    }
    Ok(simulation)
}

fn write_truth(path: &Path, simulation: &Simulation) -> Result<()> {
    let text = truth_file::write(simulation.truth());
    std::fs::write(path, text).with_context(|| format!("writing the truth to `{}`", path.display()))
}
