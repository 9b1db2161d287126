//! Wheel travel and gyro rate over time, independent of any filter state.
//!
//! A filter queries these tracks for the travel between any two instants; between two readings it is linear. So a fix whose
//! stamp lies inside an encoder interval is applied at its own time, and a late reading changes nothing but the intervals
//! that it belongs to. The travel of a track depends on the readings that it holds and not on the order in which they came.
//! The tracks hold no filter state, and reject only what a wheel cannot do.

mod gyro;
mod reading;
mod track;

use std::collections::VecDeque;

use posebridge_telemetry::TimeDelta;

pub use gyro::{GyroTrack, GyroTurn};
pub use reading::{InsertOutcome, MotionReading, MotionSource};
pub use track::{MotionTrack, TravelSegment};

/// Speeds are held for this long after the last motion observation, and are stale after that.
pub(crate) const SPEED_HOLD: TimeDelta = TimeDelta::from_millis(500);
/// Random walk of a robot whose motion is not observed, m/s per sqrt(s): a LEGO robot's usual speed.
pub(crate) const UNOBSERVED_M_PER_SQRT_S: f64 = 0.3;
/// The same for its heading, rad per sqrt(s).
pub(crate) const UNOBSERVED_RAD_PER_SQRT_S: f64 = 1.0;

/// Number of elements at the front for which `belongs` holds, as [`VecDeque::partition_point`], but by a search from
/// the back in doubling steps: recent elements are the likely ones, and in the cache.
pub fn count_before<T>(queue: &VecDeque<T>, belongs: impl Fn(&T) -> bool) -> usize {
    // All from here on do not belong.
    let mut end = queue.len();
    let mut step = 1;
    // All before here belong.
    let mut start = loop {
        let Some(index) = end.checked_sub(step) else {
            break 0;
        };
        if queue.get(index).is_some_and(&belongs) {
            break index + 1;
        }
        end = index;
        step *= 2;
    };
    while start < end {
        let middle = usize::midpoint(start, end);
        if queue.get(middle).is_some_and(&belongs) {
            start = middle + 1;
        } else {
            end = middle;
        }
    }
    start
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_counts_what_halving_counts() {
        for length in 0..40 {
            let mut queue: VecDeque<i32> = (0..length).collect();
            // Wrapped around the end of its storage.
            for next in length..length + 7 {
                queue.pop_front();
                queue.push_back(next);
            }
            for limit in -1..=length + 8 {
                let expected = queue.partition_point(|element| *element < limit);
                assert_eq!(count_before(&queue, |element| *element < limit), expected);
            }
        }
    }
}
