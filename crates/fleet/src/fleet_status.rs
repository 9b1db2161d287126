//! Whether a station may claim and serve.

use posebridge_telemetry::{HostClock, Timestamp};

/// What the station knows of its fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FleetStatus {
    /// It has started or was frozen. Somebody else may own what it owned.
    Unconfirmed { since: Timestamp<HostClock>, next_request: Timestamp<HostClock> },
    /// Nobody is connected; the sessions that a freeze has cost may come back until then.
    Waiting { serve_from: Timestamp<HostClock> },
    /// Other stations are connected, and their tokens known.
    Connected,
    /// Nobody is connected. It serves what it hears.
    Isolated,
    /// The program ends.
    Ended,
}

impl FleetStatus {
    pub(crate) const fn may_serve(self) -> bool {
        match self {
            Self::Connected | Self::Isolated => true,
            Self::Unconfirmed { .. } | Self::Waiting { .. } | Self::Ended => false,
        }
    }

    /// When it changes, or requests something, by itself.
    pub(crate) const fn due(self) -> Option<Timestamp<HostClock>> {
        match self {
            Self::Unconfirmed { next_request: due, .. } | Self::Waiting { serve_from: due } => Some(due),
            Self::Connected | Self::Isolated | Self::Ended => None,
        }
    }
}
