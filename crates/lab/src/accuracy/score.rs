//! Sums of squared errors that add up over steps and runs.

use posebridge_telemetry::{Arena, Estimate, FusionRecord, Pose, quantities::wrap_rad};

use posebridge_report::metrics::anees::nees;
use posebridge_report::metrics::{Anees, Consistency, ConsistencyBand, PoseError, SourceTally, add_to_tallies};

/// Degrees of freedom of a pose error: x, y, heading.
const POSE_DEGREES_OF_FREEDOM: f64 = 3.0;

/// What the errors of one estimator add up to, over one run or many.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FilterScore {
    run_rms_m: Vec<f64>,
    run: ErrorSums,
    all: ErrorSums,
    runs: u64,
    position_max_m: Option<f64>,
    without_estimate: u64,
    not_finite: u64,
    refused_covariances: u64,
    sources: Vec<SourceTally>,
}

/// Sums over steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ErrorSums {
    position_m: RunningSum,
    position_m2: RunningSum,
    heading_rad2: RunningSum,
    nees: RunningSum,
    claim_m2: RunningSum,
}

/// A sum and how many values are in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct RunningSum {
    sum: f64,
    count: u64,
}

impl RunningSum {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn merge(&mut self, other: &Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

impl ErrorSums {
    fn merge(&mut self, other: &Self) {
        self.position_m.merge(&other.position_m);
        self.position_m2.merge(&other.position_m2);
        self.heading_rad2.merge(&other.heading_rad2);
        self.nees.merge(&other.nees);
        self.claim_m2.merge(&other.claim_m2);
    }
}

impl FilterScore {
    /// Counts the estimate of one step against the truth. `None`, or one without a valid position, counts as a step without an
    /// estimate; one that is not finite, as that.
    pub fn add_step(&mut self, truth: Pose<Arena>, estimate: Option<&Estimate>) {
        let Some(estimate) = estimate.filter(|estimate| estimate.validity.position) else {
            self.without_estimate += 1;
            return;
        };
        let error = PoseError::of_estimate(estimate, truth);
        let position_m = error.position_m();
        let squared_m2 = position_m * position_m;
        if !(error.is_finite() && squared_m2.is_finite()) {
            self.not_finite += 1;
            return;
        }
        self.run.position_m.add(position_m);
        self.run.position_m2.add(squared_m2);
        self.position_max_m = larger(self.position_max_m, Some(position_m));
        if let Some(heading_rad) = error.heading_rad.map(wrap_rad) {
            self.run.heading_rad2.add(heading_rad * heading_rad);
            self.add_claimed_error(&error, heading_rad);
        }
    }

    fn add_claimed_error(&mut self, error: &PoseError, heading_rad: f64) {
        let Some(covariance) = &error.covariance else {
            return;
        };
        match nees([error.dx_m, error.dy_m, heading_rad], covariance) {
            Ok(value) => {
                self.run.nees.add(value);
                let claim_m2 = covariance[0][0] + covariance[1][1];
                self.run.claim_m2.add(claim_m2);
            }
            Err(_) => self.refused_covariances += 1,
        }
    }

    /// Counts what became of one observation.
    pub fn add_record(&mut self, record: &FusionRecord) {
        add_to_tallies(&mut self.sources, record);
    }

    /// Counts what became of many observations of one sensor.
    pub fn add_tally(&mut self, tally: &SourceTally) {
        match self.sources.iter_mut().find(|known| known.sensor == tally.sensor) {
            Some(known) => known.merge(tally),
            None => self.sources.push(*tally),
        }
    }

    /// Closes a run: what was added since the last one is one independent sample of the consistency test.
    pub fn end_run(&mut self) {
        self.runs += 1;
        self.run_rms_m.extend(self.run.position_m2.mean().map(f64::sqrt));
        self.all.merge(&self.run);
        self.run = ErrorSums::default();
    }

    /// Adds other closed runs. The result depends on the order in the last digits: add them in the order of the runs.
    pub fn merge(&mut self, other: &Self) {
        self.run_rms_m.extend_from_slice(&other.run_rms_m);
        self.all.merge(&other.all);
        self.runs += other.runs;
        self.position_max_m = larger(self.position_max_m, other.position_max_m);
        self.without_estimate += other.without_estimate;
        self.not_finite += other.not_finite;
        self.refused_covariances += other.refused_covariances;
        for theirs in &other.sources {
            self.add_tally(theirs);
        }
    }

    /// Closed runs.
    pub const fn runs(&self) -> u64 {
        self.runs
    }

    /// Steps with an estimate that was scored.
    pub const fn steps(&self) -> u64 {
        self.all.position_m2.count
    }

    /// Steps at which there was no estimate yet.
    pub const fn steps_without_estimate(&self) -> u64 {
        self.without_estimate
    }

    /// Steps whose estimate was not finite, or too far off for its square to be.
    pub const fn steps_not_finite(&self) -> u64 {
        self.not_finite
    }

    /// Steps whose covariance was not positive definite.
    pub const fn refused_covariances(&self) -> u64 {
        self.refused_covariances
    }

    /// Root mean square position error over all steps and runs, in metres; `None` without a step.
    pub fn position_rms_m(&self) -> Option<f64> {
        self.all.position_m2.mean().map(f64::sqrt)
    }

    /// Mean position error over all steps and runs, in metres.
    pub fn position_mean_m(&self) -> Option<f64> {
        self.all.position_m.mean()
    }

    /// Largest position error over all steps and runs, in metres.
    pub const fn position_max_m(&self) -> Option<f64> {
        self.position_max_m
    }

    /// Root mean square heading error over all steps and runs, in radians.
    pub fn heading_rms_rad(&self) -> Option<f64> {
        self.all.heading_rad2.mean().map(f64::sqrt)
    }

    /// What the estimator claims that its root mean square position error is, in metres.
    pub fn claimed_rms_m(&self) -> Option<f64> {
        self.all.claim_m2.mean().map(f64::sqrt)
    }

    /// Average normalised estimation error squared over its 3 degrees of freedom; 1 is honest, above 1 over-confident.
    pub fn anees(&self) -> Option<f64> {
        self.all.nees.mean().map(|mean| mean / POSE_DEGREES_OF_FREEDOM)
    }

    /// The 95 % interval of a consistent estimator's ANEES over this number of runs, were each run one sample. The mean
    /// over a run varies less than that: outside the band is wrong, inside is not yet right.
    pub fn band(&self) -> Option<ConsistencyBand> {
        ConsistencyBand::of_runs(self.runs)
    }

    /// The verdict on the claims.
    pub fn consistency(&self) -> Consistency {
        let outcome = Anees {
            value: self.anees(),
            samples: self.all.nees.count as usize,
            refused: self.refused_covariances as usize,
        };
        Consistency::of_anees(&outcome, self.runs)
    }

    /// Root mean square position error of each run that has one, in metres, in the order in which they were added.
    pub fn run_rms_m(&self) -> &[f64] {
        &self.run_rms_m
    }

    /// What became of the observations of each sensor, over all runs, in the order of first arrival.
    pub fn sources(&self) -> &[SourceTally] {
        &self.sources
    }
}

fn larger(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.max(other)),
        (one, other) => one.or(other),
    }
}
