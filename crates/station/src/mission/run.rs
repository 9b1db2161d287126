//! The drive of a robot along a plan, or to a single goal.
//!
//! A goal is sent when it becomes the present one, and again once a second until it is reached, because a frame may be lost. A stop is sent three
//! times. Whether a goal is reached is decided by the station's estimate. Without an estimate of the pose nothing is sent and the drive waits.
//!
//! Source: common.xml, MISSION_STATE, MISSION_CURRENT, MISSION_ITEM_REACHED.

use posebridge_protocol::dialect::plan_items::{GoalPosition, PlanStep};
use posebridge_protocol::message::{Message, MissionCurrent, Setpoint};
use posebridge_telemetry::{
    Arena, GeodeticOrigin, HostClock, Meters, MetersPerSecond, Point2, RadiansPerSecond, TimeDelta, Timestamp, severity,
};

use super::action::MissionAction;
use super::plan_upload::PlannedItem;

/// An item with a smaller radius, or none, counts as reached at this distance: robots stop 2 cm before a goal, by a pose of their own.
pub(super) const MIN_RADIUS: Meters = Meters(0.05);
const GOAL_REPEAT: TimeDelta = TimeDelta::from_millis(1_000);
const STOP_REPEAT: TimeDelta = TimeDelta::from_millis(500);
const STOPS: u8 = 3;
const REPORT_INTERVAL: TimeDelta = TimeDelta::from_millis(1_000);
const STANDSTILL: Setpoint = Setpoint::BodyVelocity { forward: MetersPerSecond(0.0), turn: RadiansPerSecond(0.0) };
/// Of MISSION_CURRENT, without a mission.
const NO_ITEMS: u16 = u16::MAX;

/// MISSION_STATE.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum MissionState {
    #[default]
    NoMission = 1,
    NotStarted = 2,
    Active = 3,
    Paused = 4,
    Complete = 5,
}

/// What the station knows of a robot that is driven.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrivenRobot {
    /// `Err` says why there is none.
    pub(crate) position: Result<Point2<Arena>, &'static str>,
    pub(crate) origin: Option<GeodeticOrigin>,
}

#[derive(Debug, Default)]
pub(crate) struct MissionRun {
    state: MissionState,
    /// The item that is driven to, or will be.
    current: usize,
    activity: Activity,
    /// It was said that the drive waits for an estimate.
    is_waiting: bool,
    /// When MISSION_CURRENT is sent again.
    next_report: Option<Timestamp<HostClock>>,
}

#[derive(Clone, Copy, Debug, Default)]
enum Activity {
    #[default]
    Rest,
    Driving {
        goal: Goal,
        sent: Option<Timestamp<HostClock>>,
    },
    /// An item without a goal, which begins with the next step.
    Waiting {
        hold: TimeDelta,
    },
    Holding {
        until: Timestamp<HostClock>,
    },
    Stopping {
        next: Timestamp<HostClock>,
        left: u8,
    },
}

#[derive(Clone, Copy, Debug)]
struct Goal {
    position: GoalPosition,
    radius: Meters,
    purpose: GoalPurpose,
}

#[derive(Clone, Copy, Debug)]
enum GoalPurpose {
    PlanItem { hold: TimeDelta },
    Reposition,
}

impl MissionRun {
    pub(crate) const fn state(&self) -> MissionState {
        self.state
    }

    /// A plan takes the place of another one. What was driven of that ends.
    pub(crate) fn replace_plan(&mut self, now: Timestamp<HostClock>, items: usize, actions: &mut Vec<MissionAction>) {
        if self.state == MissionState::Active {
            self.stop(now);
        }
        self.current = 0;
        self.state = if items == 0 { MissionState::NoMission } else { MissionState::NotStarted };
        self.report_current(now, items, actions);
    }

    /// Starts at an item, or goes on at the present one; after the end, at the first.
    pub(crate) fn start(&mut self, from: Option<usize>, plan: &[PlannedItem], actions: &mut Vec<MissionAction>) {
        let again = if self.state == MissionState::Complete { 0 } else { self.current };
        self.current = from.unwrap_or(again);
        self.state = MissionState::Active;
        self.is_waiting = false;
        actions.push(MissionAction::report(
            severity::NOTICE,
            format!("mission started at item {} of {}", self.current, plan.len()),
        ));
        self.begin_item(plan);
        self.next_report = None;
    }

    /// Stops the robot, whatever it drives to.
    pub(crate) fn pause(&mut self, now: Timestamp<HostClock>, why: &str, actions: &mut Vec<MissionAction>) {
        self.stop(now);
        self.leave_active(why, actions);
    }

    /// The robot is steered by hand or by another program. It is not stopped.
    pub(crate) fn interrupt(&mut self, why: &str, actions: &mut Vec<MissionAction>) {
        self.activity = Activity::Rest;
        self.leave_active(why, actions);
    }

    pub(crate) fn reposition(&mut self, position: GoalPosition, actions: &mut Vec<MissionAction>) {
        self.leave_active("another goal", actions);
        self.is_waiting = false;
        let goal = Goal { position, radius: MIN_RADIUS, purpose: GoalPurpose::Reposition };
        self.activity = Activity::Driving { goal, sent: None };
    }

    /// Makes another item the present one.
    pub(crate) fn set_current(&mut self, index: usize, plan: &[PlannedItem]) {
        self.current = index;
        match self.state {
            MissionState::Active => self.begin_item(plan),
            MissionState::Complete => self.state = MissionState::Paused,
            MissionState::NoMission | MissionState::NotStarted | MissionState::Paused => {}
        }
        self.next_report = None;
    }

    /// Does what is due at `now`, with the robot's present position.
    pub(crate) fn advance(
        &mut self,
        now: Timestamp<HostClock>,
        robot: &DrivenRobot,
        plan: &[PlannedItem],
        actions: &mut Vec<MissionAction>,
    ) {
        // An item takes two rounds at most, if nothing has to be waited for.
        for _ in 0..=2 * plan.len() {
            let goes_on = match self.activity {
                Activity::Rest => false,
                Activity::Stopping { next, left } => {
                    if now >= next {
                        actions.push(MissionAction::Drive(STANDSTILL));
                        self.activity = match left {
                            0 | 1 => Activity::Rest,
                            _ => Activity::Stopping { next: now + STOP_REPEAT, left: left - 1 },
                        };
                    }
                    false
                }
                Activity::Waiting { hold } => {
                    actions.push(MissionAction::Drive(STANDSTILL));
                    self.activity = Activity::Holding { until: now + hold };
                    true
                }
                Activity::Holding { until } => now >= until && self.finish_item(plan, actions),
                Activity::Driving { goal, sent } => self.drive(now, goal, sent, robot, actions),
            };
            if !goes_on {
                break;
            }
        }
        if self.state != MissionState::NoMission && self.next_report.is_none_or(|due| due <= now) {
            self.report_current(now, plan.len(), actions);
        }
    }

    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let activity = match self.activity {
            Activity::Rest | Activity::Waiting { .. } => None,
            Activity::Driving { sent, .. } => sent.map(|sent| sent + GOAL_REPEAT),
            Activity::Holding { until } => Some(until),
            Activity::Stopping { next, .. } => Some(next),
        };
        let report = self.next_report.filter(|_| self.state != MissionState::NoMission);
        [activity, report].into_iter().flatten().min()
    }

    pub(crate) fn current_message(&self, items: usize) -> Message {
        let items = if items == 0 { NO_ITEMS } else { items.min(usize::from(u16::MAX)) as u16 };
        Message::MissionCurrent(MissionCurrent { sequence: self.current as u16, items, state: self.state as u8 })
    }

    /// Sends the goal if it is due. Whether something else follows at once.
    fn drive(
        &mut self,
        now: Timestamp<HostClock>,
        goal: Goal,
        sent: Option<Timestamp<HostClock>>,
        robot: &DrivenRobot,
        actions: &mut Vec<MissionAction>,
    ) -> bool {
        let position = robot.position.and_then(|here| Ok((here, goal.point(robot.origin)?)));
        let (here, point) = match position {
            Ok(both) => both,
            Err(why) => {
                self.wait(goal, sent, why, actions);
                return false;
            }
        };
        self.is_waiting = false;
        // Also a goal where the robot is already: it may be on its way to another one.
        if sent.is_none_or(|sent| now - sent >= GOAL_REPEAT) {
            actions.push(MissionAction::Drive(Setpoint::Position { x: point.x, y: point.y }));
            self.activity = Activity::Driving { goal, sent: Some(now) };
        }
        if here.distance(point).0 > goal.radius.0 {
            return false;
        }
        match goal.purpose {
            GoalPurpose::PlanItem { hold } => {
                actions.push(MissionAction::Announce(Message::MissionItemReached { sequence: self.current as u16 }));
                self.activity = Activity::Holding { until: now + hold };
                true
            }
            GoalPurpose::Reposition => {
                actions.push(MissionAction::report(severity::INFO, "goal reached".to_owned()));
                self.activity = Activity::Rest;
                false
            }
        }
    }

    fn wait(&mut self, goal: Goal, sent: Option<Timestamp<HostClock>>, why: &str, actions: &mut Vec<MissionAction>) {
        if sent.is_some() {
            actions.push(MissionAction::Drive(STANDSTILL));
        }
        self.activity = Activity::Driving { goal, sent: None };
        if !std::mem::replace(&mut self.is_waiting, true) {
            actions.push(MissionAction::report(severity::WARNING, format!("the drive to the goal waits: {why}")));
        }
    }

    /// True: the next item, or the end, follows.
    fn finish_item(&mut self, plan: &[PlannedItem], actions: &mut Vec<MissionAction>) -> bool {
        let goes_on = plan.get(self.current).is_some_and(|done| done.item.autocontinue != 0);
        if let Some(PlannedItem { step: PlanStep::Wait(_), item }) = plan.get(self.current) {
            actions.push(MissionAction::Announce(Message::MissionItemReached { sequence: item.sequence }));
        }
        self.activity = Activity::Rest;
        self.next_report = None;
        if self.current + 1 >= plan.len() {
            self.state = MissionState::Complete;
            actions.push(MissionAction::report(severity::NOTICE, "mission complete".to_owned()));
            return false;
        }
        self.current += 1;
        if goes_on {
            self.begin_item(plan);
        } else {
            self.leave_active("the item before does not continue by itself", actions);
        }
        true
    }

    fn begin_item(&mut self, plan: &[PlannedItem]) {
        let drive = |position, hold, radius: Option<Meters>| {
            let radius = Meters(radius.map_or(MIN_RADIUS.0, |radius| radius.0.max(MIN_RADIUS.0)));
            Activity::Driving { goal: Goal { position, radius, purpose: GoalPurpose::PlanItem { hold } }, sent: None }
        };
        self.activity = match plan.get(self.current).map(|item| item.step) {
            Some(PlanStep::GoTo { position, hold, radius }) => drive(position, hold, radius),
            Some(PlanStep::ReturnToOrigin) => drive(GoalPosition::Arena(Point2::ORIGIN), TimeDelta::ZERO, None),
            Some(PlanStep::Wait(hold)) => Activity::Waiting { hold },
            None => Activity::Rest,
        };
    }

    fn stop(&mut self, now: Timestamp<HostClock>) {
        self.activity = Activity::Stopping { next: now, left: STOPS };
    }

    fn leave_active(&mut self, why: &str, actions: &mut Vec<MissionAction>) {
        if self.state == MissionState::Active {
            self.state = MissionState::Paused;
            self.next_report = None;
            actions.push(MissionAction::report(
                severity::NOTICE,
                format!("mission paused at item {}: {why}", self.current),
            ));
        }
    }

    fn report_current(&mut self, now: Timestamp<HostClock>, items: usize, actions: &mut Vec<MissionAction>) {
        actions.push(MissionAction::Announce(self.current_message(items)));
        self.next_report = Some(now + REPORT_INTERVAL);
    }
}

impl Goal {
    fn point(&self, origin: Option<GeodeticOrigin>) -> Result<Point2<Arena>, &'static str> {
        match self.position {
            GoalPosition::Arena(point) => Ok(point),
            GoalPosition::Earth(point) => origin.map(|origin| origin.to_arena(point)).ok_or(NO_ORIGIN),
        }
    }
}

/// Why a position on the Earth is not one of the arena.
pub(super) const NO_ORIGIN: &str = "set the arena's origin first (SET_GPS_GLOBAL_ORIGIN or [station.origin])";
