//! Whether this station of a fleet owns a robot.

use posebridge_telemetry::Ownership;

use crate::config::OwnershipPolicy;

/// Whether this station owns a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OwnershipStatus {
    /// There is no fleet: whoever hears the robot sends to it.
    #[default]
    Unmanaged,
    Owner {
        epoch: u64,
    },
    Standby {
        epoch: u64,
    },
}

impl OwnershipStatus {
    /// 0 without a fleet.
    pub const fn epoch(self) -> u64 {
        match self {
            Self::Unmanaged => 0,
            Self::Owner { epoch } | Self::Standby { epoch } => epoch,
        }
    }

    pub const fn is_standby(self) -> bool {
        matches!(self, Self::Standby { .. })
    }
}

impl From<OwnershipPolicy> for OwnershipStatus {
    /// Of a robot that nothing was decided about.
    fn from(policy: OwnershipPolicy) -> Self {
        match policy {
            OwnershipPolicy::Unmanaged => Self::Unmanaged,
            OwnershipPolicy::Fleet => Self::Standby { epoch: 0 },
        }
    }
}

impl From<&Ownership> for OwnershipStatus {
    fn from(ownership: &Ownership) -> Self {
        match ownership {
            Ownership::Owner { epoch, .. } => Self::Owner { epoch: *epoch },
            Ownership::Standby { epoch } => Self::Standby { epoch: *epoch },
        }
    }
}
