//! A seeded run for pictures and tests: a robot drives a square twice; odometry drifts with a wrong track width; the
//! estimate is drawn from the covariance that it claims, which grows without fixes and shrinks with them.
//!
//! It is made to be looked at and measured, not to be realistic: the simulator does that.

use posebridge_report::{FixMark, PoseTrack, RunLayers, TimedPose};
use posebridge_telemetry::{
    Arena, Estimate, FusionOutcome, Heading, Meters, Point2, Pose, Radians, TimeDelta, Timestamp,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64Mcg;

const SIDE_M: f64 = 2.0;
const STEP_MILLIS: i64 = 50;
const SPEED_M_PER_STEP: f64 = 0.012;
const TURN_STEPS: i64 = 24;
const QUARTER_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Odometry turns by this much too far: a track width that is 2.5 % wrong.
const ODOMETRY_TURN_FACTOR: f64 = 1.025;
const FIX_SIGMA_M: f64 = 0.01;
/// The camera sees nothing between these steps.
const BLACKOUT: std::ops::Range<usize> = 900..1_150;

/// Everything that one run left behind, owned.
pub(crate) struct SampleRun {
    pub(crate) ideal: Vec<Point2<Arena>>,
    pub(crate) truth: PoseTrack,
    pub(crate) odometry: PoseTrack,
    pub(crate) estimates: Vec<Estimate>,
    pub(crate) fixes: Vec<FixMark>,
}

impl SampleRun {
    pub(crate) fn layers<'a>(&'a self, title: &'a str) -> RunLayers<'a> {
        RunLayers {
            title,
            ideal: &self.ideal,
            truth: Some(&self.truth),
            odometry: Some(&self.odometry),
            estimates: &self.estimates,
            fixes: &self.fixes,
            ..RunLayers::default()
        }
    }
}

pub(crate) fn two_laps(seed: u64) -> SampleRun {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let truth = drive(0.995, 0.008);
    let odometry = drive(ODOMETRY_TURN_FACTOR, 0.012);
    let mut estimates = Vec::new();
    let mut fixes = Vec::new();
    let mut variance_m2 = 1e-5;
    let mut errors = [0.0; 3];
    for (index, sample) in truth.iter().enumerate() {
        variance_m2 += 8e-7;
        if index % 10 == 5 && !BLACKOUT.contains(&index) {
            let fix = fix_of(sample, &mut random);
            if fix.verdict == FusionOutcome::Accepted {
                variance_m2 = 1.0 / (1.0 / variance_m2 + 1.0 / FIX_SIGMA_M.powi(2));
            }
            fixes.push(fix);
        }
        // A first-order process with unit variance: errors of a filter are smooth, not white.
        for value in &mut errors {
            *value = 0.97 * *value + 0.059_f64.sqrt() * normal(&mut random);
        }
        estimates.push(estimate_near(sample, &errors, variance_m2));
    }
    let corners = [(0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0)];
    SampleRun {
        ideal: corners.map(|(x_m, y_m)| Point2::new(Meters(x_m), Meters(y_m))).to_vec(),
        truth: PoseTrack::new(truth, TimeDelta::from_millis(200)),
        odometry: PoseTrack::new(odometry, TimeDelta::from_millis(200)),
        estimates,
        fixes,
    }
}

fn drive(turn_factor: f64, veer_rad_per_m: f64) -> Vec<TimedPose> {
    let straight_steps = (SIDE_M / SPEED_M_PER_STEP).round() as i64;
    let leg_steps = straight_steps + TURN_STEPS;
    let (mut x_m, mut y_m, mut heading_rad) = (0.0_f64, 0.0_f64, 0.0_f64);
    (0..8 * leg_steps)
        .map(|step| {
            if step % leg_steps < straight_steps {
                heading_rad += veer_rad_per_m * SPEED_M_PER_STEP;
                x_m += SPEED_M_PER_STEP * heading_rad.cos();
                y_m += SPEED_M_PER_STEP * heading_rad.sin();
            } else {
                heading_rad += QUARTER_RAD / TURN_STEPS as f64 * turn_factor;
            }
            TimedPose {
                time: Timestamp::from_millis(step * STEP_MILLIS),
                pose: Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad)),
            }
        })
        .collect()
}

fn fix_of(sample: &TimedPose, random: &mut Pcg64Mcg) -> FixMark {
    let is_outlier = random.random::<f64>() < 0.04;
    let sigma_m = if is_outlier { 0.35 } else { FIX_SIGMA_M };
    FixMark {
        time: sample.time,
        position: Point2::new(
            Meters(sample.pose.x.0 + sigma_m * normal(random)),
            Meters(sample.pose.y.0 + sigma_m * normal(random)),
        ),
        verdict: if is_outlier { FusionOutcome::Gated } else { FusionOutcome::Accepted },
    }
}

/// An estimate whose error has the covariance that it claims: a correlated ellipse, wider across the heading.
fn estimate_near(sample: &TimedPose, unit: &[f64; 3], variance_m2: f64) -> Estimate {
    let (sin, cos) = sample.pose.heading.rad().sin_cos();
    let (along_var, across_var, heading_var) = (variance_m2 * 0.5, variance_m2 * 1.5, variance_m2);
    let along_m = along_var.sqrt() * unit[0];
    let across_m = across_var.sqrt() * unit[1];
    let mut covariance = [[0.0; 5]; 5];
    covariance[0][0] = along_var * cos * cos + across_var * sin * sin;
    covariance[1][1] = along_var * sin * sin + across_var * cos * cos;
    covariance[0][1] = (along_var - across_var) * sin * cos;
    covariance[1][0] = covariance[0][1];
    covariance[2][2] = heading_var;
    let estimated = TimedPose {
        time: sample.time,
        pose: Pose::new(
            Meters(sample.pose.x.0 + along_m * cos - across_m * sin),
            Meters(sample.pose.y.0 + along_m * sin + across_m * cos),
            sample.pose.heading + Radians(heading_var.sqrt() * unit[2]),
        ),
    };
    estimated.with_covariance(covariance)
}

pub(crate) fn normal(random: &mut Pcg64Mcg) -> f64 {
    StandardNormal.sample(random)
}
