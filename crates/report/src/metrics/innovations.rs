//! Innovation tests of one sensor: are its innovations as large as claimed, and are they white?
//!
//! Input is the filter's records in order. Only sums are kept, so that memory does not grow with the recording. No truth is needed.
//!
//! # Model
//! ```text
//! e_i   = nu_i / sqrt(S_ii)                        innovation of component i over its claimed deviation
//! rho   = sum e_i[k] e_i[k-1] / sum e_i[k]^2       correlation with the one before, over all components; 0 for white innovations
//! |rho| <= 1.96 / sqrt(n)                          in 95 of 100 cases, of n pairs of white ones
//! mean  = sum NIS / sum m                          1 for honest claims; m is a record's degrees of freedom
//! D     = sum m (1 - rho^2) / (1 + rho^2)          on how many independent degrees that mean stands
//! chi2(0.025, D) / D <= mean <= chi2(0.975, D) / D in 95 of 100 cases
//! ```
//! Squares of a Gaussian sequence whose correlation at lag k is rho^k are correlated by rho^2k, which widens the spread of their mean
//! by (1 + rho^2) / (1 - rho^2). With thousands of innovations the band is so narrow that no real sensor lies in it: a noise that is
//! correct within a tenth is called nearly consistent.
//!
//! # Assumptions
//! Innovations of one sensor are Gaussian except for those that the gate rejects, and their order is that of the records.
//!
//! # Sources
//! Bar-Shalom, Li, Kirubarajan (2001), section 5.4.2 (NIS, and the autocorrelation test for whiteness).

use std::fmt;

use posebridge_telemetry::estimate::NORMAL_95;
use posebridge_telemetry::{FusionOutcome, FusionRecord};

use super::consistency::{Consistency, ConsistencyBand, NisMean};

/// Fewer independent degrees of freedom do not suffice for a verdict: their band reaches from half to 1.7.
const MIN_DEGREES: f64 = 20.0;
/// Relative error of a standard deviation that is good enough for all purposes.
const NEARLY_CONSISTENT_MARGIN: f64 = 0.1;
/// Weaker correlations are significant in long recordings but irrelevant to a filter.
const MIN_CORRELATION: f64 = 0.1;
/// A larger share of gated observations indicates a problem of the sensor or of its noise; by chance it would be 0.1 %.
const MAX_GATED_SHARE: f64 = 0.05;
/// Upper limit of the correlation, so that the effective degrees of freedom stay positive.
const MAX_CORRELATION: f64 = 0.999;

/// Accumulates the innovations of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InnovationTest {
    used: u64,
    gated: u64,
    nis: NisMean,
    /// e of the previous record.
    last: Option<[Option<f64>; 3]>,
    pairs: u64,
    product_sum: f64,
    square_sum: f64,
}

impl InnovationTest {
    /// Adds the next record of the sensor. Only used ones enter the mean, as in [`SourceTally`](super::SourceTally).
    pub fn add(&mut self, record: &FusionRecord) {
        match record.outcome {
            FusionOutcome::Gated => self.gated += 1,
            FusionOutcome::Accepted | FusionOutcome::Slip => {
                self.used += 1;
                if record.nis.is_finite() && record.degrees_of_freedom > 0 {
                    self.nis.add(record.nis, record.degrees_of_freedom.into());
                    self.add_innovation(record);
                }
            }
            FusionOutcome::TooOld
            | FusionOutcome::Malformed
            | FusionOutcome::Rebased
            | FusionOutcome::PoseReset
            | FusionOutcome::Unused => {}
        }
    }

    fn add_innovation(&mut self, record: &FusionRecord) {
        let now = normalised(record);
        for (component, value) in now.iter().enumerate() {
            let Some(value) = value else { continue };
            self.square_sum += value * value;
            let before = self.last.and_then(|last| *last.get(component)?);
            if let Some(before) = before {
                self.product_sum += value * before;
                self.pairs += 1;
            }
        }
        self.last = Some(now);
    }

    /// `None` before the first prediction.
    pub fn mean_nis_per_dof(&self) -> Option<f64> {
        self.nis.mean_per_degree()
    }

    pub const fn degrees_of_freedom(&self) -> u64 {
        self.nis.degrees_of_freedom
    }

    /// Correlation of successive innovations; `None` for fewer than two.
    pub fn correlation(&self) -> Option<f64> {
        let is_known = self.pairs > 0 && self.square_sum > 0.0;
        is_known.then(|| (self.product_sum / self.square_sum).clamp(-1.0, 1.0))
    }

    pub fn evaluate(&self) -> InnovationVerdict {
        let correlation = self.correlation();
        let rho = correlation.unwrap_or(0.0).abs().min(MAX_CORRELATION);
        let spread = (1.0 + rho * rho) / (1.0 - rho * rho);
        let independent = self.nis.degrees_of_freedom as f64 / spread;
        let mean = self.mean_nis_per_dof();
        let band = ConsistencyBand::of_mean(independent as u64);
        let finding = match (mean, band) {
            (Some(mean), Some(band)) if independent >= MIN_DEGREES => classify_mean(mean, band),
            _ => InnovationFinding::TooFew,
        };
        let total = self.used + self.gated;
        InnovationVerdict {
            finding,
            mean_nis_per_dof: mean,
            degrees_of_freedom: self.nis.degrees_of_freedom,
            band: band.filter(|_| finding != InnovationFinding::TooFew),
            correlation,
            correlation_bound: (self.pairs > 0).then(|| NORMAL_95 / (self.pairs as f64).sqrt()),
            gated_share: (total > 0).then(|| self.gated as f64 / total as f64),
        }
    }
}

/// Each component over its claimed standard deviation; `None` without component or deviation.
fn normalised(record: &FusionRecord) -> [Option<f64>; 3] {
    let mut normalised = [None; 3];
    let components = normalised.iter_mut().zip(record.innovation).enumerate();
    for (component, (slot, innovation)) in components.take(record.degrees_of_freedom.into()) {
        let variance = variance(record, component);
        *slot = (variance > 0.0).then(|| innovation / variance.sqrt()).filter(|value| value.is_finite());
    }
    normalised
}

/// Claimed variance of a component of an innovation, SI units squared; 0 for an absent component.
pub(crate) fn variance(record: &FusionRecord, component: usize) -> f64 {
    let row = record.innovation_covariance.get(component);
    row.and_then(|row| row.get(component)).copied().unwrap_or(0.0)
}

fn classify_mean(mean: f64, band: ConsistencyBand) -> InnovationFinding {
    let side = band.classify(mean);
    let is_near = (mean.sqrt() - 1.0).abs() <= NEARLY_CONSISTENT_MARGIN;
    match side {
        Consistency::Consistent => InnovationFinding::Consistent,
        Consistency::OverConfident | Consistency::UnderConfident if is_near => InnovationFinding::NearlyConsistent,
        Consistency::OverConfident => InnovationFinding::OverConfident,
        Consistency::UnderConfident => InnovationFinding::UnderConfident,
        Consistency::Undetermined => InnovationFinding::TooFew,
    }
}

/// Innovations compared with their claimed size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InnovationFinding {
    TooFew,
    Consistent,
    /// Deviates significantly, but too little to matter.
    NearlyConsistent,
    OverConfident,
    UnderConfident,
}

impl InnovationFinding {
    pub const fn as_text(self) -> &'static str {
        match self {
            Self::TooFew => "too few to say",
            Self::Consistent => "consistent",
            Self::NearlyConsistent => "nearly consistent",
            Self::OverConfident => "too sure",
            Self::UnderConfident => "too careful",
        }
    }
}

/// Rating of a verdict for the reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VerdictTone {
    Good,
    Inconclusive,
    Bad,
}

/// The result of the innovation tests of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InnovationVerdict {
    pub finding: InnovationFinding,
    /// `None` without predictions.
    pub mean_nis_per_dof: Option<f64>,
    pub degrees_of_freedom: u64,
    /// 95 % interval of the mean for consistent claims; `None` for too few innovations.
    pub band: Option<ConsistencyBand>,
    pub correlation: Option<f64>,
    /// 95 % bound of the correlation of white innovations.
    pub correlation_bound: Option<f64>,
    /// Rejected share of the observations that reached the gate.
    pub gated_share: Option<f64>,
}

impl InnovationVerdict {
    /// Whether the correlation of successive innovations is significant and large enough to matter.
    pub fn has_correlation(&self) -> bool {
        let limit = self.correlation_bound.unwrap_or(1.0).max(MIN_CORRELATION);
        self.finding != InnovationFinding::TooFew && self.correlation.is_some_and(|rho| rho.abs() > limit)
    }

    pub fn has_many_gated(&self) -> bool {
        self.gated_share.is_some_and(|share| share > MAX_GATED_SHARE)
    }

    pub fn tone(&self) -> VerdictTone {
        if self.has_correlation() || self.has_many_gated() {
            return VerdictTone::Bad;
        }
        match self.finding {
            InnovationFinding::OverConfident | InnovationFinding::UnderConfident => VerdictTone::Bad,
            InnovationFinding::TooFew => VerdictTone::Inconclusive,
            InnovationFinding::Consistent | InnovationFinding::NearlyConsistent => VerdictTone::Good,
        }
    }
}

impl fmt::Display for InnovationVerdict {
    /// In plain words, with a recommendation.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_size(f, self)?;
        if let Some(rho) = self.correlation.filter(|_| self.has_correlation()) {
            let (how, cause) = if rho > 0.0 {
                ("alike", "something slow is missing from the model")
            } else {
                ("opposed", "the filter follows each observation too far, or two sources disagree")
            };
            let bound = self.correlation_bound.unwrap_or(0.0);
            write!(
                f,
                "; successive innovations are {how} (correlation {rho:.2}, by chance up to {bound:.2}): {cause}"
            )?;
        }
        if let Some(share) = self.gated_share.filter(|_| self.has_many_gated()) {
            write!(f, "; the gate turned {:.0} % away: outliers, or a noise that is set too small", share * 100.0)?;
        }
        Ok(())
    }
}

fn write_size(f: &mut fmt::Formatter<'_>, verdict: &InnovationVerdict) -> fmt::Result {
    let word = verdict.finding.as_text();
    let (Some(mean), Some(band)) = (verdict.mean_nis_per_dof, verdict.band) else {
        return match verdict.degrees_of_freedom {
            0 => write!(f, "{word}: the filter told no innovation of it"),
            some => write!(f, "{word}: {some} degrees of freedom"),
        };
    };
    let factor = mean.sqrt();
    match verdict.finding {
        InnovationFinding::TooFew | InnovationFinding::Consistent => {
            write!(f, "{word}: NIS {mean:.2}, due {:.2} to {:.2}", band.low, band.high)
        }
        InnovationFinding::NearlyConsistent => write!(
            f,
            "{word}: NIS {mean:.2} where 1 is due; its noise is right within {:.0} %",
            ((factor - 1.0).abs() * 100.0).ceil()
        ),
        InnovationFinding::OverConfident => {
            write!(f, "{word}: NIS {mean:.2} where 1 is due; raise its noise {factor:.1} times")
        }
        InnovationFinding::UnderConfident => {
            write!(f, "{word}: NIS {mean:.2} where 1 is due; lower its noise to {factor:.2} of what it is")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{SensorId, Timestamp};

    fn record(innovation: f64, sigma: f64) -> FusionRecord {
        FusionRecord {
            innovation: [innovation, 0.0, 0.0],
            innovation_covariance: [[sigma * sigma, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            nis: (innovation / sigma).powi(2),
            degrees_of_freedom: 1,
            ..FusionRecord::new(SensorId::GYRO, "turn_rate", Timestamp::ZERO, FusionOutcome::Accepted)
        }
    }

    /// Standard normal numbers that follow each other with this correlation; the generator is Park and Miller's.
    fn sequence(count: usize, rho: f64) -> Vec<f64> {
        let mut state = 20_u64;
        let mut uniform = || {
            state = state * 48_271 % 2_147_483_647;
            state as f64 / 2_147_483_647.0
        };
        let mut last = 0.0;
        let draws = (0..count).map(|_| {
            let white: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
            last = rho * last + (1.0 - rho * rho).sqrt() * white;
            last
        });
        draws.collect()
    }

    fn verdict_on(values: &[f64], claimed: f64) -> InnovationVerdict {
        let mut test = InnovationTest::default();
        for value in values {
            test.add(&record(*value, claimed));
        }
        test.evaluate()
    }

    #[test]
    fn the_claimed_sigma_against_the_true_one_decides_the_finding() {
        for (samples, claimed, finding, tone, text) in [
            (2_000, 1.0, InnovationFinding::Consistent, VerdictTone::Good, "consistent: NIS "),
            (500, 0.5, InnovationFinding::OverConfident, VerdictTone::Bad, "raise its noise 2.0 times"),
            (500, 2.0, InnovationFinding::UnderConfident, VerdictTone::Bad, "lower its noise to 0.5"),
            (20_000, 0.95, InnovationFinding::NearlyConsistent, VerdictTone::Good, ""),
        ] {
            let verdict = verdict_on(&sequence(samples, 0.0), claimed);
            assert_eq!((verdict.finding, verdict.tone()), (finding, tone), "{claimed}: {verdict}");
            assert!(verdict.to_string().contains(text), "{claimed}: {verdict}");
        }
    }

    #[test]
    fn innovations_that_follow_each_other_are_told_and_their_mean_stands_on_fewer() {
        let verdict = verdict_on(&sequence(2_000, 0.8), 1.0);
        let rho = verdict.correlation.unwrap();
        assert!((rho - 0.8).abs() < 0.05, "{rho}");
        assert!(verdict.has_correlation() && verdict.tone() == VerdictTone::Bad);
        assert!(verdict.to_string().contains("are alike (correlation 0."));
        let width = |verdict: &InnovationVerdict| {
            let band = verdict.band.unwrap();
            band.high - band.low
        };
        let white = verdict_on(&sequence(2_000, 0.0), 1.0);
        // sqrt((1 + 0.64) / (1 - 0.64)) = 2.13.
        let ratio = width(&verdict) / width(&white);
        assert!((ratio - 2.13).abs() < 0.2, "{ratio}");
        let opposed = verdict_on(&sequence(2_000, -0.5), 1.0);
        assert!(opposed.to_string().contains("opposed"), "{opposed}");
    }

    #[test]
    fn few_say_nothing_and_a_busy_gate_is_told() {
        let verdict = verdict_on(&sequence(8, 0.0), 0.1);
        assert_eq!(verdict.to_string(), "too few to say: 8 degrees of freedom");
        assert_eq!(verdict.tone(), VerdictTone::Inconclusive);
        assert_eq!(
            InnovationTest::default().evaluate().to_string(),
            "too few to say: the filter told no innovation of it"
        );
        let mut test = InnovationTest::default();
        for (index, value) in sequence(400, 0.0).into_iter().enumerate() {
            let verdict = if index % 10 == 0 { FusionOutcome::Gated } else { FusionOutcome::Accepted };
            test.add(&FusionRecord { outcome: verdict, ..record(value, 1.0) });
        }
        let message = test.evaluate().to_string();
        assert!(message.contains("the gate turned 10 % away"), "{message}");
        assert_eq!(test.evaluate().tone(), VerdictTone::Bad);
    }

    #[test]
    fn what_is_not_finite_or_was_not_predicted_is_left_out() {
        let mut test = InnovationTest::default();
        test.add(&record(f64::NAN, 1.0));
        test.add(&record(1.0, 0.0));
        test.add(&FusionRecord { degrees_of_freedom: 0, ..record(1.0, 1.0) });
        assert_eq!(test.mean_nis_per_dof(), None);
        assert_eq!(test.correlation(), None);
    }
}
