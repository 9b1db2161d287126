//! Changes of ownership, for people.

use std::fmt;

use posebridge_telemetry::TimeDelta;

use crate::epoch::{Epoch, OwnershipToken};
use crate::names::{RobotName, StationId};

/// Why a station claims a robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ClaimReason {
    /// Nobody owned it.
    Unowned,
    /// The owner did not hear it and handed it over.
    HandedOver(StationId),
    /// The owner's token vanished: it ended, or is cut off.
    OwnerVanished(StationId),
    /// The owner did not answer.
    OwnerUnresponsive(StationId),
}

/// Why an owner stops.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// Another station has a higher token.
    Replaced(OwnershipToken),
    /// The robot was handed over.
    HandedOver(StationId),
    /// The robot was silent for long.
    Silent,
    /// This station was frozen, and does not know yet who owns the robot.
    Frozen,
    /// The program ends.
    Shutdown,
}

/// A change of ownership at this station.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OwnershipEvent {
    Started {
        robot: RobotName,
        epoch: Epoch,
        reason: ClaimReason,
    },
    Stopped {
        robot: RobotName,
        epoch: Epoch,
        reason: StopReason,
    },
    /// Nobody has claimed the robot while this station was frozen.
    Resumed {
        robot: RobotName,
        epoch: Epoch,
    },
    /// This station was not running for this long.
    Frozen {
        duration: TimeDelta,
    },
    /// The robot cannot be claimed: a station holds a token of the last epoch, and does not answer.
    EpochsExhausted {
        robot: RobotName,
        holder: StationId,
    },
}

impl fmt::Display for ClaimReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unowned => write!(f, "nobody owned it"),
            Self::HandedOver(from) => write!(f, "{from} handed it over"),
            Self::OwnerVanished(from) => write!(f, "{from} ended or is cut off"),
            Self::OwnerUnresponsive(from) => write!(f, "{from} did not answer"),
        }
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Replaced(OwnershipToken { epoch, station }) => write!(f, "{station} owns it with epoch {epoch}"),
            Self::HandedOver(to) => write!(f, "handed over to {to}"),
            Self::Silent => write!(f, "it is silent"),
            Self::Frozen => write!(f, "this station was not running and asks whether somebody took over"),
            Self::Shutdown => write!(f, "this station ends"),
        }
    }
}

impl fmt::Display for OwnershipEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Started { robot, epoch, reason } => write!(f, "{robot}: owned here, epoch {epoch}: {reason}"),
            Self::Stopped { robot, epoch, reason } => write!(f, "{robot}: no longer served, epoch {epoch}: {reason}"),
            Self::Resumed { robot, epoch } => write!(f, "{robot}: still owned here, epoch {epoch}"),
            Self::Frozen { duration } => write!(f, "this station was not running for {:.2} s", duration.as_secs_f64()),
            Self::EpochsExhausted { robot, holder } => {
                write!(f, "{robot}: cannot be claimed, {holder} holds the last epoch")
            }
        }
    }
}
