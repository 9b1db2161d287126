//! Fixes from outside the station's own links: from a camera of another station, or from another program.

use crate::clock::{HostClock, TimeDelta, Timestamp};
use crate::ids::Address;
use crate::observation::Fix;

/// A fix of one robot whose time is already on the host's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutsideFix {
    /// Tells its sender from others.
    pub source: Address,
    pub time: Timestamp<HostClock>,
    /// The time is at most this far from the true one.
    pub uncertainty: TimeDelta,
    pub fix: Fix,
}
