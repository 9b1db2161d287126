//! What each source contributed: the outcomes of its observations, and whether its innovations are as large as claimed and white.
//!
//! Input is the filter's records in order; the gate's decision is not repeated. Only sums are kept, so that memory does not grow with
//! the recording. No truth is needed: this is the health of a real robot too.
//!
//! # Model
//! ```text
//! e_i   = nu_i / sqrt(S_ii)                        innovation of component i over its claimed deviation
//! rho   = sum e_i[k] e_i[k-1] / sum e_i[k]^2       correlation with the one before, over all components; 0 for white innovations
//! |rho| <= 1.96 / sqrt(n)                          in 95 of 100 cases, of n pairs of white ones
//! mean  = sum NIS / sum m                          1 for correct claims; m is a record's degrees of freedom
//! D     = sum m (1 - rho^2) / (1 + rho^2)          on how many independent degrees that mean stands
//! chi2(0.025, D) / D <= mean <= chi2(0.975, D) / D in 95 of 100 cases
//! ```
//! Squares of a Gaussian sequence whose correlation at lag k is rho^k are correlated by rho^2k, which widens the spread of their mean
//! by (1 + rho^2) / (1 - rho^2).
//!
//! # Assumptions
//! Innovations of one sensor are Gaussian except for those that the gate rejects, and their order is that of the records.
//!
//! # Sources
//! Bar-Shalom, Li, Kirubarajan (2001), section 5.4.2 (NIS, and the autocorrelation test for whiteness).

use std::collections::VecDeque;

use posebridge_telemetry::estimate::NORMAL_95;
use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId};

use super::consistency::{Consistency, ConsistencyBand};
use super::verdict::SourceVerdict;

/// Fewer independent degrees of freedom do not suffice for a verdict: their band reaches from half to 1.7.
const MIN_DEGREES: f64 = 20.0;
/// Upper limit of the correlation, so that the effective degrees of freedom stay positive.
const MAX_CORRELATION: f64 = 0.999;

/// Fusion outcomes of the observations of one sensor, and the sums of its innovations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceTally {
    pub sensor: SensorId,
    /// Slip included.
    pub used: u64,
    /// Used, but the wheels slipped.
    pub slip: u64,
    pub gated: u64,
    /// Older than the oldest state in the filter's history.
    pub too_old: u64,
    /// Not finite, negative where that is impossible, or of zero duration.
    pub malformed: u64,
    pub rebased: u64,
    /// Observations that reset the estimate.
    pub reset_to: u64,
    /// Of a kind that the filter does not use.
    pub unused: u64,
    innovations: InnovationSums,
}

impl SourceTally {
    /// Headings of [`SourceTally::counts`].
    pub const COUNT_HEADINGS: [&str; 8] =
        ["used", "slip", "gated", "too old", "malformed", "re-based", "reset to", "unused"];

    /// The first includes the observations to which the pose was reset.
    pub const fn counts(&self) -> [u64; 8] {
        let Self { used, slip, gated, too_old, malformed, rebased, reset_to, unused, .. } = *self;
        [used + reset_to, slip, gated, too_old, malformed, rebased, reset_to, unused]
    }

    pub fn new(sensor: SensorId) -> Self {
        Self {
            sensor,
            used: 0,
            slip: 0,
            gated: 0,
            too_old: 0,
            malformed: 0,
            rebased: 0,
            reset_to: 0,
            unused: 0,
            innovations: InnovationSums::default(),
        }
    }

    /// Counts one record. The caller selects the records of one sensor; [`tally_sources`] does it for many.
    pub fn add(&mut self, record: &FusionRecord) {
        match record.outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip => {
                self.used += 1;
                self.slip += u64::from(record.outcome == FusionOutcome::Slip);
                if let Some(innovation) = Innovation::of(record) {
                    self.innovations.add(innovation);
                }
            }
            FusionOutcome::Gated => self.gated += 1,
            FusionOutcome::TooOld => self.too_old += 1,
            FusionOutcome::Malformed => self.malformed += 1,
            FusionOutcome::Rebased => self.rebased += 1,
            FusionOutcome::PoseReset => self.reset_to += 1,
            FusionOutcome::Unused => self.unused += 1,
        }
    }

    /// Adds the tally of another run.
    pub fn merge(&mut self, other: &Self) {
        self.used += other.used;
        self.slip += other.slip;
        self.gated += other.gated;
        self.too_old += other.too_old;
        self.malformed += other.malformed;
        self.rebased += other.rebased;
        self.reset_to += other.reset_to;
        self.unused += other.unused;
        self.innovations.merge(&other.innovations);
    }

    /// Mean normalised innovation squared per degree of freedom of the used observations; `None` before the first prediction. Gated
    /// ones are excluded, so with a gate at 99.9 % a consistent sensor has 0.99 rather than 1.
    pub fn mean_nis_per_dof(&self) -> Option<f64> {
        self.innovations.mean()
    }

    pub const fn degrees_of_freedom(&self) -> u64 {
        self.innovations.degrees_of_freedom
    }

    /// Share of rejected observations among those that reached the gate; `None` if none did.
    pub fn gated_share(&self) -> Option<f64> {
        let gated_or_used = self.used + self.gated;
        (gated_or_used > 0).then(|| self.gated as f64 / gated_or_used as f64)
    }

    /// Whether the sensor's noise matches the filter's configuration.
    pub fn verdict(&self) -> SourceVerdict {
        SourceVerdict { gated_share: self.gated_share(), ..self.innovations.verdict() }
    }
}

/// One innovation in the unit of its own claims.
#[derive(Clone, Copy, Debug)]
struct Innovation {
    nis: f64,
    degrees_of_freedom: u64,
    /// Each component over its claimed standard deviation; `None` without component or deviation.
    normalised: [Option<f64>; 3],
}

impl Innovation {
    /// `None` if nothing was predicted, or the result is not finite.
    fn of(record: &FusionRecord) -> Option<Self> {
        let degrees_of_freedom = u64::from(record.degrees_of_freedom);
        let is_predicted = record.nis.is_finite() && degrees_of_freedom > 0;
        is_predicted.then(|| Self { nis: record.nis, degrees_of_freedom, normalised: normalised(record) })
    }
}

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

/// Sums over the innovations of one sensor in their order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct InnovationSums {
    nis: f64,
    degrees_of_freedom: u64,
    /// The components of the one before.
    last: Option<[Option<f64>; 3]>,
    pairs: u64,
    products: f64,
    squares: f64,
}

impl InnovationSums {
    fn add(&mut self, innovation: Innovation) {
        self.nis += innovation.nis;
        self.degrees_of_freedom += innovation.degrees_of_freedom;
        let now = innovation.normalised;
        for (component, value) in now.iter().enumerate() {
            let Some(value) = value else { continue };
            self.squares += value * value;
            let before = self.last.and_then(|last| *last.get(component)?);
            if let Some(before) = before {
                self.products += value * before;
                self.pairs += 1;
            }
        }
        self.last = Some(now);
    }

    /// Adds those of another run: no pair spans both.
    fn merge(&mut self, other: &Self) {
        self.nis += other.nis;
        self.degrees_of_freedom += other.degrees_of_freedom;
        self.pairs += other.pairs;
        self.products += other.products;
        self.squares += other.squares;
        self.last = None;
    }

    /// 1 if the claims are correct; `None` without innovations.
    fn mean(&self) -> Option<f64> {
        (self.degrees_of_freedom > 0).then(|| self.nis / self.degrees_of_freedom as f64)
    }

    /// Of successive innovations; `None` for fewer than two.
    fn correlation(&self) -> Option<f64> {
        let is_known = self.pairs > 0 && self.squares > 0.0;
        is_known.then(|| (self.products / self.squares).clamp(-1.0, 1.0))
    }

    /// Without the gate's share.
    fn verdict(&self) -> SourceVerdict {
        let correlation = self.correlation();
        let rho = correlation.unwrap_or(0.0).abs().min(MAX_CORRELATION);
        let spread = (1.0 + rho * rho) / (1.0 - rho * rho);
        let independent = self.degrees_of_freedom as f64 / spread;
        let mean = self.mean();
        let band = ConsistencyBand::of_mean(independent as u64).filter(|_| independent >= MIN_DEGREES);
        let finding = mean.zip(band).map_or(Consistency::TooLittleData, |(mean, band)| band.classify(mean));
        SourceVerdict {
            finding,
            mean_nis_per_dof: mean,
            degrees_of_freedom: self.degrees_of_freedom,
            band,
            correlation,
            correlation_bound: (self.pairs > 0).then(|| NORMAL_95 / (self.pairs as f64).sqrt()),
            gated_share: None,
        }
    }
}

/// The tally of a sensor; a new sensor is appended.
fn tally_of(tallies: &mut Vec<SourceTally>, sensor: SensorId) -> &mut SourceTally {
    let known = tallies.iter().position(|tally| tally.sensor == sensor);
    let index = known.unwrap_or_else(|| {
        tallies.push(SourceTally::new(sensor));
        tallies.len() - 1
    });
    &mut tallies[index]
}

/// Counts one record with its sensor; tallies are in the order of the sensors' first records.
pub fn add_to_tallies(tallies: &mut Vec<SourceTally>, record: &FusionRecord) {
    tally_of(tallies, record.sensor).add(record);
}

/// Adds a tally to that of its sensor.
pub fn merge_tally(tallies: &mut Vec<SourceTally>, tally: &SourceTally) {
    tally_of(tallies, tally.sensor).merge(tally);
}

/// The verdict on each sensor.
pub fn source_verdicts(tallies: &[SourceTally]) -> Vec<(SensorId, SourceVerdict)> {
    tallies.iter().map(|tally| (tally.sensor, tally.verdict())).collect()
}

/// One tally per sensor in the records, in the order of the sensor ids.
pub fn tally_sources<'a>(records: impl IntoIterator<Item = &'a FusionRecord>) -> Vec<SourceTally> {
    let mut tallies = Vec::new();
    for record in records {
        add_to_tallies(&mut tallies, record);
    }
    tallies.sort_unstable_by_key(|tally| tally.sensor);
    tallies
}

/// Ten seconds of a brick at 20 Hz.
const WINDOW_INNOVATIONS: usize = 200;

/// The latest innovations of one source. Over a whole run the verdict says what the source was like; over these, what it is like now.
#[derive(Clone, Debug, Default)]
pub struct RecentInnovations {
    latest: VecDeque<Innovation>,
}

impl RecentInnovations {
    /// Adds the innovation of a used observation; ignores a record of another outcome, and one without a finite prediction.
    pub fn push(&mut self, record: &FusionRecord) {
        let is_used = matches!(record.outcome, FusionOutcome::Accepted | FusionOutcome::Slip);
        let Some(innovation) = Innovation::of(record).filter(|_| is_used) else { return };
        if self.latest.len() >= WINDOW_INNOVATIONS {
            self.latest.pop_front();
        }
        self.latest.push_back(innovation);
    }

    pub fn verdict(&self) -> SourceVerdict {
        let mut sums = InnovationSums::default();
        self.latest.iter().for_each(|innovation| sums.add(*innovation));
        sums.verdict()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::VerdictTone;
    use posebridge_telemetry::Timestamp;

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

    fn verdict_on(values: &[f64], claimed: f64) -> SourceVerdict {
        let mut tally = SourceTally::new(SensorId::GYRO);
        for value in values {
            tally.add(&record(*value, claimed));
        }
        tally.verdict()
    }

    #[test]
    fn the_claimed_sigma_against_the_true_one_decides_the_finding() {
        for (samples, claimed, finding, tone, text) in [
            (2_000, 1.0, Consistency::Consistent, VerdictTone::Good, "consistent: NIS "),
            (500, 0.5, Consistency::OverConfident, VerdictTone::Bad, "raise its noise 2.0 times"),
            (500, 2.0, Consistency::UnderConfident, VerdictTone::Bad, "lower its noise to 0.5"),
            (20_000, 0.95, Consistency::Consistent, VerdictTone::Good, "its noise is right within"),
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
        let width = |verdict: &SourceVerdict| {
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
        assert_eq!(verdict.to_string(), "too little data: 8 degrees of freedom");
        assert_eq!(verdict.tone(), VerdictTone::Inconclusive);
        let mut test = SourceTally::new(SensorId::GYRO);
        assert_eq!(test.verdict().to_string(), "too little data: the filter predicts nothing of it");
        for (index, value) in sequence(400, 0.0).into_iter().enumerate() {
            let verdict = if index % 10 == 0 { FusionOutcome::Gated } else { FusionOutcome::Accepted };
            test.add(&FusionRecord { outcome: verdict, ..record(value, 1.0) });
        }
        let message = test.verdict().to_string();
        assert!(message.contains("the gate turned 10 % away"), "{message}");
        assert_eq!(test.verdict().tone(), VerdictTone::Bad);
    }

    #[test]
    fn what_is_not_finite_or_was_not_predicted_is_left_out() {
        let mut test = SourceTally::new(SensorId::GYRO);
        test.add(&record(f64::NAN, 1.0));
        test.add(&record(1.0, 0.0));
        test.add(&FusionRecord { degrees_of_freedom: 0, ..record(1.0, 1.0) });
        assert_eq!(test.mean_nis_per_dof(), None);
        assert_eq!(test.verdict().correlation, None);
    }

    #[test]
    fn only_the_latest_are_judged() {
        let mut recent = RecentInnovations::default();
        assert_eq!(recent.verdict().finding, Consistency::TooLittleData);
        let values = sequence(2 * WINDOW_INNOVATIONS, 0.0);
        let (before, after) = values.split_at(WINDOW_INNOVATIONS);
        for value in before {
            recent.push(&record(*value, 0.3));
        }
        assert_eq!(recent.verdict().finding, Consistency::OverConfident);
        for value in after {
            recent.push(&record(*value, 1.0));
        }
        recent.push(&FusionRecord { outcome: FusionOutcome::Gated, ..record(1e9, 1.0) });
        recent.push(&record(f64::NAN, 1.0));
        assert_eq!(recent.verdict().finding, Consistency::Consistent);
    }
}
