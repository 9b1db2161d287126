//! The links of a session, and the simulated brick behind one of them.

use std::path::Path;

use anyhow::{Result, bail};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkOpenConfig, LinkSet, LinkUrl};
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::LinkId;
use tokio_util::sync::CancellationToken;

use super::args::RunArgs;
use super::simulator::EmbeddedBrick;
use crate::config::{Config, LinkTarget, load_scenario};
use crate::console::print_line;

/// The simulated brick of a run, if it has one.
pub(super) struct EmbeddedLink {
    pub(super) brick: EmbeddedBrick,
    pub(super) scenario: Scenario,
    pub(super) name: String,
    pub(super) link: LinkId,
}

/// A simulated brick that has stopped.
pub(super) struct FinishedSimulation {
    pub(super) simulation: Simulation,
    pub(super) scenario: Scenario,
    pub(super) name: String,
    pub(super) link: LinkId,
    /// Whether it drove its path to the end: a lap that was cut short cannot be compared with a whole one.
    pub(super) is_complete: bool,
}

/// What a simulated brick has to know of the session that it is in.
#[derive(Clone, Copy)]
pub(super) struct SimulatedSession<'a> {
    pub(super) timer: HostTimer,
    /// Where its terminal appears.
    pub(super) folder: &'a Path,
    pub(super) laps: LapLimit,
}

/// How often a simulated brick drives its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LapLimit {
    /// Again and again, until somebody ends the run.
    Endless,
    /// As often as its scenario says.
    OfScenario,
    /// So often.
    Counted(u32),
}

impl LapLimit {
    fn apply_to(self, scenario: Scenario) -> Scenario {
        match self {
            Self::Endless => scenario.without_end(),
            Self::OfScenario => scenario,
            Self::Counted(laps) => scenario.with_laps(laps),
        }
    }
}

/// Tells everybody to stop and waits for the simulated brick, if there is one.
pub(super) fn stop_brick(
    embedded: Option<EmbeddedLink>,
    stop: &CancellationToken,
) -> Result<Option<FinishedSimulation>> {
    // Whoever is stopped is finished as well.
    let is_whole = embedded.as_ref().is_some_and(|embedded| embedded.brick.finished.is_cancelled());
    stop.cancel();
    let Some(embedded) = embedded else {
        return Ok(None);
    };
    Ok(Some(FinishedSimulation {
        is_complete: is_whole,
        simulation: embedded.brick.finish()?,
        scenario: embedded.scenario,
        name: embedded.name,
        link: embedded.link,
    }))
}

/// Opens what must open at once and starts simulated bricks.
pub(super) async fn open_links(
    args: &RunArgs,
    config: &Config,
    session: SimulatedSession<'_>,
    stop: &CancellationToken,
) -> Result<(LinkSet, Option<EmbeddedLink>)> {
    let mut ports = Vec::new();
    let mut embedded = None;
    for (index, (target, role)) in config.targets()?.into_iter().enumerate() {
        let (url, role) = match target {
            LinkTarget::Url(url) => (url, role),
            LinkTarget::Sim(name) => {
                if embedded.is_some() {
                    bail!("only one link may be sim://");
                }
                let scenario = load_scenario(&name)?;
                let scenario = args.seed.map_or_else(|| scenario.clone(), |seed| scenario.clone().with_seed(seed));
                let scenario = session.laps.apply_to(scenario);
                let path = session.folder.join("brick.tty");
                let brick = EmbeddedBrick::start(scenario.clone(), &path, session.timer, stop.clone())?;
                embedded = Some(EmbeddedLink { brick, scenario, name, link: LinkId(index as u16) });
                (LinkUrl::serial(&path)?, ConnectRole::Dial)
            }
        };
        ports.push(Link::new(LinkOpenConfig { id: LinkId(index as u16), url, role }, session.timer));
    }
    let mut ports = LinkSet::new(ports);
    ports
        .try_open_all()
        .await
        .map_err(|(id, error)| anyhow::Error::from(error).context(format!("opening link {}", id.0)))?;
    for port in &ports {
        if let (true, Some(address)) = (port.is_listening(), port.local_address()) {
            print_line(&format!("listening on {address}"));
        }
    }
    Ok((ports, embedded))
}
