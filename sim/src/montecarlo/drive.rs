//! One run: the truth at each step, the observations in the order of arrival, and what a filter is told.

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, DriveGeometry, Heading, Known, Meters, Observation, Observed, Pose, Radians,
    SensorId, SensorNoise, Span, Stamp,
};

use super::camera::CameraSensor;
use super::path::Plan;
use super::robot::{Accelerometers, GyroSensor, Robot, drawn_geometry, nominal};
use super::scenario::{Scenario, ToldGeometry};
use crate::random::Stream;

/// What happened in one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Length of a step.
    pub step: Span,
    /// The true pose: at the start, then after each step.
    pub truth: Vec<Pose<Arena>>,
    /// What the wheels really did over each step: one fewer than there are poses.
    pub wheel_turns: Vec<WheelTurn>,
    /// What the sensors said, in the order of arrival.
    pub arrivals: Vec<Arrival>,
    /// The error counts from this step on, 1 or later.
    pub scored_from: usize,
    /// The robot's true geometry.
    pub true_geometry: DriveGeometry,
    /// What a filter is told.
    pub told: Told,
}

/// The rotation of both wheels over one step, as encoders without counts would tell it: free of rounding, blind to slip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WheelTurn {
    /// Of the left wheel, forward positive.
    pub left: Radians,
    /// Of the right wheel, forward positive.
    pub right: Radians,
}

/// An observation and the step at whose end it arrives; its own stamp may be earlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// The step: 0 is the start.
    pub step: usize,
    /// The observation.
    pub observation: Observation,
}

/// What a filter may know before the drive begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// The geometry.
    pub geometry: DriveGeometry,
    /// The noise of sensors and motion.
    pub noise: SensorNoise,
    /// Where the robot starts.
    pub start: Pose<Arena>,
    /// One standard deviation of x and of y of the start, in metres.
    pub start_position_sigma_m: f64,
    /// One standard deviation of the start's heading, in radians.
    pub start_heading_sigma_rad: f64,
    /// How well the geometry is known; the gyro's bias stands in `noise`.
    pub calibration: Calibration,
}

impl Drive {
    /// The instant of a step's end; the start is the clock's zero.
    #[must_use]
    pub fn stamp(&self, step: usize) -> Stamp<BrickClock> {
        stamp(self.step, step)
    }
}

fn stamp(step: Span, count: usize) -> Stamp<BrickClock> {
    Stamp::from_nanos(step.as_nanos().saturating_mul(count as i64))
}

/// An instant so little beside a step, in steps, is that step: decimal seconds are no binary fractions.
const SAME_STEP: f64 = 1e-6;

/// The first step at or after an instant.
pub(super) fn first_step_from(at_s: f64, step_s: f64) -> usize {
    (at_s / step_s - SAME_STEP).ceil() as usize
}

/// The last step at or before an instant.
pub(super) fn last_step_until(at_s: f64, step_s: f64) -> usize {
    (at_s / step_s + SAME_STEP).floor() as usize
}

/// The seed of a run: SplitMix64's output function over base seed and number, so that neighbours have nothing in common.
///
/// Source: G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014, figure 17, with the
/// constants of its reference implementation.
fn run_seed(base: u64, run: u32) -> u64 {
    let mut z = base.wrapping_add((u64::from(run) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Draws a run.
pub(super) fn draw(scenario: &Scenario, run: u32) -> Drive {
    let seed = run_seed(scenario.seed, run);
    let plan = Plan::of(&scenario.path, scenario.step_s);
    let true_geometry = drawn_geometry(scenario, seed);
    let step_s = scenario.step_s;
    let mut log = Log {
        step: Span::from_secs_f64(step_s),
        truth: vec![pose(plan.start)],
        wheel_turns: Vec::new(),
        arrivals: Vec::new(),
    };
    let mut robot = Robot::new(scenario, true_geometry, plan.start, seed);
    let mut gyro = GyroSensor::new(scenario.gyro, step_s, seed);
    let mut accelerometers = scenario.accelerometer.map(|settings| Accelerometers::new(settings, step_s, seed));
    let mut camera = scenario.camera.map(|camera| CameraSensor::new(camera, step_s, seed));
    // The counters are zeroed at the start, and the filter hears of it: motion may begin with the first step.
    log.arrive(0, 0, SensorId::WHEELS, robot.wheel_angles());
    for (index, command) in plan.commands.iter().enumerate() {
        let step = index + 1;
        let moved = robot.advance(command);
        log.truth.push(pose(robot.pose));
        log.wheel_turns.push(moved.wheels);
        log.arrive(step, step, SensorId::WHEELS, robot.wheel_angles());
        if let Some(sensors) = &mut accelerometers {
            let observed = sensors.observe(&moved);
            log.arrive(step, step, SensorId::ACCELEROMETER, observed);
        }
        log.arrive(step, step, SensorId::GYRO, gyro.observe(moved.turn_rad));
        if let Some(camera) = &mut camera {
            camera.look(step, robot.pose);
            if let Some(fix) = camera.arriving(step) {
                log.arrive(step, fix.taken, SensorId::CAMERA, fix.observed);
            }
        }
    }
    Drive {
        step: log.step,
        truth: log.truth,
        wheel_turns: log.wheel_turns,
        arrivals: log.arrivals,
        scored_from: first_step_from(scenario.score_from_s, step_s).max(1),
        true_geometry,
        told: told(scenario, plan.start, true_geometry, seed),
    }
}

struct Log {
    step: Span,
    truth: Vec<Pose<Arena>>,
    wheel_turns: Vec<WheelTurn>,
    arrivals: Vec<Arrival>,
}

impl Log {
    fn arrive(&mut self, step: usize, taken: usize, sensor: SensorId, observed: Observed) {
        self.arrivals.push(Arrival {
            step,
            observation: Observation { sensor, stamp: stamp(self.step, taken), stamp_sigma: Span::ZERO, observed },
        });
    }
}

fn pose((x_m, y_m, heading_rad): (f64, f64, f64)) -> Pose<Arena> {
    Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad))
}

fn told(scenario: &Scenario, start: (f64, f64, f64), true_geometry: DriveGeometry, seed: u64) -> Told {
    let prior = &scenario.told;
    let off = Stream::new(seed, "start").uniform(-1.0, 1.0);
    let off_rad = off * prior.start_heading_off_deg.to_radians();
    let known = |sigma| Known { value: 0.0, sigma };
    Told {
        geometry: match prior.geometry {
            ToldGeometry::Nominal => nominal(&scenario.robot),
            ToldGeometry::True => true_geometry,
        },
        noise: told_noise(scenario),
        start: pose((start.0, start.1, start.2 + off_rad)),
        start_position_sigma_m: prior.start_position_sigma_m,
        start_heading_sigma_rad: prior.start_heading_sigma_rad,
        calibration: Calibration {
            radius_scale: known(prior.radius_scale_sigma),
            radius_difference: known(prior.radius_difference_sigma),
            track_scale: known(prior.track_scale_sigma),
            ..Calibration::default()
        },
    }
}

// A robot's file gives the noise of a camera and of accelerometers whether or not there is one, so a filter is never told of a
// sensor without noise. These are the values of the scenarios that have them.
const USUAL_FIX_M: f64 = 0.005;
const USUAL_FIX_DEG: f64 = 1.0;
const USUAL_ACCELEROMETER_M_PER_S2: f64 = 0.05;

fn told_noise(scenario: &Scenario) -> SensorNoise {
    let gyro = &scenario.gyro;
    let camera = scenario.camera;
    SensorNoise {
        wheel_travel_m_per_sqrt_m: scenario.told.wheel_travel_m_per_sqrt_m,
        turn_rad_per_sqrt_rad: scenario.told.turn_rad_per_sqrt_rad,
        gyro_rad_per_s: gyro.sigma_deg_per_s.to_radians(),
        gyro_resolution_rad_per_s: gyro.resolution_deg_per_s.to_radians(),
        gyro_bias_rad_per_s: gyro.bias_sigma_deg_per_s.to_radians(),
        gyro_bias_walk_rad_per_s_sqrt_s: gyro.bias_walk_deg_per_s_sqrt_s.to_radians(),
        fix_position_m: camera.map_or(USUAL_FIX_M, |camera| camera.position_sigma_m),
        fix_heading_rad: camera.map_or(USUAL_FIX_DEG, |camera| camera.heading_sigma_deg).to_radians(),
        accelerometer_m_per_s2: scenario
            .accelerometer
            .map_or(USUAL_ACCELEROMETER_M_PER_S2, |settings| settings.sigma_m_per_s2),
        ..SensorNoise::EXACT
    }
}
