//! Likelihood of a run under a filter: equations (1), (2) and (5) of the parent module.

use posebridge_estimator::{Filter, Params};
use posebridge_telemetry::{
    Arena, BrickClock, Fix, FusionRecord, Meters, Observation, ObservationKind, Point2, SensorId, TimeDelta, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::folds::TimeBlocks;
use crate::statistics::normal_pair;

/// Share of outliers: the mismatches of a good camera (about 1 % in the sets of docs/recordings.md).
const OUTLIER_SHARE: f64 = 0.01;
/// Ratio of an outlier's sigma: Huber's contamination with a spread that a gate at 99.9 % rejects.
const OUTLIER_SIGMA_FACTOR: f64 = 10.0;

/// Disables online adaptation of the noise, so that the configured values themselves are scored.
///
/// ```text
/// adapt_gain   0          adaptive noise would hide the configured one
/// slip_nis     infinite   a slip widens S by its own innovation: zero noise would explain everything
/// gate_prob    0.999999   a rejected observation does not update the state; the density (2) handles gross outliers
/// ```
pub const fn offline_params(params: Params) -> Params {
    Params { adapt_gain: 0.0, slip_nis: f64::INFINITY, gate_probability: 0.999_999, ..params }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceFit {
    pub sensor: SensorId,
    /// Each with one to three components.
    pub count: u64,
    pub components: u64,
    /// Sum of ln p.
    pub log_likelihood: f64,
    nis: f64,
    squares: f64,
    products: f64,
    last: [Option<f64>; 3],
}

impl SourceFit {
    const fn new(sensor: SensorId) -> Self {
        Self {
            sensor,
            count: 0,
            components: 0,
            log_likelihood: 0.0,
            nis: 0.0,
            squares: 0.0,
            products: 0.0,
            last: [None; 3],
        }
    }

    fn add(&mut self, record: &FusionRecord, ln_p: f64) {
        self.count += 1;
        self.components += u64::from(record.degrees_of_freedom);
        self.log_likelihood += ln_p;
        self.nis += record.nis;
        for (i, last) in self.last.iter_mut().enumerate() {
            let variance = record.innovation_covariance[i][i];
            let is_used = i < usize::from(record.degrees_of_freedom) && variance > 0.0;
            let whitened = is_used.then(|| record.innovation[i] / variance.sqrt());
            if let (Some(before), Some(now)) = (*last, whitened) {
                self.products += before * now;
            }
            if let Some(now) = whitened {
                self.squares += now * now;
                *last = whitened;
            }
        }
    }

    /// Mean normalised innovation squared per component, rejected ones included; 1 is consistent.
    pub fn nis(&self) -> Option<f64> {
        (self.components > 0).then(|| self.nis / self.components as f64)
    }

    /// Correlation of successive whitened innovations; 0 for an optimal filter.
    pub fn rho_1(&self) -> Option<f64> {
        (self.squares > 0.0).then(|| self.products / self.squares)
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.components += other.components;
        self.log_likelihood += other.log_likelihood;
        self.nis += other.nis;
        self.squares += other.squares;
        self.products += other.products;
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunFit {
    /// By sensor, in the order of their first observations.
    pub sources: Vec<SourceFit>,
}

impl RunFit {
    pub fn log_likelihood(&self) -> f64 {
        self.sources.iter().map(|fit| fit.log_likelihood).sum()
    }

    pub fn components(&self) -> u64 {
        self.sources.iter().map(|fit| fit.components).sum()
    }

    pub fn merge(&mut self, other: &Self) {
        for theirs in &other.sources {
            match self.source_mut(theirs.sensor) {
                Some(own) => own.merge(theirs),
                None => self.sources.push(SourceFit { last: [None; 3], ..*theirs }),
            }
        }
    }

    /// Adds a fusion record; ignores observations without a prediction.
    pub fn add(&mut self, record: &FusionRecord) {
        let Some(ln_p) = ln_density(record) else {
            return;
        };
        if let Some(fit) = self.source_mut(record.sensor) {
            fit.add(record, ln_p);
        } else {
            let mut fit = SourceFit::new(record.sensor);
            fit.add(record, ln_p);
            self.sources.push(fit);
        }
    }

    fn source_mut(&mut self, sensor: SensorId) -> Option<&mut SourceFit> {
        self.sources.iter_mut().find(|fit| fit.sensor == sensor)
    }
}

/// Runs a filter over a whole run, in the order of arrival, and scores each time block separately: one entry per block.
pub fn fit_in_blocks(observations: &[Observation], filter: &mut dyn Filter, blocks: &TimeBlocks) -> Vec<RunFit> {
    let mut fits = vec![RunFit::default(); blocks.count()];
    for observation in observations {
        let record = filter.observe(observation);
        if let Some(fit) = fits.get_mut(blocks.index(record.stamp)) {
            fit.add(&record);
        }
    }
    fits
}

/// `observations` are in the order of arrival.
pub fn fit_run(observations: &[Observation], filter: &mut dyn Filter) -> RunFit {
    let mut fit = RunFit::default();
    for observation in observations {
        fit.add(&filter.observe(observation));
    }
    fit
}

/// Prior standard deviation of the logarithm of a start value: ln 3, a factor of three either way.
pub const PRIOR_SIGMA: f64 = 1.098_612_288_668_109_8;

/// The second term of equation (3).
pub fn ln_prior(log_scales: &[f64]) -> f64 {
    let squares: f64 = log_scales.iter().map(|x| (x / PRIOR_SIGMA).powi(2)).sum();
    -0.5 * squares
}

/// ln of equation (2); the record's own log-likelihood contains the determinant of S.
fn ln_density(record: &FusionRecord) -> Option<f64> {
    let d = f64::from(record.degrees_of_freedom);
    let is_scored = d > 0.0 && record.nis.is_finite() && record.log_likelihood.is_finite();
    if !is_scored {
        return None;
    }
    let at_centre = record.log_likelihood + 0.5 * record.nis;
    let good = (1.0 - OUTLIER_SHARE).ln() - 0.5 * record.nis;
    let spread2 = OUTLIER_SIGMA_FACTOR * OUTLIER_SIGMA_FACTOR;
    let outlier = OUTLIER_SHARE.ln() - d * OUTLIER_SIGMA_FACTOR.ln() - 0.5 * record.nis / spread2;
    let more = good.max(outlier);
    let less = good.min(outlier);
    Some(at_centre + more + (less - more).exp().ln_1p())
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SyntheticFixes {
    pub every: TimeDelta,
    /// White noise of x and of y, one standard deviation.
    pub sigma_m: f64,
    pub seed: u64,
}

/// Position fixes sampled from the truth, with seeded normal noise, as a camera would measure them.
pub fn fixes_from_truth(
    truth: &[(Timestamp<BrickClock>, Point2<Arena>)],
    glimpses: &SyntheticFixes,
) -> Vec<Observation> {
    let mut rng = Pcg64::seed_from_u64(glimpses.seed);
    let mut due: Option<Timestamp<BrickClock>> = None;
    let mut fixes = Vec::new();
    for (stamp, position) in truth {
        if due.is_some_and(|due| *stamp < due) {
            continue;
        }
        due = Some(*stamp + glimpses.every);
        let [dx, dy] = normal_pair(rng.random(), rng.random());
        let position =
            Point2::new(Meters(position.x.0 + glimpses.sigma_m * dx), Meters(position.y.0 + glimpses.sigma_m * dy));
        fixes.push(Observation {
            sensor: SensorId::CAMERA,
            stamp: *stamp,
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Fix(Fix {
                position,
                heading: None,
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            }),
        });
    }
    fixes
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::FusionOutcome;

    use super::*;

    fn record(innovation: f64, s: f64) -> FusionRecord {
        let nis = innovation * innovation / s;
        FusionRecord {
            innovation: [innovation, 0.0, 0.0],
            innovation_covariance: [[s, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            nis,
            degrees_of_freedom: 1,
            log_likelihood: -0.5 * (nis + (std::f64::consts::TAU * s).ln()),
            ..FusionRecord::new(SensorId::GYRO, "turn_rate", Timestamp::ZERO, FusionOutcome::Accepted)
        }
    }

    #[test]
    fn the_density_integrates_to_one() {
        let (s, step) = (0.3, 0.01);
        let total: f64 =
            (-10_000..=10_000).map(|i| ln_density(&record(f64::from(i) * step, s)).unwrap().exp() * step).sum();
        assert!((total - 1.0).abs() < 1e-6, "{total}");
    }

    #[test]
    fn a_gross_outlier_costs_no_more_than_its_share_allows() {
        let (near, far) = (record(0.0, 1.0), record(20.0, 1.0));
        let lost = ln_density(&near).unwrap() - ln_density(&far).unwrap();
        // ln(1/0.01) + ln 10 + 20^2 / 200
        assert!((lost - (100.0_f64.ln() + 10.0_f64.ln() + 2.0)).abs() < 0.02, "{lost}");
    }

    #[test]
    fn alternating_innovations_are_not_white_and_nis_is_a_mean() {
        let mut fit = RunFit::default();
        for i in 0..100 {
            fit.add(&record(if i % 2 == 0 { 2.0 } else { -2.0 }, 1.0));
        }
        let gyro = fit.sources[0];
        assert!((gyro.rho_1().unwrap() + 0.99).abs() < 1e-12);
        assert_eq!(gyro.nis(), Some(4.0));
    }

    #[test]
    fn what_was_not_predicted_or_is_not_finite_says_nothing() {
        let mut fit = RunFit::default();
        fit.add(&FusionRecord { degrees_of_freedom: 0, ..record(0.0, 1.0) });
        fit.add(&record(f64::NAN, 1.0));
        fit.add(&record(f64::INFINITY, 1.0));
        assert_eq!(fit, RunFit::default());
    }

    #[test]
    fn two_runs_add_up_and_are_not_joined_at_the_seam() {
        let mut one = RunFit::default();
        one.add(&record(1.0, 1.0));
        let mut both = one.clone();
        both.merge(&one);
        assert_eq!(both.components(), 2);
        assert_eq!(both.log_likelihood(), 2.0 * one.log_likelihood());
        assert_eq!(both.sources[0].rho_1(), Some(0.0));
    }

    #[test]
    fn the_fixes_have_the_noise_and_the_rate_that_were_asked_for() {
        let truth: Vec<_> =
            (0..20_000).map(|i| (Timestamp::from_millis(50 * i), Point2::new(Meters(1.0), Meters(-2.0)))).collect();
        let glimpses = SyntheticFixes { every: TimeDelta::from_millis(1_000), sigma_m: 0.02, seed: 3 };
        let fixes = fixes_from_truth(&truth, &glimpses);
        assert_eq!(fixes.len(), 1_000);
        let squares: f64 = fixes
            .iter()
            .map(|fix| {
                let ObservationKind::Fix(fix) = fix.measurement else {
                    return f64::NAN;
                };
                (fix.position.x.0 - 1.0).powi(2) + (fix.position.y.0 + 2.0).powi(2)
            })
            .sum();
        let sigma_m = (squares / 2_000.0).sqrt();
        // Standard deviation of it: 0.02 / sqrt(2 * 2000) = 0.0003.
        assert!((sigma_m - 0.02).abs() < 0.001, "{sigma_m}");
        assert_eq!(fixes, fixes_from_truth(&truth, &glimpses));
        assert_ne!(fixes, fixes_from_truth(&truth, &SyntheticFixes { seed: 4, ..glimpses }));
    }
}
