//! The links of a session, and the simulated bricks behind one of them.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_link::{ConnectRole, FirstContact, HostTimer, Link, LinkOpenConfig, LinkSet, LinkTuning, LinkUrl};
use posebridge_sim::scenario::Personality;
use posebridge_sim::{BRICK, Scenario, Simulation};
use posebridge_telemetry::{LinkId, RobotId};
use tokio_util::sync::CancellationToken;

use super::args::RunArgs;
use super::cameras::Cameras;
use super::simulator::{BrickStart, EmbeddedBricks};
use crate::config::{Config, LinkTarget, load_scenario};
use crate::console::print_line;

/// Listening address of the station for several simulated bricks; the system chooses the port.
const SHARED_PORT: &str = "udp://127.0.0.1:0";

pub(super) struct FinishedSimulation {
    pub(super) simulation: Simulation,
    pub(super) scenario: Scenario,
    pub(super) name: String,
    pub(super) link: LinkId,
    /// `None` for the only one.
    pub(super) robot: Option<RobotId>,
    /// Whether it completed its path: an aborted lap cannot be compared with a whole one.
    pub(super) is_complete: bool,
}

#[derive(Clone, Copy)]
pub(super) struct SimulatedSession<'a> {
    pub(super) timer: HostTimer,
    pub(super) folder: &'a Path,
    pub(super) laps: LapLimit,
    pub(super) cameras: &'a Cameras,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LapLimit {
    Endless,
    OfScenario,
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

/// Stops all tasks and joins the simulated bricks, if there are any.
pub(super) fn stop_bricks(
    embedded: Option<EmbeddedBricks>,
    stop: &CancellationToken,
) -> Result<Vec<FinishedSimulation>> {
    // A stopped task is finished as well.
    let is_complete = embedded.as_ref().is_some_and(|bricks| bricks.finished.is_cancelled());
    stop.cancel();
    let Some(mut embedded) = embedded else {
        return Ok(Vec::new());
    };
    let bricks = std::mem::take(&mut embedded.bricks);
    let (name, link) = (embedded.name.clone(), embedded.link);
    let finished = bricks.into_iter().zip(embedded.finish()?).map(|(brick, simulation)| FinishedSimulation {
        is_complete,
        simulation,
        robot: brick.robot,
        scenario: brick.scenario,
        name: name.clone(),
        link,
    });
    Ok(finished.collect())
}

/// Opens links, with an error where retrying cannot help, and starts simulated bricks.
pub(super) async fn open_links(
    args: &RunArgs,
    config: &Config,
    session: SimulatedSession<'_>,
    stop: &CancellationToken,
) -> Result<(LinkSet, Option<EmbeddedBricks>)> {
    let mut ports = Vec::new();
    let mut simulated = SimulatedLink::None;
    for (index, (target, role)) in config.targets()?.into_iter().enumerate() {
        let id = LinkId(index as u16);
        let (url, role) = match target {
            LinkTarget::Url(url) => (url, role),
            LinkTarget::Sim(name) => {
                ensure!(matches!(simulated, SimulatedLink::None), "only one link may be sim://");
                let planned = PlannedBricks { scenarios: scenarios(args, &name, session)?, name, link: id };
                if args.robots.is_some() {
                    simulated = SimulatedLink::Planned(planned);
                    (LinkUrl::parse(SHARED_PORT)?, ConnectRole::Listen)
                } else {
                    let path = session.folder.join("brick.tty");
                    let on_terminal = |_: &Scenario| Ok((LinkUrl::pty(&path)?, ConnectRole::Listen, None));
                    simulated = SimulatedLink::Started(start_bricks(planned, session, stop, on_terminal)?);
                    (LinkUrl::serial(&path)?, ConnectRole::Dial)
                }
            }
        };
        let open = LinkOpenConfig { id, url, role };
        ports.push(session.cameras.link(open, session.timer).unwrap_or_else(|open| {
            let tuning = LinkTuning { first_contact: FirstContact::Stranger, ..LinkTuning::default() };
            Link::with_tuning(open, tuning, session.timer)
        }));
    }
    ensure!(
        args.robots.is_none() || !matches!(simulated, SimulatedLink::None),
        "--robots starts simulated bricks: give --link sim://square, or start them with `posebridge sim --robots`"
    );
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
    let embedded = match simulated {
        SimulatedLink::None => None,
        SimulatedLink::Started(link) => Some(link),
        SimulatedLink::Planned(planned) => {
            let link = planned.link;
            let port = ports.iter().find(|port| port.id() == link);
            let address =
                port.and_then(Link::local_address).context("the port for the simulated bricks is not open")?;
            // Each calls from a port of its own.
            let on_shared_port = |scenario: &Scenario| {
                let robot = RobotId { link, address: scenario.brick.address_of(BRICK) };
                Ok((LinkUrl::parse(&format!("udp://{address}"))?, ConnectRole::Dial, Some(robot)))
            };
            Some(start_bricks(planned, session, stop, on_shared_port)?)
        }
    };
    Ok((ports, embedded))
}

/// State of the simulated bricks' link while the others are opened.
enum SimulatedLink {
    None,
    /// One brick, behind a terminal that must exist before the station opens it.
    Started(EmbeddedBricks),
    /// Several bricks, which connect once the station's port is open.
    Planned(PlannedBricks),
}

struct PlannedBricks {
    scenarios: Vec<Scenario>,
    name: String,
    link: LinkId,
}

fn scenarios(args: &RunArgs, name: &str, session: SimulatedSession<'_>) -> Result<Vec<Scenario>> {
    let mut scenario = load_scenario(name)?;
    if let Some(seed) = args.seed {
        scenario = scenario.with_seed(seed);
    }
    let scenario = session.laps.apply_to(scenario);
    let Some(count) = args.robots else {
        return Ok(vec![session.cameras.watched(scenario)]);
    };
    ensure!(!session.cameras.has_simulated(), "--camera sim shows one robot: take --robots away");
    if scenario.brick.personality != Personality::Mavlink {
        bail!("--robots: the bricks of `{name}` speak no MAVLink, and only such robots can share one port");
    }
    scenario.side_by_side(count).context("--robots")
}

/// Starts a brick for each scenario, on the link that `ends` creates for it.
fn start_bricks(
    planned: PlannedBricks,
    session: SimulatedSession<'_>,
    stop: &CancellationToken,
    ends: impl Fn(&Scenario) -> Result<(LinkUrl, ConnectRole, Option<RobotId>)>,
) -> Result<EmbeddedBricks> {
    let PlannedBricks { scenarios, name, link } = planned;
    let starts = scenarios.into_iter().map(|scenario| {
        let (url, role, robot) = ends(&scenario)?;
        Ok(BrickStart {
            #[cfg(feature = "camera")]
            pictures: session.cameras.rendered(&scenario, session.timer)?,
            scenario,
            link: LinkOpenConfig { id: LinkId(0), url, role },
            robot,
        })
    });
    EmbeddedBricks::start(name, link, starts.collect::<Result<_>>()?, session.timer, stop.clone())
}
