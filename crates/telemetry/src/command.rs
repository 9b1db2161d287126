//! Commands to the station, and requests from the station to the program that runs it.
//!
//! A [`Command`] comes from the dashboard, the command line or another program. A command that comes over a link is part of the link's
//! bytes, and the station decodes it. Both are recorded inputs, so a replay repeats them at the same point.
//!
//! A [`Request`] is the other direction: the station opens no files, so the program carries the request out and reports the result with
//! [`Input::Report`](crate::Input::Report).

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::ids::{ChannelName, RobotId, SensorId};
use crate::observation::SensorSwitch;
use crate::outside_fix::OutsideFix;
use crate::quantities::{Heading, Meters, MetersPerSecond, RadiansPerSecond};
use crate::simulator::SimulatorCommand;
use crate::spaces::{Arena, Pose};

/// The key of a tunable; at most sixteen ASCII characters, as in MAVLink's parameters.
pub type ParameterName = ChannelName;

/// A command to the station; part of its recorded inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Set the pose, with the given standard deviations; counted as a reset.
    SetPose {
        pose: Pose<Arena>,
        /// One standard deviation, of x and of y each.
        position_sigma_m: f64,
        heading_sigma_rad: f64,
    },
    /// Discard the pose: the filter starts again at the configured start pose, or else at the next fix.
    ResetPose,
    SetParameter {
        /// Its key, as in `[filter]` of the configuration.
        name: ParameterName,
        /// The new value, in the tunable's own unit.
        value: f64,
    },
    /// Store, reload or reset all tunables.
    Parameters(ParameterStorage),
    /// Whether the filter goes on estimating the robot's constants: wheel radii, track width, delay of fixes, position of the tag, errors
    /// of ranges. The gyro's bias is always estimated, because it drifts.
    OnlineCalibration(OnlineCalibration),
    /// Discard the estimated constants: start again from the configured calibration.
    ResetCalibration,
    /// Use the observations of a sensor, or ignore them.
    SwitchSource {
        sensor: SensorId,
        to: SensorSwitch,
    },
    /// Drive at these speeds until the next command; the robot decides for how long.
    Drive {
        forward: MetersPerSecond,
        turn: RadiansPerSecond,
    },
    /// Run further filters beside the one that sends, those of the configuration or else all, or stop them.
    CompareFilters(FilterComparison),
    StartRecording,
    StopRecording,
    Simulator(SimulatorCommand),
}

/// No arena is as wide in metres, and nobody turns a robot so often in degrees.
const MAX_TYPED: f64 = 10_000.0;
/// How well a person places a robot by eye.
const BY_EYE_POSITION_SIGMA_M: f64 = 0.05;
const BY_EYE_HEADING_SIGMA_RAD: f64 = std::f64::consts::PI / 18.0;

impl Command {
    /// Sets a pose that a person has read off or placed by eye: 5 cm and 10 degrees are one standard deviation.
    pub const fn set_pose_by_eye(pose: Pose<Arena>) -> Self {
        Self::SetPose { pose, position_sigma_m: BY_EYE_POSITION_SIGMA_M, heading_sigma_rad: BY_EYE_HEADING_SIGMA_RAD }
    }

    /// Reads a pose as people type it: x and y in metres and the heading in degrees, between commas or spaces.
    pub fn parse_pose(text: &str) -> Result<Pose<Arena>, String> {
        let parts = text.split([',', ' ']).filter(|part| !part.is_empty());
        let numbers: Vec<f64> = parts.map(|part| part.parse().unwrap_or(f64::NAN)).collect();
        match numbers.as_slice() {
            [x_m, y_m, heading_deg] if numbers.iter().all(|number| number.abs() <= MAX_TYPED) => {
                Ok(Pose::new(Meters(*x_m), Meters(*y_m), Heading::from_rad(heading_deg.to_radians())))
            }
            _ => Err(format!(
                "`{text}` is no pose: give x and y in metres and the heading in degrees, such as 0.5,0.25,90"
            )),
        }
    }

    /// Whether it concerns robots, and not the station as a whole.
    pub const fn is_for_robots(&self) -> bool {
        match self {
            Self::SetPose { .. }
            | Self::ResetPose
            | Self::OnlineCalibration(_)
            | Self::ResetCalibration
            | Self::SwitchSource { .. }
            | Self::Drive { .. }
            | Self::Simulator(_) => true,
            Self::SetParameter { .. }
            | Self::Parameters(_)
            | Self::CompareFilters(_)
            | Self::StartRecording
            | Self::StopRecording => false,
        }
    }

    /// The command's name, as recordings spell it.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::SetPose { .. } => "set pose",
            Self::ResetPose => "reset pose",
            Self::SetParameter { .. } => "set parameter",
            Self::Parameters(ParameterStorage::Save) => "save parameters",
            Self::Parameters(ParameterStorage::Reload) => "reload parameters",
            Self::Parameters(ParameterStorage::Default) => "default parameters",
            Self::OnlineCalibration(OnlineCalibration::Frozen) => "freeze calibration",
            Self::OnlineCalibration(OnlineCalibration::Enabled) => "learn calibration",
            Self::ResetCalibration => "reset calibration",
            Self::SwitchSource { to: SensorSwitch::Off, .. } => "switch source off",
            Self::SwitchSource { to: SensorSwitch::On, .. } => "switch source on",
            Self::Drive { .. } => "drive at",
            Self::CompareFilters(FilterComparison::Off) => "stop comparing filters",
            Self::CompareFilters(FilterComparison::On) => "compare filters",
            Self::StartRecording => "start recording",
            Self::StopRecording => "stop recording",
            Self::Simulator(command) => command.name(),
        }
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name();
        match self {
            Self::SetPose { pose, position_sigma_m, heading_sigma_rad } => write!(
                f,
                "{name}: x {} m, y {} m, heading {} rad, sigma {position_sigma_m} m and {heading_sigma_rad} rad",
                pose.x.0,
                pose.y.0,
                pose.heading.rad()
            ),
            Self::SetParameter { name: parameter, value } => write!(f, "{name}: {parameter} = {value}"),
            Self::SwitchSource { sensor, .. } => write!(f, "{name}: sensor {sensor}"),
            Self::Drive { forward, turn } => write!(f, "{name} {} m/s, {} rad/s", forward.0, turn.0),
            Self::Simulator(command) => command.fmt(f),
            Self::ResetPose
            | Self::Parameters(_)
            | Self::OnlineCalibration(_)
            | Self::ResetCalibration
            | Self::CompareFilters(_)
            | Self::StartRecording
            | Self::StopRecording => f.write_str(name),
        }
    }
}

/// An operation on all tunables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterStorage {
    /// Store them for the next start.
    Save,
    /// Restore those that were saved last, or else those of the start.
    Reload,
    Default,
}

/// Whether the filter estimates the robot's constants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum OnlineCalibration {
    Frozen,
    Enabled,
}

/// Whether further filters run beside the one whose estimates are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilterComparison {
    Off,
    On,
}

/// A task for the program that runs the station. A replay ignores it.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Store the tunables for the next start.
    SaveParameters {
        /// All tunables with their values, each in its own unit.
        values: Vec<(ParameterName, f64)>,
    },
    /// Begin a new recording, unless one is open.
    StartRecording {
        /// The current tunables, for the new recording's header.
        values: Vec<(ParameterName, f64)>,
    },
    /// End the recording, if one is open.
    StopRecording,
    /// Tell the fleet of a fix of a tagged robot: its owner may be another station.
    ShareFix {
        /// The tag's number.
        tag: u32,
        fix: OutsideFix,
    },
    /// Carry out a command to a simulated brick, if the program has one.
    Simulator {
        /// The robot that the brick drives; `None` if none was named.
        robot: Option<RobotId>,
        command: SimulatorCommand,
    },
}
