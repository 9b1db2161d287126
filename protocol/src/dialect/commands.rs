//! MAVLink commands as commands to the station: which MAV_CMD has which effect, and its parameters.
//!
//! # Model
//! ```text
//!   245  MAV_CMD_PREFLIGHT_STORAGE  1: 0 reload the saved tunables, 1 save, 2 or 4 defaults, 3 forget the calibration
//!  2510  MAV_CMD_LOGGING_START      begin a new recording (nothing is streamed back)
//!  2511  MAV_CMD_LOGGING_STOP       end the recording
//! 31010  MAV_CMD_USER_1             set the pose: 1, 2: north and east, m; 3: yaw clockwise from north, degrees, at most a turn; 4, 5:
//!                                   their sigmas, m and degrees
//! 31011  MAV_CMD_USER_2             forget the pose
//! 31012  MAV_CMD_USER_3             1: 0 freeze what is learned, 1 learn on, 2 forget what was learned
//! 31013  MAV_CMD_USER_4             1: number of a sensor; 2: 0 off, 1 on
//! ```
//! The numbers of sensors are those of [`SensorId`]. common.xml has no command without latitude and longitude for the
//! last four; MAV_CMD_USER_1 to 5 are meant for such commands.
//!
//! # Source
//! common.xml, MAV_CMD and PREFLIGHT_STORAGE_PARAMETER_ACTION; docs/ground-stations.md.

use posebridge_telemetry::{
    Command, Heading, Meters, OnlineCalibration, ParameterStorage, Pose, SensorId, SensorSwitch,
};

use super::frames::{PlanarPoint, turn_ned};
use super::ids;
use crate::message::CommandLong;

/// The commands that [`decode_command`] knows, by rising number.
pub const SUPPORTED_COMMANDS: [u16; 7] = [
    ids::COMMAND_PREFLIGHT_STORAGE,
    ids::COMMAND_LOGGING_START,
    ids::COMMAND_LOGGING_STOP,
    ids::COMMAND_SET_POSE,
    ids::COMMAND_RESET_POSE,
    ids::COMMAND_CALIBRATION,
    ids::COMMAND_SOURCE,
];

/// Largest valid yaw, degrees: a full turn in either direction. Larger angles are damage, and too coarse in a float.
const MAX_YAW_DEG: f32 = 360.0;

/// Why a command is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// Not one of [`SUPPORTED_COMMANDS`].
    #[error("command {command} is unknown here")]
    Unknown {
        /// MAV_CMD.
        command: u16,
    },
    /// An invalid parameter. The message is short, because it has to fit into a STATUSTEXT.
    #[error("{command} param{index} {value:?}, not {expected}")]
    Parameter {
        command: u16,
        /// From 1 to 7.
        index: u8,
        value: f32,
        expected: &'static str,
    },
}

/// Fails if the command is none of [`SUPPORTED_COMMANDS`], or if a parameter of it is invalid.
pub fn decode_command(command: &CommandLong) -> Result<Command, CommandError> {
    match command.command {
        ids::COMMAND_PREFLIGHT_STORAGE => decode_storage(command),
        ids::COMMAND_LOGGING_START => {
            // The only format that MAVLink names is another one; a request for the first format gets ours.
            integer_parameter(command, 1, "0").and_then(|format| match format {
                0 => Ok(Command::StartRecording),
                _ => Err(parameter_error(command, 1, "0")),
            })
        }
        ids::COMMAND_LOGGING_STOP => Ok(Command::StopRecording),
        ids::COMMAND_SET_POSE => decode_set_pose(command),
        ids::COMMAND_RESET_POSE => Ok(Command::ResetPose),
        ids::COMMAND_CALIBRATION => match integer_parameter(command, 1, "0, 1 or 2")? {
            0 => Ok(Command::OnlineCalibration(OnlineCalibration::Frozen)),
            1 => Ok(Command::OnlineCalibration(OnlineCalibration::Enabled)),
            2 => Ok(Command::ResetCalibration),
            _ => Err(parameter_error(command, 1, "0, 1 or 2")),
        },
        ids::COMMAND_SOURCE => {
            let valid_values = "0 to 9, 32 to 38";
            let sensor = SensorId(integer_parameter(command, 1, valid_values)?);
            if !sensor.is_known() {
                return Err(parameter_error(command, 1, valid_values));
            }
            match integer_parameter(command, 2, "0 or 1")? {
                0 => Ok(Command::SwitchSource { sensor, to: SensorSwitch::Off }),
                1 => Ok(Command::SwitchSource { sensor, to: SensorSwitch::On }),
                _ => Err(parameter_error(command, 2, "0 or 1")),
            }
        }
        command => Err(CommandError::Unknown { command }),
    }
}

fn decode_storage(command: &CommandLong) -> Result<Command, CommandError> {
    // Parameter 3 would start or stop a log: an accepting reply would be false.
    if bounded_parameter(command, 3) != 0.0 {
        return Err(parameter_error(command, 3, "0, or command 2510"));
    }
    match integer_parameter(command, 1, "0 to 4")? {
        0 => Ok(Command::Parameters(ParameterStorage::Reload)),
        1 => Ok(Command::Parameters(ParameterStorage::Save)),
        2 | 4 => Ok(Command::Parameters(ParameterStorage::Default)),
        3 => Ok(Command::ResetCalibration),
        _ => Err(parameter_error(command, 1, "0 to 4")),
    }
}

fn decode_set_pose(command: &CommandLong) -> Result<Command, CommandError> {
    let [north_m, east_m, yaw_deg] = [1, 2, 3].map(|index| bounded_parameter(command, index));
    for (index, value) in [(1, north_m), (2, east_m), (3, yaw_deg)] {
        if !value.is_finite() {
            return Err(parameter_error(command, index, "a number"));
        }
    }
    if yaw_deg.abs() > MAX_YAW_DEG {
        return Err(parameter_error(command, 3, "-360 to 360"));
    }
    let [position_sigma_m, yaw_sigma_deg] = [4, 5].map(|index| bounded_parameter(command, index));
    for (index, value) in [(4, position_sigma_m), (5, yaw_sigma_deg)] {
        // Fields that are left out are zero: no source is that certain.
        if !(value.is_finite() && value > 0.0) {
            return Err(parameter_error(command, index, "a sigma above 0"));
        }
    }
    let arena =
        turn_ned(PlanarPoint { x: f64::from(north_m), y: f64::from(east_m), angle: f64::from(yaw_deg).to_radians() });
    Ok(Command::SetPose {
        pose: Pose::new(Meters(arena.x), Meters(arena.y), Heading::from_rad(arena.angle)),
        position_sigma_m: f64::from(position_sigma_m),
        heading_sigma_rad: f64::from(yaw_sigma_deg).to_radians(),
    })
}

/// A parameter with a few valid whole numbers.
fn integer_parameter(command: &CommandLong, index: u8, expected: &'static str) -> Result<u8, CommandError> {
    let value = bounded_parameter(command, index);
    let is_byte = (0.0..=255.0).contains(&value) && value.fract() == 0.0;
    if is_byte { Ok(value as u8) } else { Err(parameter_error(command, index, expected)) }
}

fn bounded_parameter(command: &CommandLong, index: u8) -> f32 {
    let position = usize::from(index).wrapping_sub(1);
    command.params.get(position).copied().unwrap_or_default()
}

fn parameter_error(command: &CommandLong, index: u8, expected: &'static str) -> CommandError {
    CommandError::Parameter { command: command.command, index, value: bounded_parameter(command, index), expected }
}
