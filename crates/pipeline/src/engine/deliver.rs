//! Estimates and messages on their way out.

use posebridge_protocol::message::Message;
use posebridge_protocol::routing::Way;
use posebridge_telemetry::{
    Audience, Estimate, Event, FusionRecord, HostClock, LinkId, LinkState, Output, Priority, Stamp,
};

use super::Pipeline;
use crate::config::{OutputInstant, OutputStream, Voices};
use crate::link_state::Speaker;
use crate::publish::{self, Circumstances, Prediction};
use crate::publisher::{priority, priority_of_record};
use crate::robot_voice::RobotVoice;

/// Message ids have 24 bits.
const LARGEST_ID: u32 = 0x00FF_FFFF;

impl Pipeline {
    /// One estimate per input that brought news, for the latest instant that was observed: to the robot at once.
    pub(super) fn publish_to_robot(&mut self, now: Stamp<HostClock>) {
        if !std::mem::take(&mut self.is_news) {
            return;
        }
        let estimate = match self.filter.latest() {
            Some(latest) => self.filter.estimate_at(latest),
            None => None,
        };
        self.ask_for_fix(now, estimate.as_ref());
        let Some(estimate) = &estimate else {
            return;
        };
        let robot = self.robot.unwrap_or_default();
        self.tell(Event::Estimated { robot, estimate: *estimate });
        self.publish_on(robot.link, estimate, now);
        let has_others = self.links.len() > 1 || !self.links.contains_key(&robot.link);
        self.for_others = has_others.then_some(*estimate);
    }

    /// To all others when nobody waits.
    pub(super) fn publish_to_others(&mut self, now: Stamp<HostClock>) {
        let Some(estimate) = self.for_others.take() else {
            return;
        };
        let served = self.robot.unwrap_or_default().link;
        let others = self.links.keys().copied().filter(|id| *id != served);
        for id in others.collect::<Vec<LinkId>>() {
            self.publish_on(id, &estimate, now);
        }
    }

    fn publish_on(&mut self, id: LinkId, estimate: &Estimate, now: Stamp<HostClock>) {
        let due = match self.links.get_mut(&id) {
            Some(link) if link.state == LinkState::Up => link.publisher.due(now),
            _ => return,
        };
        for stream in due {
            if let Some(message) = self.message_for(id, &stream, estimate) {
                self.transmit_output(id, stream.kind, &message, priority(stream.kind));
            }
        }
    }

    /// What became of an observation, to whoever wants to know.
    pub(super) fn publish_record(&mut self, record: &FusionRecord) {
        if record.degrees_of_freedom > 0 {
            self.last_records.insert(record.sensor, record.clone());
        }
        let (clock, now) = (&self.brick_clock, self.now);
        let host = || clock.host_at(record.stamp).map_or(now, |(host, _)| host);
        let mut wanted = Vec::new();
        for (id, link) in &mut self.links {
            let said = link.publisher.of_record(record, &host, now).into_iter();
            wanted.extend(said.map(|(kind, message)| (*id, kind, message)));
        }
        for (id, kind, message) in wanted {
            let priority = priority_of_record(kind, record.sensor);
            self.transmit_output(id, kind, &message, priority);
        }
    }

    /// What one of a link's outputs says of an estimate.
    pub(super) fn message_for(&self, id: LinkId, stream: &OutputStream, observed: &Estimate) -> Option<Message> {
        let voice = self.links.get(&id).and_then(|link| link.voice.as_ref());
        let voices = voice.map_or(Voices::Own, |_| Voices::OwnAndRobot);
        let arrival = self.now + publish::travel_time(self.brick_clock.round_trip());
        let ahead = match stream.instant {
            OutputInstant::Observed => None,
            OutputInstant::Arrival => self.brick_clock.remote_at(arrival).map(|(brick, _)| brick),
        };
        let predicted = ahead.filter(|brick| *brick > observed.stamp).and_then(|brick| self.filter.estimate_at(brick));
        if let Some(predicted) = predicted {
            let circumstances =
                Circumstances { prediction: Prediction::Ahead, host: arrival, fix_ratio: self.fix_ratio, voices };
            return publish::message(stream.kind, &predicted, &circumstances);
        }
        let circumstances = Circumstances {
            prediction: Prediction::None,
            host: self.host_instant(observed.stamp),
            fix_ratio: self.fix_ratio,
            voices,
        };
        publish::message(stream.kind, observed, &circumstances)
    }

    /// Sends a message of our own to all peers of a link.
    pub(super) fn transmit(&mut self, id: LinkId, message: &Message, priority: Priority) {
        self.transmit_as(id, Speaker::Station, message, priority);
    }

    /// The same, as the station or as the robot.
    pub(super) fn transmit_as(&mut self, id: LinkId, speaker: Speaker, message: &Message, priority: Priority) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let own = match speaker {
            Speaker::Station => Some(self.config.own),
            Speaker::Robot => link.voice.as_ref().and_then(RobotVoice::address),
        };
        let Some(own) = own else {
            return;
        };
        if link.state == LinkState::Down {
            link.health.drops_out += 1;
            return;
        }
        // Before it takes a sequence number: what is held back must not look like a loss.
        let stream = match priority {
            // Behind the message's id may stand the sensor's.
            Priority::Estimate { stream } => Some(stream & LARGEST_ID),
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
        match speaker {
            Speaker::Robot => {
                let way = self.robot_heard.map_or_else(Way::default, |(way, _)| way);
                self.router.say_for(self.now, way, &bytes);
            }
            Speaker::Station if link.codec.is_none() => self.router.say(&bytes),
            Speaker::Station => {}
        }
        link.health.bytes_out += bytes.len() as u64;
        link.health.frames_out += 1;
        self.outputs.push(Output::Transmit { link: id, to: Audience::All, priority, bytes });
    }
}
