//! Fixes of cameras for robots of other stations: out with this station's time, in with its uncertainty.

use std::collections::BTreeMap;

use posebridge_fleet::{CameraName, ClockOffset, FleetKey, RobotName, SharedFix, StationId, encode_message};
use posebridge_telemetry::{Address, OutsideFix};
use posebridge_zenoh::Publication;

use crate::config::Config;

/// Cameras of other stations that are told apart; further ones count as the last.
const MAX_CAMERAS: usize = 64;

/// What goes out and comes in of fixes.
pub(super) struct FixExchange {
    /// The robots that tags belong to, by the configuration.
    tags: BTreeMap<u32, RobotName>,
    sequences: BTreeMap<(RobotName, Address), u32>,
    /// Cameras of other stations, each with the address that it has here: two stations may have cameras with the same.
    cameras: Vec<(StationId, Address, Address)>,
    last_sequences: BTreeMap<(RobotName, StationId, Address), u32>,
    /// Fixes that did not arrive, by their senders' numbers.
    lost: u64,
    /// Fixes of stations whose clocks were not compared yet.
    unaligned: u64,
}

impl FixExchange {
    pub(super) fn new(config: &Config) -> Self {
        let tags = config.robots.iter().filter_map(|block| Some((block.tag?, RobotName::new(&block.robot.name).ok()?)));
        Self {
            tags: tags.collect(),
            sequences: BTreeMap::new(),
            cameras: Vec::new(),
            last_sequences: BTreeMap::new(),
            lost: 0,
            unaligned: 0,
        }
    }

    pub(super) fn robot_of(&self, tag: u32) -> Option<&RobotName> {
        self.tags.get(&tag)
    }

    /// `None` if the station's name leaves no room for the camera's.
    pub(super) fn publication(
        &mut self,
        station: &StationId,
        robot: RobotName,
        fix: &OutsideFix,
    ) -> Option<Publication> {
        let OutsideFix { source, time, uncertainty, fix } = *fix;
        let sequence = self.sequences.entry((robot.clone(), source)).or_default();
        let message = SharedFix { from: station.clone(), sequence: *sequence, camera: source, time, uncertainty, fix };
        *sequence = sequence.wrapping_add(1);
        let camera = CameraName::new(&format!("{}.{}-{}", station.name, source.system, source.component)).ok()?;
        Some(Publication { key: FleetKey::Fix { robot, camera }, bytes: encode_message(&message) })
    }

    /// A fix of another station on this one's clock; `None` while that station's clock is not known.
    pub(super) fn receive(
        &mut self,
        robot: &RobotName,
        shared: &SharedFix,
        offset: Option<ClockOffset>,
    ) -> Option<OutsideFix> {
        let SharedFix { from, sequence, camera, time, uncertainty, fix } = shared;
        let last = self.last_sequences.insert((robot.clone(), from.clone(), *camera), *sequence);
        let step = last.map_or(1, |last| sequence.wrapping_sub(last));
        self.lost += if step < u32::MAX / 2 { u64::from(step.saturating_sub(1)) } else { 0 };
        let Some(offset) = offset else {
            self.unaligned += 1;
            return None;
        };
        Some(OutsideFix {
            source: self.address_here(from, *camera),
            time: offset.to_own(*time),
            uncertainty: *uncertainty + offset.uncertainty,
            fix: *fix,
        })
    }

    /// Fixes that did not arrive, and those of stations whose clocks were not compared yet.
    pub(super) const fn losses(&self) -> (u64, u64) {
        (self.lost, self.unaligned)
    }

    fn address_here(&mut self, station: &StationId, camera: Address) -> Address {
        if let Some((_, _, here)) = self.cameras.iter().find(|(of, known, _)| of == station && *known == camera) {
            return *here;
        }
        let is_free = |address: &Address| self.cameras.iter().all(|(_, _, here)| here != address);
        let systems = (1..=u8::MAX).rev().map(|system| Address::new(system, camera.component.0));
        let here = [camera].into_iter().chain(systems).find(is_free).unwrap_or(camera);
        if self.cameras.len() < MAX_CAMERAS {
            self.cameras.push((station.clone(), camera, here));
        }
        here
    }
}

#[cfg(test)]
mod tests {
    use posebridge_fleet::{StationName, decode_message};
    use posebridge_telemetry::{Fix, Meters, Point2, TimeDelta, Timestamp};

    use super::*;

    fn station(name: &str) -> StationId {
        StationId { name: StationName::new(name).unwrap(), instance: 1 }
    }

    fn fix() -> OutsideFix {
        OutsideFix {
            source: Address::new(1, 100),
            time: Timestamp::from_millis(7_000),
            uncertainty: TimeDelta::from_millis(2),
            fix: Fix {
                position: Point2::new(Meters(1.0), Meters(2.0)),
                heading: None,
                covariance: None,
                tag_in_body: Point2::new(Meters(0.0), Meters(0.0)),
                reset_counter: 0,
            },
        }
    }

    #[test]
    fn the_uncertainty_of_both_clocks_enters_the_fix_and_cameras_stay_apart() {
        let mut exchange = FixExchange::new(&Config::default());
        let robot = RobotName::new("ada").unwrap();
        let mut send = |from: &str| {
            let Publication { key, bytes } = exchange.publication(&station(from), robot.clone(), &fix()).unwrap();
            assert_eq!(
                key,
                FleetKey::Fix { robot: robot.clone(), camera: CameraName::new(&format!("{from}.1-100")).unwrap() }
            );
            decode_message::<SharedFix>(&bytes).unwrap()
        };
        let [first, _, third] = [send("lab-1"), send("lab-1"), send("lab-1")];
        let other = send("lab-2");
        let offset = ClockOffset { offset: TimeDelta::from_millis(5_000), uncertainty: TimeDelta::from_millis(1) };
        assert_eq!(exchange.receive(&robot, &first, None), None);
        let received = exchange.receive(&robot, &third, Some(offset)).unwrap();
        let uncertainty = TimeDelta::from_millis(3);
        assert_eq!(received, OutsideFix { time: Timestamp::from_millis(2_000), uncertainty, ..fix() });
        assert_eq!(exchange.losses(), (1, 1));
        let namesake = exchange.receive(&robot, &other, Some(offset)).unwrap();
        assert_ne!(namesake.source, received.source);
    }
}
