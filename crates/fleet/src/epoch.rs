//! Epochs number the owners of a robot; a fence drops what an earlier owner still sends.

use std::fmt;
use std::num::NonZeroU32;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::names::StationId;

/// Counts the owners of one robot, from 1. Each new owner takes the highest epoch that it knows and adds one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Epoch(NonZeroU32);

impl Epoch {
    pub const FIRST: Self = Self(NonZeroU32::MIN);
    /// The last one. Nobody gets there by counting; a faulty or hostile station may announce it.
    pub const LAST: Self = Self(NonZeroU32::MAX);

    /// `None` for 0.
    pub const fn new(number: u32) -> Option<Self> {
        match NonZeroU32::new(number) {
            Some(number) => Some(Self(number)),
            None => None,
        }
    }

    pub const fn get(self) -> u32 {
        self.0.get()
    }

    /// The epoch of the next owner. [`Self::LAST`] follows itself: stations then settle by their ids, and a fence cannot tell
    /// such owners apart.
    pub const fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }
}

impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

impl fmt::Debug for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.0, f)
    }
}

/// A station's claim to own a robot. Of several for one robot the highest holds: by epoch, then by station.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct OwnershipToken {
    pub epoch: Epoch,
    pub station: StationId,
}

/// What a fence says of an estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FenceDecision {
    Accepted,
    /// It comes from an earlier owner: drop it.
    Stale {
        highest: Epoch,
    },
}

/// Drops the estimates of earlier owners, for one robot, at whoever receives them.
///
/// After a silence of [`Self::FORGET_AFTER`] a lower epoch is accepted: nobody sends the higher one any more, and a fleet
/// whose stations were all restarted counts from 1 again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EpochFence {
    /// Of the last accepted estimate, with its time.
    highest: Option<(Epoch, Timestamp<HostClock>)>,
}

impl EpochFence {
    /// Longer than a robot is without an owner when that one freezes, which is the lease of 2 s and half a second.
    pub const FORGET_AFTER: TimeDelta = TimeDelta::from_millis(3_000);

    pub fn check(&mut self, now: Timestamp<HostClock>, epoch: Epoch) -> FenceDecision {
        if let Some((highest, last)) = self.highest
            && epoch < highest
            && now - last < Self::FORGET_AFTER
        {
            return FenceDecision::Stale { highest };
        }
        self.highest = Some((epoch, now));
        FenceDecision::Accepted
    }

    /// The epoch of the last accepted estimate.
    pub fn highest(&self) -> Option<Epoch> {
        self.highest.map(|(epoch, _)| epoch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn epoch(number: u32) -> Epoch {
        Epoch::new(number).unwrap()
    }

    #[test]
    fn epochs_count_from_one_and_stop_at_the_last() {
        assert_eq!(Epoch::new(0), None);
        assert_eq!(Epoch::FIRST.next(), epoch(2));
        assert_eq!(Epoch::LAST.next(), Epoch::LAST);
    }

    #[test]
    fn a_fence_drops_lower_epochs_until_the_higher_one_was_silent_for_long() {
        let at = Timestamp::from_millis;
        let mut fence = EpochFence::default();
        assert_eq!(fence.check(at(0), epoch(7)), FenceDecision::Accepted);
        assert_eq!(fence.check(at(1), epoch(6)), FenceDecision::Stale { highest: epoch(7) });
        assert_eq!(fence.check(at(10), epoch(7)), FenceDecision::Accepted);
        assert_eq!(fence.check(at(3_009), epoch(1)), FenceDecision::Stale { highest: epoch(7) });
        assert_eq!(fence.check(at(3_010), epoch(1)), FenceDecision::Accepted);
        assert_eq!(fence.highest(), Some(epoch(1)));
        assert_eq!(fence.check(at(3_011), epoch(8)), FenceDecision::Accepted);
    }
}
