//! The random draws of one unit, made before its outcome is known.
//!
//! A stage that drew only for the units that reach it would shift its whole sequence with every unit that an earlier stage drops: with
//! a little more loss, other bits would fail and other datagrams be duplicated. So every stage draws for every offered unit and byte.
//! Two links of one seed that differ in one stage then differ only in the effect of that stage.
//!
//! # Model
//! ```text
//! lost whole            with probability loss
//! bits, bytes           until the next error ~ Geometric(bit error rate), until the next one is missing ~ Geometric(byte loss)
//! datagrams only        with probability p held back by U(from, to), those behind do not wait; with probability q a copy
//!                       arrives right behind it
//! ```

use posebridge_telemetry::TimeDelta;

use super::profile::{DirectionProfile, LinkKind, Reorder};
use crate::random::RandomStream;

/// `-mean ln(1 - u)`.
pub(super) fn exponential(stream: &mut RandomStream, mean: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(-mean.as_secs_f64() * (1.0 - stream.uniform(0.0, 1.0)).ln())
}

pub(super) fn uniform(stream: &mut RandomStream, from: TimeDelta, to: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(stream.uniform(from.as_secs_f64(), to.as_secs_f64()))
}

pub(super) fn millis(milliseconds: f64) -> TimeDelta {
    TimeDelta::from_secs_f64(milliseconds * 1e-3)
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct UnitDraw {
    pub(super) is_lost: bool,
    /// Uniform on [0, 1): one per datagram, or one per byte of a stream. Empty on a link without burst loss.
    pub(super) burst_draws: Vec<f64>,
    pub(super) missing_bytes: Vec<u64>,
    /// Eight times the byte index plus the bit index.
    pub(super) flipped_bits: Vec<u64>,
    pub(super) held_back: Option<TimeDelta>,
    pub(super) is_duplicated: bool,
}

/// Random streams of the stages whose probabilities do not depend on time.
#[derive(Clone, Debug)]
pub(super) struct UnitDraws {
    kind: LinkKind,
    loss: f64,
    losing: RandomStream,
    bursts: Option<RandomStream>,
    missing_bytes: ErrorGaps,
    bit_errors: ErrorGaps,
    reorder: Option<Reorder>,
    reordering: RandomStream,
    duplicate: f64,
    duplicating: RandomStream,
}

impl UnitDraws {
    /// `stream` creates the random stream of each stage.
    pub(super) fn new(profile: &DirectionProfile, kind: LinkKind, stream: impl Fn(&str) -> RandomStream) -> Self {
        Self {
            kind,
            loss: profile.loss,
            losing: stream("loss"),
            bursts: profile.burst_loss.map(|_| stream("burst loss")),
            missing_bytes: ErrorGaps::new(profile.byte_loss, stream("byte loss")),
            bit_errors: ErrorGaps::new(profile.bit_error_rate, stream("bit errors")),
            reorder: profile.reorder,
            reordering: stream("reorder"),
            duplicate: profile.duplicate,
            duplicating: stream("duplicate"),
        }
    }

    /// Draws for the next unit of `bytes` bytes.
    pub(super) fn draw(&mut self, bytes: usize) -> UnitDraw {
        let is_datagram = self.kind == LinkKind::Datagram;
        let trials = if is_datagram { 1 } else { bytes };
        let burst_draws = match &mut self.bursts {
            Some(stream) => (0..trials).map(|_| stream.uniform(0.0, 1.0)).collect(),
            None => Vec::new(),
        };
        UnitDraw {
            is_lost: self.losing.bernoulli(self.loss),
            burst_draws,
            missing_bytes: self.missing_bytes.hits(bytes as u64),
            flipped_bits: self.bit_errors.hits(8 * bytes as u64),
            held_back: self.reorder.filter(|_| is_datagram).and_then(|reorder| self.draw_reordering(reorder)),
            is_duplicated: is_datagram && self.duplicating.bernoulli(self.duplicate),
        }
    }

    fn draw_reordering(&mut self, reorder: Reorder) -> Option<TimeDelta> {
        let is_held_back = self.reordering.bernoulli(reorder.probability);
        let wait = uniform(&mut self.reordering, millis(reorder.from_ms), millis(reorder.to_ms));
        is_held_back.then_some(wait)
    }
}

/// Independent events at a rate, drawn as the gaps between them: a rate of 1e-6 costs almost nothing.
#[derive(Clone, Debug)]
struct ErrorGaps {
    probability: f64,
    /// Trials before the next event; drawn at the first trial.
    until_next: Option<u64>,
    stream: RandomStream,
}

impl ErrorGaps {
    const fn new(probability: f64, stream: RandomStream) -> Self {
        Self { probability, until_next: None, stream }
    }

    /// Indices of the events among the next `trials`, in order.
    fn hits(&mut self, trials: u64) -> Vec<u64> {
        let mut hits = Vec::new();
        if self.probability <= 0.0 {
            return hits;
        }
        let mut until_next = match self.until_next {
            Some(until_next) => until_next,
            None => failures_before_success(&mut self.stream, self.probability),
        };
        let mut passed = 0;
        while until_next < trials - passed {
            passed += until_next;
            hits.push(passed);
            passed += 1;
            until_next = failures_before_success(&mut self.stream, self.probability);
        }
        self.until_next = Some(until_next - (trials - passed));
        hits
    }
}

/// Geometric draw: `floor(ln(1 - u) / ln(1 - p))`, p above 0.
fn failures_before_success(stream: &mut RandomStream, probability: f64) -> u64 {
    // ln_1p keeps the digits of rare errors; a certain success divides by minus infinity and gives 0.
    ((-stream.uniform(0.0, 1.0)).ln_1p() / (-probability).ln_1p()) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_the_trials_are_counted_does_not_change_the_hits() {
        for (probability, hits) in [(0.0, 0), (0.2, 195), (1.0, 1_000)] {
            let gaps = || ErrorGaps::new(probability, RandomStream::new(4, "gaps"));
            let whole = gaps().hits(1_000);
            let mut parts = gaps();
            let mut found = Vec::new();
            let mut start = 0;
            for size in [1, 7, 0, 92, 400, 500] {
                found.extend(parts.hits(size).into_iter().map(|hit| hit + start));
                start += size;
            }
            assert_eq!(found, whole);
            assert!(whole.len().abs_diff(hits) < 50, "{} of {hits}", whole.len());
        }
    }
}
