//! The distributions of the impairments, drawn from a seeded stream by inversion.

use posebridge_telemetry::TimeDelta;

use crate::random::RandomStream;

/// A draw from the exponential distribution: `-mean ln(1 - u)`.
pub(super) fn exponential(stream: &mut RandomStream, mean: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(-mean.as_secs_f64() * (1.0 - stream.uniform(0.0, 1.0)).ln())
}

/// A draw from the uniform distribution between two spans.
pub(super) fn uniform(stream: &mut RandomStream, from: TimeDelta, to: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(stream.uniform(from.as_secs_f64(), to.as_secs_f64()))
}

/// How many trials fail before the next one succeeds, each with this probability: `floor(ln(1 - u) / ln(1 - p))`.
pub(super) fn failures_before_success(stream: &mut RandomStream, probability: f64) -> u64 {
    let u = stream.uniform(0.0, 1.0);
    if probability <= 0.0 {
        return u64::MAX;
    }
    // ln_1p keeps the digits of rare errors; a certain success divides by minus infinity and gives 0.
    ((-u).ln_1p() / (-probability).ln_1p()) as u64
}

/// Milliseconds of a profile as a span.
pub(super) fn millis(milliseconds: f64) -> TimeDelta {
    TimeDelta::from_secs_f64(milliseconds * 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn certain_and_impossible_events_need_no_luck() {
        let mut stream = RandomStream::new(1, "draws");
        for _ in 0..1_000 {
            assert_eq!(failures_before_success(&mut stream, 1.0), 0);
            assert_eq!(failures_before_success(&mut stream, 0.0), u64::MAX);
        }
    }

    #[test]
    fn gaps_between_rare_events_have_their_mean() {
        let mut stream = RandomStream::new(2, "draws");
        let sum: u64 = (0..20_000).map(|_| failures_before_success(&mut stream, 0.01)).sum();
        // Mean (1 - p) / p = 99, sigma of the mean 0.7.
        let mean = sum as f64 / 20_000.0;
        assert!((mean - 99.0).abs() < 2.8, "{mean}");
    }
}
