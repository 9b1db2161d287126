//! `posebridge sim`: the simulated brick as a process of its own.
//!
//! It waits on a link for a station, or calls one, drives its path and writes the truth to a file if asked. The truth never
//! goes over the link.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, Role};
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_telemetry::LinkId;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::{Failure, Stage};
use crate::cli::{SimArgs, SteerBy};
use crate::link_target::load_scenario;
use crate::tasks::sim_brick::drive;
use crate::truth_file;

/// Runs the brick until its path ends or somebody stops it.
///
/// # Errors
/// The scenario or the link makes no sense, or the truth cannot be written.
pub fn execute(args: &SimArgs) -> Result<(), Failure> {
    let scenario = scenario(args).at_start()?;
    let (text, role) = match (&args.listen, &args.link) {
        (Some(url), _) => (url, Role::Listen),
        (None, Some(url)) => (url, Role::Dial),
        (None, None) => return Err(anyhow::anyhow!("give --listen URL or --link URL")).at_start(),
    };
    let url = LinkUrl::parse(text).at_start()?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .at_start()?;
    let simulation = runtime.block_on(brick(scenario, url, role))?;
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

async fn brick(scenario: Scenario, url: LinkUrl, role: Role) -> Result<Simulation, Failure> {
    let timer = HostTimer::start();
    let name = url.to_string();
    let mut port = Port::new(
        PortConfig {
            id: LinkId(0),
            url,
            role,
        },
        timer,
    );
    port.open_first()
        .await
        .with_context(|| format!("opening `{name}`"))
        .at_start()?;
    tracing::info!(link = name, seed = scenario.seed, "the brick is up");
    let mut simulation = Simulation::new(scenario);
    let stop = CancellationToken::new();
    let (progress, _) = watch::channel(0.0);
    tokio::select! {
        () = drive(&mut simulation, &mut port, timer, &stop, &progress) => {}
        () = super::run::interrupted() => {}
    }
    Ok(simulation)
}

fn write_truth(path: &Path, simulation: &Simulation) -> Result<()> {
    let text = truth_file::write(simulation.truth());
    std::fs::write(path, text).with_context(|| format!("writing the truth to `{}`", path.display()))
}
