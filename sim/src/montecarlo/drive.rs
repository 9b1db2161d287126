//! One run: the truth at each step, the observations in the order of arrival, and the filter's prior.

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, DriveGeometry, Observation, ObservationKind, Pose, SensorId, SensorNoise,
    TimeDelta, Timestamp, UncertainValue,
};

use super::plan::{DrivePlan, PlanarPose, first_step_from};
use super::robot::{Accelerometers, CameraSensor, GyroSensor, Robot, WheelTurn, nominal_geometry, true_geometry};
use super::scenario::{PriorGeometry, Scenario};
use crate::random::RandomStream;

/// Truth, observations and filter prior of one Monte-Carlo run.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    pub step: TimeDelta,
    /// True pose at the start, then after each step.
    pub truth: Vec<Pose<Arena>>,
    /// True wheel rotation over each step: one fewer than there are poses.
    pub wheel_turns: Vec<WheelTurn>,
    /// In the order of arrival.
    pub arrivals: Vec<Arrival>,
    /// The first step whose error counts, 1 or later.
    pub scored_from: usize,
    pub true_geometry: DriveGeometry,
    pub prior: FilterPrior,
}

/// An observation and the step at whose end it arrives; its own timestamp may be earlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// 0 is the start.
    pub step: usize,
    pub observation: Observation,
}

/// The prior knowledge of a filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterPrior {
    pub geometry: DriveGeometry,
    pub noise: SensorNoise,
    pub start: Pose<Arena>,
    pub start_position_sigma_m: f64,
    pub start_heading_sigma_rad: f64,
    /// Uncertainty of the geometry; that of the gyro's bias is in `noise`.
    pub calibration: Calibration,
}

impl Drive {
    /// End of a step; the start is the clock's zero.
    pub fn time_at(&self, step: usize) -> Timestamp<BrickClock> {
        time_at(self.step, step)
    }
}

fn time_at(step: TimeDelta, count: usize) -> Timestamp<BrickClock> {
    Timestamp::from_nanos(step.as_nanos().saturating_mul(count as i64))
}

/// The seed of a run: SplitMix64's output function over base seed and number, so that the seeds of neighbouring runs are uncorrelated.
///
/// Source: G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014, figure 17, with the
/// constants of its reference implementation.
fn run_seed(base: u64, run: u32) -> u64 {
    let mut z = base.wrapping_add((u64::from(run) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Scenario {
    /// Draws run `run`. The same scenario and number give the same drive, bit for bit, whatever was drawn before.
    pub fn drive(&self, run: u32) -> Drive {
        simulate_drive(self, run)
    }
}

fn simulate_drive(scenario: &Scenario, run: u32) -> Drive {
    let seed = run_seed(scenario.seed, run);
    let plan = DrivePlan::new(&scenario.path, scenario.step_s);
    let true_geometry = true_geometry(scenario, seed);
    let step_s = scenario.step_s;
    let mut log = DriveLog {
        step: TimeDelta::from_secs_f64(step_s),
        truth: vec![plan.start.into()],
        wheel_turns: Vec::new(),
        arrivals: Vec::new(),
    };
    let mut robot = Robot::new(scenario, true_geometry, plan.start, seed);
    let mut gyro = GyroSensor::new(scenario.gyro, step_s, seed);
    let mut accelerometers = scenario.accelerometer.map(|settings| Accelerometers::new(settings, step_s, seed));
    let mut camera = scenario.camera.map(|camera| CameraSensor::new(camera, step_s, seed));
    // The counters are zeroed at the start, and the filter gets that reading: motion may begin with the first step.
    log.push(0, 0, SensorId::WHEELS, robot.wheel_angles());
    for (index, command) in plan.commands.iter().enumerate() {
        let step = index + 1;
        let moved = robot.advance(command);
        log.truth.push(robot.pose.into());
        log.wheel_turns.push(moved.wheels);
        log.push(step, step, SensorId::WHEELS, robot.wheel_angles());
        if let Some(sensors) = &mut accelerometers {
            let observed = sensors.observe(&moved);
            log.push(step, step, SensorId::ACCELEROMETER, observed);
        }
        log.push(step, step, SensorId::GYRO, gyro.observe(moved.turn_rad));
        if let Some(camera) = &mut camera {
            camera.observe(step, &robot.pose);
            if let Some(fix) = camera.next_arrival(step) {
                log.push(step, fix.taken_step, SensorId::CAMERA, fix.observed);
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
        prior: filter_prior(scenario, plan.start, true_geometry, seed),
    }
}

struct DriveLog {
    step: TimeDelta,
    truth: Vec<Pose<Arena>>,
    wheel_turns: Vec<WheelTurn>,
    arrivals: Vec<Arrival>,
}

impl DriveLog {
    fn push(&mut self, step: usize, taken: usize, sensor: SensorId, observed: ObservationKind) {
        self.arrivals.push(Arrival {
            step,
            observation: Observation {
                sensor,
                stamp: time_at(self.step, taken),
                stamp_sigma: TimeDelta::ZERO,
                measurement: observed,
            },
        });
    }
}

fn filter_prior(scenario: &Scenario, start: PlanarPose, true_geometry: DriveGeometry, seed: u64) -> FilterPrior {
    let prior = &scenario.told;
    let off = RandomStream::new(seed, "start").uniform(-1.0, 1.0);
    let off_rad = off * prior.start_heading_off_deg.to_radians();
    let known = |sigma| UncertainValue { value: 0.0, sigma };
    FilterPrior {
        geometry: match prior.geometry {
            PriorGeometry::Nominal => nominal_geometry(&scenario.robot),
            PriorGeometry::True => true_geometry,
        },
        noise: prior_noise(scenario),
        start: PlanarPose { heading_rad: start.heading_rad + off_rad, ..start }.into(),
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

// A robot's file gives the noise of a camera and of accelerometers whether or not there is one, so a filter is never configured
// with a sensor without noise. These are the values of the scenarios that have them.
const DEFAULT_FIX_SIGMA_M: f64 = 0.005;
const DEFAULT_FIX_SIGMA_DEG: f64 = 1.0;
const DEFAULT_ACCELEROMETER_SIGMA_M_PER_S2: f64 = 0.05;

fn prior_noise(scenario: &Scenario) -> SensorNoise {
    let gyro = &scenario.gyro;
    let camera = scenario.camera;
    SensorNoise {
        wheel_travel_m_per_sqrt_m: scenario.told.wheel_travel_m_per_sqrt_m,
        turn_rad_per_sqrt_rad: scenario.told.turn_rad_per_sqrt_rad,
        gyro_rad_per_s: gyro.sigma_deg_per_s.to_radians(),
        gyro_resolution_rad_per_s: gyro.resolution_deg_per_s.to_radians(),
        gyro_bias_rad_per_s: gyro.bias_sigma_deg_per_s.to_radians(),
        gyro_bias_walk_rad_per_s_sqrt_s: gyro.bias_walk_deg_per_s_sqrt_s.to_radians(),
        fix_position_m: camera.map_or(DEFAULT_FIX_SIGMA_M, |camera| camera.position_sigma_m),
        fix_heading_rad: camera.map_or(DEFAULT_FIX_SIGMA_DEG, |camera| camera.heading_sigma_deg).to_radians(),
        accelerometer_m_per_s2: scenario
            .accelerometer
            .map_or(DEFAULT_ACCELEROMETER_SIGMA_M_PER_S2, |settings| settings.sigma_m_per_s2),
        ..SensorNoise::EXACT
    }
}
