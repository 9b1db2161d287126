//! Thermometers: from a message to what is told of it.
//!
//! A thermometer may sit on the robot or on any other brick. That one's clock is kept like a camera's, but never converted: its filter
//! asks only how much time lies between two readings.

use posebridge_protocol::message::{Message, WireStamp};
use posebridge_protocol::routing::Occurrence;
use posebridge_telemetry::{BrickClock, Event, LinkId, RobotId, Stamp};

use super::intake::{Arrival, Arrived};
use super::{Pipeline, SEVERITY_WARNING};
use crate::clock::unwrap::Unwrapped;
use crate::thermometers::Reading;

impl Pipeline {
    /// Aligns a thermometer's reading and lets it wait for [`Self::settle_temperatures`]; other messages say nothing here. `id` is the
    /// first link of the group by which it came.
    pub(super) fn handle_temperature(&mut self, arrival: Arrival, id: LinkId, arrived: &Arrived) {
        let Message::Thermometer { stamp, channel, temperature } = arrived.message else {
            return;
        };
        let brick = RobotId { link: id, address: arrived.source };
        let is_robot = self.robot == Some(brick);
        if arrived.occurrence != Occurrence::First && !is_robot {
            return;
        }
        let instant = if is_robot {
            let instant = self.brick_instant(arrival, brick, stamp);
            instant.map(|(stamp, _)| stamp)
        } else {
            self.foreign_instant(arrival, brick, stamp)
        };
        if let Some(stamp) = instant {
            self.thermometers.wait(Reading { brick, channel, arrival: arrival.at, stamp, shown: temperature });
        }
    }

    /// The instant of a stamp by the clock of a brick that is not the robot, or not yet.
    fn foreign_instant(&mut self, arrival: Arrival, brick: RobotId, stamp: WireStamp) -> Option<Stamp<BrickClock>> {
        let RobotId { link, address } = brick;
        if matches!(stamp, WireStamp::Asked { .. }) {
            // Without a clock of its own its answers have no instants; with one it is a robot.
            self.tell_unaligned(link, address);
            return None;
        }
        let clock = self.observers.entry((link, address)).or_default();
        let unwrapped = clock.arrived(arrival.way, stamp, arrival.at);
        // Nothing is converted by this clock.
        clock.take_contradiction();
        let instant = match unwrapped {
            Unwrapped::Continued(instant) => instant,
            Unwrapped::Restarted(instant) => {
                self.restart_thermometers(brick);
                self.ask_time_again(link, address);
                instant
            }
            Unwrapped::Outlived => {
                self.tell_unaligned(link, address);
                return None;
            }
        };
        Some(Stamp::from_nanos(instant.as_nanos()))
    }

    /// What came before a restart is used before it.
    pub(super) fn restart_thermometers(&mut self, brick: RobotId) {
        self.settle_temperatures();
        self.thermometers.restart(brick);
    }

    /// Uses the readings that wait.
    pub(super) fn settle_temperatures(&mut self) {
        let (filter, known) = (&self.config.filter_config, &self.config.thermometers);
        let outputs = &mut self.outputs;
        self.thermometers.settle(filter, known, |event| {
            outputs.tell(event);
        });
        if self.thermometers.take_refusal() {
            self.tell(Event::Text {
                source: self.config.own,
                severity: SEVERITY_WARNING,
                text: "there are more thermometers than are followed; those heard last are left out".to_owned(),
            });
        }
    }
}
