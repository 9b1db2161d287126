//! What the page shows of the fleet: the table of robots and stations as rows. A pure function.

use std::collections::BTreeMap;

use posebridge_dashboard::model::{FleetEstimateRow, FleetOwnerRow, FleetRobotRow, FleetState, FleetStationRow};
use posebridge_dashboard::views::robot_name;
use posebridge_fleet::{FleetEstimate, FleetName, FleetRobot, FleetStation, FleetTable, RobotName, StationId};
use posebridge_telemetry::{HostClock, RobotId, TimeDelta, Timestamp};

/// The station whose page it is.
pub(super) struct OwnStation<'a> {
    pub(super) id: &'a StationId,
    pub(super) fleet: &'a FleetName,
    /// The robots that it has heard.
    pub(super) robots: &'a BTreeMap<RobotName, RobotId>,
}

/// The fleet as the table shows it now. Ages and offsets are by this station's clock.
pub(super) fn fleet_state(own: &OwnStation<'_>, table: &FleetTable, now: Timestamp<HostClock>) -> FleetState {
    let robots: Vec<FleetRobotRow> = table.robots().map(|(name, robot)| robot_row(own, name, robot, now)).collect();
    let is_own = |robot: &&FleetRobotRow| robot.owner.as_ref().is_some_and(|owner| owner.is_this);
    let this = FleetStationRow {
        id: own.id.to_string(),
        name: own.id.name.to_string(),
        is_this: true,
        clock_offset_s: Some(0.0),
        clock_uncertainty_s: Some(0.0),
        robots: robots.iter().filter(is_own).count(),
    };
    let others = table.stations(now).into_iter().filter(|station| station.id != *own.id);
    FleetState {
        name: own.fleet.to_string(),
        stations: [this].into_iter().chain(others.map(|station| station_row(&station))).collect(),
        robots,
    }
}

fn station_row(station: &FleetStation) -> FleetStationRow {
    FleetStationRow {
        id: station.id.to_string(),
        name: station.id.name.to_string(),
        is_this: false,
        clock_offset_s: station.clock.map(|clock| clock.offset.as_secs_f64()),
        clock_uncertainty_s: station.clock.map(|clock| clock.uncertainty.as_secs_f64()),
        robots: station.robots,
    }
}

fn robot_row(own: &OwnStation<'_>, name: &RobotName, robot: &FleetRobot, now: Timestamp<HostClock>) -> FleetRobotRow {
    let owner = robot.owner.as_ref().map(|owner| FleetOwnerRow {
        id: owner.station.to_string(),
        name: owner.station.name.to_string(),
        is_this: owner.station == *own.id,
        epoch: owner.epoch.get(),
    });
    FleetRobotRow {
        name: name.to_string(),
        owner,
        robot: own.robots.get(name).map(|id| robot_name(*id)),
        estimate: robot.estimate.as_ref().map(|estimate| estimate_row(estimate, robot, now)),
        received: robot.received,
        lost: robot.lost,
        stale: robot.stale,
    }
}

fn estimate_row(estimate: &FleetEstimate, robot: &FleetRobot, now: Timestamp<HostClock>) -> FleetEstimateRow {
    let since_arrival = robot.arrival.map_or(TimeDelta::ZERO, |arrival| now - arrival);
    // By uncertain clocks an estimate may arrive before its instant; it is not from the future.
    let age = (since_arrival + robot.transit.unwrap_or(TimeDelta::ZERO)).max(TimeDelta::ZERO);
    FleetEstimateRow {
        epoch: estimate.epoch.get(),
        x_m: estimate.pose.x.0.into(),
        y_m: estimate.pose.y.0.into(),
        heading_rad: estimate.pose.heading.rad().into(),
        major_m: estimate.ellipse_95().map_or(f64::NAN, |ellipse| ellipse.semi_major_m).into(),
        heading_sigma_rad: estimate.heading_sigma_rad().into(),
        is_position_valid: estimate.validity.position,
        is_heading_valid: estimate.validity.heading,
        is_dead_reckoning: estimate.is_dead_reckoning,
        age_s: age.as_secs_f64(),
        transit_s: robot.transit.map(TimeDelta::as_secs_f64),
    }
}

#[cfg(test)]
mod tests {
    use posebridge_fleet::{ClockExchange, Epoch, OwnershipToken, StationName};
    use posebridge_telemetry::{
        Address, Arena, Heading, LinkId, Meters, MetersPerSecond, Pose, RadiansPerSecond, Validity,
    };

    use super::*;

    fn station(name: &str, instance: u64) -> StationId {
        StationId { name: StationName::new(name).unwrap(), instance }
    }

    fn estimate(sequence: u32, host_ms: i64) -> FleetEstimate {
        FleetEstimate {
            epoch: Epoch::new(4).unwrap(),
            sequence,
            host_time: Timestamp::from_millis(host_ms),
            pose: Pose::<Arena>::new(Meters(1.0), Meters(-2.0), Heading::from_rad(0.5)),
            covariance: [0.04, 0.0, 0.0, 0.01, 0.0, 0.0025],
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            validity: Validity { position: true, heading: false, speeds: true },
            is_dead_reckoning: true,
            reset_counter: 0,
        }
    }

    #[test]
    fn rows_say_who_owns_a_robot_how_old_its_estimate_is_and_what_was_lost() {
        let at = Timestamp::from_millis;
        let (own, other) = (station("left", 1), station("right", 2));
        let (ada, bob) = (RobotName::new("ada").unwrap(), RobotName::new("bob").unwrap());
        let mut table = FleetTable::new(8, 8);
        table.add_station(other.clone());
        table.push_exchange(&other, ClockExchange { sent: at(0), received: at(2), remote: at(9_001) });
        table.set_owner(at(5), &ada, Some(OwnershipToken { epoch: Epoch::new(4).unwrap(), station: other.clone() }));
        table.push_estimate(at(10), &ada, estimate(0, 9_007));
        table.push_estimate(at(20), &ada, estimate(3, 9_017));
        table.set_owner(at(5), &bob, Some(OwnershipToken { epoch: Epoch::FIRST, station: own.clone() }));
        let fleet = FleetName::new("class").unwrap();
        let heard = RobotId { link: LinkId(0), address: Address::new(7, 1) };
        let robots = BTreeMap::from([(bob, heard)]);
        let state = fleet_state(&OwnStation { id: &own, fleet: &fleet, robots: &robots }, &table, at(120));

        assert_eq!(state.name, "class");
        let stations: Vec<_> =
            state.stations.iter().map(|row| (row.name.as_str(), row.is_this, row.clock_offset_s, row.robots)).collect();
        assert_eq!(stations, [("left", true, Some(0.0), 1), ("right", false, Some(9.0), 1)]);
        assert_eq!(state.stations[0].id, own.to_string());
        let uncertainty_s = state.stations[1].clock_uncertainty_s.unwrap();
        assert!((0.001..0.0011).contains(&uncertainty_s), "half of the exchange, and drift: {uncertainty_s}");

        let [ada, bob] = &state.robots[..] else { panic!("{:?}", state.robots) };
        let owner = FleetOwnerRow { id: other.to_string(), name: "right".to_owned(), is_this: false, epoch: 4 };
        assert_eq!((ada.name.as_str(), ada.owner.as_ref(), ada.robot.as_deref()), ("ada", Some(&owner), None));
        assert_eq!((ada.received, ada.lost, ada.stale), (2, 2, 0));
        let seen = ada.estimate.as_ref().unwrap();
        assert_eq!((seen.epoch, seen.x_m, seen.y_m, seen.heading_rad), (4, 1.0.into(), (-2.0).into(), 0.5.into()));
        assert_eq!(seen.major_m, (0.2 * 2.447_746_830_680_816).into());
        assert_eq!(seen.heading_sigma_rad, 0.05.into());
        assert_eq!((seen.is_position_valid, seen.is_heading_valid, seen.is_dead_reckoning), (true, false, true));
        let age_s = TimeDelta::from_millis(103).as_secs_f64();
        assert_eq!((seen.transit_s, seen.age_s), (Some(0.003), age_s), "3 ms on its way, 100 ms here");
        assert_eq!((bob.robot.as_deref(), bob.estimate.is_none()), (Some("0/7/1"), true));
        assert!(bob.owner.as_ref().unwrap().is_this);
    }

    #[test]
    fn an_estimate_that_seems_to_come_before_its_instant_has_no_negative_age() {
        let at = Timestamp::from_millis;
        let (own, other) = (station("left", 1), station("right", 2));
        let ada = RobotName::new("ada").unwrap();
        let mut table = FleetTable::new(8, 8);
        table.add_station(other.clone());
        table.push_exchange(&other, ClockExchange { sent: at(0), received: at(2), remote: at(9_001) });
        table.set_owner(at(5), &ada, Some(OwnershipToken { epoch: Epoch::new(4).unwrap(), station: other }));
        table.push_estimate(at(10), &ada, estimate(0, 9_012));
        let fleet = FleetName::new("class").unwrap();
        let state = fleet_state(&OwnStation { id: &own, fleet: &fleet, robots: &BTreeMap::new() }, &table, at(11));
        let seen = state.robots[0].estimate.as_ref().unwrap();
        assert_eq!((seen.transit_s, seen.age_s), (Some(-0.002), 0.0));
    }

    #[test]
    fn without_clocks_an_estimate_is_as_old_as_its_arrival_and_a_robot_may_have_no_owner() {
        let at = Timestamp::from_millis;
        let own = station("left", 1);
        let mut table = FleetTable::new(8, 8);
        table.add_station(station("right", 2));
        table.push_estimate(at(10), &RobotName::new("ada").unwrap(), estimate(0, 9_007));
        let fleet = FleetName::new("class").unwrap();
        let state = fleet_state(&OwnStation { id: &own, fleet: &fleet, robots: &BTreeMap::new() }, &table, at(60));
        assert_eq!((state.stations[1].clock_offset_s, state.stations[1].clock_uncertainty_s), (None, None));
        let seen = state.robots[0].estimate.as_ref().unwrap();
        assert_eq!((state.robots[0].owner.as_ref(), seen.transit_s, seen.age_s), (None, None, 0.05));
    }
}
