//! What a person or another program asks of the pipeline, and what the pipeline asks of the program around it.
//!
//! A [`Command`] comes from the dashboard, the command line or a program; one that comes over a link is in the link's bytes, and the
//! engine makes a command of it itself. Both are inputs, so that a replay does the same at the same place.
//!
//! A [`Request`] is the other direction: the engine has no file, so whoever owns one carries it out and says what became of it with
//! [`Input::Report`](crate::Input::Report).

use crate::ids::{ChannelName, SensorId};
use crate::simulator::SimulatorCommand;
use crate::spaces::{Arena, Pose};

/// The key of a tunable; it has the form of a channel's name, which is that of MAVLink's parameters.
pub type ParameterName = ChannelName;

/// A request to the pipeline; part of its recorded inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Put the robot there, with the given standard deviations; counted as a reset.
    SetPose {
        /// Where the robot is.
        pose: Pose<Arena>,
        /// One standard deviation of x and of y, in metres.
        position_sigma_m: f64,
        /// One standard deviation of the heading, in radians.
        heading_sigma_rad: f64,
    },
    /// Forget where the robot is: it is where the configuration lets it start, or else where the next fix sees it.
    ResetPose,
    /// Set one tunable of the filter from now on.
    SetParameter {
        /// Its key, as in `[filter]` of the configuration.
        name: ParameterName,
        /// The new value, in the tunable's own unit.
        value: f64,
    },
    /// Set all tunables at once.
    Parameters(ParameterStorage),
    /// Whether the robot's constants are learned further: wheel radii, track, delay and place of the tag, errors of ranges. A gyro's
    /// bias is none of them: it walks.
    Learning(Learning),
    /// Forget what was learned about the robot: begin again from what is configured.
    ResetCalibration,
    /// Use what a sensor says, or leave it out.
    SwitchSource {
        /// The sensor.
        sensor: SensorId,
        /// Whether it is used from now on.
        to: Switch,
    },
    /// Begin a new recording.
    StartRecording,
    /// End the recording.
    StopRecording,
    /// Do something to the simulated brick.
    Simulator(SimulatorCommand),
}

impl Command {
    /// What is asked for in words, as records name it.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::SetPose { .. } => "set pose",
            Self::ResetPose => "reset pose",
            Self::SetParameter { .. } => "set parameter",
            Self::Parameters(ParameterStorage::Save) => "save parameters",
            Self::Parameters(ParameterStorage::Reload) => "reload parameters",
            Self::Parameters(ParameterStorage::Default) => "default parameters",
            Self::Learning(Learning::Frozen) => "freeze calibration",
            Self::Learning(Learning::Free) => "learn calibration",
            Self::ResetCalibration => "reset calibration",
            Self::SwitchSource { to: Switch::Off, .. } => "switch source off",
            Self::SwitchSource { to: Switch::On, .. } => "switch source on",
            Self::StartRecording => "start recording",
            Self::StopRecording => "stop recording",
            Self::Simulator(command) => command.name(),
        }
    }
}

/// What happens to all tunables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterStorage {
    /// Keep them for the next start.
    Save,
    /// Go back to those that were saved last, or with which the run began.
    Reload,
    /// Go back to the defaults.
    Default,
}

/// Whether the robot's constants are learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Learning {
    /// They are taken as they stand.
    Frozen,
    /// Observations go on to correct them.
    Free,
}

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// Used.
    On,
    /// Left out.
    Off,
}

/// What only the program around the pipeline can do. A replay has nobody to ask and leaves it.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Write the tunables down, so that the next start can begin with them.
    SaveParameters {
        /// All of them with their values, in the tunables' own units.
        values: Vec<(ParameterName, f64)>,
    },
    /// Begin a new recording, if none is being written.
    StartRecording {
        /// The tunables as they are set, for the new recording's header.
        values: Vec<(ParameterName, f64)>,
    },
    /// End the recording, if one is being written.
    StopRecording,
    /// Do something to the simulated brick, if the program has one.
    Simulator(SimulatorCommand),
}
