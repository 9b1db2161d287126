//! Items of plans and requests to drive somewhere, as goals: which MAV_CMD and MAV_FRAME have which meaning, and why one is refused.
//!
//! # Model
//! ```text
//!  16  MAV_CMD_NAV_WAYPOINT          1: time to stand there, s; 2: acceptance radius, m (0: the receiver's own); 5, 6: position
//!  20  MAV_CMD_NAV_RETURN_TO_LAUNCH  to the arena's origin
//!  93  MAV_CMD_NAV_DELAY             1: time to stand, s
//! 192  MAV_CMD_DO_REPOSITION         1: speed, must not be given; 5, 6: position
//! ```
//! A position is in metres (MAV_FRAME_LOCAL_NED) or degrees (MAV_FRAME_GLOBAL, _GLOBAL_RELATIVE_ALT and both with _INT). Robots on the ground
//! have no use for heights and, as their heading follows from their path, for the yaw of a goal: these numbers are kept and not read.
//!
//! # Source
//! common.xml, MAV_CMD and MAV_FRAME; MAVLink guide, "Mission Protocol".

use std::ops::RangeInclusive;

use posebridge_telemetry::{Arena, GeodeticPoint, Meters, Point2, Radians, TimeDelta};

use super::frames::{PlanarPoint, turn_ned};
use super::ids;
use crate::message::{CommandInt, CommandResult, MissionItem, MissionResult, integer_coordinate};

/// Metres from the arena's origin; no arena is as wide.
const MAX_LOCAL_M: f64 = 10_000.0;
const MAX_LATITUDE_DEG: f64 = 90.0;
const MAX_LONGITUDE_DEG: f64 = 180.0;
/// Nobody waits for longer than a day.
const MAX_HOLD_S: f32 = 86_400.0;
/// Beyond it a plan's item would mean nothing.
const MAX_RADIUS_M: f32 = 1_000.0;

/// Where a robot is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GoalPosition {
    Arena(Point2<Arena>),
    /// Needs the arena's place on the Earth.
    Earth(GeodeticPoint),
}

/// What a robot does for an item of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanStep {
    GoTo {
        position: GoalPosition,
        /// Time to stand there.
        hold: TimeDelta,
        /// The distance at which it counts as reached; `None` leaves it to the receiver.
        radius: Option<Meters>,
    },
    Wait(TimeDelta),
    ReturnToOrigin,
}

/// Why an item is refused. The messages are short, because they have to fit into a STATUSTEXT.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanItemError {
    #[error("item {sequence}: no robot here does command {command}, use 16, 20 or 93")]
    Command { sequence: u16, command: u16 },
    #[error("item {sequence}: no position in frame {frame}, use 0, 1, 3, 5 or 6")]
    Frame { sequence: u16, frame: u8 },
    #[error("item {sequence}, command {command}: param{index} {value:?}, not {expected}")]
    Parameter {
        sequence: u16,
        command: u16,
        /// From 1 to 7.
        index: u8,
        value: f64,
        expected: &'static str,
    },
}

impl PlanItemError {
    pub const fn result(&self) -> MissionResult {
        match self {
            Self::Command { .. } => MissionResult::Unsupported,
            Self::Frame { .. } => MissionResult::UnsupportedFrame,
            Self::Parameter { index: 1, .. } => MissionResult::InvalidParam1,
            Self::Parameter { index: 2, .. } => MissionResult::InvalidParam2,
            Self::Parameter { index: 3, .. } => MissionResult::InvalidParam3,
            Self::Parameter { index: 4, .. } => MissionResult::InvalidParam4,
            Self::Parameter { index: 5, .. } => MissionResult::InvalidParam5X,
            Self::Parameter { index: 6, .. } => MissionResult::InvalidParam6Y,
            Self::Parameter { .. } => MissionResult::InvalidParam7,
        }
    }
}

/// Why a request to drive somewhere is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RepositionError {
    #[error("reposition: no position in frame {frame}, use 0, 1, 3, 5 or 6")]
    Frame { frame: u8 },
    #[error("reposition: param{index} {value:?}, not {expected}")]
    Parameter { index: u8, value: f64, expected: &'static str },
}

impl RepositionError {
    pub const fn result(&self) -> CommandResult {
        match self {
            Self::Frame { .. } => CommandResult::UnsupportedFrame,
            Self::Parameter { .. } => CommandResult::Denied,
        }
    }
}

/// Fails if the command is none that a robot on wheels can do, or if its frame or a parameter is invalid.
pub fn decode_plan_item(item: &MissionItem) -> Result<PlanStep, PlanItemError> {
    let MissionItem { sequence, command, frame, .. } = *item;
    match command {
        ids::COMMAND_WAYPOINT => {
            let hold = duration_parameter(item, Missing::IsZero)?;
            let [_, radius_m, ..] = item.params;
            // A radius that is left out is zero or NaN.
            let is_radius = radius_m.is_nan() || (0.0..=MAX_RADIUS_M).contains(&radius_m);
            if !is_radius {
                let (value, expected) = (f64::from(radius_m), "0 to 1000");
                return Err(PlanItemError::Parameter { sequence, command, index: 2, value, expected });
            }
            let position = goal_position(frame, item.position.coordinates(frame)).map_err(|error| match error {
                PositionError::Frame => PlanItemError::Frame { sequence, frame },
                PositionError::Coordinate { index, value, expected } => {
                    PlanItemError::Parameter { sequence, command, index, value, expected }
                }
            })?;
            let radius = (radius_m > 0.0).then(|| Meters(f64::from(radius_m)));
            Ok(PlanStep::GoTo { position, hold, radius })
        }
        ids::COMMAND_DELAY => Ok(PlanStep::Wait(duration_parameter(item, Missing::IsInvalid)?)),
        ids::COMMAND_RETURN_TO_LAUNCH => Ok(PlanStep::ReturnToOrigin),
        _ => Err(PlanItemError::Command { sequence, command }),
    }
}

/// The goal of MAV_CMD_DO_REPOSITION, to the last digit of its integers.
pub fn decode_reposition(command: &CommandInt) -> Result<GoalPosition, RepositionError> {
    let [speed_m_per_s, ..] = command.params;
    // A goal has no speed: an accepting reply would be false.
    if speed_m_per_s > 0.0 {
        let value = f64::from(speed_m_per_s);
        return Err(RepositionError::Parameter { index: 1, value, expected: "-1: no speed can be set" });
    }
    let coordinates = [command.x, command.y].map(|value| integer_coordinate(value, command.frame));
    goal_position(command.frame, coordinates).map_err(|error| match error {
        PositionError::Frame => RepositionError::Frame { frame: command.frame },
        PositionError::Coordinate { index, value, expected } => RepositionError::Parameter { index, value, expected },
    })
}

enum PositionError {
    Frame,
    Coordinate { index: u8, value: f64, expected: &'static str },
}

/// What a duration of NaN means.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Missing {
    IsZero,
    IsInvalid,
}

/// The first parameter.
fn duration_parameter(item: &MissionItem, missing: Missing) -> Result<TimeDelta, PlanItemError> {
    let [seconds, ..] = item.params;
    if seconds.is_nan() && missing == Missing::IsZero {
        return Ok(TimeDelta::ZERO);
    }
    if (0.0..=MAX_HOLD_S).contains(&seconds) {
        return Ok(TimeDelta::from_secs_f64(f64::from(seconds)));
    }
    let MissionItem { sequence, command, .. } = *item;
    let value = f64::from(seconds);
    Err(PlanItemError::Parameter { sequence, command, index: 1, value, expected: "0 to 86400 s" })
}

/// A position from its two coordinates, north or latitude first.
fn goal_position(frame: u8, [first, second]: [f64; 2]) -> Result<GoalPosition, PositionError> {
    let check = |index, value, range: RangeInclusive<f64>, expected| {
        if range.contains(&value) { Ok(()) } else { Err(PositionError::Coordinate { index, value, expected }) }
    };
    match frame {
        // LOCAL_NED.
        1 => {
            let range = -MAX_LOCAL_M..=MAX_LOCAL_M;
            check(5, first, range.clone(), "-10000 to 10000 m")?;
            check(6, second, range, "-10000 to 10000 m")?;
            let arena = turn_ned(PlanarPoint { x: first, y: second, angle: 0.0 });
            Ok(GoalPosition::Arena(Point2::new(Meters(arena.x), Meters(arena.y))))
        }
        // GLOBAL and GLOBAL_RELATIVE_ALT, both also as they were named for messages with integers.
        0 | 3 | 5 | 6 => {
            check(5, first, -MAX_LATITUDE_DEG..=MAX_LATITUDE_DEG, "-90 to 90 deg")?;
            check(6, second, -MAX_LONGITUDE_DEG..=MAX_LONGITUDE_DEG, "-180 to 180 deg")?;
            let [latitude, longitude] = [first, second].map(|degrees| Radians(degrees.to_radians()));
            Ok(GoalPosition::Earth(GeodeticPoint { latitude, longitude }))
        }
        _ => Err(PositionError::Frame),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{ItemPosition, plan};
    use posebridge_telemetry::Address;

    const WAYPOINT: MissionItem = MissionItem {
        target: Address::new(1, 1),
        plan: plan::MISSION,
        sequence: 3,
        frame: 1,
        command: ids::COMMAND_WAYPOINT,
        current: 0,
        autocontinue: 1,
        params: [0.0; 4],
        position: ItemPosition::Integer { x: 12_500, y: -20_000 },
        z: 0.0,
    };

    #[test]
    fn north_and_east_of_a_way_point_are_y_and_x_of_the_arena() {
        let goal = |x_m, y_m| PlanStep::GoTo {
            position: GoalPosition::Arena(Point2::new(Meters(x_m), Meters(y_m))),
            hold: TimeDelta::from_millis(1_500),
            radius: Some(Meters(0.25)),
        };
        let params = [1.5, 0.25, 0.0, f32::NAN];
        assert_eq!(decode_plan_item(&MissionItem { params, ..WAYPOINT }), Ok(goal(-2.0, 1.25)));
        let float = MissionItem { params, position: ItemPosition::Float { x: 1.25, y: -2.0 }, ..WAYPOINT };
        assert_eq!(decode_plan_item(&float), Ok(goal(-2.0, 1.25)));
    }

    #[test]
    fn what_a_robot_cannot_do_is_refused_with_the_result_of_the_standard() {
        use MissionResult as Result;
        let item = WAYPOINT;
        let integer = |x, y| ItemPosition::Integer { x, y };
        for (refused, result) in [
            (MissionItem { command: 22, ..item }, Result::Unsupported),
            (MissionItem { frame: 10, ..item }, Result::UnsupportedFrame),
            (MissionItem { params: [-1.0, 0.0, 0.0, 0.0], ..item }, Result::InvalidParam1),
            (MissionItem { params: [0.0, f32::INFINITY, 0.0, 0.0], ..item }, Result::InvalidParam2),
            (MissionItem { position: integer(i32::MAX, 0), ..item }, Result::InvalidParam5X),
            (MissionItem { position: integer(0, 100_000_001), ..item }, Result::InvalidParam6Y),
            (MissionItem { frame: 6, position: integer(900_000_001, 0), ..item }, Result::InvalidParam5X),
            (MissionItem { position: ItemPosition::Float { x: 0.0, y: f32::NAN }, ..item }, Result::InvalidParam6Y),
            (MissionItem { command: 93, params: [-1.0; 4], ..item }, Result::InvalidParam1),
        ] {
            let error = decode_plan_item(&refused).unwrap_err();
            assert_eq!(error.result(), result, "{error}");
            assert!(error.to_string().starts_with("item 3"), "{error}");
        }
    }

    #[test]
    fn a_reposition_keeps_the_seventh_digit_of_its_degrees() {
        let command = CommandInt {
            target: Address::new(1, 1),
            frame: 5,
            command: ids::COMMAND_REPOSITION,
            params: [-1.0, 0.0, 0.0, 0.0],
            x: 520_115_001,
            y: 43_571_002,
            z: 0.0,
        };
        let Ok(GoalPosition::Earth(point)) = decode_reposition(&command) else { panic!("it is on the Earth") };
        assert!((point.latitude.0.to_degrees() - 52.011_500_1).abs() < 1e-10, "{point:?}");
        assert!((point.longitude.0.to_degrees() - 4.357_100_2).abs() < 1e-10, "{point:?}");
        let fast = CommandInt { params: [0.5, 0.0, 0.0, 0.0], ..command };
        assert_eq!(decode_reposition(&fast).unwrap_err().result(), CommandResult::Denied);
        assert_eq!(
            decode_reposition(&CommandInt { frame: 8, ..command }).unwrap_err().result(),
            CommandResult::UnsupportedFrame
        );
    }
}
