//! The ranges to beacons of the last seconds, whatever order they came in.

use std::collections::VecDeque;

use posebridge_telemetry::{BeaconId, BrickClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::motion::count_before;
use crate::saved::{is_ordered, not_negative};

/// A pose is sought from the ranges of the shorter time first: the robot may have been carried before.
pub const WINDOWS: [TimeDelta; 2] = [TimeDelta::from_millis(2_500), TimeDelta::from_millis(8_000)];
/// Of two ranges of one beacon within this time one is used.
const MIN_INTERVAL: TimeDelta = TimeDelta::from_millis(200);
/// Most ranges of one search.
const MAX_RANGES: usize = 64;

/// A range as it was measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeaconRange {
    pub stamp: Timestamp<BrickClock>,
    pub beacon: BeaconId,
    #[serde(deserialize_with = "not_negative")]
    pub range_m: f64,
}

/// The ranges of the last seconds in the order of time, whatever order they came in.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RecentRanges {
    ranges: VecDeque<BeaconRange>,
}

impl RecentRanges {
    pub(super) fn are_in_order(&self) -> bool {
        is_ordered(&self.ranges, |range| (range.stamp, range.beacon), |one, next| one <= next)
    }

    pub fn insert(&mut self, range: BeaconRange) {
        let is_before = |other: &BeaconRange| {
            let key = |range: &BeaconRange| (range.stamp, range.beacon);
            key(other).cmp(&key(&range)).then(other.range_m.total_cmp(&range.range_m)).is_le()
        };
        let index = count_before(&self.ranges, is_before);
        self.ranges.insert(index, range);
    }

    pub fn discard_before(&mut self, stamp: Timestamp<BrickClock>) {
        while self.ranges.front().is_some_and(|range| range.stamp < stamp) {
            self.ranges.pop_front();
        }
    }

    /// Number of beacons, three at most, whose ranges were measured between two instants.
    pub fn beacons_between(&self, from: Timestamp<BrickClock>, until: Timestamp<BrickClock>) -> usize {
        let mut seen = [None; 3];
        let end = count_before(&self.ranges, |range| range.stamp <= until);
        for range in self.ranges.range(..end).rev().take_while(|range| range.stamp >= from) {
            if !seen.contains(&Some(range.beacon))
                && let Some(slot) = seen.iter_mut().find(|slot| slot.is_none())
            {
                *slot = Some(range.beacon);
            }
        }
        seen.into_iter().flatten().count()
    }

    /// Ranges between two instants, the latest first, without those that follow another of their beacon closely.
    pub fn spread_between(
        &self,
        from: Timestamp<BrickClock>,
        until: Timestamp<BrickClock>,
    ) -> impl Iterator<Item = &BeaconRange> {
        let mut taken: [Option<(BeaconId, Timestamp<BrickClock>)>; 8] = [None; 8];
        let end = count_before(&self.ranges, |range| range.stamp < until);
        let recent = self.ranges.range(..end).rev().take_while(move |range| range.stamp >= from);
        recent
            .filter(move |range| {
                let slot = taken.iter_mut().find(|slot| slot.is_none_or(|(beacon, _)| beacon == range.beacon));
                let Some(slot) = slot else { return false };
                let is_spread = slot.is_none_or(|(_, last)| last - range.stamp >= MIN_INTERVAL);
                if is_spread {
                    *slot = Some((range.beacon, range.stamp));
                }
                is_spread
            })
            .take(MAX_RANGES)
    }
}
