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
//! Encoders measure `dphi_i`, without slip and kicks; the gyro measures the true turn. With play in the gears the commanded rotation is
//! the encoder's, and the wheel follows it through a dead zone. Every run has its own seed and every sensor its own
//! random stream, so a run can be repeated alone, and scenarios with the same seed, path and robot share their truth.

mod arena_sensors;
mod camera;
mod disturbances;
mod kidnapper;
mod limits;
mod observers;
mod plan;
mod prior;
mod robot;
mod scenario;
mod schedule;
mod slips;

use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Observation, ObservationKind, Pose, SensorId, TimeDelta, Timestamp,
};

use self::arena_sensors::ArenaSensor;
use self::camera::CameraSensor;
use self::kidnapper::Kidnapper;
use self::plan::{DrivePlan, first_step_from};
use self::robot::{Accelerometers, GyroSensor, Robot, true_geometry};

pub use crate::config_file::{ConfigFileError as ScenarioError, MAX_RUNS};
pub use crate::scenario::Blackout;
pub use disturbances::{FixBursts, Kidnaps, Patches, SlipBursts};
pub use limits::Limits;
pub use observers::{Beacons, Compass, DrawnValue, Landmarks, SensorPlace, StampErrors};
pub use prior::FilterPrior;
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
    /// The steps after which the robot is at a pose that a filter does not know: after a kidnap, and the start if it is unknown.
    pub landings: Vec<usize>,
    /// The first step of each slip burst.
    pub slip_bursts: Vec<usize>,
    pub prior: FilterPrior,
}

/// An observation and the step at whose end it arrives; its own timestamp may be earlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// 0 is the start.
    pub step: usize,
    /// The step at whose end it was measured; its timestamp may differ.
    pub measured_step: usize,
    pub observation: Observation,
}

impl Drive {
    /// End of a step; the start is the clock's zero.
    pub fn time_at(&self, step: usize) -> Timestamp<BrickClock> {
        Timestamp::from_nanos(self.step.as_nanos().saturating_mul(step as i64))
    }

    fn push(&mut self, step: usize, sensor: SensorId, observed: ObservationKind) {
        self.push_late(step, step, sensor, observed, TimeDelta::ZERO);
    }

    /// `stamp_late_by` is how much later than the measurement its timestamp is.
    fn push_late(
        &mut self,
        step: usize,
        measured_step: usize,
        sensor: SensorId,
        observed: ObservationKind,
        stamp_late_by: TimeDelta,
    ) {
        let stamp = self.time_at(measured_step) + stamp_late_by;
        let observation = Observation { sensor, stamp, stamp_sigma: TimeDelta::ZERO, measurement: observed };
        self.arrivals.push(Arrival { step, measured_step, observation });
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
        let mut plan = DrivePlan::new(&self.path, step_s);
        let kidnapper = self.kidnaps.map(|kidnaps| Kidnapper::new(&kidnaps, self, seed));
        if let Some(kidnapper) = &kidnapper {
            kidnapper.pause(&mut plan.commands);
        }
        let true_geometry = true_geometry(self, seed);
        let mut robot = Robot::new(self, true_geometry, plan.start, seed);
        let mut gyro = GyroSensor::new(self.gyro, step_s, seed);
        let mut accelerometers = self.accelerometer.map(|settings| Accelerometers::new(settings, step_s, seed));
        let cameras = [(self.camera, "camera"), (self.second_camera, "second camera")];
        let cameras = (0..).zip(cameras).filter_map(|(index, (camera, name))| {
            Some((SensorId::camera(index), CameraSensor::new(camera?, name, self, seed)))
        });
        let mut cameras: Vec<(SensorId, CameraSensor)> = cameras.collect();
        let mut arena_sensors = ArenaSensor::all(self, seed);
        let steps = plan.commands.len();
        let unknown_start = self.told.start_is_unknown.then_some(0);
        let kidnaps = kidnapper.as_ref().map(|kidnapper| kidnapper.landings(steps));
        let mut drive = Drive {
            step: TimeDelta::from_secs_f64(step_s),
            truth: vec![plan.start.into()],
            wheel_turns: Vec::new(),
            arrivals: Vec::new(),
            scored_from: first_step_from(self.score_from_s, step_s).max(1),
            true_geometry,
            landings: unknown_start.into_iter().chain(kidnaps.into_iter().flatten()).collect(),
            slip_bursts: robot.slip_bursts(steps),
            prior: FilterPrior::new(self, plan.start, true_geometry, seed),
        };
        // The counters are zeroed at the start, and the filter gets that reading: motion may begin with the first step.
        drive.push(0, SensorId::WHEELS, robot.wheel_angles());
        for (index, command) in plan.commands.iter().enumerate() {
            let step = index + 1;
            let carried = kidnapper.as_ref().and_then(|kidnapper| kidnapper.carry(step, &mut robot));
            let moved = carried.unwrap_or_else(|| robot.advance(step, command));
            drive.truth.push(robot.pose.into());
            drive.wheel_turns.push(moved.wheels);
            drive.push(step, SensorId::WHEELS, robot.wheel_angles());
            if let Some(sensors) = &mut accelerometers {
                drive.push(step, SensorId::ACCELEROMETER, sensors.observe(&moved));
            }
            drive.push(step, SensorId::GYRO, gyro.observe(moved.turn_rad));
            for (id, camera) in &mut cameras {
                camera.observe(step, &robot.pose);
                if let Some(fix) = camera.next_arrival(step) {
                    let late_by = camera.stamps.late_by(fix.taken_step as f64 * step_s);
                    drive.push_late(step, fix.taken_step, *id, fix.observed, late_by);
                }
            }
            for sensor in &mut arena_sensors {
                sensor.observe(step, &robot.pose);
                for measured in sensor.arrivals(step) {
                    let late_by = sensor.stamps.late_by(measured.taken_step as f64 * step_s);
                    drive.push_late(step, measured.taken_step, sensor.id, measured.observed, late_by);
                }
            }
        }
        drive
    }
}
