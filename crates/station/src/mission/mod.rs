//! The missions of robots that take goals: plans that ground stations upload, and the drive along them.
//!
//! A mission belongs to its robot, so that every ground station sees the same one, on whichever link. It gets requests, commands, estimates and
//! the time, and gives [`MissionAction`]s. `mission_service` connects it with links.

mod action;
mod plan_upload;
mod run;

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::dialect::ids;
use posebridge_protocol::dialect::plan_items::{GoalPosition, PlanStep, decode_plan_item, decode_reposition};
use posebridge_protocol::message::{
    CommandResult, Message, MissionItem, MissionResult, PlanContent, PlanMessage, plan,
};
use posebridge_protocol::session::PlanRequest;
use posebridge_telemetry::{Arena, Estimate, GeodeticOrigin, HostClock, Point2, TimeDelta, Timestamp, severity};

pub(crate) use self::action::MissionAction;
pub(crate) use self::plan_upload::PlanClient;
use self::plan_upload::{PlanUpload, PlannedItem, UploadProgress};
use self::run::{DrivenRobot, MissionRun, MissionState, NO_ORIGIN};
use crate::link_command::LinkCommand;
use crate::sender_identity::RobotIndex;

/// A plan in an arena has fewer items; so many take 64 kB.
const MAX_ITEMS: u16 = 1_000;
/// The robot may be elsewhere than an older estimate says.
const ESTIMATE_TIMEOUT: TimeDelta = TimeDelta::from_millis(2_000);
/// The tangential plane is right within 8 m there.
const MAX_DISTANCE_M: f64 = 10_000.0;

/// Custom mode and sub-mode of MAV_CMD_DO_SET_MODE: the numbers of PX4, which MAVSDK sends to every vehicle that is not an ArduPilot.
mod mode {
    /// MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.
    pub(super) const CUSTOM: u32 = 1;
    pub(super) const AUTO: u32 = 4;
    pub(super) const HOLD: u32 = 3;
    pub(super) const MISSION: u32 = 4;
    pub(super) const RETURN: u32 = 5;
}

/// Why a command was refused: the result, and the reason as text.
#[derive(Debug, PartialEq)]
pub(crate) struct DriveRefusal {
    pub(crate) result: CommandResult,
    pub(crate) text: String,
}

/// The mission of one robot.
#[derive(Debug, Default)]
pub(crate) struct Mission {
    plan: Vec<PlannedItem>,
    upload: Option<PlanUpload>,
    run: MissionRun,
    /// Where the robot was last, and when; `None` while it has no pose in the arena.
    estimate: Option<(Timestamp<HostClock>, Option<Point2<Arena>>)>,
    actions: Vec<MissionAction>,
    /// Its place in [`Missions::due`].
    due: Option<Timestamp<HostClock>>,
}

impl Mission {
    /// Answers a request of a ground station. `origin` is the arena's place on the Earth.
    pub(crate) fn handle_request(
        &mut self,
        now: Timestamp<HostClock>,
        client: PlanClient,
        request: &PlanRequest,
        origin: Option<GeodeticOrigin>,
    ) {
        let message = match request {
            PlanRequest::Item(item) => return self.handle_item(now, client, item, origin),
            PlanRequest::Message(message) => message,
        };
        match message.content {
            PlanContent::RequestList => {
                self.answer(client, message.plan, PlanContent::Count { items: self.plan.len() as u16 });
            }
            PlanContent::RequestInt { sequence } => self.answer_item(client, sequence, |item| MissionItem {
                position: item.position.to_integer(item.frame),
                ..item
            }),
            PlanContent::Request { sequence } => self.answer_item(client, sequence, |item| MissionItem {
                position: item.position.to_float(item.frame),
                ..item
            }),
            PlanContent::Count { items } => self.handle_count(now, client, items),
            PlanContent::ClearAll => {
                if self.is_uploading_for_other(client) {
                    self.acknowledge(client, message.plan, MissionResult::Denied);
                } else {
                    self.upload = None;
                    self.replace_plan(now, Vec::new());
                    self.acknowledge(client, message.plan, MissionResult::Accepted);
                }
            }
            PlanContent::SetCurrent { sequence } => {
                let set = self.set_current(usize::from(sequence));
                if let Err(refusal) = set {
                    self.report(severity::WARNING, refusal.text);
                }
                let current = self.run.current_message(self.plan.len());
                self.actions.push(MissionAction::Answer(client, current));
            }
            PlanContent::RequestPartialList { .. } | PlanContent::WritePartialList { .. } => {
                self.acknowledge(client, message.plan, MissionResult::Unsupported);
            }
            PlanContent::Ack { result } => {
                // The end of a download, or that of an upload whose client gives up.
                let is_cancelled = result != MissionResult::Accepted as u8;
                if is_cancelled && self.upload.as_ref().is_some_and(|upload| upload.client == client) {
                    self.upload = None;
                }
            }
        }
    }

    /// Carries out a command; an error is no change.
    pub(crate) fn handle_command(
        &mut self,
        now: Timestamp<HostClock>,
        request: &LinkCommand,
        origin: Option<GeodeticOrigin>,
    ) -> Result<(), DriveRefusal> {
        let [p1, p2, p3, ..] = request.command.params;
        match request.command.command {
            ids::COMMAND_MISSION_START => {
                let last = self.plan.len().saturating_sub(1);
                let first = whole(p1).filter(|first| *first as usize <= last);
                let first = first.ok_or_else(|| denied(format!("mission start: item {p1} not in 0..{last}")))?;
                if whole(p2).is_none_or(|end| end != 0 && (end as usize) < last) {
                    return Err(denied(format!("mission start: ends with the plan, param2 {p2:?} must be 0")));
                }
                // 0 is what programs send that mean the whole plan, or its rest.
                self.start((first != 0).then_some(first as usize))?;
            }
            ids::COMMAND_PAUSE_CONTINUE => match whole(p1) {
                Some(0) => self.pause(now),
                Some(1) => self.start(None)?,
                _ => return Err(denied(format!("pause or continue: param1 {p1:?}, not 0 or 1"))),
            },
            ids::COMMAND_SET_MISSION_CURRENT => {
                // -1 is the present one.
                if p1 < 0.0 {
                    return Ok(());
                }
                match whole(p1) {
                    Some(index) => self.set_current(index as usize)?,
                    None => return Err(denied(format!("set current item: param1 {p1:?} is no number of an item"))),
                }
            }
            ids::COMMAND_SET_MODE => match (whole(p1).map(|flags| flags & mode::CUSTOM), whole(p2), whole(p3)) {
                (Some(mode::CUSTOM), Some(mode::AUTO), Some(mode::MISSION)) => self.start(None)?,
                (Some(mode::CUSTOM), Some(mode::AUTO), Some(mode::HOLD)) => self.pause(now),
                (Some(mode::CUSTOM), Some(mode::AUTO), Some(mode::RETURN)) => self.return_to_origin(),
                _ => {
                    let text = format!("no mode {p1:?}, {p2:?}, {p3:?}: use 1, 4 and 4 mission, 3 hold, 5 return");
                    return Err(denied(text));
                }
            },
            ids::COMMAND_RETURN_TO_LAUNCH => self.return_to_origin(),
            ids::COMMAND_REPOSITION => {
                let Some(exact) = &request.exact else {
                    let text = "reposition: send COMMAND_INT, COMMAND_LONG is a metre off".to_owned();
                    return Err(DriveRefusal { result: CommandResult::IntOnly, text });
                };
                let position = decode_reposition(exact)
                    .map_err(|error| DriveRefusal { result: error.result(), text: error.to_string() })?;
                check_reachable(position, origin)
                    .map_err(|why| DriveRefusal { result: why.result, text: format!("reposition: {}", why.text) })?;
                self.run.reposition(position, &mut self.actions);
            }
            _ => {
                return Err(DriveRefusal { result: CommandResult::Unsupported, text: "unknown command".to_owned() });
            }
        }
        Ok(())
    }

    /// The robot is steered by hand or by another program.
    pub(crate) fn interrupt(&mut self, why: &str) {
        self.run.interrupt(why, &mut self.actions);
    }

    pub(crate) fn record_estimate(&mut self, now: Timestamp<HostClock>, estimate: &Estimate) {
        let position = estimate.validity.position.then(|| estimate.pose.origin());
        self.estimate = Some((now, position));
    }

    /// Does what is due.
    pub(crate) fn advance(&mut self, now: Timestamp<HostClock>, origin: Option<GeodeticOrigin>) {
        if let Some(upload) = &mut self.upload {
            let client = upload.client;
            let progress = upload.advance(now);
            self.continue_upload(now, client, progress);
        }
        let position = match self.estimate {
            Some((last, _)) if now - last >= ESTIMATE_TIMEOUT => Err("the robot is silent"),
            Some((_, Some(position))) => Ok(position),
            Some((_, None)) | None => Err("the robot has no pose in the arena"),
        };
        self.run.advance(now, &DrivenRobot { position, origin }, &self.plan, &mut self.actions);
    }

    pub(crate) fn take_actions(&mut self) -> Vec<MissionAction> {
        std::mem::take(&mut self.actions)
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let upload = self.upload.as_ref().map(PlanUpload::deadline);
        [upload, self.run.deadline()].into_iter().flatten().min()
    }

    fn handle_count(&mut self, now: Timestamp<HostClock>, client: PlanClient, items: u16) {
        if self.is_uploading_for_other(client) {
            self.acknowledge(client, plan::MISSION, MissionResult::Denied);
            return;
        }
        self.upload = None;
        if items == 0 {
            self.replace_plan(now, Vec::new());
            self.acknowledge(client, plan::MISSION, MissionResult::Accepted);
        } else if items > MAX_ITEMS {
            self.report(severity::WARNING, format!("plan refused: {items} items, at most {MAX_ITEMS}"));
            self.acknowledge(client, plan::MISSION, MissionResult::NoSpace);
        } else {
            let (upload, progress) = PlanUpload::begin(now, client, items);
            self.upload = Some(upload);
            self.continue_upload(now, client, progress);
        }
    }

    fn handle_item(
        &mut self,
        now: Timestamp<HostClock>,
        client: PlanClient,
        item: &MissionItem,
        origin: Option<GeodeticOrigin>,
    ) {
        if self.is_uploading_for_other(client) {
            self.acknowledge(client, item.plan, MissionResult::Denied);
            return;
        }
        let Some(upload) = &mut self.upload else {
            // The last item again: its acknowledgement was lost.
            let is_last = self.plan.last().is_some_and(|PlannedItem { item: last, .. }| {
                (last.sequence, last.command, last.position) == (item.sequence, item.command, item.position)
            });
            let result = if is_last { MissionResult::Accepted } else { MissionResult::InvalidSequence };
            self.acknowledge(client, item.plan, result);
            return;
        };
        let progress = if item.sequence == upload.expected() {
            match planned_item(item, origin) {
                Ok(planned) => upload.push(now, planned),
                Err(refusal) => {
                    self.upload = None;
                    self.report(severity::WARNING, format!("plan refused: {}", refusal.text));
                    self.acknowledge(client, item.plan, refusal.result);
                    return;
                }
            }
        } else {
            upload.handle_unexpected(item.sequence)
        };
        self.continue_upload(now, client, progress);
    }

    fn continue_upload(&mut self, now: Timestamp<HostClock>, client: PlanClient, progress: UploadProgress) {
        match progress {
            UploadProgress::Unchanged => {}
            UploadProgress::Request { sequence } => {
                self.answer(client, plan::MISSION, PlanContent::RequestInt { sequence });
            }
            UploadProgress::Complete(items) => {
                self.upload = None;
                self.acknowledge(client, plan::MISSION, MissionResult::Accepted);
                self.report(severity::INFO, format!("plan of {} items taken", items.len()));
                self.replace_plan(now, items);
            }
            UploadProgress::GivenUp => {
                self.upload = None;
                self.report(severity::WARNING, "plan not taken: its sender is silent".to_owned());
                self.acknowledge(client, plan::MISSION, MissionResult::OperationCancelled);
            }
        }
    }

    fn replace_plan(&mut self, now: Timestamp<HostClock>, items: Vec<PlannedItem>) {
        self.plan = items;
        self.run.replace_plan(now, self.plan.len(), &mut self.actions);
    }

    fn start(&mut self, from: Option<usize>) -> Result<(), DriveRefusal> {
        if self.plan.is_empty() {
            return Err(denied("there is no plan to drive".to_owned()));
        }
        // It is repeated by programs that have not heard the answer.
        if from.is_some() || self.run.state() != MissionState::Active {
            self.run.start(from, &self.plan, &mut self.actions);
        }
        Ok(())
    }

    fn pause(&mut self, now: Timestamp<HostClock>) {
        self.run.pause(now, "as requested", &mut self.actions);
    }

    fn return_to_origin(&mut self) {
        self.run.reposition(GoalPosition::Arena(Point2::ORIGIN), &mut self.actions);
    }

    fn set_current(&mut self, index: usize) -> Result<(), DriveRefusal> {
        if index >= self.plan.len() {
            return Err(denied(format!("no item {index}: the plan has {}", self.plan.len())));
        }
        self.run.set_current(index, &self.plan);
        Ok(())
    }

    fn is_uploading_for_other(&self, client: PlanClient) -> bool {
        self.upload.as_ref().is_some_and(|upload| upload.client != client)
    }

    fn answer_item(&mut self, client: PlanClient, sequence: u16, convert: impl FnOnce(MissionItem) -> MissionItem) {
        match self.plan.get(usize::from(sequence)) {
            Some(planned) => {
                let item = MissionItem { target: client.address, ..convert(planned.item) };
                self.actions.push(MissionAction::Answer(client, Message::MissionItem(item)));
            }
            None => self.acknowledge(client, plan::MISSION, MissionResult::InvalidSequence),
        }
    }

    fn answer(&mut self, client: PlanClient, plan: u8, content: PlanContent) {
        let message = Message::Plan(PlanMessage { target: client.address, plan, content });
        self.actions.push(MissionAction::Answer(client, message));
    }

    fn acknowledge(&mut self, client: PlanClient, plan: u8, result: MissionResult) {
        self.answer(client, plan, PlanContent::Ack { result: result as u8 });
    }

    fn report(&mut self, severity: u8, text: String) {
        self.actions.push(MissionAction::report(severity, text));
    }
}

/// A number of an item, a mode or a switch in a parameter; `None` for anything else.
fn whole(parameter: f32) -> Option<u32> {
    let is_whole = (0.0..=65_535.0).contains(&parameter) && parameter.fract() == 0.0;
    is_whole.then_some(parameter as u32)
}

fn denied(text: String) -> DriveRefusal {
    DriveRefusal { result: CommandResult::Denied, text }
}

struct ItemRefusal {
    result: MissionResult,
    text: String,
}

fn planned_item(item: &MissionItem, origin: Option<GeodeticOrigin>) -> Result<PlannedItem, ItemRefusal> {
    let step =
        decode_plan_item(item).map_err(|error| ItemRefusal { result: error.result(), text: error.to_string() })?;
    if let PlanStep::GoTo { position, .. } = step {
        check_reachable(position, origin).map_err(|why| ItemRefusal {
            result: match origin {
                None => MissionResult::UnsupportedFrame,
                Some(_) => MissionResult::InvalidParam5X,
            },
            text: format!("item {}: {}", item.sequence, why.text),
        })?;
    }
    Ok(PlannedItem { item: *item, step })
}

/// Whether a position is one of the arena or its surroundings.
fn check_reachable(position: GoalPosition, origin: Option<GeodeticOrigin>) -> Result<(), DriveRefusal> {
    let GoalPosition::Earth(point) = position else {
        return Ok(());
    };
    let Some(origin) = origin else {
        return Err(denied(NO_ORIGIN.to_owned()));
    };
    let distance_m = origin.to_arena(point).distance(Point2::ORIGIN).0;
    if distance_m <= MAX_DISTANCE_M {
        Ok(())
    } else {
        Err(denied(format!("{:.0} km from the arena's origin", distance_m * 1e-3)))
    }
}

/// The missions of all robots that have one, and when each is due.
#[derive(Debug, Default)]
pub(crate) struct Missions {
    by_robot: BTreeMap<RobotIndex, Mission>,
    /// Those with something new.
    pending: BTreeSet<RobotIndex>,
    due: BTreeSet<(Timestamp<HostClock>, RobotIndex)>,
}

impl Missions {
    /// The mission of a robot, which gets its turn with [`Self::take_ready`].
    pub(crate) fn open(&mut self, robot: RobotIndex) -> &mut Mission {
        self.pending.insert(robot);
        self.by_robot.entry(robot).or_default()
    }

    /// The same, if it has one.
    pub(crate) fn find(&mut self, robot: RobotIndex) -> Option<&mut Mission> {
        let mission = self.by_robot.get_mut(&robot)?;
        self.pending.insert(robot);
        Some(mission)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.by_robot.is_empty()
    }

    pub(crate) fn robots(&self) -> Vec<RobotIndex> {
        self.by_robot.keys().copied().collect()
    }

    /// The robots whose mission has something to do.
    pub(crate) fn take_ready(&mut self, now: Timestamp<HostClock>) -> BTreeSet<RobotIndex> {
        let mut ready = std::mem::take(&mut self.pending);
        ready.extend(self.due.iter().take_while(|(due, _)| *due <= now).map(|(_, robot)| *robot));
        ready
    }

    /// Lets a mission do what is due.
    pub(crate) fn advance(
        &mut self,
        now: Timestamp<HostClock>,
        robot: RobotIndex,
        origin: Option<GeodeticOrigin>,
    ) -> Vec<MissionAction> {
        let Some(mission) = self.by_robot.get_mut(&robot) else {
            return Vec::new();
        };
        mission.advance(now, origin);
        if let Some(due) = mission.due {
            self.due.remove(&(due, robot));
        }
        mission.due = mission.deadline();
        self.due.extend(mission.due.map(|due| (due, robot)));
        mission.take_actions()
    }

    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.due.first().map(|(due, _)| *due)
    }
}
