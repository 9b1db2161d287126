//! The posterior Cramer-Rao bound of a run: no estimate that uses what has arrived by a step can have a smaller mean
//! squared error.
//!
//! ```text
//! J+ = Q^-1 + H'R^-1 H - Q^-1 F (J + F'Q^-1 F)^-1 F'Q^-1             the information matrix, for a regular Q
//! P+ = (M^-1 + H'R^-1 H)^-1,  M = F P F' + Q,  P = J^-1             the same by the matrix inversion lemma
//! ```
//! The second form is used, since Q is singular here. It is linearised along the *true* path; the expectation over
//! paths is left to the mean over runs. Fixes see mid-axle, nothing slips, every gyro sample is held against its own
//! step, and the rounding of the encoders is left out: a bound that knows more than a filter does is lower, and still a
//! bound. What the configuration leaves unknown is a state: mountings, delays, the gyro's scale, the map's errors.
//!
//! Source: Tichavsky, Muravchik and Nehorai (1998), IEEE Transactions on Signal Processing 46(5), equation 21;
//! docs/maths/pose.md section B5.

mod states;

use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector};
use posebridge_telemetry::{Arena, Calibration, Pose};

pub use self::states::ArrivedObservation;
use self::states::{CORE, ExtraStates, FIRST_CONSTANT, GYRO_BIAS, HEADING, ObservedScalar, STEP_ERROR, X, Y};
use super::nominal::{CONSTANTS, UNKNOWN_POSITION_SIGMA_M, bias_prior, calibrated_motion, constants_of, true_geometry};
use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, step_noise};
use crate::models::lie::Se2;
use crate::models::se2::{BodyStep, StepRule, displace};
use crate::numerics::covariance::symmetrise;
use crate::observations::StateTerm;
use crate::observations::gyro_window::gyro_variance;
use crate::observations::sensor_frame::Exposure;

type Core = SMatrix<f64, CORE, CORE>;

/// The true motion of a run, on a grid of equal steps.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruthRun<'a> {
    /// The true pose before the first step and after each step: one more than there are steps.
    pub poses: &'a [Pose<Arena>],
    /// The wheels' travel over each step, by counters and the nominal geometry.
    pub travel: &'a [WheelTravel],
    /// The length of a step; the gyro gives one sample per step.
    pub step_s: f64,
    /// In any order; of other kinds than fixes, landmarks, beacons and compass headings nothing is taken.
    pub observations: &'a [ArrivedObservation],
}

/// The least mean squared position error after each step with a pose before and after, m².
pub fn cramer_rao_bound(config: &FilterConfig, run: &GroundTruthRun<'_>) -> Vec<f64> {
    let steps = run.travel.len().min(run.poses.len().saturating_sub(1));
    let mut recursion = BoundRecursion::new(config, run);
    let mut arrivals: Vec<&ArrivedObservation> = run
        .observations
        .iter()
        .filter(|arrived| (1..=steps).contains(&arrived.exposure_step) && arrived.arrival_step >= arrived.exposure_step)
        .collect();
    arrivals.sort_by_key(|arrived| arrived.arrival_step);
    let mut arrivals = arrivals.into_iter().peekable();
    (1..=steps)
        .map(|step| {
            let mut oldest = step;
            while let Some(arrived) = arrivals.next_if(|arrived| arrived.arrival_step == step) {
                oldest = oldest.min(arrived.exposure_step);
                let scalars = recursion.linearise(arrived);
                recursion.arrived[arrived.exposure_step].extend(scalars);
            }
            for again in oldest..=step {
                recursion.advance(again);
            }
            let after = &recursion.covariances[step];
            after[(X, X)] + after[(Y, Y)]
        })
        .collect()
}

struct BoundRecursion<'a> {
    config: &'a FilterConfig,
    run: &'a GroundTruthRun<'a>,
    constants: [f64; CONSTANTS],
    extra: ExtraStates,
    /// After each step, with what has arrived; the first is the start.
    covariances: Vec<DMatrix<f64>>,
    arrived: Vec<Vec<ObservedScalar>>,
}

impl<'a> BoundRecursion<'a> {
    fn new(config: &'a FilterConfig, run: &'a GroundTruthRun<'a>) -> Self {
        let calibration: &Calibration = &config.calibration;
        let mut start = SVector::<f64, CORE>::zeros();
        let (position, heading) = config.start.map_or((UNKNOWN_POSITION_SIGMA_M, UNKNOWN_HEADING_SIGMA_RAD), |start| {
            (start.position_sigma_m, start.heading_sigma_rad)
        });
        start[X] = position;
        start[Y] = position;
        start[HEADING] = heading;
        start[GYRO_BIAS] = bias_prior(config).sigma;
        let known = constants_of(calibration);
        for (row, known) in start.iter_mut().skip(FIRST_CONSTANT).zip(known) {
            *row = known.sigma;
        }
        let extra = ExtraStates::new(config, run.observations);
        let sigmas = start.iter().copied().chain(extra.priors.iter().map(|(_, sigma)| *sigma));
        let variances: Vec<f64> = sigmas.map(|sigma| sigma * sigma).collect();
        Self {
            config,
            run,
            constants: known.map(|known| known.value),
            extra,
            covariances: vec![DMatrix::from_diagonal(&DVector::from_vec(variances))],
            arrived: vec![Vec::new(); run.travel.len() + 1],
        }
    }

    fn linearise(&self, arrived: &ArrivedObservation) -> Vec<ObservedScalar> {
        let (before, at) = (self.run.poses[arrived.exposure_step - 1], self.run.poses[arrived.exposure_step]);
        let moved = se2(before).between(se2(at)).log();
        let exposure = Exposure::at_speeds(moved[0] / self.run.step_s, moved[2] / self.run.step_s);
        self.extra.linearise(arrived, self.config, se2(at), &exposure)
    }

    /// Computes the covariance after a step, again if it exists already.
    fn advance(&mut self, step: usize) {
        let mut covariance = self.covariances[step - 1].clone();
        covariance.row_mut(STEP_ERROR).fill(0.0);
        covariance.column_mut(STEP_ERROR).fill(0.0);
        self.move_by(step, &mut covariance);
        let step_s = self.run.step_s;
        let gyro = gyro_variance(&self.config.noise, step_s * step_s);
        let turn_rad = (self.run.poses[step].heading - self.run.poses[step - 1].heading).0;
        let scale = self.extra.row(StateTerm::GyroScale).map(|row| (row, turn_rad));
        let entries = [Some((GYRO_BIAS, step_s)), Some((STEP_ERROR, 1.0)), scale].into_iter().flatten();
        observe(&mut covariance, &ObservedScalar { entries: entries.collect(), variance: gyro });
        for scalar in &self.arrived[step] {
            observe(&mut covariance, scalar);
        }
        self.covariances.truncate(step);
        self.covariances.push(covariance);
    }

    /// M = F P F' + G Q G', along the true path.
    fn move_by(&self, step: usize, covariance: &mut DMatrix<f64>) {
        let walk = self.config.noise.gyro_bias_walk_rad_per_s_sqrt_s;
        covariance[(GYRO_BIAS, GYRO_BIAS)] += walk * walk * self.run.step_s;
        let travel = self.run.travel[step - 1];
        if travel == WheelTravel::default() {
            return;
        }
        let (before, after) = (self.run.poses[step - 1], self.run.poses[step]);
        let known = calibrated_motion(travel, self.config, &self.constants);
        let moved = displace(
            before.heading.rad(),
            BodyStep { forward_m: known.step.forward_m, turn_rad: (after.heading - before.heading).0 },
            StepRule::Arc,
        );
        let mut by_state = Core::identity();
        let mut by_noise = SMatrix::<f64, CORE, 2>::zeros();
        for axis in [X, Y] {
            by_state[(axis, HEADING)] = moved.by_heading[axis];
            by_noise[(axis, 0)] = moved.by_forward[axis];
            by_noise[(axis, 1)] = moved.by_turn[axis];
        }
        by_noise[(HEADING, 1)] = 1.0;
        for constant in 0..3 {
            let (d, dth) = (known.forward_by_scales[constant], known.turn_by_scales[constant]);
            for axis in [X, Y] {
                by_state[(axis, FIRST_CONSTANT + constant)] = moved.by_forward[axis] * d + moved.by_turn[axis] * dth;
            }
            by_state[(HEADING, FIRST_CONSTANT + constant)] = dth;
            by_state[(STEP_ERROR, FIRST_CONSTANT + constant)] = dth;
        }
        by_noise[(STEP_ERROR, 1)] = 1.0;
        let noise = step_noise(known.travel, &true_geometry(self.config, &self.constants), &self.config.noise);
        let cross = noise.forward_turn_m_rad;
        let q = Matrix2::new(noise.forward_var_m2, cross, cross, noise.turn_var_rad2);
        let core: Core = covariance.fixed_view::<CORE, CORE>(0, 0).into_owned();
        let mut moved_core = by_state * core * by_state.transpose() + by_noise * q * by_noise.transpose();
        symmetrise(&mut moved_core);
        covariance.fixed_view_mut::<CORE, CORE>(0, 0).copy_from(&moved_core);
        let extra = self.extra.priors.len();
        if extra > 0 {
            let side = by_state * covariance.view((0, CORE), (CORE, extra));
            covariance.view_mut((0, CORE), (CORE, extra)).copy_from(&side);
            covariance.view_mut((CORE, 0), (extra, CORE)).copy_from(&side.transpose());
        }
        self.forget_fix_biases(known.step.forward_m.abs(), covariance);
    }

    /// The errors that fixes share are Gauss-Markov processes over the path.
    fn forget_fix_biases(&self, path_m: f64, covariance: &mut DMatrix<f64>) {
        let noise = &self.config.noise;
        let keep = (-path_m / noise.fix_persistence_m).exp();
        for row in self.extra.rows_of_fix_biases() {
            covariance.row_mut(row).scale_mut(keep);
            covariance.column_mut(row).scale_mut(keep);
            covariance[(row, row)] += (1.0 - keep * keep) * noise.fix_persistent_m.powi(2);
        }
    }
}

fn se2(pose: Pose<Arena>) -> Se2 {
    Se2 { x_m: pose.x.0, y_m: pose.y.0, heading_rad: pose.heading.rad() }
}

/// Uniform on the circle, rad.
const UNKNOWN_HEADING_SIGMA_RAD: f64 = 1.813_799_364_234_217_8;

/// (M^-1 + h'h / R)^-1 for a row h that is zero except at some places.
fn observe(covariance: &mut DMatrix<f64>, scalar: &ObservedScalar) {
    let mut cross = DVector::<f64>::zeros(covariance.nrows());
    for (row, by_row) in &scalar.entries {
        cross.axpy(*by_row, &covariance.column(*row), 1.0);
    }
    let s = scalar.entries.iter().map(|(row, by_row)| by_row * cross[*row]).sum::<f64>() + scalar.variance;
    // Without noise, what is known exactly already cannot be known better.
    if s > 0.0 {
        let rows = covariance.nrows();
        for (column, across) in covariance.as_mut_slice().chunks_exact_mut(rows).zip(cross.as_slice()) {
            for (value, along) in column.iter_mut().zip(cross.as_slice()) {
                *value -= along * across / s;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use posebridge_telemetry::{
        ArenaMap, BeaconId, Fix, Heading, LandmarkId, Meters, MountedSensor, ObservationKind, Point2, Radians,
        SensorId, StartPose, UncertainValue,
    };

    use super::*;

    fn fix(exposure_step: usize, arrival_step: usize) -> ArrivedObservation {
        let measurement = ObservationKind::Fix(Fix {
            position: Point2::ORIGIN,
            heading: Some(Heading::default()),
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        });
        ArrivedObservation { exposure_step, arrival_step, sensor: SensorId::CAMERA, measurement }
    }

    /// 40 steps straight ahead with a fix after every fourth, `late` steps late.
    fn straight(config: &FilterConfig, late: usize) -> Vec<f64> {
        let poses: Vec<Pose<Arena>> =
            (0..=40).map(|k| Pose::new(Meters(0.01 * f64::from(k)), Meters(0.0), Heading::default())).collect();
        let travel = vec![WheelTravel { left_m: 0.01, right_m: 0.01 }; 40];
        let fixes: Vec<ArrivedObservation> = (1..=10).map(|k| fix(4 * k, 4 * k + late)).collect();
        let run = GroundTruthRun { poses: &poses, travel: &travel, step_s: 0.05, observations: &fixes };
        cramer_rao_bound(config, &run)
    }

    #[test]
    fn it_is_the_information_recursion_where_that_exists() {
        // Without a gyro and with nothing to calibrate, x on a straight is a random walk of its own: Q is regular.
        let mut config = crate::filter::tests::config();
        config.noise.gyro_rad_per_s = 1e6;
        config.noise.turn_rad_per_sqrt_rad = 0.0;
        let start = config.start.unwrap();
        let own = straight(&config, 0);
        let wheel_var = config.noise.wheel_travel_m_per_sqrt_m.powi(2) * 0.01;
        // x: F = 1. (y, heading): F = [1, d; 0, 1], noise of the turn on both, which is regular over two steps only, so a
        // share is added that changes nothing.
        let (q_x, q_turn) = (0.5 * wheel_var, 2.0 * wheel_var / 0.112_f64.powi(2));
        let (r, r_heading) = (config.noise.fix_position_m.powi(2), 0.02_f64.powi(2));
        let f = Matrix2::new(1.0, 0.01, 0.0, 1.0);
        let g = nalgebra::Vector2::new(0.005, 1.0);
        let q = g * q_turn * g.transpose() + Matrix2::from_diagonal_element(1e-14);
        let q_inverse = q.try_inverse().unwrap();
        let mut j_x = start.position_sigma_m.powi(-2);
        let mut j = Matrix2::from_diagonal(&nalgebra::Vector2::new(
            start.position_sigma_m.powi(-2),
            start.heading_sigma_rad.powi(-2),
        ));
        for (index, own) in own.iter().enumerate() {
            let has_fix = (index + 1).is_multiple_of(4);
            let fix_weight = f64::from(u8::from(has_fix));
            j_x = 1.0 / q_x + fix_weight / r - 1.0 / q_x / (j_x + 1.0 / q_x) / q_x;
            let inner = (j + f.transpose() * q_inverse * f).try_inverse().unwrap();
            j = q_inverse - q_inverse * f * inner * f.transpose() * q_inverse
                + Matrix2::from_diagonal(&nalgebra::Vector2::new(fix_weight / r, fix_weight / r_heading));
            let expected = 1.0 / j_x + j.try_inverse().unwrap()[(0, 0)];
            assert!((own / expected - 1.0).abs() < 1e-4, "step {}: {own} against {expected}", index + 1);
        }
    }

    #[test]
    fn a_late_fix_helps_late_and_then_as_much() {
        let config = crate::filter::tests::config();
        let (at_once, late) = (straight(&config, 0), straight(&config, 3));
        assert!(late[3] > at_once[3] && late[5] > at_once[5]);
        // After step 7 both know the fix of step 4; summed in another order, so up to rounding.
        assert!((late[6] / at_once[6] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn at_rest_and_for_an_empty_run_it_is_what_was_known() {
        let config = crate::filter::tests::config();
        let poses = [Pose::default(); 3];
        let travel = [WheelTravel::default(); 2];
        let run = GroundTruthRun { poses: &poses, travel: &travel, step_s: 0.05, observations: &[] };
        for variance in cramer_rao_bound(&config, &run) {
            assert!((variance - 2e-8).abs() < 1e-20);
        }
        let nothing = GroundTruthRun { poses: &[], travel: &[], ..run };
        assert!(cramer_rao_bound(&config, &nothing).is_empty());
    }

    /// The variance of the position, m², of a robot of known heading that knows nothing else of its pose, after one step along x
    /// at 1 m/s and these observations at its end.
    fn after(config: &FilterConfig, measurements: &[(SensorId, ObservationKind)]) -> f64 {
        let mut config = config.clone();
        config.start = Some(StartPose { pose: Pose::default(), position_sigma_m: 1e3, heading_sigma_rad: 0.0 });
        config.noise.gyro_rad_per_s = 1e3;
        config.noise.wheel_travel_m_per_sqrt_m = 0.0;
        config.noise.turn_rad_per_sqrt_rad = 0.0;
        let observations: Vec<ArrivedObservation> = measurements
            .iter()
            .map(|(sensor, measurement)| ArrivedObservation { sensor: *sensor, measurement: *measurement, ..fix(1, 1) })
            .collect();
        let run = GroundTruthRun {
            poses: &[Pose::default(), Pose::new(Meters(0.1), Meters(0.0), Heading::default())],
            travel: &[WheelTravel { left_m: 0.1, right_m: 0.1 }],
            step_s: 0.1,
            observations: &observations,
        };
        cramer_rao_bound(&config, &run)[0]
    }

    /// A landmark 2 m ahead of the end of that step, and two beacons 2 m ahead and to the left.
    fn in_an_arena() -> FilterConfig {
        let mut config = crate::filter::tests::config();
        let at = |x_m, y_m| Point2::new(Meters(x_m), Meters(y_m));
        config.arena_map = Arc::new(ArenaMap {
            landmarks: [(LandmarkId(5), at(2.1, 0.0))].into(),
            beacons: [(BeaconId(0), at(2.1, 0.0)), (BeaconId(1), at(0.1, 2.0))].into(),
            walls: Vec::new(),
        });
        config.noise.landmark_range_m = 0.03;
        config.noise.landmark_bearing_rad = 0.02;
        config.noise.beacon_range_m = 0.05;
        config
    }

    #[test]
    fn what_is_unknown_of_a_sensor_adds_to_its_noise() {
        let unknown = |sigma| UncertainValue { value: 0.0, sigma };
        let landmark = (
            SensorId::LANDMARKS,
            ObservationKind::Landmark { id: LandmarkId(5), range: Meters(2.0), bearing: Radians(0.0) },
        );
        let beacons =
            [0, 1].map(|id| (SensorId::BEACONS, ObservationKind::BeaconRange { id: BeaconId(id), range: Meters(2.0) }));
        let fixes = [(SensorId::CAMERA, fix(1, 1).measurement); 100];
        // By hand: the position along and across, from the range and 2 m times the bearing, or from either beacon's range.
        let (r, b) = (0.03_f64, 0.02_f64);
        let plain = r * r + 4.0 * b * b;
        let of_landmark = |change: &dyn Fn(&mut FilterConfig)| {
            let mut config = in_an_arena();
            change(&mut config);
            after(&config, &[landmark])
        };
        let of_beacons = |change: &dyn Fn(&mut FilterConfig)| {
            let mut config = in_an_arena();
            change(&mut config);
            after(&config, &beacons)
        };
        let of_fixes = |change: &dyn Fn(&mut FilterConfig), count: usize| {
            let mut config = in_an_arena();
            change(&mut config);
            after(&config, &fixes[..count])
        };
        let cases = [
            ("landmark", of_landmark(&|_| ()), plain),
            ("share", of_landmark(&|config| config.noise.landmark_range_share = 0.1), plain + 0.04),
            ("map", of_landmark(&|config| config.noise.landmark_place_m = 0.1), plain + 0.02),
            (
                "yaw and place",
                of_landmark(&|config| {
                    let mounting = &mut config.calibration.mountings[MountedSensor::Landmarks];
                    (mounting.x_m, mounting.y_m, mounting.yaw_rad) = (unknown(0.1), unknown(0.2), unknown(0.05));
                }),
                plain + 0.01 + 0.04 + (2.0 * 0.05_f64).powi(2),
            ),
            (
                // 1 m/s along the range.
                "delay",
                of_landmark(&|config| config.calibration.landmark_delay_s = unknown(0.2)),
                plain + 0.04,
            ),
            (
                "offset and scale",
                of_landmark(&|config| {
                    config.calibration.landmark_offset_m = unknown(0.1);
                    config.calibration.landmark_scale = unknown(0.01);
                }),
                plain + 0.01 + 0.0004,
            ),
            ("beacons", of_beacons(&|_| ()), 2.0 * 0.05_f64.powi(2)),
            (
                "their offsets and scales",
                of_beacons(&|config| {
                    config.calibration.beacon_offset_m = unknown(0.1);
                    config.calibration.beacon_scale = unknown(0.01);
                }),
                2.0 * (0.05_f64.powi(2) + 0.01 + 0.0004),
            ),
            (
                "a shared error stays",
                of_fixes(&|config| config.noise.fix_persistent_m = 0.02, 100),
                2.0 * (0.005_f64.powi(2) / 100.0 + 0.02_f64.powi(2)),
            ),
            (
                "delay of fixes",
                of_fixes(&|config| config.calibration.fix_delay_s = unknown(0.1), 1),
                2.0 * 0.005_f64.powi(2) + 0.01,
            ),
        ];
        for (what, found, expected) in cases {
            assert!((found / expected - 1.0).abs() < 1e-3, "{what}: {found} instead of {expected}");
        }
    }

    #[test]
    fn an_unknown_scale_of_the_gyro_is_part_of_every_turn() {
        // Half a turn in place by a gyro alone, then 1 m straight ahead: by hand, y is off by 1 m times the heading's error.
        let mut config = crate::filter::tests::config();
        config.calibration.gyro_scale = UncertainValue { value: 0.0, sigma: 0.01 };
        config.noise.gyro_rad_per_s = 1e-9;
        config.noise.gyro_bias_rad_per_s = 1e-9;
        config.noise.wheel_travel_m_per_sqrt_m = 1e-9;
        config.noise.turn_rad_per_sqrt_rad = 10.0;
        let turn = std::f64::consts::PI / 20.0;
        let turned = (0..=20).map(|k| Pose::new(Meters(0.0), Meters(0.0), Heading::from_rad(turn * f64::from(k))));
        let driven =
            (1..=10).map(|k| Pose::new(Meters(-0.1 * f64::from(k)), Meters(0.0), Heading::from_rad(20.0 * turn)));
        let poses: Vec<Pose<Arena>> = turned.chain(driven).collect();
        let mut travel = vec![WheelTravel { left_m: -0.056 * turn, right_m: 0.056 * turn }; 20];
        travel.extend([WheelTravel { left_m: 0.1, right_m: 0.1 }; 10]);
        let run = GroundTruthRun { poses: &poses, travel: &travel, step_s: 0.05, observations: &[] };
        let last = cramer_rao_bound(&config, &run)[29].sqrt();
        let expected = 0.01 * std::f64::consts::PI;
        assert!((last / expected - 1.0).abs() < 1e-2, "{last} instead of {expected}");
    }
}
