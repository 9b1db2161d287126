//! The indirect filter of paper 4: its derivatives, a tag with a lever, its predictions; and on the square of 3 m by
//! 3 m against the wheels alone, and feed-forward against feedback.

use nalgebra::{SMatrix, SVector};
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::numerics::statistics::quantile;
use posebridge_estimator::papers::indirect::error_state::{
    ACCELERATED_ANGLE, ACCELERATED_DISTANCE, Covariance, DISTANCE, ErrorState, GYRO_ANGLE, HEADING, N,
    RADIUS_DIFFERENCE, RADIUS_SCALE, SampleIntervals, TRACK_SCALE, X, Y, nominal_step, process_noise, start_row,
    transition,
};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    Fix, FusionOutcome, Meters, MetersPerSecondSquared, Observation, ObservationKind, Point2, Radians,
    RadiansPerSecond, SensorId, StartPose, Timestamp, quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::support::filters::{latest, named};
use crate::support::observe::{at, fix, fix_of, wheels};
use crate::support::robot::{DEGREE, RADIUS_M, TRACK_M, config, unknown};
use crate::support::score::{error_of, nees_per_dof};
use crate::support::simulation::{STEP_S, ramp};

/// 400 ug per root Hz (MPU-6050 data sheet) over the 10 Hz that 20 samples a second leave.
const ACCELEROMETER_M_PER_S2: f64 = 0.012;
/// With the errors fed forward and fed back.
const BOTH: [&str; 2] = ["indirect", "indirect-feedback"];

/// Where a step leads from a path's state: x, y, heading, distance and the three scales.
fn stepped(state: &SVector<f64, 7>, travel: WheelTravel) -> SVector<f64, 7> {
    let config = config();
    let scales = [state[4], state[5], state[6]];
    let nominal = nominal_step(state[2], travel, &scales, &config.geometry, &config.noise);
    let mut next = *state;
    next[0] += nominal.displacement.dx_m;
    next[1] += nominal.displacement.dy_m;
    next[2] += nominal.step.turn_rad;
    next[3] += nominal.step.forward_m;
    next
}

#[test]
fn the_transition_of_the_errors_is_the_derivative_of_the_path() {
    let rows = [X, Y, HEADING, DISTANCE, RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE];
    let h = 1e-6;
    for (heading, left_m, right_m, scales) in [
        (0.3, 0.01, 0.012, [0.0, 0.0, 0.0]),
        (-2.9, -0.02, 0.05, [0.01, -0.02, 0.04]),
        (1.6, 0.0, 0.0, [0.0, 0.01, 0.0]),
        (3.1, -0.03, -0.01, [-0.05, 0.03, -0.1]),
    ] {
        let travel = WheelTravel { left_m, right_m };
        let config = config();
        let (geometry, noise) = (&config.geometry, &config.noise);
        let f = transition(&nominal_step(heading, travel, &scales, geometry, noise), STEP_S);
        let state = SVector::<f64, 7>::from([0.4, -1.0, heading, 2.0, scales[0], scales[1], scales[2]]);
        for column in 0..7 {
            let mut ahead = state;
            let mut behind = state;
            ahead[column] += h;
            behind[column] -= h;
            let by_difference = (stepped(&ahead, travel) - stepped(&behind, travel)) / (2.0 * h);
            for row in 0..7 {
                let found = f[(rows[row], rows[column])];
                assert!(
                    (found - by_difference[row]).abs() < 1e-8,
                    "{row} by {column}: {found} and {}",
                    by_difference[row]
                );
            }
        }
    }
}

#[test]
fn the_instruments_errors_grow_as_their_integrals_do() {
    let config = config();
    let (geometry, noise) = (&config.geometry, &config.noise);
    let nominal = nominal_step(0.0, WheelTravel::default(), &[0.0; 3], geometry, noise);
    let mut errors = ErrorState::zeros();
    for first in [ACCELERATED_DISTANCE, ACCELERATED_ANGLE] {
        errors[first] = 1.0;
        errors[first + 1] = 0.5;
        errors[first + 2] = -0.2;
    }
    errors[GYRO_ANGLE] = 0.1;
    errors[GYRO_ANGLE + 1] = 0.01;
    let mut in_parts = errors;
    for dt_s in [0.3, 0.7, 1.0] {
        in_parts = transition(&nominal, dt_s) * in_parts;
    }
    for first in [ACCELERATED_DISTANCE, ACCELERATED_ANGLE] {
        assert!((in_parts[first] - (1.0 + 0.5 * 2.0 - 0.1 * 4.0)).abs() < 1e-12);
        assert!((in_parts[first + 1] - 0.1).abs() < 1e-12);
    }
    assert!((in_parts[GYRO_ANGLE] - 0.12).abs() < 1e-12);
}

/// White noise has no memory: two halves of a step, one carried through the other, add up to the whole.
#[test]
fn the_instruments_process_noise_of_two_half_steps_is_that_of_the_step() {
    let mut config = config();
    config.noise.accelerometer_m_per_s2 = ACCELEROMETER_M_PER_S2;
    let (geometry, noise) = (&config.geometry, &config.noise);
    let nominal = nominal_step(0.0, WheelTravel::default(), &[0.0; 3], geometry, noise);
    let over = |share: f64| {
        let elapsed =
            SampleIntervals { dt_s: share * STEP_S, gyro_s2: share, accelerometer_s2: share * STEP_S * STEP_S };
        process_noise(&nominal, &elapsed, geometry, noise)
    };
    let half = over(0.5);
    let f = transition(&nominal, 0.5 * STEP_S);
    let (composed, whole) = (f * half * f.transpose() + half, over(1.0));
    for first in [ACCELERATED_DISTANCE, ACCELERATED_ANGLE] {
        for (row, column) in [(first, first), (first, first + 1), (first + 1, first), (first + 1, first + 1)] {
            let (found, expected) = (composed[(row, column)], whole[(row, column)]);
            assert!(expected > 0.0 && (found / expected - 1.0).abs() < 1e-9, "{row}, {column}: {found} {expected}");
        }
    }
}

#[test]
fn process_noise_is_a_covariance_and_the_paths_part_is_none_at_rest() {
    let mut config = config();
    config.noise.accelerometer_m_per_s2 = ACCELEROMETER_M_PER_S2;
    let (geometry, noise) = (&config.geometry, &config.noise);
    let elapsed = SampleIntervals { dt_s: STEP_S, gyro_s2: STEP_S * STEP_S, accelerometer_s2: STEP_S * STEP_S };
    for (left_m, right_m) in [(0.01, 0.03), (-0.02, 0.02), (0.0, 0.0)] {
        let travel = WheelTravel { left_m, right_m };
        let q = process_noise(&nominal_step(0.7, travel, &[0.0; 3], geometry, noise), &elapsed, geometry, noise);
        assert_eq!(q, q.transpose());
        let lowest = q.symmetric_eigenvalues().min();
        assert!(lowest > -1e-15, "{lowest:e}");
        let path = q.fixed_view::<4, 4>(0, 0).norm();
        assert_eq!(path == 0.0, left_m == 0.0, "{path}");
    }
}

#[test]
fn an_instrument_that_starts_is_at_rest_against_the_path() {
    let half = SMatrix::<f64, N, N>::from_fn(|i, j| ((3 * i + 5 * j) % 7) as f64 - 3.0);
    let mut covariance: Covariance = half * half.transpose();
    let before = covariance;
    let mut errors = ErrorState::repeat(0.3);
    start_row(&mut errors, &mut covariance, GYRO_ANGLE, HEADING, 0.01);
    // g = -e_th - r with the rounding r: dz = e_th + g carries no information yet.
    assert_eq!(errors[GYRO_ANGLE], -0.3);
    let mut h = SVector::<f64, N>::zeros();
    h[HEADING] = 1.0;
    h[GYRO_ANGLE] = 1.0;
    assert!(((h.transpose() * covariance * h)[0] - 0.01).abs() < 1e-12);
    assert_eq!(covariance[(HEADING, X)], before[(HEADING, X)]);
    assert_eq!(covariance[(GYRO_ANGLE, X)], -before[(HEADING, X)]);
    assert!(covariance.symmetric_eigenvalues().min() > -1e-9);
}

fn started(position_sigma_m: f64, heading_sigma_rad: f64, fix_position_m: f64) -> FilterConfig {
    let mut config = config();
    config.start = config.start.map(|start| StartPose { position_sigma_m, heading_sigma_rad, ..start });
    config.noise.fix_position_m = fix_position_m;
    config
}

/// The tag sits a third of a metre ahead and to the left: its position determines the heading.
#[test]
fn a_fix_of_a_tag_with_a_lever_turns_the_robot_in_the_right_direction() {
    for name in BOTH {
        let mut filter = named(name, &started(1e-3, 0.1, 1e-3));
        let (x, y, heading) = (0.3_f64, 0.2_f64, 0.02_f64);
        let measured = fix_of(x * heading.cos() - y * heading.sin(), x * heading.sin() + y * heading.cos(), None);
        let record = filter.observe(&fix(50, Fix { tag_in_body: Point2::new(Meters(x), Meters(y)), ..measured }));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{name}");
        assert_eq!(record.degrees_of_freedom, 2);
        let found = latest(filter.as_ref()).pose.heading.rad();
        assert!((found - heading).abs() < 5e-4, "{name}: {found}");
    }
}

#[test]
fn fixes_that_are_gated_for_long_enough_move_the_robot_and_silence_is_dead_reckoning() {
    for name in BOTH {
        let mut config = started(1e-3, 1e-3, 1e-3);
        (config.params.reset_after_s, config.params.reset_after_fixes) = (1.5, 5.0);
        let mut filter = named(name, &config);
        let mut outcome = |millis, x_m| {
            filter.observe(&wheels(millis, 0.0, 0.0));
            let outcome = filter.observe(&fix(millis, fix_of(x_m, 0.0, None))).outcome;
            (outcome, latest(filter.as_ref()).is_dead_reckoning)
        };
        assert_eq!(outcome(0, 0.0), (FusionOutcome::Accepted, false), "{name}");
        // Five fixes and 1.5 s, both; the last fix that was used becomes older than 2 s.
        let outcomes = [1_000, 1_400, 1_800, 2_200, 2_600].map(|millis| outcome(millis, 1.0));
        let gated = FusionOutcome::Gated;
        let expected =
            [(gated, false), (gated, false), (gated, false), (gated, true), (FusionOutcome::PoseReset, false)];
        assert_eq!(outcomes, expected, "{name}");
    }
}

/// A robot that is known exactly and a fix that is exact have nothing to weigh against each other.
#[test]
fn a_fix_that_could_not_be_weighed_is_not_one_that_was_used() {
    for name in BOTH {
        let mut filter = named(name, &started(0.0, 0.0, 0.0));
        assert_eq!(filter.observe(&wheels(0, 0.0, 0.0)).outcome, FusionOutcome::Accepted, "{name}");
        assert_eq!(filter.observe(&fix(20, fix_of(0.0, 0.0, None))).outcome, FusionOutcome::Malformed, "{name}");
        assert_eq!(latest(filter.as_ref()).fix_age, None, "{name}");
        assert_eq!(filter.latest_time(), Some(Timestamp::ZERO), "{name}");
    }
}

#[test]
fn a_prediction_turns_on_and_grows_uncertain_as_the_turn_rate_may_change() {
    let config = config();
    let mut filter = named("indirect", &config);
    for step in 0..=20 {
        let turned_rad = 0.5 * STEP_S * f64::from(step) * TRACK_M / (2.0 * RADIUS_M);
        filter.observe(&wheels(50 * i64::from(step), -turned_rad, turned_rad));
    }
    let now = latest(filter.as_ref());
    let ahead = filter.estimate_at(Timestamp::from_millis(1_400)).unwrap();
    assert!((ahead.pose.heading.rad() - 0.7).abs() < 1e-9);
    let grown = ahead.heading_sigma_rad().powi(2) - now.heading_sigma_rad().powi(2);
    let walk = config.params.turn_acceleration_rad_per_s2.powi(2) * 0.4_f64.powi(3) / 3.0;
    assert!((grown - walk).abs() < 1e-9, "{grown} {walk}");
}

/// How well the wheels of the square's robot are known: calibrated radii, an effective track that is 3 % off at one sigma.
const SCALE_SIGMAS: [f64; 3] = [0.002, 0.001, 0.03];

/// Which sensors the robot has beside its wheels.
#[derive(Clone, Copy)]
struct Sensors {
    has_accelerometers: bool,
    has_gyro: bool,
    fixes_every: Option<usize>,
}

const WHEELS_ONLY: Sensors = Sensors { has_accelerometers: false, has_gyro: false, fixes_every: None };
const ACCELEROMETERS: Sensors = Sensors { has_accelerometers: true, ..WHEELS_ONLY };
const ACCELEROMETERS_AND_GYRO: Sensors = Sensors { has_gyro: true, ..ACCELEROMETERS };

/// What happened on a drive: truth at its end and all observations.
struct Drive {
    end: (f64, f64, f64),
    observations: Vec<Observation>,
}

/// The path printed in the paper, read as (0,0), (3,0), (3,-3), (0,-3), (0,0): four sides of 3 m, turns to the right. Each step's
/// commanded speed and turn rate; a rest before, and after each motion.
fn commands() -> Vec<(f64, f64)> {
    let mut steps = vec![(0.0, 0.0); 40];
    for _ in 0..4 {
        for (amount, speed, sign) in [(3.0, 0.2, 0.0), (std::f64::consts::FRAC_PI_2, 1.0, -1.0)] {
            let speeds = ramp(amount, speed).into_iter().map(|share| share * speed);
            steps.extend(speeds.map(|now| if sign == 0.0 { (now, 0.0) } else { (0.0, sign * now) }));
            steps.extend([(0.0, 0.0); 15]);
        }
    }
    steps
}

struct SimulatedRobot {
    normals: Pcg64,
    truth: (f64, f64, f64),
    wheels_rad: [f64; 2],
    scales: [f64; 3],
    biases: [f64; 3],
    /// At the end of the last step: commanded, and true.
    commanded: (f64, f64),
    speeds: (f64, f64),
}

impl SimulatedRobot {
    fn new(seed: u64) -> Self {
        let mut world = Self {
            normals: Pcg64::seed_from_u64(seed),
            truth: (0.0, 0.0, 0.0),
            wheels_rad: [0.0; 2],
            scales: [0.0; 3],
            biases: [0.0; 3],
            commanded: (0.0, 0.0),
            speeds: (0.0, 0.0),
        };
        world.scales = SCALE_SIGMAS.map(|sigma| sigma * world.normal());
        world.biases = [0.05 * world.normal(), 0.05 * world.normal(), DEGREE * world.normal()];
        world
    }

    fn normal(&mut self) -> f64 {
        self.normals.sample(StandardNormal)
    }

    /// Moves for one step, from the speeds at its start to those at its end, linearly; returns the true accelerations. The wheels
    /// turn as commanded; the robot slips.
    fn advance(&mut self, speed: f64, turn: f64) -> (f64, f64) {
        let d = 0.5 * (self.commanded.0 + speed) * STEP_S;
        let dth = 0.5 * (self.commanded.1 + turn) * STEP_S;
        self.commanded = (speed, turn);
        let [m, dr, tb] = self.scales;
        let half_m = 0.5 * dth * TRACK_M * (1.0 + tb);
        let mut slips_m = [0.0; 2];
        for (i, side) in [-1.0, 1.0].into_iter().enumerate() {
            let travel_m = d + side * half_m;
            slips_m[i] = 0.0008 * travel_m.abs().sqrt() * self.normal();
            self.wheels_rad[i] += travel_m / (RADIUS_M * (1.0 + m + side * 0.5 * dr));
        }
        let slipped_rad = (slips_m[1] - slips_m[0]) / TRACK_M + 0.004 * dth.abs().sqrt() * self.normal();
        let new_speeds = (speed + 0.5 * (slips_m[0] + slips_m[1]) / STEP_S, turn + slipped_rad / STEP_S);
        let accelerations = ((new_speeds.0 - self.speeds.0) / STEP_S, (new_speeds.1 - self.speeds.1) / STEP_S);
        let true_m = 0.5 * (self.speeds.0 + new_speeds.0) * STEP_S;
        let true_rad = 0.5 * (self.speeds.1 + new_speeds.1) * STEP_S;
        self.speeds = new_speeds;
        let middle = self.truth.2 + 0.5 * true_rad;
        self.truth.0 += true_m * middle.cos();
        self.truth.1 += true_m * middle.sin();
        self.truth.2 = wrap_rad(self.truth.2 + true_rad);
        accelerations
    }

    fn wheels(&self) -> ObservationKind {
        let floored = |rad: f64| Radians((rad / DEGREE).floor() * DEGREE);
        ObservationKind::WheelAngles { left: floored(self.wheels_rad[0]), right: floored(self.wheels_rad[1]) }
    }

    /// The accelerometers sit on the frame at the nominal track, measured by a ruler; the tyres' effective track is another.
    fn accelerations(&mut self, (forward, turn): (f64, f64)) -> ObservationKind {
        let half = 0.5 * TRACK_M * turn;
        let left = forward - half + self.biases[0] + ACCELEROMETER_M_PER_S2 * self.normal();
        let right = forward + half + self.biases[1] + ACCELEROMETER_M_PER_S2 * self.normal();
        ObservationKind::WheelAccelerations { left: MetersPerSecondSquared(left), right: MetersPerSecondSquared(right) }
    }

    fn gyro(&mut self, turned_rad: f64) -> ObservationKind {
        let rate = turned_rad / STEP_S + self.biases[2] + 0.6 * DEGREE * self.normal();
        ObservationKind::TurnRate(RadiansPerSecond((rate / DEGREE).round() * DEGREE))
    }

    fn fix(&mut self) -> ObservationKind {
        let (x, y, heading) = self.truth;
        let noise = [0.005, 0.005, DEGREE].map(|sigma| sigma * self.normal());
        ObservationKind::Fix(fix_of(x + noise[0], y + noise[1], heading + noise[2]))
    }
}

fn drive(sensors: Sensors, seed: u64) -> Drive {
    let mut world = SimulatedRobot::new(seed);
    let mut observations = vec![];
    for (index, (speed, turn)) in commands().into_iter().enumerate() {
        let before_rad = world.truth.2;
        let accelerations = world.advance(speed, turn);
        let turned_rad = wrap_rad(world.truth.2 - before_rad);
        // Every sensor draws its noise in every case: the cases differ by what is used, not by the world.
        let of_accelerometers = world.accelerations(accelerations);
        let of_gyro = world.gyro(turned_rad);
        let of_camera = world.fix();
        let is_fixed = sensors.fixes_every.is_some_and(|every| index.is_multiple_of(every));
        let millis = 50 * (index as i64 + 1);
        for (sensor, observed, is_used) in [
            (SensorId::ACCELEROMETER, of_accelerometers, sensors.has_accelerometers),
            (SensorId::GYRO, of_gyro, sensors.has_gyro),
            (SensorId::WHEELS, world.wheels(), true),
            (SensorId::CAMERA, of_camera, is_fixed),
        ] {
            if is_used {
                observations.push(at(millis, sensor, observed));
            }
        }
    }
    Drive { end: world.truth, observations }
}

/// The robot of the square, with the sigmas of its scales.
fn square_config() -> FilterConfig {
    let mut config = config();
    config.noise.accelerometer_m_per_s2 = ACCELEROMETER_M_PER_S2;
    config.calibration.radius_scale = unknown(SCALE_SIGMAS[0]);
    config.calibration.radius_difference = unknown(SCALE_SIGMAS[1]);
    config.calibration.track_scale = unknown(SCALE_SIGMAS[2]);
    config
}

fn played(name: &str, config: &FilterConfig, drive: &Drive) -> Box<dyn Filter> {
    let mut filter = named(name, config);
    for observation in &drive.observations {
        let verdict = filter.observe(observation).outcome;
        let is_fine = matches!(
            verdict,
            FusionOutcome::Accepted | FusionOutcome::Gated | FusionOutcome::Unused | FusionOutcome::PoseReset
        );
        assert!(is_fine, "{name}: {observation:?} {verdict:?}");
    }
    filter
}

/// Error at the end in x and y, m, and the heading's, rad.
fn end_error(filter: &dyn Filter, drive: &Drive) -> [f64; 3] {
    error_of(&latest(filter), drive.end)
}

const SEEDS: u64 = 100;

/// Root mean squares of the end errors in x and y, medians of their lengths, and the mean NEES per degree of freedom.
struct EndErrors {
    rms_m: [f64; 2],
    lengths_m: Vec<f64>,
    anees: f64,
}

impl EndErrors {
    fn median_m(&self) -> f64 {
        quantile(&self.lengths_m, 0.5).expect("there are runs")
    }
}

fn end_errors(name: &str, sensors: Sensors, seeds: u64) -> EndErrors {
    let config = square_config();
    let (mut squares, mut lengths_m, mut nees) = ([0.0; 2], vec![], 0.0);
    for seed in 0..seeds {
        let drive = drive(sensors, seed);
        let filter = played(name, &config, &drive);
        let error = end_error(filter.as_ref(), &drive);
        squares[0] += error[0] * error[0];
        squares[1] += error[1] * error[1];
        lengths_m.push(error[0].hypot(error[1]));
        let p = latest(filter.as_ref()).covariance;
        nees += nees_per_dof(error, |i, j| p[i][j]);
    }
    let end_errors =
        EndErrors { rms_m: squares.map(|sum| f64::sqrt(sum / seeds as f64)), lengths_m, anees: nees / seeds as f64 };
    println!(
        "{name}: x {:.3} m, y {:.3} m rms, median {:.3} m, NEES/3 {:.2}",
        end_errors.rms_m[0],
        end_errors.rms_m[1],
        end_errors.median_m(),
        end_errors.anees
    );
    end_errors
}

#[test]
fn on_the_square_accelerometers_bring_the_end_closer_than_the_wheels_alone() {
    let wheels = end_errors("odometry", WHEELS_ONLY, SEEDS);
    for name in BOTH {
        let fused = end_errors(name, ACCELEROMETERS, SEEDS);
        // The paper's own end errors.
        assert!(fused.rms_m[0] <= 0.235, "{name}");
        assert!(fused.rms_m[1] <= 0.32, "{name}");
        let better = fused.lengths_m.iter().zip(&wheels.lengths_m).filter(|(fused, wheels)| fused < wheels).count();
        println!("{name}: better than the wheels in {better} of {SEEDS}");
        assert!(2 * better as u64 > SEEDS, "{name}");
        assert!(fused.median_m() < wheels.median_m(), "{name}");
    }
}

/// Fed forward the errors stay linearised about the wheels' path, which is wrong by tens of degrees in the end: what it claims of
/// itself is then too good, and fixes are refused until the path is put down anew. Fed back it is consistent.
#[test]
fn a_gyro_reduces_the_error_fixes_more_and_feedback_knows_its_error() {
    let seeds = 30;
    for (name, anees) in [("indirect", 1.3..10.0), ("indirect-feedback", 0.5..1.4)] {
        let accelerometers = end_errors(name, ACCELEROMETERS, seeds);
        let gyro = end_errors(name, ACCELEROMETERS_AND_GYRO, seeds);
        let with_fixes = Sensors { fixes_every: Some(20), ..ACCELEROMETERS_AND_GYRO };
        let fixed = end_errors(name, with_fixes, seeds);
        assert!(gyro.median_m() < accelerometers.median_m(), "{name}");
        assert!(fixed.median_m() < 0.02, "{name}");
        assert!(anees.contains(&gyro.anees), "{name}: {}", gyro.anees);
    }
}

/// The errors of feed-forward are linearised about the wheels' path, those of feedback about the corrected one: the same while
/// the errors are small, and not when they have grown.
#[test]
fn feed_forward_and_feedback_agree_while_errors_are_small() {
    let config = square_config();
    let mut grown_m: f64 = 0.0;
    for seed in 0..10 {
        let drive = drive(ACCELEROMETERS_AND_GYRO, seed);
        let [mut forward, mut back] = BOTH.map(|name| named(name, &config));
        let mut small_m: f64 = 0.0;
        for observation in &drive.observations {
            forward.observe(observation);
            back.observe(observation);
            if observation.sensor != SensorId::WHEELS {
                continue;
            }
            let (a, b) = (latest(forward.as_ref()).pose, latest(back.as_ref()).pose);
            let differ_m = (a.x.0 - b.x.0).hypot(a.y.0 - b.y.0);
            if observation.stamp <= Timestamp::from_millis(10_000) {
                small_m = small_m.max(differ_m);
            }
            grown_m = grown_m.max(differ_m);
        }
        assert!(small_m < 2e-3, "{seed}: {small_m}");
    }
    println!("by the end of the square they differ by up to {grown_m:.3} m");
    assert!(grown_m > 0.02, "{grown_m}");
}

#[test]
fn every_comparison_is_reported_with_its_innovation() {
    let drive = drive(ACCELEROMETERS_AND_GYRO, 1);
    let config = square_config();
    for name in BOTH {
        let mut filter = named(name, &config);
        let (mut nis, mut count) = (0.0, 0.0);
        for observation in &drive.observations {
            let record = filter.observe(observation);
            let is_first = observation.stamp < Timestamp::from_millis(150);
            if observation.sensor == SensorId::WHEELS && !is_first {
                assert_eq!(record.degrees_of_freedom, 3, "{name} {observation:?}");
                assert!(record.innovation_covariance[2][2] > 0.0);
                nis += record.nis / 3.0;
                count += 1.0;
            }
        }
        let mean: f64 = nis / count;
        println!("{name}: mean NIS per degree of freedom {mean:.2}");
        assert!((0.3..1.5).contains(&mean), "{name}: {mean}");
    }
}

#[test]
fn the_track_width_is_learned_from_the_accelerometers_and_the_gyro_bias_at_rest() {
    let drive = drive(ACCELEROMETERS_AND_GYRO, 4);
    let truth = SimulatedRobot::new(4);
    for name in BOTH {
        let filter = played(name, &square_config(), &drive);
        let learned = filter.calibration().unwrap();
        let track = learned.track_scale;
        let bias = learned.gyro_bias_rad_per_s;
        println!("{name}: track {track:?} of {}, bias {bias:?} of {}", truth.scales[2], truth.biases[2]);
        assert!(track.sigma < 0.01);
        assert!((track.value - truth.scales[2]).abs() < 4.0 * track.sigma);
        assert!(bias.sigma < 0.1 * DEGREE);
        assert!((bias.value - truth.biases[2]).abs() < 4.0 * bias.sigma);
    }
}
