//! A drive through the pose filter, held against the truth at each step.

use nalgebra::{DMatrix, Matrix3, Vector3};
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{Estimate, FusionOutcome, FusionRecord, quantities::wrap_rad};

use super::filters::named;
use super::simulation::{Drive, stamp};

/// What the filter made of a drive.
pub(crate) struct FilterRun {
    /// Its estimate after each step, as soon as the observations of that step had arrived.
    pub(crate) estimates: Vec<Option<Estimate>>,
    /// One record for each observation, in the order of arrival.
    pub(crate) records: Vec<FusionRecord>,
}

/// Root-mean-square errors and consistency over a drive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Score {
    pub(crate) position_rms_m: f64,
    pub(crate) heading_rms_rad: f64,
    /// Average normalised estimation error squared of the pose, divided by its three degrees of freedom.
    pub(crate) anees: f64,
    /// The same of the innovations of the fixes that were used; not a number when there were none.
    pub(crate) fix_nis_per_dof: f64,
}

/// Gives a drive to the pose filter as it arrives.
pub(crate) fn play(drive: &Drive, config: &FilterConfig) -> FilterRun {
    play_with("pose", drive, config)
}

/// Gives a drive to a filter of the table as it arrives.
pub(crate) fn play_with(name: &str, drive: &Drive, config: &FilterConfig) -> FilterRun {
    let mut filter = named(name, config);
    let mut played = FilterRun { estimates: vec![], records: vec![] };
    let mut arrivals = drive.arrivals.iter().peekable();
    for step in 1..=drive.poses.len() {
        while let Some(next) = arrivals.next_if(|next| next.step <= step) {
            played.records.push(filter.observe(&next.observation));
        }
        played.estimates.push(filter.estimate_at(stamp(step)));
    }
    played
}

/// Errors of an estimate: x, y in m and heading in rad.
pub(crate) fn error_of(estimate: &Estimate, (x, y, heading): (f64, f64, f64)) -> [f64; 3] {
    [estimate.pose.x.0 - x, estimate.pose.y.0 - y, wrap_rad(estimate.pose.heading.rad() - heading)]
}

/// Normalised error squared of a pose over its three degrees of freedom.
pub(crate) fn nees_per_dof(error: [f64; 3], covariance: impl FnMut(usize, usize) -> f64) -> f64 {
    let error = Vector3::from(error);
    let inverse = Matrix3::from_fn(covariance).try_inverse().expect("positive definite");
    (error.transpose() * inverse * error)[0] / 3.0
}

/// Scores the steps from `first` on, at which there must be an estimate.
pub(crate) fn score(drive: &Drive, played: &FilterRun, first: usize) -> Score {
    let (mut squares, mut heading_squares, mut nees, mut count) = (0.0, 0.0, 0.0, 0.0);
    let pairs = played.estimates.iter().zip(&drive.poses);
    for (estimate, truth) in pairs.skip(first) {
        let estimate = estimate.expect("something was observed");
        let error = error_of(&estimate, *truth);
        squares += error[0] * error[0] + error[1] * error[1];
        heading_squares += error[2] * error[2];
        nees += nees_per_dof(error, |row, column| estimate.covariance[row][column]);
        count += 1.0;
    }
    Score {
        position_rms_m: f64::sqrt(squares / count),
        heading_rms_rad: f64::sqrt(heading_squares / count),
        anees: nees / count,
        fix_nis_per_dof: nis_per_dof(played, "fix"),
    }
}

/// Normalised innovations squared of a kind that were used, over their degrees of freedom.
pub(crate) fn nis_per_dof(played: &FilterRun, kind: &str) -> f64 {
    let used = played.records.iter().filter(|record| record.kind == kind && record.outcome == FusionOutcome::Accepted);
    let (nis, degrees) = used
        .fold((0.0, 0.0), |(nis, degrees), record| (nis + record.nis, degrees + f64::from(record.degrees_of_freedom)));
    nis / degrees
}

/// The mean of several scores; of the root-mean-squares the root mean square.
pub(crate) fn mean(scores: &[Score]) -> Score {
    let mean = |pick: fn(&Score) -> f64| scores.iter().map(pick).sum::<f64>() / scores.len() as f64;
    Score {
        position_rms_m: mean(|score| score.position_rms_m.powi(2)).sqrt(),
        heading_rms_rad: mean(|score| score.heading_rms_rad.powi(2)).sqrt(),
        anees: mean(|score| score.anees),
        fix_nis_per_dof: mean(|score| score.fix_nis_per_dof),
    }
}

/// The mean score over seeds, each with its drive and configuration, from a step on.
pub(crate) fn mean_score(runs: u64, first: usize, make: impl Fn(u64) -> (Drive, FilterConfig)) -> Score {
    let scores: Vec<Score> = (0..runs)
        .map(|seed| {
            let (drive, config) = make(seed);
            score(&drive, &play(&drive, &config), first)
        })
        .collect();
    mean(&scores)
}

/// Finite and symmetric, and every eigenvalue of the correlations is positive, but for rounding; certain rows are left out.
pub(crate) fn assert_positive(what: &str, p: &DMatrix<f64>, rounding: f64) {
    assert!(p.iter().all(|value| value.is_finite()), "{what}: {p}");
    assert_eq!(*p, p.transpose(), "{what}");
    assert!(p.diagonal().min() >= 0.0, "{what}: {p}");
    let uncertain: Vec<usize> = (0..p.nrows()).filter(|&i| p[(i, i)] > 0.0).collect();
    let sigmas: Vec<f64> = uncertain.iter().map(|&i| p[(i, i)].sqrt()).collect();
    let correlations = DMatrix::from_fn(uncertain.len(), uncertain.len(), |i, j| {
        p[(uncertain[i], uncertain[j])] / (sigmas[i] * sigmas[j])
    });
    if !uncertain.is_empty() {
        let lowest = correlations.symmetric_eigenvalues().min();
        assert!(lowest > -rounding, "{what}: eigenvalue {lowest:e} of {p}");
    }
}

/// A pose filter that was given a complete drive.
pub(crate) fn played<const N: usize>(drive: &Drive, config: &FilterConfig) -> PoseFilter<N> {
    let mut filter = PoseFilter::new(config);
    for arrival in &drive.arrivals {
        filter.observe(&arrival.observation);
    }
    filter
}
