//! How long a sender may be silent.

use posebridge_telemetry::TimeDelta;

/// Silence after which a robot, or any other peer, counts as lost. Five missed heartbeats: the usual limit of ground stations.
pub(crate) const PEER_TIMEOUT: TimeDelta = TimeDelta::from_millis(5_000);
/// Silence after which another peer with the same address takes the place of the first, at the earliest.
pub(crate) const HANDOVER: TimeDelta = TimeDelta::from_millis(300);
