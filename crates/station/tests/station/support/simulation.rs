//! A simulated robot behind a link with delays, and a station at the other end.

use posebridge_sim::{Scenario, Simulation};
use posebridge_station::StationConfig;
use posebridge_telemetry::{HostClock, Input, LinkState, TimeDelta, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::network::BytesInTransit;
use super::{LINK, TestStation};

/// Each way takes so long, and up to as long again by chance; order is kept.
const DELAY_MS: i64 = 10;

/// Simulation and station, driven in steps of a millisecond of world time; the host's clock is the world's.
pub(crate) struct StationSimulation {
    pub(crate) simulation: Simulation,
    pub(crate) station: TestStation,
    rng: Pcg64,
    to_station: BytesInTransit<()>,
    to_robot: BytesInTransit<()>,
    handled_outputs: usize,
}

impl StationSimulation {
    pub(crate) fn new(scenario: Scenario, config: &StationConfig) -> Self {
        Self {
            rng: Pcg64::seed_from_u64(scenario.seed),
            simulation: Simulation::new(scenario),
            station: TestStation::new(config),
            to_station: BytesInTransit::default(),
            to_robot: BytesInTransit::default(),
            handled_outputs: 0,
        }
    }

    pub(crate) fn now(&self) -> Timestamp<HostClock> {
        Timestamp::ZERO + self.simulation.elapsed()
    }

    /// Lets some seconds pass.
    pub(crate) fn run_for(&mut self, seconds: i64) {
        for _ in 0..seconds * 1_000 {
            self.step();
        }
    }

    fn step(&mut self) {
        self.simulation.step();
        let now = self.now();
        while let Some(bytes) = self.simulation.poll() {
            let arrival = self.arrival(self.to_station.last_arrival());
            self.to_station.send(arrival, (), bytes);
        }
        while let Some(((), bytes)) = self.to_station.take_due(now) {
            self.station.bytes(now, &bytes);
        }
        if self.station.engine.deadline().is_some_and(|due| due <= now) {
            self.station.handle(now, Input::Tick);
        }
        self.send_back();
        while let Some(((), bytes)) = self.to_robot.take_due(now) {
            self.simulation.receive(&bytes);
        }
    }

    fn send_back(&mut self) {
        let fresh = self.station.sent_since(self.handled_outputs).filter(|sent| sent.link == LINK);
        let fresh: Vec<_> = fresh.map(|sent| sent.bytes.to_vec()).collect();
        self.handled_outputs = self.station.outputs.len();
        for bytes in fresh {
            let arrival = self.arrival(self.to_robot.last_arrival());
            self.to_robot.send(arrival, (), bytes);
        }
    }

    fn arrival(&mut self, last: Option<Timestamp<HostClock>>) -> Timestamp<HostClock> {
        let delay = TimeDelta::from_millis(DELAY_MS + self.rng.random_range(0..=DELAY_MS));
        let arrival = self.now() + delay;
        last.map_or(arrival, |last| last.max(arrival))
    }

    /// Cuts the link for some seconds: bytes in transit are lost.
    pub(crate) fn cut_for(&mut self, seconds: i64) {
        self.station.link(self.now(), LINK, LinkState::Down);
        for _ in 0..seconds * 1_000 {
            self.step();
            self.to_station.lose(|()| true);
            self.to_robot.lose(|()| true);
        }
        self.station.link(self.now(), LINK, LinkState::Up);
    }
}
