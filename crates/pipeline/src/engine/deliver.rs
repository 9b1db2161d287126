//! Estimates and messages on their way out.

use posebridge_protocol::message::Message;
use posebridge_telemetry::{
    Audience, Estimate, Event, HostClock, LinkId, LinkState, Output, Priority, Stamp,
};

use super::Pipeline;
use crate::config::{OutputInstant, OutputStream};
use crate::publish::{self, Circumstances, Prediction};

impl Pipeline {
    /// One estimate per input that brought news, for the latest instant that was observed: to the robot at once.
    pub(super) fn publish_to_robot(&mut self, now: Stamp<HostClock>) {
        if !std::mem::take(&mut self.is_news) {
            return;
        }
        let Some(estimate) = self
            .filter
            .latest()
            .and_then(|latest| self.filter.estimate_at(latest))
        else {
            return;
        };
        let robot = self.robot.unwrap_or_default();
        self.tell(Event::Estimated { robot, estimate });
        self.publish_on(robot.link, &estimate, now);
        self.for_others = Some(estimate);
    }

    /// To all others when nobody waits.
    pub(super) fn publish_to_others(&mut self, now: Stamp<HostClock>) {
        let Some(estimate) = self.for_others.take() else {
            return;
        };
        let served = self.robot.unwrap_or_default().link;
        let ids: Vec<LinkId> = self.links.keys().copied().collect();
        for id in ids.into_iter().filter(|id| *id != served) {
            self.publish_on(id, &estimate, now);
        }
    }

    fn publish_on(&mut self, id: LinkId, estimate: &Estimate, now: Stamp<HostClock>) {
        let due = match self.links.get_mut(&id) {
            Some(link) if link.state == LinkState::Up => link.publisher.due(now),
            _ => return,
        };
        for stream in due {
            if let Some(message) = self.message_for(&stream, estimate, now) {
                self.transmit(id, &message, publish::priority(stream.kind));
            }
        }
    }

    fn message_for(
        &self,
        stream: &OutputStream,
        observed: &Estimate,
        now: Stamp<HostClock>,
    ) -> Option<Message> {
        let arrival = now + publish::travel_time(self.brick_clock.round_trip());
        let ahead = match stream.instant {
            OutputInstant::Observed => None,
            OutputInstant::Arrival => self.brick_clock.remote_at(arrival).map(|(brick, _)| brick),
        };
        let predicted = ahead
            .filter(|brick| *brick > observed.stamp)
            .and_then(|brick| self.filter.estimate_at(brick));
        if let Some(predicted) = predicted {
            let circumstances = Circumstances {
                prediction: Prediction::Ahead,
                host: arrival,
                fix_ratio: self.fix_ratio,
            };
            return publish::message(stream.kind, &predicted, &circumstances);
        }
        let host = self.brick_clock.host_at(observed.stamp);
        let host = host.map_or(now, |(host, _)| host);
        let circumstances = Circumstances {
            prediction: Prediction::None,
            host,
            fix_ratio: self.fix_ratio,
        };
        publish::message(stream.kind, observed, &circumstances)
    }

    /// Sends a message of our own to all peers of a link.
    pub(super) fn transmit(&mut self, id: LinkId, message: &Message, priority: Priority) {
        let own = self.config.own;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if link.state == LinkState::Down {
            link.health.drops_out += 1;
            return;
        }
        // Before it takes a sequence number: what is held back must not look like a loss.
        let stream = match priority {
            Priority::Estimate { stream } => Some(stream),
            Priority::Command | Priority::Conversation | Priority::Forwarded => None,
        };
        if stream.is_some_and(|id| !link.limiter.admits(self.now, own, id, 0)) {
            link.health.thinned += 1;
            return;
        }
        let mut bytes = Vec::new();
        if link.encode(self.now, own, message, &mut bytes) == 0 {
            // A message that this link's MAVLink version does not have, or that cannot be signed. A brick with a protocol of its own
            // is told what it understands; the rest was never meant for it.
            link.health.drops_out += u64::from(link.codec.is_none());
            return;
        }
        if stream.is_some() || priority == Priority::Command {
            link.limiter.charge(self.now, bytes.len());
        }
        if link.codec.is_none() {
            self.router.say(&bytes);
        }
        link.health.bytes_out += bytes.len() as u64;
        link.health.frames_out += 1;
        self.outputs.push_back(Output::Transmit {
            link: id,
            to: Audience::All,
            priority,
            bytes,
        });
    }
}
