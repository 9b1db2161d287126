//! The alignment of host and brick clock, as a station has published it, for instants that it did not convert itself.

use posebridge_telemetry::{BrickClock, Event, HostClock, TimeDelta, Timestamp};

/// An instant by both clocks, and how fast one goes against the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockAlignment {
    /// By the host's clock.
    pub host: Timestamp<HostClock>,
    /// By the brick's clock.
    pub brick: Timestamp<BrickClock>,
    /// Rate of the brick's clock against the host's, minus one, in parts per million.
    pub skew_ppm: f64,
}

impl ClockAlignment {
    /// What an event says of the clocks, if it does.
    pub const fn from_event(event: &Event) -> Option<Self> {
        if let Event::BrickClockAligned { host, brick, skew_ppm, .. } = *event {
            return Some(Self { host, brick, skew_ppm });
        }
        None
    }

    /// An instant of the host's clock by the brick's.
    pub fn brick_at(&self, host: Timestamp<HostClock>) -> Timestamp<BrickClock> {
        let since_s = (host - self.host).as_secs_f64();
        self.brick + TimeDelta::from_secs_f64(since_s * self.rate())
    }

    /// An instant of the brick's clock by the host's.
    pub fn host_at(&self, brick: Timestamp<BrickClock>) -> Timestamp<HostClock> {
        let since_s = (brick - self.brick).as_secs_f64();
        self.host + TimeDelta::from_secs_f64(since_s / self.rate())
    }

    fn rate(&self) -> f64 {
        1.0 + 1e-6 * self.skew_ppm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instant_goes_to_the_other_clock_and_back() {
        let aligned = ClockAlignment {
            host: Timestamp::from_millis(5_000),
            brick: Timestamp::from_millis(1_000),
            skew_ppm: 1_000.0,
        };
        let host = Timestamp::from_millis(15_000);
        let brick = aligned.brick_at(host);
        assert_eq!(brick, Timestamp::from_millis(11_010));
        let there_and_back = aligned.host_at(brick) - host;
        assert!(there_and_back.as_secs_f64().abs() < 1e-8);
    }
}
