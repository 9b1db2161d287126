//! Times and limits of the protocol. Every station of a fleet should have the same.

use posebridge_telemetry::TimeDelta;

/// Times and limits; [`Default`] fits a local network with delays below 50 ms and a lease of 2 s.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OwnershipConfig {
    /// An owner that does not answer for this long is replaced.
    pub query_timeout: TimeDelta,
    /// A longer time between two calls means that this station was frozen. Shorter than `query_timeout`, because that is how
    /// fast others replace an owner, and longer than `tick_interval`.
    pub freeze_limit: TimeDelta,
    /// The longest time between two calls, so that a freeze is seen.
    pub tick_interval: TimeDelta,
    /// How long a station that has started or was frozen waits for its fleet before it serves alone: longer than a session takes to
    /// come back.
    pub rejoin_grace: TimeDelta,
    /// How long a confirmation of the fleet may take before it is requested again.
    pub confirmation_interval: TimeDelta,
    /// How long the token of a replaced owner stays: longer than a message takes.
    pub withdrawal_delay: TimeDelta,
    /// How long an owner that has handed a robot over waits for the claim.
    pub hand_over_timeout: TimeDelta,
    /// How often an owner publishes the state.
    pub state_interval: TimeDelta,
    /// An owner releases a robot that was silent for this long.
    pub release_after: TimeDelta,
    /// A robot that only the asker has heard since it came is silent for the owner after this time, or after little more than the
    /// robot's own interval where that is longer.
    pub departed_after: TimeDelta,
    /// A robot that both have heard is silent after this time, or after 4.5 of its intervals where that is longer, so that lost
    /// messages do not move it.
    pub silent_after: TimeDelta,
    /// The first and the longest time after which a stand-by asks again; it doubles in between.
    pub query_backoff: TimeDelta,
    pub max_query_backoff: TimeDelta,
    /// How many queries in a row an owner may leave unanswered that has answered before.
    pub max_unanswered: u32,
    pub max_robots: usize,
    pub max_stations: usize,
    /// In bytes. All cached states have at most `max_robots` times this.
    pub max_state_len: usize,
}

impl Default for OwnershipConfig {
    fn default() -> Self {
        Self {
            query_timeout: TimeDelta::from_millis(300),
            freeze_limit: TimeDelta::from_millis(250),
            tick_interval: TimeDelta::from_millis(100),
            rejoin_grace: TimeDelta::from_millis(2_000),
            confirmation_interval: TimeDelta::from_millis(1_000),
            withdrawal_delay: TimeDelta::from_millis(200),
            hand_over_timeout: TimeDelta::from_millis(500),
            state_interval: TimeDelta::from_millis(1_000),
            release_after: TimeDelta::from_millis(30_000),
            departed_after: TimeDelta::from_millis(150),
            silent_after: TimeDelta::from_millis(300),
            query_backoff: TimeDelta::from_millis(50),
            max_query_backoff: TimeDelta::from_millis(2_000),
            max_unanswered: 2,
            max_robots: 256,
            max_stations: 64,
            max_state_len: 524_288,
        }
    }
}
