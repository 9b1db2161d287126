//! A robot on a square with the noise that the filter is told: truth and sensors. Seeded, in virtual time.

use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Fix, Heading, Meters, Observation, ObservationKind, Point2, Radians,
    RadiansPerSecond, SensorId, TimeDelta, Timestamp, quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::robot::{DEGREE, GEOMETRY, NOISE};

pub(crate) const STEP_S: f64 = 0.05;

/// An overhead camera; `every`, `delay` and `spread` count steps.
#[derive(Clone, Copy)]
pub(crate) struct Camera {
    pub(crate) every: usize,
    pub(crate) delay: usize,
    pub(crate) spread: usize,
    /// Share of the fixes that are half a metre off.
    pub(crate) outliers: f64,
}

pub(crate) struct Scenario {
    pub(crate) laps: usize,
    pub(crate) camera: Option<Camera>,
}

/// One observation of a drive, with the step at which it arrives.
pub(crate) struct Arrival {
    pub(crate) step: usize,
    pub(crate) observation: Observation,
}

/// What happened: the pose (x, y, heading) after each step, counted from 1, and what the sensors said of it.
pub(crate) struct Drive {
    pub(crate) poses: Vec<(f64, f64, f64)>,
    pub(crate) arrivals: Vec<Arrival>,
}

pub(crate) fn stamp(step: usize) -> Timestamp<BrickClock> {
    Timestamp::from_millis(step as i64 * 50)
}

/// Drives the squares of a scenario.
pub(crate) fn drive(scenario: &Scenario, seed: u64) -> Drive {
    let mut world = RobotSimulation::new(seed);
    let mut drive = Drive { poses: vec![], arrivals: vec![] };
    for (distance_m, turn_rad) in commands(scenario.laps) {
        drive.append(&mut world, (distance_m, turn_rad), scenario.camera);
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
    drive
}

impl Drive {
    /// Moves the world by one step of (distance, turn) and takes down what happened.
    pub(crate) fn append(
        &mut self,
        world: &mut RobotSimulation,
        (distance_m, turn_rad): (f64, f64),
        camera: Option<Camera>,
    ) {
        let step = self.poses.len() + 1;
        let moved_rad = world.move_by(distance_m, turn_rad);
        self.poses.push((world.x_m, world.y_m, world.heading_rad));
        let wheels = world.wheels();
        self.arrivals.push(arrival(step, step, SensorId::WHEELS, wheels));
        let rate = world.gyro(moved_rad);
        self.arrivals.push(arrival(step, step, SensorId::GYRO, rate));
        if let Some(camera) = camera.filter(|camera| step.is_multiple_of(camera.every)) {
            let (fix, late) = world.look(camera);
            self.arrivals.push(arrival(step + late, step, SensorId::CAMERA, fix));
        }
    }
}

/// Commanded (distance, turn) of each step: rest, then squares of 3 m at 0.2 m/s with turns in place, ramped.
pub(crate) fn commands(laps: usize) -> Vec<(f64, f64)> {
    let mut steps = vec![(0.0, 0.0); 40];
    for _ in 0..4 * laps {
        steps.extend(ramped(3.0, 0.2).map(|d| (d, 0.0)));
        steps.extend([(0.0, 0.0); 20]);
        steps.extend(ramped(std::f64::consts::FRAC_PI_2, 1.0).map(|turn| (0.0, turn)));
        steps.extend([(0.0, 0.0); 10]);
    }
    steps
}

/// The parts of an amount that is covered at a speed, six steps longer for the ramps at both ends.
fn ramped(amount: f64, speed: f64) -> impl Iterator<Item = f64> {
    let whole = (amount / (speed * STEP_S)).round() as usize;
    let total = whole + 6;
    (0..total).map(move |k| {
        let edge = (k + 1).min(total - k).min(6) as f64 / 7.0;
        let share = if k < 6 || k >= total - 6 { edge } else { 1.0 };
        share * speed * STEP_S
    })
}

pub(crate) struct RobotSimulation {
    normals: Pcg64,
    uniforms: Pcg64,
    /// The robot as it is, which its configuration need not know.
    pub(crate) geometry: DriveGeometry,
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    pub(crate) heading_rad: f64,
    left_rad: f64,
    right_rad: f64,
    pub(crate) bias_rad_per_s: f64,
}

impl RobotSimulation {
    pub(crate) fn new(seed: u64) -> Self {
        let mut world = Self {
            normals: Pcg64::seed_from_u64(seed),
            uniforms: Pcg64::seed_from_u64(seed ^ 0x5eed),
            geometry: GEOMETRY,
            x_m: 0.0,
            y_m: 0.0,
            heading_rad: 0.0,
            left_rad: 0.0,
            right_rad: 0.0,
            bias_rad_per_s: 0.0,
        };
        world.bias_rad_per_s = NOISE.gyro_bias_rad_per_s * world.normal();
        world
    }

    pub(crate) fn normal(&mut self) -> f64 {
        self.normals.sample(StandardNormal)
    }

    /// Moves as commanded, with the noise of the motion, and returns the true turn.
    fn move_by(&mut self, distance_m: f64, turn_rad: f64) -> f64 {
        let (left_m, right_m) = (
            distance_m - 0.5 * turn_rad * self.geometry.track_width.0,
            distance_m + 0.5 * turn_rad * self.geometry.track_width.0,
        );
        self.left_rad += left_m / self.geometry.left_wheel_radius.0;
        self.right_rad += right_m / self.geometry.right_wheel_radius.0;
        let left_m = self.travelled(left_m);
        let right_m = self.travelled(right_m);
        let true_m = 0.5 * (left_m + right_m);
        let mut moved_rad = (right_m - left_m) / self.geometry.track_width.0;
        moved_rad += NOISE.turn_rad_per_sqrt_rad * moved_rad.abs().sqrt() * self.normal();
        let chord = if moved_rad.abs() < 1e-9 { 1.0 } else { (0.5 * moved_rad).sin() / (0.5 * moved_rad) };
        let middle_rad = self.heading_rad + 0.5 * moved_rad;
        self.x_m += chord * true_m * middle_rad.cos();
        self.y_m += chord * true_m * middle_rad.sin();
        self.heading_rad = wrap_rad(self.heading_rad + moved_rad);
        moved_rad
    }

    fn travelled(&mut self, commanded_m: f64) -> f64 {
        commanded_m + NOISE.wheel_travel_m_per_sqrt_m * commanded_m.abs().sqrt() * self.normal()
    }

    fn wheels(&self) -> ObservationKind {
        let floored = |rad: f64| Radians((rad / DEGREE).floor() * DEGREE);
        ObservationKind::WheelAngles { left: floored(self.left_rad), right: floored(self.right_rad) }
    }

    fn gyro(&mut self, moved_rad: f64) -> ObservationKind {
        let rate = moved_rad / STEP_S + self.bias_rad_per_s + NOISE.gyro_rad_per_s * self.normal();
        self.bias_rad_per_s += NOISE.gyro_bias_walk_rad_per_s_sqrt_s * STEP_S.sqrt() * self.normal();
        ObservationKind::TurnRate(RadiansPerSecond((rate / DEGREE).round() * DEGREE))
    }

    /// A fix of where the robot is, and by how many steps it is late.
    fn look(&mut self, camera: Camera) -> (ObservationKind, usize) {
        let mut noise = [
            NOISE.fix_position_m * self.normal(),
            NOISE.fix_position_m * self.normal(),
            NOISE.fix_heading_rad * self.normal(),
        ];
        if self.uniforms.random::<f64>() < camera.outliers {
            noise = noise.map(|error| error + 0.5 * self.normal());
        }
        let late = camera.delay - camera.spread + self.uniforms.random_range(0..=2 * camera.spread);
        let fix = ObservationKind::Fix(Fix {
            position: Point2::<Arena>::new(Meters(self.x_m + noise[0]), Meters(self.y_m + noise[1])),
            heading: Some(Heading::from_rad(self.heading_rad + noise[2])),
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        });
        (fix, late)
    }
}

fn arrival(step: usize, taken: usize, sensor: SensorId, observed: ObservationKind) -> Arrival {
    let observation = Observation { sensor, stamp: stamp(taken), stamp_sigma: TimeDelta::ZERO, measurement: observed };
    Arrival { step, observation }
}
