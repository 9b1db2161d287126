//! Consistency tests of a filter: do its errors match its claimed covariance?
//!
//! A mean of chi-square variables, over its degrees of freedom, lies in a known band around 1 if the claims are consistent. The band
//! assumes independent samples. Runs with different seeds are independent; the errors at successive instants of one run are not, so a
//! run counts once. Innovations of a consistent filter are white and count singly.
//!
//! Source: Bar-Shalom, Li, Kirubarajan (2001), section 5.4.2.

use std::collections::VecDeque;
use std::fmt;

use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::numerics::chi_square::chi_square_quantile;
use posebridge_estimator::numerics::cholesky::{factorise, solve_lower};
use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId};
use thiserror::Error;

/// Below the band, and above it: 95 % lie within.
const TAIL_PROBABILITY: f64 = 0.025;

const POSE_DEGREES_OF_FREEDOM: u64 = 3;

/// The 95 % interval of the mean normalised error of a consistent filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyBand {
    /// Below 1.
    pub low: f64,
    /// Above 1.
    pub high: f64,
}

impl ConsistencyBand {
    /// `degrees_of_freedom` in total; `None` for zero.
    pub fn of_mean(degrees_of_freedom: u64) -> Option<Self> {
        let per_degree = |probability| chi_square_quantile(degrees_of_freedom, probability) / degrees_of_freedom as f64;
        (degrees_of_freedom > 0)
            .then(|| Self { low: per_degree(TAIL_PROBABILITY), high: per_degree(1.0 - TAIL_PROBABILITY) })
    }

    /// For the ANEES of a planar pose over independent runs; `None` for zero runs.
    pub fn of_runs(runs: u64) -> Option<Self> {
        Self::of_mean(runs.checked_mul(POSE_DEGREES_OF_FREEDOM)?)
    }

    pub fn classify(self, mean: f64) -> Consistency {
        if mean.is_nan() {
            Consistency::Undetermined
        } else if mean > self.high {
            Consistency::OverConfident
        } else if mean < self.low {
            Consistency::UnderConfident
        } else {
            Consistency::Consistent
        }
    }
}

/// Whether a filter's errors match its claims.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Consistency {
    /// Errors are larger than claimed: the gate rejects good observations, and steering trusts the estimate too much.
    OverConfident,
    Consistent,
    /// Errors are smaller than claimed: the filter follows noisy observations more than necessary.
    UnderConfident,
    Undetermined,
}

impl Consistency {
    /// Tests an ANEES that was averaged over `runs` independent runs. A covariance that could not be tested counts as over-confident,
    /// because it is impossible.
    pub fn of_anees(anees: &Anees, runs: u64) -> Self {
        if anees.refused > 0 {
            return Self::OverConfident;
        }
        let value = anees.value.zip(ConsistencyBand::of_runs(runs));
        value.map_or(Self::Undetermined, |(value, band)| band.classify(value))
    }

    pub const fn as_text(self) -> &'static str {
        match self {
            Self::OverConfident => "over-confident",
            Self::Consistent => "consistent",
            Self::UnderConfident => "under-confident",
            Self::Undetermined => "undetermined",
        }
    }
}

impl fmt::Display for Consistency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_text())
    }
}

// Whether the claimed covariance fits the errors: the average normalised estimation error squared.
//
// ```text
// e = [dx_m, dy_m, heading_rad]ᵀ   error, 3 x 1      P   claimed covariance, 3 x 3
// P = L Lᵀ                         L lower triangular (Cholesky)
// NEES = eᵀ P⁻¹ e = |L⁻¹ e|²       chi-square with 3 degrees of freedom if the claim is honest
// ANEES = mean(NEES) / 3           1 if the claim is honest, above 1 if it boasts
// ```
// Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
// section 5.4. The verdict on the value is [`super::consistency`]'s; a partial pose (no heading) is not tested here.

/// Why a normalised error cannot be computed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NeesError {
    #[error("error or covariance is not finite; leave this sample out")]
    NotFinite,
    #[error(
        "covariance is not positive definite: pivot {pivot:e} in row {row}; the filter that claims it has broken down"
    )]
    NotPositiveDefinite {
        /// Row of the pivot: 0 x, 1 y, 2 heading.
        row: usize,
        /// Not positive.
        pivot: f64,
    },
}

/// The normalised error over many samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Anees {
    /// Mean of e' P^-1 e / 3; `None` if no sample could be tested.
    pub value: Option<f64>,
    pub samples: usize,
    /// Samples whose covariance is not positive definite or not finite.
    pub refused: usize,
}

/// e' P^-1 e of one sample; rows are x in m, y in m, heading in rad. Only the lower triangle of P is read.
pub fn nees(error: [f64; 3], covariance: &[[f64; 3]; 3]) -> Result<f64, NeesError> {
    let covariance = Matrix3::from_fn(|row, column| covariance[row][column]);
    if !covariance.iter().chain(&error).all(|value| value.is_finite()) {
        return Err(NeesError::NotFinite);
    }
    let factor = factorise(&covariance, |row, pivot| {
        let root = (pivot > 0.0).then(|| pivot.sqrt());
        root.ok_or(NeesError::NotPositiveDefinite { row, pivot })
    })?;
    let value = solve_lower(&factor, &Vector3::from(error)).norm_squared();
    if value.is_finite() { Ok(value) } else { Err(NeesError::NotFinite) }
}

// What each sensor contributed: how often it was used, and whether its innovations fit the claims.
//
// Works without truth, so it is the health of a real robot too. It reads the filter's records; it does not repeat the
// gate's decision.

/// Fusion outcomes of the observations of one sensor.
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
    nis: NisMean,
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

    pub const fn new(sensor: SensorId) -> Self {
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
            nis: NisMean { sum: 0.0, degrees_of_freedom: 0 },
        }
    }

    /// Counts one record. The caller selects the records of one sensor; [`tally_sources`] does it for many.
    pub fn add(&mut self, record: &FusionRecord) {
        match record.outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip => {
                self.used += 1;
                self.slip += u64::from(record.outcome == FusionOutcome::Slip);
                if record.nis.is_finite() {
                    self.nis.add(record.nis, record.degrees_of_freedom.into());
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

    pub fn merge(&mut self, other: &Self) {
        self.used += other.used;
        self.slip += other.slip;
        self.gated += other.gated;
        self.too_old += other.too_old;
        self.malformed += other.malformed;
        self.rebased += other.rebased;
        self.reset_to += other.reset_to;
        self.unused += other.unused;
        self.nis.add(other.nis.sum, other.nis.degrees_of_freedom);
    }

    /// Mean normalised innovation squared per degree of freedom of the used observations; `None` before the first prediction. Gated
    /// ones are excluded, so with a gate at 99.9 % a consistent sensor has 0.99 rather than 1.
    pub fn mean_nis_per_dof(&self) -> Option<f64> {
        self.nis.mean_per_degree()
    }

    pub const fn degrees_of_freedom(&self) -> u64 {
        self.nis.degrees_of_freedom
    }

    /// Share of rejected observations among those that reached the gate; `None` if none did.
    pub fn gated_share(&self) -> Option<f64> {
        let gated_or_used = self.used + self.gated;
        (gated_or_used > 0).then(|| self.gated as f64 / gated_or_used as f64)
    }

    /// Whether the sensor's noise matches the filter's configuration.
    pub fn consistency(&self) -> Consistency {
        self.nis.consistency()
    }
}

/// Mean of normalised innovations squared over their degrees of freedom.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct NisMean {
    pub(super) sum: f64,
    pub(super) degrees_of_freedom: u64,
}

impl NisMean {
    pub(super) const fn add(&mut self, nis: f64, degrees_of_freedom: u64) {
        self.sum += nis;
        self.degrees_of_freedom += degrees_of_freedom;
    }

    /// 1 if the claims are consistent; `None` without samples.
    pub(super) fn mean_per_degree(self) -> Option<f64> {
        (self.degrees_of_freedom > 0).then(|| self.sum / self.degrees_of_freedom as f64)
    }

    fn consistency(self) -> Consistency {
        let band = ConsistencyBand::of_mean(self.degrees_of_freedom);
        let mean = self.mean_per_degree().zip(band);
        mean.map_or(Consistency::Undetermined, |(mean, band)| band.classify(mean))
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

/// One tally per sensor in the records, in the order of the sensor ids.
pub fn tally_sources<'a>(records: impl IntoIterator<Item = &'a FusionRecord>) -> Vec<SourceTally> {
    let mut tallies = Vec::new();
    for record in records {
        add_to_tallies(&mut tallies, record);
    }
    tallies.sort_unstable_by_key(|tally| tally.sensor);
    tallies
}

// Whether the latest innovations of one source fit the claims: for live views.
//
// A mean over the whole run says what it was like; over the last observations, what it is like. The verdict is that of
// [`ConsistencyBand::of_mean`].

/// Ten seconds of a brick at 20 Hz; the dashboard page uses the same number.
const WINDOW_SAMPLES: usize = 200;

/// The latest normalised innovations squared of one source.
#[derive(Clone, Debug, Default)]
pub struct RecentNis {
    /// NIS and degrees of freedom.
    latest: VecDeque<(f64, u64)>,
}

impl RecentNis {
    /// Adds the NIS of a used observation; ignores one that is not finite or has no degrees of freedom.
    pub fn push(&mut self, nis: f64, degrees_of_freedom: u64) {
        if !nis.is_finite() || degrees_of_freedom == 0 {
            return;
        }
        if self.latest.len() >= WINDOW_SAMPLES {
            self.latest.pop_front();
        }
        self.latest.push_back((nis, degrees_of_freedom));
    }

    /// 1 if the claims are consistent; `None` without samples.
    pub fn mean_per_degree(&self) -> Option<f64> {
        self.mean().mean_per_degree()
    }

    pub fn consistency(&self) -> Consistency {
        self.mean().consistency()
    }

    fn mean(&self) -> NisMean {
        let mut mean = NisMean::default();
        self.latest.iter().for_each(|(nis, degrees)| mean.add(*nis, *degrees));
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bands_are_the_published_ones() {
        for (runs, low, high) in [(1, 0.07, 3.12), (20, 0.67, 1.39), (50, 0.79, 1.24), (100, 0.85, 1.17)] {
            let band = ConsistencyBand::of_runs(runs).unwrap();
            assert!((band.low - low).abs() < 0.006 && (band.high - high).abs() < 0.006, "{runs}: {band:?}");
        }
    }

    #[test]
    fn a_mean_above_the_band_is_over_confident() {
        let band = ConsistencyBand::of_runs(20).unwrap();
        assert_eq!(band.classify(1.5), Consistency::OverConfident);
        assert_eq!(band.classify(1.0), Consistency::Consistent);
        assert_eq!(band.classify(0.01), Consistency::UnderConfident);
        assert_eq!(band.classify(f64::NAN), Consistency::Undetermined);
        assert_eq!(ConsistencyBand::of_mean(0), None);
    }

    #[test]
    fn a_broken_covariance_is_never_called_consistent() {
        let anees = Anees { value: Some(1.0), samples: 20, refused: 1 };
        assert_eq!(Consistency::of_anees(&anees, 20), Consistency::OverConfident);
    }

    #[test]
    fn a_covariance_that_is_not_positive_definite_names_its_row() {
        let flat = [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(nees([0.0; 3], &flat), Err(NeesError::NotPositiveDefinite { row: 1, pivot: 0.0 }));
        assert_eq!(nees([0.0; 3], &[[f64::NAN; 3]; 3]), Err(NeesError::NotFinite));
    }

    #[test]
    fn only_the_latest_are_judged() {
        let mut recent = RecentNis::default();
        assert_eq!(recent.consistency(), Consistency::Undetermined);
        assert_eq!(recent.mean_per_degree(), None);
        for _ in 0..WINDOW_SAMPLES {
            recent.push(30.0, 3);
        }
        assert_eq!(recent.mean_per_degree(), Some(10.0));
        assert_eq!(recent.consistency(), Consistency::OverConfident);
        for _ in 0..WINDOW_SAMPLES {
            recent.push(3.0, 3);
        }
        assert_eq!(recent.mean_per_degree(), Some(1.0));
        assert_eq!(recent.consistency(), Consistency::Consistent);
    }

    #[test]
    fn what_is_not_finite_says_nothing() {
        let mut recent = RecentNis::default();
        recent.push(f64::NAN, 1);
        recent.push(f64::INFINITY, 1);
        recent.push(1.0, 0);
        assert_eq!(recent.consistency(), Consistency::Undetermined);
    }
}
