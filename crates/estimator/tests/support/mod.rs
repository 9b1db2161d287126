//! A robot on a square with the noise that the filter is told: truth, sensors, scores. Seeded, in virtual time.

use posebridge_estimator::{FilterConfig, Params, StartPose, filter_named};
use posebridge_telemetry::{
    Arena, DriveGeometry, Fix, Heading, Meters, Observation, Observed, Point2, Pose, Radians,
    RadiansPerSecond, SensorId, SensorNoise, Span, Stamp, Verdict, quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

pub const STEP_S: f64 = 0.05;
const RADIUS_M: f64 = 0.028;
const TRACK_M: f64 = 0.112;
const DEGREE: f64 = std::f64::consts::PI / 180.0;

pub const NOISE: SensorNoise = SensorNoise {
    wheel_travel_m_per_sqrt_m: 0.0008,
    travel_m_per_sqrt_m: 0.0,
    turn_rad_per_sqrt_rad: 0.004,
    heading_rad_per_sqrt_m: 0.0,
    gyro_rad_per_s: 0.6 * DEGREE,
    gyro_resolution_rad_per_s: DEGREE,
    gyro_bias_rad_per_s: DEGREE,
    gyro_bias_walk_rad_per_s_sqrt_s: 0.01 * DEGREE,
    fix_position_m: 0.005,
    fix_heading_rad: DEGREE,
};

pub const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(RADIUS_M),
    right_wheel_radius: Meters(RADIUS_M),
    track_width: Meters(TRACK_M),
    tick: Radians(DEGREE),
};

#[derive(Clone, Copy)]
pub struct Camera {
    pub every: usize,
    pub delay: usize,
    pub spread: usize,
    pub outliers: f64,
}

pub struct Scenario {
    pub laps: usize,
    pub camera: Option<Camera>,
}

#[derive(Clone, Copy, Debug)]
pub struct Run {
    pub position_rms_m: f64,
    pub heading_rms_rad: f64,
    pub anees: f64,
    pub fix_nis_per_dof: f64,
}

pub fn config() -> FilterConfig {
    FilterConfig {
        geometry: GEOMETRY,
        noise: NOISE,
        start: Some(StartPose {
            pose: Pose::default(),
            position_sigma_m: 1e-4,
            heading_sigma_rad: 1e-4,
        }),
        params: Params::default(),
    }
}

/// Commanded (distance, turn) of each step: rest, then squares of 3 m at 0.2 m/s with turns in place, ramped.
fn commands(laps: usize) -> Vec<(f64, f64)> {
    let mut steps = vec![(0.0, 0.0); 40];
    let mut ramp = |amount: f64, speed: f64, is_turn: bool, rest_steps: usize| {
        let whole = (amount / (speed * STEP_S)).round() as usize;
        let total = whole + 6;
        for k in 0..total {
            let edge = (k + 1).min(total - k).min(6) as f64 / 7.0;
            let share = if k < 6 || k >= total - 6 { edge } else { 1.0 };
            steps.push(if is_turn {
                (0.0, share * speed * STEP_S)
            } else {
                (share * speed * STEP_S, 0.0)
            });
        }
        steps.extend(std::iter::repeat_n((0.0, 0.0), rest_steps));
    };
    for lap in 0..laps {
        let side = if lap % 2 == 0 { 1.0 } else { -1.0 };
        for _ in 0..4 {
            ramp(3.0, 0.2, false, 20);
            ramp(std::f64::consts::FRAC_PI_2, 1.0, true, 10);
        }
        let _ = side;
    }
    steps
}

/// One observation of the run, with the step at which it arrives.
pub struct Arrival {
    pub step: usize,
    pub observation: Observation,
}

pub struct Truth {
    pub poses: Vec<(f64, f64, f64)>,
    pub arrivals: Vec<Arrival>,
}

pub fn stamp(step: usize) -> Stamp<posebridge_telemetry::BrickClock> {
    Stamp::from_millis(step as i64 * 50)
}

pub fn drive(scenario: &Scenario, seed: u64) -> Truth {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut normal = move || -> f64 { rng.sample(StandardNormal) };
    let mut uniform = Pcg64::seed_from_u64(seed ^ 0x5eed);
    let (mut x, mut y, mut heading) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut left_rad, mut right_rad) = (0.0_f64, 0.0_f64);
    let mut bias = DEGREE * normal();
    let mut truth = Truth {
        poses: vec![],
        arrivals: vec![],
    };
    for (index, (d, turn)) in commands(scenario.laps).into_iter().enumerate() {
        let step = index + 1;
        left_rad += (d - 0.5 * turn * TRACK_M) / RADIUS_M;
        right_rad += (d + 0.5 * turn * TRACK_M) / RADIUS_M;
        let mut travel = |s: f64| s + 0.0008 * s.abs().sqrt() * normal();
        let (left_m, right_m) = (
            travel(d - 0.5 * turn * TRACK_M),
            travel(d + 0.5 * turn * TRACK_M),
        );
        let true_d = 0.5 * (left_m + right_m);
        let mut true_turn = (right_m - left_m) / TRACK_M;
        true_turn += 0.004 * true_turn.abs().sqrt() * normal();
        let chord = if true_turn.abs() < 1e-9 {
            1.0
        } else {
            (0.5 * true_turn).sin() / (0.5 * true_turn)
        };
        x += chord * true_d * (heading + 0.5 * true_turn).cos();
        y += chord * true_d * (heading + 0.5 * true_turn).sin();
        heading = wrap_rad(heading + true_turn);
        truth.poses.push((x, y, heading));

        let floored = |rad: f64| Radians((rad / DEGREE).floor() * DEGREE);
        let wheels = Observed::WheelAngles {
            left: floored(left_rad),
            right: floored(right_rad),
        };
        truth
            .arrivals
            .push(arrival(step, step, SensorId::WHEELS, wheels));
        let rate = true_turn / STEP_S + bias + 0.6 * DEGREE * normal();
        let rate = Observed::TurnRate(RadiansPerSecond((rate / DEGREE).round() * DEGREE));
        truth
            .arrivals
            .push(arrival(step, step, SensorId::GYRO, rate));
        bias += 0.01 * DEGREE * STEP_S.sqrt() * normal();
        if let Some(camera) = scenario.camera
            && step.is_multiple_of(camera.every)
        {
            let mut noise = [0.005 * normal(), 0.005 * normal(), DEGREE * normal()];
            if uniform.random::<f64>() < camera.outliers {
                noise = noise.map(|error| error + 0.5 * normal());
            }
            let late = camera.delay - camera.spread + uniform.random_range(0..=2 * camera.spread);
            let fix = Observed::Fix(Fix {
                position: Point2::<Arena>::new(Meters(x + noise[0]), Meters(y + noise[1])),
                heading: Some(Heading::from_rad(heading + noise[2])),
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            });
            truth
                .arrivals
                .push(arrival(step + late, step, SensorId::CAMERA, fix));
        }
    }
    truth.arrivals.sort_by_key(|arrival| arrival.step);
    truth
}

fn arrival(step: usize, taken: usize, sensor: SensorId, observed: Observed) -> Arrival {
    let observation = Observation {
        sensor,
        stamp: stamp(taken),
        stamp_sigma: Span::ZERO,
        observed,
    };
    Arrival { step, observation }
}

pub fn run(scenario: &Scenario, seed: u64) -> Run {
    let truth = drive(scenario, seed);
    let mut filter = (filter_named("pose").expect("it is in the table").build)(&config());
    let mut arrivals = truth.arrivals.iter().peekable();
    let (mut squares, mut heading_squares, mut nees, mut nis, mut dof) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (index, (x, y, heading)) in truth.poses.iter().enumerate() {
        let step = index + 1;
        while let Some(next) = arrivals.next_if(|next| next.step <= step) {
            let record = filter.observe(&next.observation);
            if record.degrees_of_freedom > 0 && record.verdict == Verdict::Accepted {
                nis += record.nis;
                dof += f64::from(record.degrees_of_freedom);
            }
        }
        let estimate = filter
            .estimate_at(stamp(step))
            .expect("something was observed");
        let error = nalgebra::Vector3::new(
            estimate.pose.x.0 - x,
            estimate.pose.y.0 - y,
            wrap_rad(estimate.pose.heading.rad() - heading),
        );
        let p = nalgebra::Matrix3::from_fn(|row, column| estimate.covariance[row][column]);
        squares += error[0] * error[0] + error[1] * error[1];
        heading_squares += error[2] * error[2];
        nees += (error.transpose() * p.try_inverse().expect("positive definite") * error)[0] / 3.0;
    }
    let count = truth.poses.len() as f64;
    Run {
        position_rms_m: (squares / count).sqrt(),
        heading_rms_rad: (heading_squares / count).sqrt(),
        anees: nees / count,
        fix_nis_per_dof: nis / dof,
    }
}
