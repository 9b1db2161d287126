//! The robot's voice on a link for ground stations.
//!
//! A ground station shows a vehicle if component 1 of a system says HEARTBEAT, and takes the attitude from that component alone. A
//! robot that speaks no MAVLink says nothing there, and one that does says no attitude. So the station speaks as the robot on such a
//! link, and whoever listens must not notice that two speak under one address:
//!
//! - The robot's frames that are passed on to the link take the next number of the same count ([`Encoder::renumber`]); payload and
//!   checksum's seed stay as they are. So do everybody else's, each of his own count, because not all of them are for this link.
//! - What the robot says itself is not said a second time.
//! - Signed frames must not be changed and leave as they came. While they do, the station keeps silent as the robot.
//! - On a link with a key unsigned frames of others are numbered like everywhere, and stay unsigned. The station's own are signed there,
//!   and its signature must not stand beside frames that the robot sends without one: it keeps silent as the robot there, too.
//!   docs/adr/0010 says why.
//!
//! [`Encoder::renumber`]: posebridge_protocol::dialect::Encoder::renumber

use std::collections::BTreeMap;

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::Message;
use posebridge_protocol::session::{Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{Address, ComponentId, HostClock, Span, Stamp, SystemId};

use crate::publisher::kind_of;

/// MAV_COMP_ID_AUTOPILOT1: the component that a ground station takes for the vehicle.
pub(crate) const VEHICLE: ComponentId = ComponentId(1);
/// What was not passed on for this long is not said by the robot any more: five heartbeats.
const SAID_LATELY: Span = Span::from_millis(5_000);

/// Who answers what is commanded to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Vehicle {
    /// The station, because the robot cannot: it speaks no MAVLink, or under another component.
    Mute,
    /// The robot, except for what the station says in its name.
    Speaks,
}

/// The robot's voice on one link.
#[derive(Debug, Default)]
pub(crate) struct RobotVoice {
    /// Who the robot is, once it is known.
    known: Option<Known>,
    /// When vehicles' own frames of the messages that we might say left here last.
    said: BTreeMap<(SystemId, u32), Stamp<HostClock>>,
    /// When a frame of somebody that must not be changed left here last.
    untouched: BTreeMap<Address, Stamp<HostClock>>,
    /// When a vehicle's own frame left here last while the link has a key.
    beside_a_key: BTreeMap<SystemId, Stamp<HostClock>>,
}

#[derive(Debug)]
struct Known {
    address: Address,
    vehicle: Vehicle,
    session: Session<HostClock>,
}

impl RobotVoice {
    /// The robot is known; `config` says under which address it appears.
    pub(crate) fn meet(&mut self, config: SessionConfig, vehicle: Vehicle, now: Stamp<HostClock>) {
        if self.known.is_none() {
            self.known = Some(Known { address: config.own, vehicle, session: Session::new(config, now) });
        }
    }

    /// The address that it speaks under; `None` before the robot is known.
    pub(crate) fn address(&self) -> Option<Address> {
        self.known.as_ref().map(|known| known.address)
    }

    pub(crate) fn session(&mut self) -> Option<&mut Session<HostClock>> {
        self.known.as_mut().map(|known| &mut known.session)
    }

    pub(crate) fn poll(&mut self) -> Option<SessionOutput<HostClock>> {
        self.session()?.poll()
    }

    pub(crate) fn deadline(&self) -> Option<Stamp<HostClock>> {
        self.known.as_ref()?.session.deadline()
    }

    /// Whether the conversation wants nothing.
    pub(crate) fn is_silent(&self) -> bool {
        self.known.as_ref().is_none_or(|known| known.session.is_silent())
    }

    /// Whether the conversation waits for an instant that has come.
    pub(crate) fn is_due(&mut self, now: Stamp<HostClock>) -> bool {
        self.session().is_some_and(|session| session.is_due(now))
    }

    /// A vehicle's own frame leaves on the link.
    pub(crate) fn passed(&mut self, now: Stamp<HostClock>, from: SystemId, message_id: u32) {
        // Of the others nobody asks; so the map stays small whatever comes.
        if message_id == ids::HEARTBEAT || kind_of(message_id).is_some() {
            self.said.insert((from, message_id), now);
        }
    }

    /// A frame leaves as it came, because it must not be changed.
    pub(crate) fn passed_untouched(&mut self, now: Stamp<HostClock>, from: Address) {
        self.untouched.insert(from, now);
    }

    /// A vehicle's own frame leaves on a link with a key, where ours under the same address would be signed.
    pub(crate) fn passed_beside_a_key(&mut self, now: Stamp<HostClock>, from: SystemId) {
        self.beside_a_key.insert(from, now);
    }

    /// Whether somebody's frames leave under numbers of his own.
    pub(crate) fn is_untouched(&self, now: Stamp<HostClock>, from: Address) -> bool {
        is_lately(now, self.untouched.get(&from))
    }

    /// Whether frames leave under the robot's address beside which ours must not stand: signed ones, or any where the link has a key.
    pub(crate) fn is_silenced(&self, now: Stamp<HostClock>) -> bool {
        self.address()
            .is_some_and(|own| self.is_untouched(now, own) || is_lately(now, self.beside_a_key.get(&own.system)))
    }

    /// Whether the robot says this message here itself.
    pub(crate) fn is_said_by_robot(&self, now: Stamp<HostClock>, message_id: u32) -> bool {
        let own = self.address();
        is_lately(now, own.and_then(|own| self.said.get(&(own.system, message_id))))
    }

    /// Whether a message commands the vehicle something that is ours to answer: all of it where the robot cannot, else what concerns
    /// messages that we say in its name.
    pub(crate) fn takes(&self, now: Stamp<HostClock>, message: &Message) -> bool {
        let Some(known) = &self.known else {
            return false;
        };
        let Some((target, concerns)) = concern_of(message) else {
            return false;
        };
        if target != known.address || self.is_silenced(now) {
            return false;
        }
        let is_ours = |id| kind_of(id).is_some() && !self.is_said_by_robot(now, id);
        known.vehicle == Vehicle::Mute || concerns.is_some_and(is_ours)
    }
}

fn is_lately(now: Stamp<HostClock>, last: Option<&Stamp<HostClock>>) -> bool {
    last.is_some_and(|last| now - *last < SAID_LATELY)
}

/// Whom a message commands, and which message the command is about, if it is about one.
fn concern_of(message: &Message) -> Option<(Address, Option<u32>)> {
    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "only these are commands, however many kinds of messages there are"
    )]
    match message {
        Message::SetMessageInterval(wanted) => Some((wanted.target, Some(wanted.message_id))),
        Message::Command(command) => Some((command.target, command.named_message())),
        Message::CommandInt(command) => {
            let command = command.to_long();
            Some((command.target, command.named_message()))
        }
        _ => None,
    }
}
