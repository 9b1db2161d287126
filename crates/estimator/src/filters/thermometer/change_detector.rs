//! Classifies the readings of a slow sensor: expected, outlier, or the start of a new value (cumulative sum test).
//!
//! ```text
//! z = (y - expected) / (kappa sqrt(S)), within +-5
//! c+ <- max(0, c+ + z - 1)        c- <- max(0, c- - z - 1)        a break when c+ or c- exceeds 8
//! kappa^2 = max(1, (10 + sum of z^2 kappa^2) / (10 + n))          sums forgotten over 100 readings
//! ```
//! With these numbers white noise makes a break about once in exp(2 * 8) readings (Wald's approximation), which at 10
//! Hz is ten days; a step of many sigmas makes one with the third reading, and a single damaged reading makes none.
//!
//! Source: Page (1954), the cumulative sum test.

use serde::{Deserialize, Serialize};

use crate::saved::not_negative;

/// A reading further from the expected one, in sigmas, is not used and counts as this far.
const GATE: f64 = 5.0;
/// Deviation, in sigmas, that does not add to the sums.
const ALLOWANCE: f64 = 1.0;
/// A sum beyond this is not chance. Two readings at the gate reach exactly this.
const LIMIT: f64 = 8.0;
/// The configured noise weighs as much as this number of readings.
const PRIOR_READINGS: f64 = 10.0;
/// Number of readings after which the spread forgets.
const MEMORY_READINGS: f64 = 100.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadingClass {
    /// Within the gate.
    Expected,
    /// A single reading outside the gate.
    Outlier,
    /// The last readings together show a new value.
    StepChange {
        /// Their number.
        readings: usize,
    },
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ChangeDetector {
    #[serde(deserialize_with = "not_negative")]
    above: f64,
    #[serde(deserialize_with = "not_negative")]
    below: f64,
    #[serde(deserialize_with = "not_negative")]
    squares: f64,
    /// Number of readings, as far as they are not forgotten.
    #[serde(deserialize_with = "not_negative")]
    weight: f64,
    /// The readings since each sum was last zero.
    runs: [DeviatingRun; 2],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct DeviatingRun {
    readings: usize,
    #[serde(deserialize_with = "not_negative")]
    squares: f64,
}

impl ChangeDetector {
    /// Classifies a deviation, in sigmas of the model.
    pub(super) fn classify(&mut self, deviation: f64) -> ReadingClass {
        if !deviation.is_finite() {
            return ReadingClass::Outlier;
        }
        let scale = self.inflation().sqrt();
        let z = deviation / scale;
        let counted = z.clamp(-GATE, GATE);
        self.above = (self.above + counted - ALLOWANCE).max(0.0);
        self.below = (self.below - counted - ALLOWANCE).max(0.0);
        let retention = 1.0 - 1.0 / MEMORY_READINGS;
        self.squares = retention * self.squares + (counted * scale).powi(2);
        self.weight = retention * self.weight + 1.0;
        for (sum, run) in [self.above, self.below].into_iter().zip(&mut self.runs) {
            if sum > 0.0 {
                run.readings = run.readings.saturating_add(1);
                run.squares += (counted * scale).powi(2);
            } else {
                *run = DeviatingRun::default();
            }
        }
        if self.above.max(self.below) > LIMIT {
            // What belongs to a step says nothing about the noise.
            let run = self.runs[usize::from(self.below > self.above)];
            self.squares = (self.squares - run.squares).max(0.0);
            self.weight = (self.weight - run.readings as f64).max(0.0);
            self.above = 0.0;
            self.below = 0.0;
            self.runs = Default::default();
            ReadingClass::StepChange { readings: run.readings }
        } else if z.abs() > GATE {
            ReadingClass::Outlier
        } else {
            ReadingClass::Expected
        }
    }

    /// Forgets the latest deviations, but not how large they are usually.
    pub(super) fn restart(&mut self) {
        *self = Self { squares: self.squares, weight: self.weight, ..Self::default() };
    }

    /// Factor of the observed variance over the model's; at least 1.
    pub(super) fn inflation(&self) -> f64 {
        ((PRIOR_READINGS + self.squares) / (PRIOR_READINGS + self.weight)).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    #[test]
    fn a_step_is_a_break_with_the_third_reading_and_a_slip_is_none() {
        for side in [1.0, -1.0] {
            let mut surprise = ChangeDetector::default();
            (0..50).for_each(|_| assert_eq!(surprise.classify(0.0), ReadingClass::Expected));
            let verdicts: Vec<_> = (0..3).map(|_| surprise.classify(side * 40.0)).collect();
            let (slip, end) = (ReadingClass::Outlier, ReadingClass::StepChange { readings: 3 });
            assert_eq!(verdicts, [slip, slip, end]);

            let mut surprise = ChangeDetector::default();
            assert_eq!(surprise.classify(side * 1e6), ReadingClass::Outlier);
            assert_eq!(surprise.classify(0.1), ReadingClass::Expected);
        }
    }

    #[test]
    fn a_small_deviation_that_stays_is_a_break_in_the_end() {
        let mut surprise = ChangeDetector::default();
        let first = (0..100).find(|_| matches!(surprise.classify(2.0), ReadingClass::StepChange { .. }));
        assert!((8..=30).contains(&first.unwrap()), "{first:?}");
    }

    #[test]
    fn noise_makes_no_break_even_where_it_is_twice_what_was_configured() {
        for (sigma, inflation) in [(1.0_f64, 1.0..1.3), (2.0, 2.5..6.0)] {
            let mut surprise = ChangeDetector::default();
            let mut random = Pcg64::seed_from_u64(4);
            for k in 0..20_000 {
                let deviation = sigma * random.sample::<f64, _>(StandardNormal);
                let class = surprise.classify(deviation);
                assert!(!matches!(class, ReadingClass::StepChange { .. }), "{k}");
            }
            assert!(inflation.contains(&surprise.inflation()), "{surprise:?}");
        }
    }
}
