//! Simulated bricks and one station in virtual time: each brick on a link and peer of its own, nothing lost or late.
#![allow(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

use posebridge::config::{Config, LinkSection};
use posebridge::station::event_collector::EventCollector;
use posebridge::station::per_robot::{PerRobot, RobotEntry};
use posebridge::station::run_report::{SimulationTruth, errors};
use posebridge_sim::{Scenario, Simulation};
use posebridge_station::Station;
use posebridge_telemetry::{Event, Input, LinkId, LinkState, Output, PeerId, Recipients, TimeDelta, Timestamp};

/// A brick and where the station hears it.
pub(crate) struct ConnectedBrick {
    pub(crate) simulation: Simulation,
    link: LinkId,
    peer: PeerId,
}

impl ConnectedBrick {
    pub(crate) fn new(scenario: Scenario, link: u16, peer: u32) -> Self {
        Self { simulation: Simulation::new(scenario), link: LinkId(link), peer: PeerId(peer) }
    }

    fn receives(&self, link: LinkId, to: Recipients) -> bool {
        self.link == link
            && match to {
                Recipients::All => true,
                Recipients::AllExcept(peer) => peer != self.peer,
                Recipients::Peer(peer) => peer == self.peer,
            }
    }
}

/// What bricks and a station leave behind.
pub(crate) struct BricksRun {
    pub(crate) bricks: Vec<ConnectedBrick>,
    pub(crate) inputs: Vec<(TimeDelta, Input)>,
    pub(crate) events: Vec<Event>,
}

/// A station whose first link is a UDP port and whose others are terminals.
pub(crate) fn station(links: u16) -> Station {
    let port = LinkSection { listen: true, ..LinkSection::new("udp://127.0.0.1:14550") };
    let terminals = (1..links).map(|link| LinkSection::new(&format!("serial:brick-{link}.tty")));
    let config = Config { links: std::iter::once(port).chain(terminals).collect(), ..Config::default() };
    Station::new(config.station_config().unwrap(), Timestamp::ZERO).unwrap()
}

/// Lets bricks drive for so long with a station of this many links; every input and event is kept.
pub(crate) fn run(links: u16, bricks: Vec<ConnectedBrick>, duration: TimeDelta) -> BricksRun {
    run_with(&mut station(links), links, bricks, duration)
}

/// The same with any station.
pub(crate) fn run_with(
    station: &mut Station,
    links: u16,
    mut bricks: Vec<ConnectedBrick>,
    duration: TimeDelta,
) -> BricksRun {
    let mut run = BricksRun { bricks: Vec::new(), inputs: Vec::new(), events: Vec::new() };
    let mut pending: Vec<Input> =
        (0..links).map(|link| Input::Link { link: LinkId(link), state: LinkState::Up }).collect();
    let mut elapsed = TimeDelta::ZERO;
    while elapsed < duration {
        let now = Timestamp::ZERO + elapsed;
        if station.deadline().is_some_and(|deadline| deadline <= now) {
            pending.push(Input::Tick);
        }
        for input in pending.drain(..) {
            station.handle(now, &input);
            run.inputs.push((elapsed, input));
            while let Some(output) = station.poll() {
                match output {
                    Output::Event(event) => run.events.push(event),
                    Output::Transmit { link, to, bytes, .. } => {
                        let listeners = bricks.iter_mut().filter(|brick| brick.receives(link, to));
                        listeners.for_each(|brick| brick.simulation.receive(&bytes));
                    }
                    Output::Request(_) => {}
                }
            }
        }
        for brick in &mut bricks {
            brick.simulation.step();
            while let Some(bytes) = brick.simulation.poll() {
                pending.push(Input::Bytes { link: brick.link, peer: brick.peer, bytes });
            }
        }
        elapsed = bricks.first().map_or(duration, |brick| brick.simulation.elapsed());
    }
    run.bricks = bricks;
    run
}

/// The root mean square error of each robot's estimates in metres, in the order of the bricks.
pub(crate) fn rms_m(run: &BricksRun) -> Vec<f64> {
    let mut robots = PerRobot::new(EventCollector::default);
    for event in &run.events {
        robots.push(event, EventCollector::on_event);
    }
    let rms_of = |brick: &ConnectedBrick| {
        let truth = SimulationTruth::from_simulation(&brick.simulation);
        let rms = |robot: &RobotEntry<EventCollector>| errors(&robot.value, &truth).0.position_rms_m;
        // Robots with the same ids are told apart by where they are: the others are at least a path away.
        let on_link = robots.entries().iter().filter(|robot| robot.robot.is_some_and(|id| id.link == brick.link));
        on_link.filter_map(rms).min_by(f64::total_cmp).unwrap()
    };
    run.bricks.iter().map(rms_of).collect()
}
