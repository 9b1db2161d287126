//! Which station of a fleet owns a robot.
//!
//! The stations of a fleet decide it among themselves; the engine gets the decision as an input.

use crate::clock::TimeDelta;

/// Whether this station owns a robot. The epoch rises with every change of the owner, so that a robot can tell a station that was the
/// owner before from the one that is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ownership {
    /// This station sends to the robot.
    Owner {
        epoch: u64,
        /// What the owner before knew of the robot; without it this station continues with what it has heard itself.
        state: Option<RobotSnapshot>,
    },
    /// Another station sends to the robot. This one goes on hearing it, and sends it nothing.
    Standby { epoch: u64 },
}

impl Ownership {
    pub const fn epoch(&self) -> u64 {
        match self {
            Self::Owner { epoch, .. } | Self::Standby { epoch } => *epoch,
        }
    }
}

/// The saved state of a robot from another station: not to be trusted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotSnapshot {
    pub bytes: Vec<u8>,
    /// The host clock of the station that saved it, minus that of this station.
    pub clock_offset: TimeDelta,
}
