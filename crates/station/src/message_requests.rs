//! Commands about messages: sends one on request, and reports or sets intervals.
//!
//! The station's own component replies and, on a link for ground stations, each robot for which it sends there.
//!
//! Sources: MAVLink guide, "Command Protocol"; common.xml, MAV_CMD_REQUEST_MESSAGE and MAV_CMD_GET_MESSAGE_INTERVAL.

use posebridge_protocol::dialect::ids::{
    self, COMMAND_GET_HOME_POSITION, COMMAND_GET_MESSAGE_INTERVAL, COMMAND_REQUEST_CAPABILITIES,
    COMMAND_REQUEST_MESSAGE, COMMAND_REQUEST_PROTOCOL_VERSION, COMMAND_SET_MESSAGE_INTERVAL,
};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{
    AutopilotVersion, AvailableMode, CommandLong, CommandResult, ComponentInformation, ComponentMetadata, Heartbeat,
    Message, MessageInterval, MetadataForm, ProtocolVersion, SetMessageInterval,
};
use posebridge_telemetry::{ComponentId, HostClock, LinkId, Timestamp};

use crate::config::{AcceptedVersions, LinkConfig, OutputKind, StationConfig};
use crate::estimate_messages::host_stamp;
use crate::metadata_files::{GENERAL_URI, general_crc};
use crate::robot::Robot;
use crate::robot_table::RobotTable;
use crate::sender_identity::RobotIndex;
use crate::sessions::SenderRole;
use crate::vehicle_status::{STATUS_MESSAGES, status_message_id, vehicle_status};

/// MAV_PROTOCOL_CAPABILITY: COMMAND_INT is supported.
const CAPABILITY_COMMAND_INT: u64 = 8;
/// A vehicle's plans are requested with MISSION_REQUEST_INT: without this some ground stations do not ask for them at all.
const CAPABILITY_MISSION_INT: u64 = 4;
/// Files are served.
const CAPABILITY_FTP: u64 = 32;
/// Parameters are sent as the bytes of their type.
const CAPABILITY_PARAM_BYTEWISE: u64 = 16;
/// Positions in the arena are followed.
const CAPABILITY_SET_POSITION_TARGET: u64 = 128;
/// MAVLink 2 is supported.
const CAPABILITY_MAVLINK2: u64 = 8_192;
/// FIRMWARE_VERSION_TYPE_DEV and FIRMWARE_VERSION_TYPE_OFFICIAL.
const FIRMWARE_DEVELOPMENT: u8 = 0;
const FIRMWARE_RELEASE: u8 = 255;
/// The only mode of a robot. Its custom mode is that of the heartbeat.
const MODE_NAME: &str = "Driving";
/// MAV_MODE_PROPERTY_NOT_USER_SELECTABLE.
const NOT_SELECTABLE: u32 = 2;
/// Time between two heartbeats.
const HEARTBEAT_MICROS: i32 = 1_000_000;
/// MESSAGE_INTERVAL for a message that does not exist.
const NO_SUCH_MESSAGE: i32 = 0;

/// The result of a request, and the messages after the acknowledgement.
#[derive(Debug)]
pub(crate) struct RequestReply {
    pub(crate) result: CommandResult,
    pub(crate) messages: Vec<Message>,
}

impl RequestReply {
    pub(crate) const fn of(result: CommandResult) -> Self {
        Self { result, messages: Vec::new() }
    }

    /// Without any, there was none yet; it may be requested again.
    fn from_messages(messages: Vec<Message>) -> Self {
        let result = if messages.is_empty() { CommandResult::TemporarilyRejected } else { CommandResult::Accepted };
        Self { result, messages }
    }

    fn accepted(message: Message) -> Self {
        Self { result: CommandResult::Accepted, messages: vec![message] }
    }

    /// A command to all components may be for any that supports it: when the station does not, another one may.
    pub(crate) fn may_be_left_to_others(&self, command: &CommandLong) -> bool {
        let is_about_messages = matches!(command.command, COMMAND_REQUEST_MESSAGE | COMMAND_GET_MESSAGE_INTERVAL);
        let is_refused = match self.result {
            CommandResult::Accepted | CommandResult::InProgress => false,
            CommandResult::Unsupported | CommandResult::TemporarilyRejected => true,
            // The station's own command with a wrong value.
            CommandResult::Denied
            | CommandResult::Failed
            | CommandResult::IntOnly
            | CommandResult::UnsupportedFrame => is_about_messages,
        };
        command.target.component == ComponentId(0) && is_refused
    }
}

#[derive(Clone, Copy)]
pub(crate) struct RequestContext<'a> {
    pub(crate) config: &'a StationConfig,
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) robots: &'a RobotTable,
    pub(crate) link: LinkId,
    pub(crate) role: SenderRole,
    pub(crate) requester: Option<RobotIndex>,
}

impl RequestContext<'_> {
    /// The reply to a command about messages; `None` for other commands. `heartbeat` is the present one of the role. A role
    /// that sends no heartbeats does not send one on request either.
    pub(crate) fn answer(&self, command: &CommandLong, heartbeat: Option<Heartbeat>) -> Option<RequestReply> {
        match command.command {
            COMMAND_REQUEST_MESSAGE => Some(self.requested_message(command, heartbeat)),
            COMMAND_GET_MESSAGE_INTERVAL => Some(match command.named_message() {
                Some(message_id) => self.interval(message_id),
                None => RequestReply::of(CommandResult::Denied),
            }),
            COMMAND_REQUEST_PROTOCOL_VERSION => Some(RequestReply::accepted(self.protocol_version())),
            COMMAND_GET_HOME_POSITION => Some(RequestReply::from_messages(self.vehicle_status(ids::HOME_POSITION))),
            COMMAND_REQUEST_CAPABILITIES => Some(RequestReply::accepted(self.autopilot_version())),
            COMMAND_SET_MESSAGE_INTERVAL => Some(RequestReply::of(match SetMessageInterval::from_command(command) {
                Some(_) => CommandResult::Unsupported,
                // It names no message, or an interval that is none.
                None => CommandResult::Denied,
            })),
            _ => None,
        }
    }

    fn requested_message(&self, command: &CommandLong, heartbeat: Option<Heartbeat>) -> RequestReply {
        let Some(message_id) = command.named_message() else {
            return RequestReply::of(CommandResult::Denied);
        };
        let messages = match message_id {
            ids::HEARTBEAT => heartbeat.map(Message::Heartbeat).into_iter().collect(),
            ids::AUTOPILOT_VERSION => vec![self.autopilot_version()],
            ids::PROTOCOL_VERSION => vec![self.protocol_version()],
            ids::COMPONENT_INFORMATION_BASIC => vec![self.component_information()],
            ids::COMPONENT_METADATA if self.is_vehicle() => vec![self.component_metadata(MetadataForm::Current)],
            ids::COMPONENT_INFORMATION if self.is_vehicle() => vec![self.component_metadata(MetadataForm::Deprecated)],
            ids::AVAILABLE_MODES if self.is_vehicle() => {
                let [_, index, ..] = command.params;
                // 0 is all of them, and there is one.
                if !(0.0..2.0).contains(&index) {
                    return RequestReply::of(CommandResult::Denied);
                }
                vec![Message::AvailableMode(AvailableMode {
                    custom_mode: 0,
                    properties: NOT_SELECTABLE,
                    modes: 1,
                    index: 1,
                    standard_mode: 0,
                    name: MODE_NAME.to_owned(),
                })]
            }
            ids::MESSAGE_INTERVAL => {
                let [_, about, ..] = command.params;
                // The id is the second parameter, and the reply has 16 bits for it.
                if !(0.0..=f32::from(u16::MAX)).contains(&about) {
                    return RequestReply::of(CommandResult::Denied);
                }
                return self.interval(about as u32);
            }
            status if STATUS_MESSAGES.contains(&status) => self.vehicle_status(status),
            other => match OutputKind::of_message(other) {
                Some(kind) => match self.robot() {
                    Some(robot) => robot.publisher.current(self.link, kind, robot.estimate_source(self.now)),
                    None => Vec::new(),
                },
                None => return RequestReply::of(CommandResult::Unsupported),
            },
        };
        RequestReply::from_messages(messages)
    }

    /// The status message of the robot with this id; none while it is unknown.
    fn vehicle_status(&self, message_id: u32) -> Vec<Message> {
        let messages = self.robot().map_or_else(Vec::new, |robot| vehicle_status(self.now, robot));
        messages.into_iter().filter(|message| status_message_id(message) == Some(message_id)).collect()
    }

    /// The robot of the reply: the one as which the station replies, or the requesting one, or the only one.
    fn robot(&self) -> Option<&Robot> {
        match self.role {
            SenderRole::Station => match self.requester {
                Some(index) => Some(self.robots.get(index)),
                None => (self.robots.len() < 2).then(|| self.robots.first()),
            },
            SenderRole::Vehicle(id) => self.robots.find(id).map(|index| self.robots.get(index)),
        }
    }

    fn interval(&self, message_id: u32) -> RequestReply {
        let Ok(on_wire) = u16::try_from(message_id) else {
            return RequestReply::of(CommandResult::Denied);
        };
        let kind = OutputKind::of_message(message_id);
        // For a requester that is no robot the first one represents all: it has the intervals that were requested for all of them.
        let robot = self.robot().unwrap_or_else(|| self.robots.first());
        let interval = kind.and_then(|kind| robot.publisher.interval_micros(self.link, kind));
        // They are sent with the heartbeats.
        let of_status = (self.is_vehicle() && STATUS_MESSAGES.contains(&message_id)).then_some(HEARTBEAT_MICROS);
        let interval_micros = interval.or(of_status).unwrap_or(NO_SUCH_MESSAGE);
        let reply = Message::MessageInterval(MessageInterval { message_id: on_wire, interval_micros });
        RequestReply { result: CommandResult::Accepted, messages: vec![reply] }
    }

    fn is_vehicle(&self) -> bool {
        self.role != SenderRole::Station
    }

    fn capabilities(&self) -> u64 {
        let sends_v2 = self.link_config().is_some_and(|link| link.send_version == WireVersion::V2);
        let of_vehicle = if self.is_vehicle() { CAPABILITY_MISSION_INT | CAPABILITY_FTP } else { 0 };
        let takes_goals = self.is_vehicle() && self.robot().is_some_and(|robot| robot.accepts_goals);
        let of_goals = if takes_goals { CAPABILITY_SET_POSITION_TARGET } else { 0 };
        let of_link = if sends_v2 { CAPABILITY_MAVLINK2 } else { 0 };
        CAPABILITY_COMMAND_INT | CAPABILITY_PARAM_BYTEWISE | of_vehicle | of_goals | of_link
    }

    fn autopilot_version(&self) -> Message {
        Message::AutopilotVersion(AutopilotVersion { capabilities: self.capabilities(), software: firmware_version() })
    }

    fn component_metadata(&self, form: MetadataForm) -> Message {
        Message::ComponentMetadata(ComponentMetadata {
            form,
            boot_millis: (self.now.as_micros() / 1_000) as u32,
            file_crc: general_crc(),
            uri: GENERAL_URI.to_owned(),
        })
    }

    fn link_config(&self) -> Option<&LinkConfig> {
        self.config.links.iter().find(|link| link.id == self.link)
    }

    fn protocol_version(&self) -> Message {
        let link = self.link_config();
        let sends_v1 = link.is_some_and(|link| link.send_version == WireVersion::V1);
        let accepts_v1 = link.is_some_and(|link| link.accepted_versions == AcceptedVersions::V1AndV2);
        Message::ProtocolVersion(ProtocolVersion {
            version: if sends_v1 { 100 } else { 200 },
            min_version: if accepts_v1 { 100 } else { 200 },
            max_version: 200,
        })
    }

    fn component_information(&self) -> Message {
        let model = match self.role {
            SenderRole::Station => "pose estimator",
            SenderRole::Vehicle(_) => "robot seen by posebridge",
        };
        Message::ComponentInformation(ComponentInformation {
            capabilities: self.capabilities(),
            stamp: host_stamp(self.now),
            vendor: "posebridge".to_owned(),
            model: model.to_owned(),
            software_version: env!("CARGO_PKG_VERSION").to_owned(),
        })
    }
}

/// Our version for AUTOPILOT_VERSION; a number that does not fit becomes 0.
fn firmware_version() -> [u8; 4] {
    let number = |text: &str| text.parse().unwrap_or(0);
    let kind = if env!("CARGO_PKG_VERSION_PRE").is_empty() { FIRMWARE_RELEASE } else { FIRMWARE_DEVELOPMENT };
    [
        number(env!("CARGO_PKG_VERSION_MAJOR")),
        number(env!("CARGO_PKG_VERSION_MINOR")),
        number(env!("CARGO_PKG_VERSION_PATCH")),
        kind,
    ]
}
