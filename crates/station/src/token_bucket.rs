//! A token bucket: how much a peer may cause, in the long run and at once.

use posebridge_telemetry::{HostClock, Timestamp};

const NANOS_PER_SEC: i64 = 1_000_000_000;

/// How fast a bucket fills, and how much it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TokenRate {
    pub(crate) per_second: i64,
    pub(crate) burst: i64,
}

/// What is left of one peer's tokens.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TokenBucket {
    rate: TokenRate,
    /// In tokens times nanoseconds per second, so that no rounding adds up.
    left: i64,
    refilled: Timestamp<HostClock>,
}

impl TokenBucket {
    /// A full bucket.
    pub(crate) const fn new(rate: TokenRate) -> Self {
        Self { rate, left: rate.burst * NANOS_PER_SEC, refilled: Timestamp::ZERO }
    }

    /// Takes tokens if there are as many; false, and takes none, if there are not.
    pub(crate) fn charge(&mut self, now: Timestamp<HostClock>, tokens: usize) -> bool {
        let full = self.rate.burst * NANOS_PER_SEC;
        // A full bucket takes no more: limited, so that the product stays within 64 bits.
        let elapsed = (now - self.refilled).as_nanos().clamp(0, full / self.rate.per_second.max(1) + 1);
        self.refilled = self.refilled.max(now);
        self.left = (self.left + elapsed * self.rate.per_second).min(full);
        let cost = i64::try_from(tokens).unwrap_or(i64::MAX).saturating_mul(NANOS_PER_SEC);
        let is_covered = cost <= self.left;
        if is_covered {
            self.left -= cost;
        }
        is_covered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn a_burst_and_then_the_rate_pass_whatever_is_asked() {
        let mut bucket = TokenBucket::new(TokenRate { per_second: 200, burst: 400 });
        let passed = |bucket: &mut TokenBucket, times: std::ops::Range<i64>| {
            times.filter(|millis| bucket.charge(at(*millis), 1)).count()
        };
        // A thousand a second: 400 at once and 200 a second, and less than one more by its beginning.
        assert_eq!(passed(&mut bucket, 0..1_000), 599);
        assert_eq!(passed(&mut bucket, 1_000..11_000), 2_000);
        // Two seconds of silence fill it again, a year no further.
        assert_eq!((0..1_000).filter(|_| bucket.charge(at(31_536_000_000), 1)).count(), 400);
        assert!(!bucket.charge(at(0), 1), "time that steps back brings nothing");
        assert!(!bucket.charge(at(31_536_001_000), 401));
        assert!(!bucket.charge(at(31_536_001_000), usize::MAX));
        assert!(bucket.charge(at(31_536_001_000), 200));
    }
}
