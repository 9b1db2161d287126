//! Estimates on their way from the robots to the links: to the robot itself at once, to all others as deferred work.

use posebridge_protocol::message::{Message, NamedValue, WireStamp};
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{
    ChannelName, Estimate, Event, LinkId, LinkState, Priority, RobotId, ScalarEstimate, severity,
};

use crate::link_context::LinkContext;
use crate::sender_identity::RobotIndex;
use crate::station::Station;

/// Names of the estimate of one quantity on the wire, and of its rate per second.
const QUANTITY_NAME: &[u8] = b"estimate";
const RATE_NAME: &[u8] = b"est_rate";
/// Their streams: the id of NAMED_VALUE_FLOAT, and a number above all message ids.
const QUANTITY_STREAMS: [u32; 2] = [0x0100_00FB, 0x0200_00FB];

impl Station {
    /// Publishes one estimate per robot with new data, for the latest observed instant: to the robot at once.
    pub(crate) fn publish_to_robots(&mut self) {
        while let Some(index) = self.robots.changed.pop_first() {
            let estimator = &self.robots.get(index).estimator;
            let (estimate, quantity) = (estimator.latest_estimate(), estimator.latest_quantity());
            if let Some(quantity) = quantity {
                self.publish_quantity(self.robots.get(index).id, &quantity);
            }
            self.request_fixes(estimate.as_ref());
            let Some(estimate) = &estimate else {
                continue;
            };
            let robot = self.robots.get(index).id;
            self.emit(Event::EstimateUpdated { robot, estimate: *estimate });
            self.record_mission_estimate(index, estimate);
            if let Some(text) = self.robots.get_mut(index).alarms.observe_estimate(estimate) {
                self.report_own_text(severity::NOTICE, self.robots.labelled(index, &text));
            }
            self.robots.get_mut(index).compared.push_published(estimate);
            self.publish_estimate(index, robot.link, estimate);
            if self.links.len() > 1 || !self.links.contains_key(&robot.link) {
                self.robots.get_mut(index).publisher.pending = Some(*estimate);
                self.robots.pending.insert(index);
            }
        }
    }

    /// Sends the estimate of one quantity on every link, value and rate as two NAMED_VALUE_FLOAT, which a small brick can read.
    fn publish_quantity(&mut self, robot: RobotId, estimate: &ScalarEstimate) {
        self.emit(Event::QuantityUpdated { robot, estimate: *estimate });
        let stamp = WireStamp::Micros64(u64::try_from(estimate.stamp.as_nanos() / 1_000).unwrap_or_default());
        for link in self.link_ids() {
            if self.links.get(&link).is_none_or(|link| link.state != LinkState::Up) {
                continue;
            }
            let values = [(QUANTITY_NAME, estimate.value), (RATE_NAME, estimate.rate_per_s)];
            // In a crowd what is for all goes to ground stations alone.
            let is_crowded = self.links.get(&link).is_some_and(LinkContext::is_crowded);
            let index = self.robots.find(robot).filter(|_| is_crowded);
            let own_peer = index.and_then(|index| self.robots.identities.peer_on(index, link));
            for (stream, (name, value)) in QUANTITY_STREAMS.into_iter().zip(values) {
                let named = NamedValue { stamp, name: ChannelName::from_bytes(name), value: value as f32 };
                let (message, priority) = (Message::NamedValue(named), Priority::Estimate { stream });
                if let Some(peer) = own_peer {
                    self.transmitter().send_to_peer(Endpoint { link, peer }, &message, priority);
                }
                self.transmitter().send(link, &message, priority);
            }
        }
    }

    /// Publishes the estimates on all other links, as deferred work.
    pub(crate) fn publish_to_others(&mut self) {
        while let Some(index) = self.robots.pending.pop_first() {
            let robot = self.robots.get_mut(index);
            let home = robot.id.link;
            let Some(estimate) = robot.publisher.pending.take() else {
                continue;
            };
            for id in self.link_ids() {
                if id != home {
                    self.publish_estimate(index, id, &estimate);
                }
            }
        }
    }

    /// Runs the compared filters, as deferred work.
    pub(crate) fn process_comparisons(&mut self) {
        for robot in self.robots.all_mut().iter_mut().filter(|robot| robot.compared.has_pending()) {
            robot.compared.process(robot.id, |event| self.outputs.emit(event));
        }
    }

    fn publish_estimate(&mut self, index: RobotIndex, id: LinkId, estimate: &Estimate) {
        if self.links.get(&id).is_none_or(|link| link.state != LinkState::Up) {
            return;
        }
        let (publisher, source) = self.robots.get_mut(index).publishing(self.time.now);
        for message in publisher.publish(id, estimate, source) {
            self.transmitter().send_published(index, &message);
        }
    }
}
