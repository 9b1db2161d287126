//! Drives for Monte-Carlo experiments: truth and sensors on a fixed grid of steps, without brick, link, clock or estimator.
//!
//! A [`Scenario`] holds every number; [`Scenario::drive`] draws one run of it: the observations in the order of arrival, the truth at each
//! step, and the [`FilterPrior`] from which the experiment builds a filter.
//!
//! # Model
//! ```text
//! dphi_i = s_i / r_i          wheel rotation of the commanded travel s_L, s_R = ds -+ b dth / 2, with the true r_i and b
//! s_i   <- s_i + k_w sqrt|s_i| n                                     travel of wheel i, with slip
//! dth    = (s_R - s_L) / b    dth <- dth + k_t sqrt|dth| n + kick    true turn
//! (x, y) <- the chord of an exact arc of length (s_L + s_R) / 2 and turn dth
//! n   standard normal, drawn anew each time
//! ```
//! Encoders measure `dphi_i`, without slip and kicks; the gyro measures the true turn. Every run has its own seed and every sensor its own
//! random stream, so a run can be repeated alone, and scenarios with the same seed, path and robot share their truth.

mod plan;
mod robot;
mod scenario;

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, DriveGeometry, Observation, ObservationKind, Pose, SensorId, SensorNoise,
    TimeDelta, Timestamp, UncertainValue,
};

use self::plan::{DrivePlan, PlanarPose, first_step_from};
use self::robot::{Accelerometers, CameraSensor, GyroSensor, Robot, nominal_geometry, true_geometry};
use crate::random::RandomStream;

pub use crate::config_file::{ConfigFileError as ScenarioError, MAX_RUNS};
pub use crate::scenario::Blackout;
pub use robot::WheelTurn;
pub use scenario::{
    Accelerometer, Camera, CameraSees, Course, GeometryErrors, Gyro, Kicks, Laps, MotionNoise, NominalRobot, Outliers,
    PriorGeometry, PriorSettings, SCENARIOS, Scenario, Spline, Weave,
};

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
        Timestamp::from_nanos(self.step.as_nanos().saturating_mul(step as i64))
    }

    fn push(&mut self, step: usize, taken: usize, sensor: SensorId, observed: ObservationKind) {
        let stamp = self.time_at(taken);
        let observation = Observation { sensor, stamp, stamp_sigma: TimeDelta::ZERO, measurement: observed };
        self.arrivals.push(Arrival { step, observation });
    }
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
        let seed = run_seed(self.seed, run);
        let step_s = self.step_s;
        let plan = DrivePlan::new(&self.path, step_s);
        let true_geometry = true_geometry(self, seed);
        let mut robot = Robot::new(self, true_geometry, plan.start, seed);
        let mut gyro = GyroSensor::new(self.gyro, step_s, seed);
        let mut accelerometers = self.accelerometer.map(|settings| Accelerometers::new(settings, step_s, seed));
        let mut camera = self.camera.map(|camera| CameraSensor::new(camera, step_s, seed));
        let mut drive = Drive {
            step: TimeDelta::from_secs_f64(step_s),
            truth: vec![plan.start.into()],
            wheel_turns: Vec::new(),
            arrivals: Vec::new(),
            scored_from: first_step_from(self.score_from_s, step_s).max(1),
            true_geometry,
            prior: filter_prior(self, plan.start, true_geometry, seed),
        };
        // The counters are zeroed at the start, and the filter gets that reading: motion may begin with the first step.
        drive.push(0, 0, SensorId::WHEELS, robot.wheel_angles());
        for (index, command) in plan.commands.iter().enumerate() {
            let step = index + 1;
            let moved = robot.advance(command);
            drive.truth.push(robot.pose.into());
            drive.wheel_turns.push(moved.wheels);
            drive.push(step, step, SensorId::WHEELS, robot.wheel_angles());
            if let Some(sensors) = &mut accelerometers {
                drive.push(step, step, SensorId::ACCELEROMETER, sensors.observe(&moved));
            }
            drive.push(step, step, SensorId::GYRO, gyro.observe(moved.turn_rad));
            if let Some(camera) = &mut camera {
                camera.observe(step, &robot.pose);
                if let Some(fix) = camera.next_arrival(step) {
                    drive.push(step, fix.taken_step, SensorId::CAMERA, fix.observed);
                }
            }
        }
        drive
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
