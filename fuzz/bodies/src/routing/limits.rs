//! Any traffic on a slow link: no message is sent sooner than its interval, and no more bytes than the rate limit.

use std::collections::BTreeMap;

use posebridge_protocol::routing::{LinkRateLimiter, RateLimits};
use posebridge_telemetry::{Address, TimeDelta, Timestamp};

use crate::operands::Operands;

/// A frame with signature; so much may leave beyond the budget.
const LARGEST_FRAME: i64 = 280;
/// What may leave at once: a quarter of a second's worth.
const BURSTS_PER_S: i64 = 4;
/// The message that has an interval.
const LIMITED_MESSAGE: u32 = 30;

/// Input: rate, interval, then operations.
pub(super) fn check(mut operands: Operands<'_>) {
    let rate = u32::from(operands.number());
    let interval = TimeDelta::from_millis(i64::from(operands.byte()) * 10);
    let limits = RateLimits {
        min_intervals: BTreeMap::from([(LIMITED_MESSAGE, interval)]),
        bytes_per_s: (rate > 0).then_some(rate),
    };
    let mut now = Timestamp::ZERO;
    let mut limiter = LinkRateLimiter::new(limits, now);
    let mut last = BTreeMap::new();
    let mut left: i64 = 0;
    while !operands.is_empty() {
        let (what, size) = (operands.byte(), operands.byte());
        let bytes = 12 + usize::from(size);
        match what % 4 {
            0 => now = now + TimeDelta::from_millis(i64::from(what >> 2) * i64::from(size)),
            1 => limiter.charge(now, bytes),
            kind => {
                let message_id = if kind == 2 { LIMITED_MESSAGE } else { 0 };
                let source = Address::new(1 + (what >> 2) % 8, 1);
                if !limiter.admits(now, source, message_id, bytes) {
                    continue;
                }
                left += bytes as i64;
                let before = last.insert((message_id, source), now);
                if let (Some(before), LIMITED_MESSAGE) = (before, message_id) {
                    assert!(now - before >= interval, "{:?}", now - before);
                }
            }
        }
        let earned = (now - Timestamp::ZERO).as_nanos() / 1_000 * i64::from(rate) / 1_000_000;
        let burst = (i64::from(rate) / BURSTS_PER_S).max(LARGEST_FRAME);
        let allowed = earned + burst + LARGEST_FRAME + 1;
        assert!(rate == 0 || left <= allowed, "{left} bytes of {allowed}");
    }
}
