//! Commands about messages: what the station says once because somebody asks, and how often it says the rest.
//!
//! Both answer alike, the station's own component and, on a link for ground stations, the robot in whose name it speaks there.
//!
//! Sources: MAVLink guide, "Command Protocol"; common.xml, MAV_CMD_REQUEST_MESSAGE and MAV_CMD_GET_MESSAGE_INTERVAL.

use posebridge_protocol::dialect::ids::{
    self, COMMAND_GET_MESSAGE_INTERVAL, COMMAND_REQUEST_MESSAGE, COMMAND_SET_MESSAGE_INTERVAL,
};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{
    AutopilotVersion, CommandLong, CommandResult, ComponentInformation, Message, MessageInterval, ProtocolVersion,
};
use posebridge_telemetry::{Address, ComponentId, LinkId, Span};

use super::Pipeline;
use super::ground_station::LastRange;
use crate::config::{AcceptedVersions, OutputInstant, OutputKind, OutputStream};
use crate::link_state::Speaker;
use crate::publish::since_boot;
use crate::publisher::kind_of;
use crate::records;

/// Of MAV_PROTOCOL_CAPABILITY: COMMAND_INT is understood.
const TAKES_COMMAND_INT: u64 = 8;
/// Parameters are sent as the bytes of their type.
const PARAM_ENCODE_BYTEWISE: u64 = 16;
/// MAVLink 2 is spoken.
const MAVLINK2: u64 = 8_192;
/// FIRMWARE_VERSION_TYPE_DEV and FIRMWARE_VERSION_TYPE_OFFICIAL.
const DEVELOPMENT: u8 = 0;
const RELEASE: u8 = 255;
/// An interval of a message that there is not.
const NO_SUCH_MESSAGE: i32 = 0;

/// What becomes of a request, and what is said behind the answer.
type Outcome = (CommandResult, Vec<Message>);

impl Pipeline {
    /// Answers a command that a session does not know.
    pub(super) fn commanded(&mut self, (id, speaker): (LinkId, Speaker), by: Address, command: &CommandLong) {
        let (result, said) = match command.command {
            COMMAND_REQUEST_MESSAGE => self.requested(id, speaker, command),
            COMMAND_GET_MESSAGE_INTERVAL => match command.named_message() {
                Some(message_id) => self.interval_told(id, message_id),
                None => (CommandResult::Denied, Vec::new()),
            },
            // It names no message, or an interval that is none.
            COMMAND_SET_MESSAGE_INTERVAL => (CommandResult::Denied, Vec::new()),
            _ if speaker == Speaker::Station => (self.obey(id, command), Vec::new()),
            _ => (CommandResult::Unsupported, Vec::new()),
        };
        // A question to all components is for whoever can answer it; another one may be the one that is meant.
        let is_question = matches!(command.command, COMMAND_REQUEST_MESSAGE | COMMAND_GET_MESSAGE_INTERVAL);
        let is_for_all = command.target.component == ComponentId(0);
        if is_question && is_for_all && result != CommandResult::Accepted {
            return;
        }
        let link = self.links.get_mut(&id);
        if let Some(session) = link.and_then(|link| link.conversation(speaker)) {
            session.answer(by, command.command, result);
            for message in said {
                session.say(message);
            }
        }
    }

    fn requested(&mut self, id: LinkId, speaker: Speaker, command: &CommandLong) -> Outcome {
        let Some(message_id) = command.named_message() else {
            return (CommandResult::Denied, Vec::new());
        };
        let said = match message_id {
            ids::HEARTBEAT => self.heartbeat_on(id, speaker).into_iter().collect(),
            ids::AUTOPILOT_VERSION => vec![Message::AutopilotVersion(AutopilotVersion {
                capabilities: self.capabilities(id),
                software: software(),
            })],
            ids::PROTOCOL_VERSION => vec![self.protocol_version(id)],
            ids::COMPONENT_INFORMATION_BASIC => vec![self.component_information(id, speaker)],
            ids::MESSAGE_INTERVAL => {
                let [_, about, ..] = command.params;
                // The id stands in the second parameter, and the answer has room for 16 bits of it.
                if !(0.0..=f32::from(u16::MAX)).contains(&about) {
                    return (CommandResult::Denied, Vec::new());
                }
                return self.interval_told(id, about as u32);
            }
            other => match kind_of(other) {
                Some(kind) => self.last_of(id, kind),
                None => return (CommandResult::Unsupported, Vec::new()),
            },
        };
        if said.is_empty() {
            // There was none yet; it may be asked for again.
            (CommandResult::TemporarilyRejected, said)
        } else {
            (CommandResult::Accepted, said)
        }
    }

    fn heartbeat_on(&mut self, id: LinkId, speaker: Speaker) -> Option<Message> {
        // Who does not show that it is there does not say so when asked, either.
        let link = self.links.get_mut(&id)?;
        let beat = link.conversation(speaker)?.shown_heartbeat();
        beat.map(Message::Heartbeat)
    }

    fn interval_told(&self, id: LinkId, message_id: u32) -> Outcome {
        let Ok(on_wire) = u16::try_from(message_id) else {
            return (CommandResult::Denied, Vec::new());
        };
        let publisher = self.links.get(&id).map(|link| &link.publisher);
        let interval_micros = match (kind_of(message_id), publisher) {
            (Some(kind), Some(publisher)) => publisher.interval_micros(kind),
            _ => NO_SUCH_MESSAGE,
        };
        let told = MessageInterval { message_id: on_wire, interval_micros };
        (CommandResult::Accepted, vec![Message::MessageInterval(told)])
    }

    /// What an output would say at present; nothing if there was nothing to say yet.
    fn last_of(&self, id: LinkId, kind: OutputKind) -> Vec<Message> {
        match kind {
            OutputKind::DistanceSensor => {
                let last = self.last_range.map(LastRange::message);
                last.into_iter().collect()
            }
            OutputKind::FusionHealth | OutputKind::NamedValue | OutputKind::FloatArray => {
                let publisher = self.links.get(&id).map(|link| &link.publisher);
                let records = self.last_records.values();
                records
                    .filter_map(|record| {
                        let counts = publisher?.counts_of(record.sensor);
                        records::message(kind, record, self.host_instant(record.stamp), counts)
                    })
                    .collect()
            }
            OutputKind::PlanarPose
            | OutputKind::Odometry
            | OutputKind::LocalPosition
            | OutputKind::Attitude
            | OutputKind::EstimatorStatus => {
                let stream = OutputStream { kind, interval: Span::ZERO, instant: OutputInstant::Observed };
                let latest = self.filter.latest();
                let estimate = latest.and_then(|latest| self.filter.estimate_at(latest));
                let message = estimate.and_then(|last| self.message_for(id, &stream, &last));
                message.into_iter().collect()
            }
        }
    }

    fn capabilities(&self, id: LinkId) -> u64 {
        let spoken = match self.links.get(&id).map(|link| link.speaks) {
            Some(WireVersion::V2) => MAVLINK2,
            Some(WireVersion::V1) | None => 0,
        };
        TAKES_COMMAND_INT | PARAM_ENCODE_BYTEWISE | spoken
    }

    fn protocol_version(&self, id: LinkId) -> Message {
        let link = self.config.links.iter().find(|link| link.id == id);
        let speaks_v1 = link.is_some_and(|link| link.speaks == WireVersion::V1);
        let hears_v1 = link.is_some_and(|link| link.version == AcceptedVersions::V1AndV2);
        Message::ProtocolVersion(ProtocolVersion {
            version: if speaks_v1 { 100 } else { 200 },
            min_version: if hears_v1 { 100 } else { 200 },
            max_version: 200,
        })
    }

    fn component_information(&self, id: LinkId, speaker: Speaker) -> Message {
        let model = match speaker {
            Speaker::Station => "pose estimator",
            Speaker::Robot => "robot seen by posebridge",
        };
        Message::ComponentInformation(ComponentInformation {
            capabilities: self.capabilities(id),
            stamp: since_boot(self.now),
            vendor: "posebridge".to_owned(),
            model: model.to_owned(),
            software_version: env!("CARGO_PKG_VERSION").to_owned(),
        })
    }
}

/// Our version as AUTOPILOT_VERSION tells it; a number that does not fit reads as 0.
fn software() -> [u8; 4] {
    let number = |text: &str| text.parse().unwrap_or(0);
    let kind = if env!("CARGO_PKG_VERSION_PRE").is_empty() { RELEASE } else { DEVELOPMENT };
    [
        number(env!("CARGO_PKG_VERSION_MAJOR")),
        number(env!("CARGO_PKG_VERSION_MINOR")),
        number(env!("CARGO_PKG_VERSION_PATCH")),
        kind,
    ]
}
