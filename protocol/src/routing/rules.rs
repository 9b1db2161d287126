//! Filters, minimum intervals per message, and byte budgets of a link.
//!
//! # Model
//! ```text
//! interval   a message of one sender passes if the last one that passed is at least its interval ago
//! budget     bucket of rate · 0.25 s (at least one complete frame), filled at rate; passes while it is above zero, then pays
//! ```
//! The budget may go below zero by one frame, so that a small rate does not shut out large frames; over time the rate holds.
//! Commands always pass, but pay.

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, ComponentId, HostClock, SystemId, TimeDelta, Timestamp};

use super::endpoints::MAX_PEERS;
use crate::dialect::catalogue::is_stock_message;

/// The rules of one link.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkRules {
    /// Redundant links to one robot share a number; `None` for a single link.
    pub group: Option<u16>,
    pub forward: ForwardPolicy,
    /// Which of its frames are used and forwarded.
    pub inward: FrameFilter,
    /// Which frames of other links may be sent on it.
    pub outward: FrameFilter,
    pub dialects: ForwardedDialects,
    /// Rate limits of other links' frames and of our estimates.
    pub limits: RateLimits,
}

/// The dialects whose messages are forwarded to a link. A receiver cannot verify a message that it does not know, and counts it as lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForwardedDialects {
    /// Messages of no known dialect as well.
    #[default]
    All,
    /// Those of the MAVLink project, without our own; and what the outward filter allows by name.
    Stock,
}

impl LinkRules {
    /// Whether the filters let a frame of another link leave on this one.
    pub(super) fn admits_outward(&self, source: Address, message_id: u32) -> bool {
        let is_known_there = match self.dialects {
            ForwardedDialects::All => true,
            ForwardedDialects::Stock => {
                is_stock_message(message_id) || self.outward.messages.allow.contains(&message_id)
            }
        };
        is_known_there && self.outward.admits(source, message_id)
    }
}

/// Which frames of other links are forwarded to a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForwardPolicy {
    /// Those that concern it, by the roles of sender and recipients, which only the caller of the router knows: robots to ground
    /// stations, cameras to a lone robot, ground stations to all, never robot to robot.
    #[default]
    ByRole,
    All,
    /// Only frames whose target has been received there.
    Targeted,
    /// None, and none of its frames is forwarded to another link.
    Disabled,
}

/// Accepts frames by message, and by the sender's system and component. The default accepts all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameFilter {
    pub messages: AllowBlockList<u32>,
    pub systems: AllowBlockList<SystemId>,
    pub components: AllowBlockList<ComponentId>,
}

impl FrameFilter {
    pub fn admits(&self, source: Address, message_id: u32) -> bool {
        self.messages.admits(&message_id)
            && self.systems.admits(&source.system)
            && self.components.admits(&source.component)
    }
}

/// Selects the items in `allow`, or all if that is empty, except those in `block`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AllowBlockList<T> {
    pub allow: Vec<T>,
    pub block: Vec<T>,
}

impl<T> Default for AllowBlockList<T> {
    fn default() -> Self {
        Self { allow: Vec::new(), block: Vec::new() }
    }
}

impl<T: PartialEq> AllowBlockList<T> {
    pub fn admits(&self, item: &T) -> bool {
        (self.allow.is_empty() || self.allow.contains(item)) && !self.block.contains(item)
    }
}

/// Share of the rate that may be sent at once: a delay of a quarter of a second is noticeable in steering.
const BURST: TimeDelta = TimeDelta::from_millis(250);
const MAX_FRAME_BYTES: i64 = 280;
const MAX_SENDERS: usize = MAX_PEERS;
const NANOS_PER_SEC: i64 = 1_000_000_000;

/// Limits of one link. The default limits nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RateLimits {
    pub min_intervals: BTreeMap<u32, TimeDelta>,
    /// `None` for no budget. A frame for several peers of the link is charged once, and each of them gets it.
    pub bytes_per_s: Option<u32>,
}

/// Enforces the rate limits of one link.
#[derive(Clone, Debug)]
pub struct LinkRateLimiter {
    limits: RateLimits,
    last_sent: BTreeMap<(u32, Address), Timestamp<HostClock>>,
    /// Remaining budget, in bytes times nanoseconds per second: integers, so that rounding does not accumulate.
    budget: i64,
    refilled: Timestamp<HostClock>,
}

impl LinkRateLimiter {
    pub fn new(limits: RateLimits, now: Timestamp<HostClock>) -> Self {
        let mut limiter = Self { limits, last_sent: BTreeMap::new(), budget: 0, refilled: now };
        limiter.budget = limiter.max_budget();
        limiter
    }

    /// Whether a frame of `bytes` bytes may be sent at `now`; if so it is charged.
    pub fn admits(&mut self, now: Timestamp<HostClock>, source: Address, message_id: u32, bytes: usize) -> bool {
        let interval = self.limits.min_intervals.get(&message_id).copied();
        let key = (message_id, source);
        let is_early = interval.zip(self.last_sent.get(&key)).is_some_and(|(interval, last)| now - *last < interval);
        self.refill(now);
        if is_early || (self.limits.bytes_per_s.is_some() && self.budget <= 0) {
            return false;
        }
        if interval.is_some() {
            if self.last_sent.len() >= MAX_SENDERS {
                // More than any real network has: a sender invents addresses. Beginning anew costs one message of each.
                self.last_sent.clear();
            }
            self.last_sent.insert(key, now);
        }
        self.consume(bytes);
        true
    }

    /// Charges a frame that is sent at `now` regardless of the budget.
    pub fn charge(&mut self, now: Timestamp<HostClock>, bytes: usize) {
        self.refill(now);
        self.consume(bytes);
    }

    fn consume(&mut self, bytes: usize) {
        let bytes = i64::try_from(bytes).unwrap_or(MAX_FRAME_BYTES);
        // Never deeper than a burst, or a flood of commands would silence the rest for long.
        self.budget = (self.budget - bytes.saturating_mul(NANOS_PER_SEC)).max(-self.max_budget());
    }

    fn refill(&mut self, now: Timestamp<HostClock>) {
        let rate = i64::from(self.limits.bytes_per_s.unwrap_or(0));
        let most = self.max_budget();
        // Longer than this no bucket takes to fill, and the product stays within 64 bits.
        let elapsed = (now - self.refilled).max(TimeDelta::ZERO).min(TimeDelta::from_millis(2_000_000));
        let gained = i128::from(elapsed.as_nanos()) * i128::from(rate);
        let filled = i128::from(self.budget) + gained;
        self.budget = i64::try_from(filled).unwrap_or(most).min(most);
        self.refilled = self.refilled.max(now);
    }

    fn max_budget(&self) -> i64 {
        let rate = i64::from(self.limits.bytes_per_s.unwrap_or(0));
        (rate * BURST.as_nanos()).max(MAX_FRAME_BYTES * NANOS_PER_SEC)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_choice_takes_all_and_a_block_beats_an_allow() {
        let mut choice = AllowBlockList::default();
        assert!(choice.admits(&7));
        choice.allow = vec![7, 8];
        assert!(choice.admits(&7) && !choice.admits(&9));
        choice.block = vec![7];
        assert!(!choice.admits(&7) && choice.admits(&8));
    }

    #[test]
    fn every_condition_of_a_filter_must_hold() {
        let filter = FrameFilter {
            messages: AllowBlockList { allow: vec![0, 30], block: vec![] },
            systems: AllowBlockList { allow: vec![SystemId(1)], block: vec![] },
            components: AllowBlockList { allow: vec![], block: vec![ComponentId(9)] },
        };
        assert!(filter.admits(Address::new(1, 1), 30));
        assert!(!filter.admits(Address::new(1, 1), 31));
        assert!(!filter.admits(Address::new(2, 1), 30));
        assert!(!filter.admits(Address::new(1, 9), 30));
    }

    const ROBOT: Address = Address::new(1, 1);

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn a_message_is_limited_to_its_interval_for_each_sender() {
        let limits =
            RateLimits { min_intervals: BTreeMap::from([(30, TimeDelta::from_millis(100))]), bytes_per_s: None };
        let mut limiter = LinkRateLimiter::new(limits, at(0));
        let mut passed = |source| {
            let times = (0..50).map(|k| at(k * 20));
            times.filter(|now| limiter.admits(*now, source, 30, 40)).count()
        };
        assert_eq!(passed(ROBOT), 10);
        assert_eq!(passed(Address::new(2, 1)), 10);
        assert!(limiter.admits(at(981), ROBOT, 31, 40) && limiter.admits(at(981), ROBOT, 31, 40));
    }

    #[test]
    fn the_budget_holds_over_time_for_small_and_for_large_frames() {
        for (rate, size) in [(1_000, 30), (1_000, 280), (100, 280), (1_000_000, 280)] {
            let limits = RateLimits { min_intervals: BTreeMap::new(), bytes_per_s: Some(rate) };
            let mut limiter = LinkRateLimiter::new(limits, at(0));
            let mut sent = 0;
            for k in 0..600_000 {
                if limiter.admits(at(k / 10), ROBOT, 30, size) {
                    sent += size;
                }
            }
            let allowed = 60 * rate as usize;
            let slack = (rate as usize / 4).max(280) + 280;
            assert!(
                sent <= allowed + slack && sent + slack >= allowed.min(600_000 * size),
                "{rate} B/s in frames of {size}: {sent}"
            );
        }
    }

    #[test]
    fn commands_pay_but_a_flood_of_them_silences_the_rest_only_briefly() {
        let limits = RateLimits { min_intervals: BTreeMap::new(), bytes_per_s: Some(1_000) };
        let mut limiter = LinkRateLimiter::new(limits, at(0));
        for _ in 0..1_000 {
            limiter.charge(at(0), 45);
        }
        assert!(!limiter.admits(at(0), ROBOT, 30, 40));
        assert!(!limiter.admits(at(280), ROBOT, 30, 40));
        assert!(limiter.admits(at(281), ROBOT, 30, 40));
    }
}
