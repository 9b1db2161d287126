//! What a vehicle answers beside telemetry, parameters and commands: plans, an empty list of logs, and the files that describe it.
//!
//! Each request has an answer, because a ground station waits for one before it goes on. Without an owner of its mission
//! a vehicle refuses every plan at once; one without items is accepted, because then there is nothing that is not done. Fences and rally
//! points have no owner.
//!
//! Sources: MAVLink guide, "Mission Protocol" and "Log Transfer Protocol" (LOG_ENTRY with no logs; LOG_DATA without bytes ends a log).

use std::sync::Arc;

use posebridge_telemetry::Address;

use super::file_server::{FileServer, ServedFile, max_frames};
use super::output::{PlanRequest, SessionSender};
use crate::dialect::ids;
use crate::message::{CommandLong, LogMessage, Message, MissionCurrent, MissionResult, PlanContent, PlanMessage, plan};

/// MISSION_CURRENT without a mission: no number of items, and MISSION_STATE_NO_MISSION.
const NO_MISSION: MissionCurrent = MissionCurrent { sequence: 0, items: u16::MAX, state: 1 };

/// Sensors of a robot: the numbered ones and eight cameras.
const MAX_SENSORS: usize = 18;

/// Who keeps the mission of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanService {
    /// Nobody: it has no items.
    Empty,
    /// The session's owner, who gets the requests about it.
    Owner,
}

#[derive(Debug)]
pub(super) struct VehicleServices {
    files: FileServer,
    plans: PlanService,
}

impl VehicleServices {
    pub(super) const fn new(files: Arc<[ServedFile]>, plans: PlanService) -> Self {
        Self { files: FileServer::new(files), plans }
    }

    pub(super) const fn plan_service(&self) -> PlanService {
        self.plans
    }

    /// A request that the owner answers.
    #[expect(clippy::wildcard_enum_match_arm, reason = "most messages are about something else")]
    pub(super) fn owners_request(&self, message: &Message) -> Option<PlanRequest> {
        let (plan, request) = match message {
            Message::Plan(request) => (request.plan, PlanRequest::Message(*request)),
            Message::MissionItem(item) => (item.plan, PlanRequest::Item(*item)),
            _ => return None,
        };
        let is_for_all =
            matches!(message, Message::Plan(PlanMessage { plan: plan::ALL, content: PlanContent::ClearAll, .. }));
        (self.plans == PlanService::Owner && (plan == plan::MISSION || is_for_all)).then_some(request)
    }

    /// The answers to a message that is for this vehicle.
    #[expect(clippy::wildcard_enum_match_arm, reason = "most messages are about something else")]
    pub(super) fn answer(&mut self, client: SessionSender, message: &Message) -> Vec<Message> {
        match message {
            Message::Plan(request) => answer_about_plan(client.address, request).into_iter().collect(),
            // None was asked for.
            Message::MissionItem(item) => {
                let content = PlanContent::Ack { result: MissionResult::Unsupported as u8 };
                vec![Message::Plan(PlanMessage { target: client.address, plan: item.plan, content })]
            }
            Message::FileTransfer(request) => {
                self.files.answer(client, request).into_iter().map(Message::FileTransfer).collect()
            }
            Message::Log(LogMessage::RequestList { .. }) => {
                vec![Message::Log(LogMessage::Entry { unix_s: 0, bytes: 0, id: 0, logs: 0, last: 0 })]
            }
            Message::Log(LogMessage::RequestData { id, offset, .. }) => {
                vec![Message::Log(LogMessage::Data { id: *id, offset: *offset, data: Vec::new() })]
            }
            _ => Vec::new(),
        }
    }
}

/// `None` for the end of a transfer.
fn answer_about_plan(to: Address, request: &PlanMessage) -> Option<Message> {
    let content = match request.content {
        PlanContent::Ack { .. } => return None,
        PlanContent::SetCurrent { .. } => return Some(Message::MissionCurrent(NO_MISSION)),
        PlanContent::ClearAll => PlanContent::Ack { result: MissionResult::Accepted as u8 },
        _ if request.plan > plan::RALLY => PlanContent::Ack { result: MissionResult::Unsupported as u8 },
        PlanContent::RequestList => PlanContent::Count { items: 0 },
        PlanContent::Count { items: 0 } => PlanContent::Ack { result: MissionResult::Accepted as u8 },
        PlanContent::Count { .. } | PlanContent::RequestPartialList { .. } | PlanContent::WritePartialList { .. } => {
            PlanContent::Ack { result: MissionResult::Unsupported as u8 }
        }
        PlanContent::Request { .. } | PlanContent::RequestInt { .. } => {
            PlanContent::Ack { result: MissionResult::InvalidSequence as u8 }
        }
    };
    Some(Message::Plan(PlanMessage { target: to, plan: request.plan, content }))
}

/// The acknowledgement, and the message that was requested; of these there is one for each sensor.
fn command_answers(command: &CommandLong) -> usize {
    let is_request = command.command == ids::COMMAND_REQUEST_MESSAGE;
    match command.named_message().filter(|_| is_request) {
        Some(ids::NAMED_VALUE_FLOAT | ids::DEBUG_FLOAT_ARRAY) => 1 + MAX_SENSORS,
        Some(_) | None => 2,
    }
}

/// Frames that answer a request, at most, but for those of a list of parameters, which come at a rate of their own.
#[expect(clippy::wildcard_enum_match_arm, reason = "every other request has one answer")]
pub fn most_answers(message: &Message) -> usize {
    match message {
        Message::FileTransfer(request) => max_frames(request),
        Message::Command(command) => command_answers(command),
        Message::CommandInt(command) => command_answers(&command.to_long()),
        _ => 1,
    }
}
