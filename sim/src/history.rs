//! The history of a simulation, bounded for endless drives.

use posebridge_telemetry::TimeDelta;

/// History of an endless drive; up to [`HISTORY_TRIM_BLOCK`] more is kept.
pub const HISTORY_DURATION: TimeDelta = TimeDelta::from_millis(600_000);
/// The oldest part of the history is dropped in blocks of this length: moving the rest for each item would be slow.
pub const HISTORY_TRIM_BLOCK: TimeDelta = TimeDelta::from_millis(20_000);
/// More than 10 minutes at 200 per second, the highest rate of a scenario.
const MAX_HISTORY_ITEMS: usize = 130_000;

/// Drops the oldest items of a list that is sorted by simulation time.
pub(crate) fn trim_history<T>(
    history: HistoryPolicy,
    world: TimeDelta,
    list: &mut Vec<T>,
    world_of: fn(&T) -> TimeDelta,
) {
    if history != HistoryPolicy::Recent {
        return;
    }
    let begins = world - HISTORY_DURATION;
    let oldest = list.first().map(world_of);
    if oldest.is_some_and(|oldest| oldest < begins - HISTORY_TRIM_BLOCK) {
        list.drain(..list.partition_point(|item| world_of(item) < begins));
    }
    if list.len() >= MAX_HISTORY_ITEMS {
        list.drain(..MAX_HISTORY_ITEMS / 16);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HistoryPolicy {
    All,
    /// The last [`HISTORY_DURATION`].
    Recent,
    /// A brick that runs for days must not fill the memory.
    Nothing,
}
