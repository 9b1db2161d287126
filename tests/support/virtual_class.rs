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
pub(crate) struct Pupil {
    pub(crate) simulation: Simulation,
    link: LinkId,
    peer: PeerId,
    /// Telemetry of the brick from before this instant is lost.
    telemetry_from: TimeDelta,
}

impl Pupil {
    pub(crate) fn new(scenario: Scenario, link: u16, peer: u32) -> Self {
        let simulation = Simulation::new(scenario);
        Self { simulation, link: LinkId(link), peer: PeerId(peer), telemetry_from: TimeDelta::ZERO }
    }

    /// The same, whose first telemetry is lost.
    pub(crate) fn with_telemetry_from(self, telemetry_from: TimeDelta) -> Self {
        Self { telemetry_from, ..self }
    }

    /// What the brick and its camera send next, as the station receives it.
    fn poll(&mut self) -> Option<Vec<u8>> {
        let bytes = self.simulation.poll()?;
        let is_early = self.simulation.elapsed() < self.telemetry_from;
        Some(if is_early { without_telemetry(&bytes) } else { bytes })
    }

    fn hears(&self, link: LinkId, to: Recipients) -> bool {
        self.link == link
            && match to {
                Recipients::All => true,
                Recipients::AllExcept(peer) => peer != self.peer,
                Recipients::Peer(peer) => peer == self.peer,
            }
    }
}

/// The MAVLink 2 frames that are neither PB_WHEEL_TICKS nor PB_INERTIAL.
fn without_telemetry(mut frames: &[u8]) -> Vec<u8> {
    let mut kept = Vec::new();
    while let [_, length, _, _, _, _, _, id @ ..] = frames {
        let id = u32::from_le_bytes([id[0], id[1], id[2], 0]);
        let (frame, rest) = frames.split_at(12 + usize::from(*length));
        if !(42_100..=42_101).contains(&id) {
            kept.extend_from_slice(frame);
        }
        frames = rest;
    }
    kept
}

/// What a class leaves behind.
pub(crate) struct ClassRun {
    pub(crate) pupils: Vec<Pupil>,
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

/// Lets bricks drive for so long; every input and event is kept.
pub(crate) fn run(links: u16, mut pupils: Vec<Pupil>, duration: TimeDelta) -> ClassRun {
    let mut station = station(links);
    let mut run = ClassRun { pupils: Vec::new(), inputs: Vec::new(), events: Vec::new() };
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
                        let listeners = pupils.iter_mut().filter(|pupil| pupil.hears(link, to));
                        listeners.for_each(|pupil| pupil.simulation.receive(&bytes));
                    }
                    Output::Request(_) => {}
                }
            }
        }
        for pupil in &mut pupils {
            pupil.simulation.step();
            while let Some(bytes) = pupil.poll() {
                pending.push(Input::Bytes { link: pupil.link, peer: pupil.peer, bytes });
            }
        }
        elapsed = pupils.first().map_or(duration, |pupil| pupil.simulation.elapsed());
    }
    run.pupils = pupils;
    run
}

/// The root mean square error of each robot's estimates in metres, in the order of the pupils.
pub(crate) fn rms_m(run: &ClassRun) -> Vec<f64> {
    let mut robots = PerRobot::new(EventCollector::default);
    for event in &run.events {
        robots.push(event, EventCollector::on_event);
    }
    let rms_of = |pupil: &Pupil| {
        let truth = SimulationTruth::from_simulation(&pupil.simulation);
        let rms = |robot: &RobotEntry<EventCollector>| errors(&robot.value, &truth).0.position_rms_m;
        // Robots with the same ids are told apart by where they are: the others are at least a path away.
        let on_link = robots.entries().iter().filter(|robot| robot.robot.is_some_and(|id| id.link == pupil.link));
        on_link.filter_map(rms).min_by(f64::total_cmp).unwrap()
    };
    run.pupils.iter().map(rms_of).collect()
}
