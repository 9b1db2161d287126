//! What a station knows of all robots of its fleet, for viewers: owners, estimates, their ages and losses.

use std::collections::BTreeMap;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::epoch::{Epoch, OwnershipToken};
use crate::estimate::FleetEstimate;
use crate::names::{RobotName, StationId};
use crate::station_clock::{ClockExchange, ClockOffset, StationClock};

/// A robot without owner and estimates is forgotten after this time, and a station that is gone.
const FORGET_AFTER: TimeDelta = TimeDelta::from_millis(60_000);

/// A robot of the fleet as this station sees it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FleetRobot {
    /// `None` while nobody owns it.
    pub owner: Option<OwnershipToken>,
    pub estimate: Option<FleetEstimate>,
    /// When the estimate came, on the clock of this station.
    pub arrival: Option<Timestamp<HostClock>>,
    /// How long the estimate was on its way, by the clocks of both stations; `None` while they are not aligned.
    pub transit: Option<TimeDelta>,
    pub received: u64,
    /// Estimates that did not arrive, by the owner's sequence numbers.
    pub lost: u64,
    /// Estimates of earlier owners.
    pub stale: u64,
    last_change: Option<Timestamp<HostClock>>,
}

/// A station of the fleet as this station sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetStation {
    pub id: StationId,
    /// `None` before the first exchange.
    pub clock: Option<ClockOffset>,
    /// Number of robots that it owns.
    pub robots: usize,
}

#[derive(Clone, Debug, Default)]
struct KnownStation {
    clock: StationClock,
    /// Its clock is kept for a while, because its last states are still used.
    gone_since: Option<Timestamp<HostClock>>,
}

/// All robots and stations. Its size is limited: what does not fit is not shown.
#[derive(Clone, Debug)]
pub struct FleetTable {
    robots: BTreeMap<RobotName, FleetRobot>,
    stations: BTreeMap<StationId, KnownStation>,
    max_robots: usize,
    max_stations: usize,
}

impl FleetTable {
    pub const fn new(max_robots: usize, max_stations: usize) -> Self {
        Self { robots: BTreeMap::new(), stations: BTreeMap::new(), max_robots, max_stations }
    }

    pub fn set_owner(&mut self, now: Timestamp<HostClock>, robot: &RobotName, owner: Option<OwnershipToken>) {
        if let Some(entry) = self.entry(now, robot) {
            entry.owner = owner;
        }
    }

    /// Takes an estimate that arrived now. One of an earlier owner than the last is counted and not shown.
    pub fn push_estimate(&mut self, now: Timestamp<HostClock>, robot: &RobotName, estimate: FleetEstimate) {
        let offset = self.robots.get(robot).and_then(|known| known.owner.as_ref());
        let offset = offset.and_then(|owner| self.offset(now, &owner.station));
        let Some(entry) = self.entry(now, robot) else { return };
        entry.received += 1;
        if let Some(last) = &entry.estimate {
            if estimate.epoch < last.epoch && entry.owner.as_ref().is_some_and(|owner| owner.epoch > estimate.epoch) {
                entry.stale += 1;
                return;
            }
            entry.lost += missing(last, &estimate);
        }
        entry.transit = offset.map(|offset| now - offset.to_own(estimate.host_time));
        entry.estimate = Some(estimate);
        entry.arrival = Some(now);
    }

    /// Takes an estimate of this station itself.
    pub fn set_own_estimate(&mut self, now: Timestamp<HostClock>, robot: &RobotName, estimate: FleetEstimate) {
        if let Some(entry) = self.entry(now, robot) {
            entry.transit = Some(TimeDelta::ZERO);
            entry.estimate = Some(estimate);
            entry.arrival = Some(now);
        }
    }

    pub fn add_station(&mut self, station: StationId) {
        if self.stations.len() < self.max_stations || self.stations.contains_key(&station) {
            self.stations.entry(station).or_default().gone_since = None;
        }
    }

    pub fn push_exchange(&mut self, station: &StationId, exchange: ClockExchange) {
        if let Some(known) = self.stations.get_mut(station) {
            known.clock.push(exchange);
        }
    }

    pub fn remove_station(&mut self, now: Timestamp<HostClock>, station: &StationId) {
        if let Some(known) = self.stations.get_mut(station) {
            known.gone_since = Some(now);
        }
    }

    /// The clock of a station, also of one that is gone since less than a minute.
    pub fn offset(&self, now: Timestamp<HostClock>, station: &StationId) -> Option<ClockOffset> {
        self.stations.get(station)?.clock.offset(now)
    }

    /// Those that are owned, or were heard of in the last minute.
    pub fn robots(&self) -> impl Iterator<Item = (&RobotName, &FleetRobot)> {
        self.robots.iter()
    }

    pub fn stations(&self, now: Timestamp<HostClock>) -> Vec<FleetStation> {
        let owned = |id: &StationId| {
            self.robots.values().filter(|robot| robot.owner.as_ref().is_some_and(|owner| owner.station == *id)).count()
        };
        let present = self.stations.iter().filter(|(_, known)| known.gone_since.is_none());
        let stations = present.map(|(id, known)| FleetStation {
            id: id.clone(),
            clock: known.clock.offset(now),
            robots: owned(id),
        });
        stations.collect()
    }

    pub fn forget_old(&mut self, now: Timestamp<HostClock>) {
        self.stations.retain(|_, known| known.gone_since.is_none_or(|since| now - since < FORGET_AFTER));
        self.robots.retain(|_, robot| {
            robot.owner.is_some() || robot.last_change.is_some_and(|last| now - last < FORGET_AFTER)
        });
    }

    fn entry(&mut self, now: Timestamp<HostClock>, robot: &RobotName) -> Option<&mut FleetRobot> {
        if !self.robots.contains_key(robot) && self.robots.len() >= self.max_robots {
            return None;
        }
        let entry = self.robots.entry(robot.clone()).or_default();
        entry.last_change = Some(now);
        Some(entry)
    }
}

/// Estimates between two that came one after the other from one owner.
fn missing(last: &FleetEstimate, next: &FleetEstimate) -> u64 {
    let is_same = |epoch: Epoch| epoch == last.epoch;
    let step = next.sequence.wrapping_sub(last.sequence);
    // A large step is one backwards: it came twice, or out of order.
    if is_same(next.epoch) && step > 1 && step < u32::MAX / 2 { u64::from(step) - 1 } else { 0 }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Arena, Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond, Validity};

    use super::*;
    use crate::names::StationName;

    fn robot() -> RobotName {
        RobotName::new("ada").unwrap()
    }

    fn station(instance: u64) -> StationId {
        StationId { name: StationName::new("lab").unwrap(), instance }
    }

    fn estimate(epoch: u32, sequence: u32, host_ms: i64) -> FleetEstimate {
        FleetEstimate {
            epoch: Epoch::new(epoch).unwrap(),
            sequence,
            host_time: Timestamp::from_millis(host_ms),
            pose: at_x(0.0),
            covariance: [0.0; 6],
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            validity: Validity { position: true, heading: true, speeds: true },
            is_dead_reckoning: false,
            reset_counter: 0,
        }
    }

    fn at_x(x_m: f64) -> Pose<Arena> {
        Pose::new(Meters(x_m), Meters(0.0), Heading::from_rad(0.0))
    }

    #[test]
    fn losses_are_counted_by_sequence_numbers_of_one_owner() {
        let mut table = FleetTable::new(4, 4);
        let at = Timestamp::from_millis;
        for (epoch, sequence) in [(1, u32::MAX), (1, 2), (1, 1), (2, 700), (2, 702)] {
            table.push_estimate(at(0), &robot(), estimate(epoch, sequence, 0));
        }
        let (_, row) = table.robots().next().unwrap();
        assert_eq!((row.received, row.lost, row.stale), (5, 3, 0), "0 and 1 of the first owner, 701 of the second");
    }

    #[test]
    fn an_estimate_of_an_earlier_owner_is_counted_and_not_shown() {
        let mut table = FleetTable::new(4, 4);
        let now = Timestamp::ZERO;
        table.set_owner(now, &robot(), Some(OwnershipToken { epoch: Epoch::new(2).unwrap(), station: station(2) }));
        table.push_estimate(now, &robot(), FleetEstimate { pose: at_x(2.0), ..estimate(2, 0, 0) });
        table.push_estimate(now, &robot(), FleetEstimate { pose: at_x(1.0), ..estimate(1, 9, 0) });
        let (_, row) = table.robots().next().unwrap();
        assert_eq!((row.stale, row.estimate.unwrap().pose.x), (1, Meters(2.0)));
    }

    #[test]
    fn transit_is_measured_by_both_clocks() {
        let mut table = FleetTable::new(4, 4);
        let at = Timestamp::from_millis;
        let owner = station(3);
        table.add_station(owner.clone());
        table.push_exchange(&owner, ClockExchange { sent: at(0), received: at(2), remote: at(9_001) });
        table.set_owner(at(5), &robot(), Some(OwnershipToken { epoch: Epoch::FIRST, station: owner.clone() }));
        table.push_estimate(at(10), &robot(), estimate(1, 0, 9_007));
        let (_, row) = table.robots().next().unwrap();
        assert_eq!(row.transit, Some(TimeDelta::from_millis(3)));
        assert_eq!(table.stations(at(10))[0].robots, 1);
        table.remove_station(at(10), &owner);
        assert!(table.stations(at(10)).is_empty() && table.offset(at(10), &owner).is_some());
        table.forget_old(at(60_010));
        assert_eq!(table.offset(at(60_010), &owner), None);
    }

    #[test]
    fn its_size_is_limited_and_robots_that_are_gone_are_forgotten() {
        let mut table = FleetTable::new(1, 1);
        let at = Timestamp::from_millis;
        table.push_estimate(at(0), &robot(), estimate(1, 0, 0));
        table.push_estimate(at(0), &RobotName::new("bob").unwrap(), estimate(1, 0, 0));
        table.add_station(station(1));
        table.add_station(station(2));
        assert_eq!((table.robots().count(), table.stations(at(0)).len()), (1, 1));
        table.forget_old(at(59_999));
        assert_eq!(table.robots().count(), 1);
        table.forget_old(at(60_000));
        assert_eq!(table.robots().count(), 0);
    }
}
