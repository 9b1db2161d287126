//! Links for ground stations: who is seen there, and whose frames bear which number.
//!
//! The estimator appears as the station's own component, the robot as component 1 of its system ([`crate::robot_voice`]). Both say
//! heartbeats only while the robot is heard: a ground station must notice when it is not.

use posebridge_protocol::dialect::{RenumberError, ids};
use posebridge_protocol::message::{Heartbeat, Message, WireStamp};
use posebridge_protocol::session::{Presence, SessionConfig};
use posebridge_telemetry::{
    Address, Audience, BrickClock, HostClock, LinkId, LinkState, Meters, Output, Priority, RobotId, Stamp,
};

use super::Pipeline;
use super::forward::Passed;
use crate::config::OutputKind;
use crate::link_state::{Link, PEER_TIMEOUT, Speaker, conversation_of};
use crate::publish::since_boot;
use crate::publisher::{id_of, priority};
use crate::robot_voice::{VEHICLE, Vehicle};

/// MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, nothing armed, MAV_STATE_ACTIVE.
const ROVER: Heartbeat = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };

/// A range as it was observed last.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastRange {
    pub(super) range: Meters,
    pub(super) host: Stamp<HostClock>,
}

impl LastRange {
    pub(super) fn message(self) -> Message {
        let stamp: WireStamp = since_boot(self.host);
        Message::DistanceSensor { stamp, range: self.range, sigma: None }
    }
}

impl Pipeline {
    /// Whether the robot was heard of late.
    pub(super) fn robot_is_heard(&self) -> bool {
        let heard = self.robot_heard.map(|(_, last)| last);
        heard.is_some_and(|last| self.now - last < PEER_TIMEOUT)
    }

    /// Lets the links for ground stations know who the robot is, and whether it is there. To be called before their sessions are woken.
    pub(super) fn show_robot(&mut self) {
        if self.voices == 0 {
            return;
        }
        let presence = if self.robot_is_heard() { Presence::Shown } else { Presence::Withheld };
        let vehicle = self.vehicle();
        for (id, link) in &mut self.links {
            let Some(voice) = &mut link.voice else {
                continue;
            };
            // On a link where it is heard itself it needs nobody to speak for it.
            if let Some((robot, address, vehicle)) = vehicle
                && !self.router.lead_to_one(*id, robot.link)
            {
                voice.meet(as_vehicle(address, &self.config), vehicle, self.now);
            }
            link.session.show(presence);
            if let Some(session) = voice.session() {
                session.show(presence);
            }
        }
    }

    /// The robot, the address under which ground stations see it, and who answers there; `None` before it is known, and where that
    /// address is the station's own.
    fn vehicle(&self) -> Option<(RobotId, Address, Vehicle)> {
        let robot = self.robot?;
        let address = Address { system: robot.address.system, component: VEHICLE };
        let link = self.links.get(&robot.link)?;
        let vehicle = if link.codec.is_some() || robot.address != address { Vehicle::Mute } else { Vehicle::Speaks };
        (address != self.config.own).then_some((robot, address, vehicle))
    }

    /// Sends one of the outputs on a link, as whoever says it there; nobody does if the robot says it itself.
    pub(super) fn transmit_output(&mut self, id: LinkId, kind: OutputKind, message: &Message, priority: Priority) {
        let now = self.now;
        let voice = self.links.get(&id).and_then(|link| link.voice.as_ref());
        let speaker = match voice {
            Some(voice) if kind.is_of_vehicle() && voice.address().is_some() => {
                if voice.is_said_by_robot(now, id_of(kind)) {
                    return;
                }
                if voice.is_silenced(now) { Speaker::Station } else { Speaker::Robot }
            }
            _ => Speaker::Station,
        };
        self.transmit_as(id, speaker, message, priority);
    }

    /// Sends what the robot's voice on a link says of itself: heartbeats that the robot does not send, and answers.
    pub(super) fn transmit_conversation_of_robot(&mut self, id: LinkId, message: &Message, priority: Priority) {
        let now = self.now;
        let voice = self.links.get(&id).and_then(|link| link.voice.as_ref());
        let may_speak = voice.is_some_and(|voice| {
            let is_beat = matches!(message, Message::Heartbeat(_));
            let is_said = is_beat && voice.is_said_by_robot(now, ids::HEARTBEAT);
            !voice.is_silenced(now) && !is_said
        });
        if may_speak {
            self.transmit_as(id, Speaker::Robot, message, priority);
        }
    }

    /// The robot's range was observed: it goes to whoever wants it.
    pub(super) fn publish_range(&mut self, range: Meters, stamp: Stamp<BrickClock>) {
        let host = self.host_instant(stamp);
        let last = LastRange { range, host };
        self.last_range = Some(last);
        let now = self.now;
        let links = self.links.iter_mut();
        let wanting: Vec<LinkId> = links
            .filter_map(|(id, link)| {
                let is_due = link.state == LinkState::Up && link.publisher.range_due(now);
                is_due.then_some(*id)
            })
            .collect();
        for id in wanting {
            let kind = OutputKind::DistanceSensor;
            self.transmit_output(id, kind, &last.message(), priority(kind));
        }
    }

    /// A brick instant by the host's clock; the present while that is not known.
    pub(super) fn host_instant(&self, stamp: Stamp<BrickClock>) -> Stamp<HostClock> {
        let host = self.brick_clock.host_at(stamp);
        host.map_or(self.now, |(host, _)| host)
    }

    /// Passes a frame on to a link for ground stations, under the next number of its sender's count there. False if it is to be
    /// passed on like any other.
    ///
    /// Not every frame of a sender is for this link (answers to others, what is filtered or thinned), and the robot shares its address
    /// with us: by the numbers that they came with a ground station would compute losses that are none.
    pub(super) fn pass_on_counted(&mut self, id: LinkId, frame: &Passed) -> bool {
        let now = self.now;
        let home = self.robot.map(|robot| robot.link);
        let origin = match home {
            Some(home) if !self.router.lead_to_one(frame.from.link, home) => Origin::Elsewhere,
            Some(_) | None => Origin::Robot,
        };
        // Whoever is on the link himself is heard there by some peers without us.
        let is_at_home = self.router.lead_to_one(frame.from.link, id);
        let link = self.links.get_mut(&id).filter(|_| !is_at_home);
        let Some((link, numbered)) =
            link.and_then(|link| numbered(link, now, frame, origin).map(|bytes| (link, bytes)))
        else {
            return false;
        };
        self.router.say_for(now, frame.from, &numbered);
        link.health.bytes_out += numbered.len() as u64;
        link.health.frames_out += 1;
        link.health.forwarded += 1;
        // Among our own, because the robot's count is ours, too, and what is counted first must leave first. To all peers of the link,
        // because whoever does not get a frame would take it for lost.
        self.outputs.push(Output::Transmit { link: id, to: Audience::All, priority: frame.priority, bytes: numbered });
        true
    }
}

/// By which way a frame came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Origin {
    /// By a link of the robot, or while that is not known.
    Robot,
    /// By another one: whoever bears the robot's address there must not make us silent.
    Elsewhere,
}

/// The frame under the next number of its sender's count on a link; `None` if it has to stay as it is.
fn numbered(link: &mut Link, now: Stamp<HostClock>, frame: &Passed, origin: Origin) -> Option<Vec<u8>> {
    let voice = link.voice.as_mut()?;
    let from = frame.source;
    let is_of_robot = origin == Origin::Robot;
    if is_of_robot && from.component == VEHICLE {
        voice.passed(now, from.system, frame.message_id);
        if link.peers.signing.is_some() {
            voice.passed_beside_a_key(now, from.system);
        }
    }
    let mut bytes = frame.bytes.clone();
    let outcome = if voice.is_untouched(now, from) {
        Err(RenumberError::Signed)
    } else {
        link.encoder.renumber(&mut bytes).map(|()| bytes)
    };
    if outcome == Err(RenumberError::Signed) && is_of_robot {
        if frame.is_signed {
            voice.passed_untouched(now, from);
        }
        // Should the next one be ours, it follows that.
        link.encoder.follow(from, frame.sequence);
    }
    outcome.ok()
}

fn as_vehicle(address: Address, config: &crate::config::PipelineConfig) -> SessionConfig {
    SessionConfig {
        own: address,
        heartbeat: ROVER,
        timesync_period: None,
        wanted: Vec::new(),
        ..conversation_of(config)
    }
}

impl OutputKind {
    /// Whether a ground station looks for it at the vehicle.
    const fn is_of_vehicle(self) -> bool {
        match self {
            Self::Attitude | Self::DistanceSensor => true,
            Self::PlanarPose
            | Self::Odometry
            | Self::LocalPosition
            | Self::EstimatorStatus
            | Self::FusionHealth
            | Self::NamedValue
            | Self::FloatArray => false,
        }
    }
}
