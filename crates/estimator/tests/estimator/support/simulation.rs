//! A robot on squares with the noise that the filter is configured with, in a furnished room: truth and sensors. Seeded, in virtual time.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{
    Arena, ArenaMap, BeaconId, BrickClock, DriveGeometry, Fix, Heading, LandmarkId, Meters, MetersPerSecondSquared,
    Observation, ObservationKind, Point2, Radians, RadiansPerSecond, SensorId, SensorNoise, TimeDelta, Timestamp, Wall,
    quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::robot::{DEGREE, GEOMETRY, GEOMETRY_SIGMAS, NOISE, RADIUS_M, TRACK_M};

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

/// 10 Hz, 150 ± 50 ms late.
pub(crate) const CAMERA_10_HZ: Camera = Camera { every: 2, delay: 3, spread: 1, outliers: 0.0 };

/// One observation of a drive, with the step at which it arrives.
#[derive(Clone, Copy)]
pub(crate) struct Arrival {
    pub(crate) step: usize,
    pub(crate) observation: Observation,
}

/// What happened: the pose (x, y, heading) after each step, counted from 1, and the observations of it.
#[derive(Clone)]
pub(crate) struct Drive {
    pub(crate) poses: Vec<(f64, f64, f64)>,
    pub(crate) arrivals: Vec<Arrival>,
}

pub(crate) fn stamp(step: usize) -> Timestamp<BrickClock> {
    Timestamp::from_millis(step as i64 * 50)
}

/// Drives one lap of the square from a pose that no filter without a start would guess.
pub(crate) fn drive_lap_from_elsewhere(seed: u64) -> Drive {
    let mut world = RobotSimulation::new(seed);
    (world.x_m, world.y_m, world.heading_rad) = (3.2, -0.3, FRAC_PI_2);
    drive_steps(&mut world, commands(), None)
}

/// Drives one lap of the square.
pub(crate) fn drive_lap(camera: Option<Camera>, seed: u64) -> Drive {
    drive_steps(&mut RobotSimulation::new(seed), commands(), camera)
}

/// A robot that is lifted off its lap and put down elsewhere.
#[derive(Clone, Copy)]
pub(crate) struct Carry {
    /// The step before which it is lifted.
    pub(crate) from: usize,
    pub(crate) steps: usize,
    /// x, y and heading.
    pub(crate) by: (f64, f64, f64),
}

impl Carry {
    /// The first step on the floor again.
    pub(crate) const fn end(&self) -> usize {
        self.from + self.steps
    }
}

/// Drives one lap of the square, and is carried on the way: its wheels stand meanwhile, and its gyro turns.
pub(crate) fn drive_carried_lap(camera: Option<Camera>, carry: &Carry, seed: u64) -> Drive {
    let mut world = RobotSimulation::new(seed);
    let mut drive = Drive { poses: vec![], arrivals: vec![] };
    for (index, step) in commands().into_iter().enumerate() {
        for _ in (0..carry.steps).filter(|_| index + 1 == carry.from) {
            let share = 1.0 / carry.steps as f64;
            let (x_m, y_m, turn_rad) = carry.by;
            world.x_m += share * x_m;
            world.y_m += share * y_m;
            world.heading_rad = wrap_rad(world.heading_rad + share * turn_rad);
            drive.record(&mut world, share * turn_rad, camera);
        }
        drive.append(&mut world, step, camera);
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
    drive
}

/// A drive with steps of one's own, (distance, turn) each, in a world of one's own.
pub(crate) fn drive_steps(
    world: &mut RobotSimulation,
    steps: impl IntoIterator<Item = (f64, f64)>,
    camera: Option<Camera>,
) -> Drive {
    let mut drive = Drive { poses: vec![], arrivals: vec![] };
    for step in steps {
        drive.append(world, step, camera);
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
    drive
}

impl Drive {
    /// What was observed, in the order of arrival.
    pub(crate) fn observations(&self) -> Vec<Observation> {
        self.arrivals.iter().map(|arrival| arrival.observation).collect()
    }

    /// Moves the world by one step of (distance, turn) and takes down what happened.
    fn append(&mut self, world: &mut RobotSimulation, (distance_m, turn_rad): (f64, f64), camera: Option<Camera>) {
        let moved_rad = world.move_by(distance_m, turn_rad);
        self.record(world, moved_rad, camera);
    }

    /// Takes down a step in which the world has turned by `moved_rad`.
    fn record(&mut self, world: &mut RobotSimulation, moved_rad: f64, camera: Option<Camera>) {
        let step = self.poses.len() + 1;
        self.poses.push((world.x_m, world.y_m, world.heading_rad));
        let wheels = world.wheels();
        self.arrivals.push(arrival(step, step, SensorId::WHEELS, wheels));
        let rate = world.gyro(moved_rad);
        self.arrivals.push(arrival(step, step, SensorId::GYRO, rate));
        if let Some(camera) = camera.filter(|camera| step.is_multiple_of(camera.every)) {
            let (fix, late) = world.camera_fix(camera);
            self.arrivals.push(arrival(step + late, step, SensorId::CAMERA, fix));
        }
    }
}

/// Commanded (distance, turn) of each step: rest, then a square of 3 m at 0.2 m/s with turns in place, ramped.
fn commands() -> Vec<(f64, f64)> {
    let mut steps = vec![(0.0, 0.0); 40];
    for _ in 0..4 {
        steps.extend(ramp(SIDE_M, SPEED_M_PER_S).into_iter().map(|share| (share * SPEED_M_PER_S * STEP_S, 0.0)));
        steps.extend([(0.0, 0.0); 20]);
        steps.extend(ramp(FRAC_PI_2, TURN_RAD_PER_S).into_iter().map(|share| (0.0, share * TURN_RAD_PER_S * STEP_S)));
        steps.extend([(0.0, 0.0); 10]);
    }
    steps
}

const SIDE_M: f64 = 3.0;
const SPEED_M_PER_S: f64 = 0.2;
const TURN_RAD_PER_S: f64 = 1.0;

/// The share of full speed at each step of an amount that is covered at a speed, six steps longer for the ramps at both ends.
pub(crate) fn ramp(amount: f64, speed: f64) -> Vec<f64> {
    let total = (amount / (speed * STEP_S)).round() as usize + 6;
    (0..total).map(|k| (k + 1).min(total - k).min(7) as f64 / 7.0).collect()
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
    /// Play between each encoder and its wheel.
    pub(crate) backlash_rad: f64,
    /// By how much of the play each encoder is ahead of its wheel, -1/2 to 1/2: left, right.
    leads: [f64; 2],
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
            backlash_rad: 0.0,
            leads: [0.0; 2],
        };
        world.bias_rad_per_s = NOISE.gyro_bias_rad_per_s * world.normal();
        world
    }

    pub(crate) fn normal(&mut self) -> f64 {
        self.normals.sample(StandardNormal)
    }

    /// Draws the robot's geometry within [`GEOMETRY_SIGMAS`]; returns what the calibration should find.
    pub(crate) fn draw_geometry(&mut self) -> [f64; 3] {
        let [mean, difference, track] = GEOMETRY_SIGMAS.map(|sigma| sigma * self.normal());
        self.geometry = DriveGeometry {
            left_wheel_radius: Meters(RADIUS_M * (1.0 + mean - 0.5 * difference)),
            right_wheel_radius: Meters(RADIUS_M * (1.0 + mean + 0.5 * difference)),
            track_width: Meters(TRACK_M * (1.0 + track)),
            ..self.geometry
        };
        [mean, difference, track]
    }

    /// With this play, in which the gears stand anywhere at the start.
    pub(crate) fn with_backlash(mut self, backlash_rad: f64) -> Self {
        self.backlash_rad = backlash_rad;
        self.leads = [(); 2].map(|()| self.uniforms.random::<f64>() - 0.5);
        self
    }

    /// Moves as commanded, with the noise of the motion, and returns the true turn.
    fn move_by(&mut self, distance_m: f64, turn_rad: f64) -> f64 {
        let (left_m, right_m) = (
            distance_m - 0.5 * turn_rad * self.geometry.track_width.0,
            distance_m + 0.5 * turn_rad * self.geometry.track_width.0,
        );
        for (lead, travel_m) in self.leads.iter_mut().zip([left_m, right_m]).filter(|(_, travel_m)| *travel_m != 0.0) {
            *lead = 0.5 * travel_m.signum();
        }
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
        let [left_rad, right_rad] = self.leads.map(|lead| lead * self.backlash_rad);
        ObservationKind::WheelAngles {
            left: floored(self.left_rad + left_rad),
            right: floored(self.right_rad + right_rad),
        }
    }

    fn gyro(&mut self, moved_rad: f64) -> ObservationKind {
        let rate = moved_rad / STEP_S + self.bias_rad_per_s + NOISE.gyro_rad_per_s * self.normal();
        self.bias_rad_per_s += NOISE.gyro_bias_walk_rad_per_s_sqrt_s * STEP_S.sqrt() * self.normal();
        ObservationKind::TurnRate(RadiansPerSecond((rate / DEGREE).round() * DEGREE))
    }

    /// A fix of where the robot is, and by how many steps it is late.
    fn camera_fix(&mut self, camera: Camera) -> (ObservationKind, usize) {
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

/// Drives laps of a square on a grid with a geometry that is drawn for the run.
///
/// Even laps turn left and odd ones right, with one more quarter turn between laps. On the straights a controller that knows the
/// truth keeps the robot on the grid, so that runs of any length stay comparable.
pub(crate) fn drive_on_grid(laps: usize, camera: Option<Camera>, seed: u64) -> (Drive, DriveGeometry) {
    let mut world = RobotSimulation::new(seed);
    world.draw_geometry();
    let geometry = world.geometry;
    let mut grid =
        Grid { world, drive: Drive { poses: vec![], arrivals: vec![] }, camera, corner_m: (0.0, 0.0), target_rad: 0.0 };
    grid.rest(40);
    for lap in 0..laps {
        let quarter = if lap % 2 == 0 { FRAC_PI_2 } else { -FRAC_PI_2 };
        for _ in 0..4 {
            grid.straight();
            grid.rest(20);
            grid.turn(quarter);
            grid.rest(10);
        }
        grid.turn(quarter);
        grid.rest(20);
    }
    grid.drive.arrivals.sort_by_key(|arrival| arrival.step);
    (grid.drive, geometry)
}

struct Grid {
    world: RobotSimulation,
    drive: Drive,
    camera: Option<Camera>,
    /// Where the straight began, or should have.
    corner_m: (f64, f64),
    target_rad: f64,
}

impl Grid {
    fn step(&mut self, distance_m: f64, turn_rad: f64) {
        self.drive.append(&mut self.world, (distance_m, turn_rad), self.camera);
    }

    fn rest(&mut self, steps: usize) {
        for _ in 0..steps {
            self.step(0.0, 0.0);
        }
    }

    fn turn(&mut self, turn_rad: f64) {
        for part in parts(turn_rad.abs(), TURN_RAD_PER_S) {
            self.step(0.0, part.copysign(turn_rad));
        }
        self.target_rad = wrap_rad(self.target_rad + turn_rad);
    }

    fn straight(&mut self) {
        let (sin, cos) = self.target_rad.sin_cos();
        for part in parts(SIDE_M, SPEED_M_PER_S) {
            let (dx_m, dy_m) = (self.world.x_m - self.corner_m.0, self.world.y_m - self.corner_m.1);
            let left_m = cos * dy_m - sin * dx_m;
            let turn_rad = 0.1 * wrap_rad(self.target_rad - self.world.heading_rad) - 0.5 * left_m * 4.0 * STEP_S;
            self.step(part, turn_rad.clamp(-0.03, 0.03));
        }
        self.corner_m.0 += SIDE_M * cos;
        self.corner_m.1 += SIDE_M * sin;
    }
}

/// The parts of an amount, with ramps at both ends.
fn parts(amount: f64, speed: f64) -> Vec<f64> {
    let shares = ramp(amount, speed);
    let sum: f64 = shares.iter().sum();
    shares.iter().map(|share| amount * share / sum).collect()
}

/// What an accelerometer at each wheel feels at each step, with white noise of `sigma` m/s²: the change of the wheel's mean speed
/// from the step before to the step after.
pub(crate) fn add_accelerations(drive: &mut Drive, sigma: f64, seed: u64) {
    let mut normals = Pcg64::seed_from_u64(seed ^ 0xacce1);
    let speeds: Vec<[f64; 2]> = commands()
        .into_iter()
        .map(|(distance_m, turn_rad)| {
            let half_m = 0.5 * turn_rad * TRACK_M;
            [distance_m - half_m, distance_m + half_m].map(|travel_m| travel_m / STEP_S)
        })
        .collect();
    for (index, pair) in speeds.windows(2).enumerate() {
        let step = index + 1;
        let mut felt = |wheel: usize| {
            let noise: f64 = normals.sample(StandardNormal);
            MetersPerSecondSquared((pair[1][wheel] - pair[0][wheel]) / STEP_S + sigma * noise)
        };
        let felt = ObservationKind::WheelAccelerations { left: felt(0), right: felt(1) };
        drive.arrivals.push(arrival(step, step, SensorId::ACCELEROMETER, felt));
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
}

/// Landmarks and beacons around the square that is driven.
const POSITIONS_M: [(f64, f64); 4] = [(-1.0, -1.2), (4.1, -0.9), (3.9, 4.0), (-1.1, 4.2)];
/// The corners of the room, a wall between each and the next.
const CORNERS_M: [(f64, f64); 4] = [(-1.5, -1.5), (4.5, -1.5), (4.5, 4.5), (-1.5, 4.5)];

/// The world and the noise of its sensors, added to a configuration.
pub(crate) fn furnished(config: &FilterConfig) -> FilterConfig {
    let point = |(x, y)| Point2::new(Meters(x), Meters(y));
    let landmarks = POSITIONS_M.iter().enumerate();
    let beacons = POSITIONS_M.iter().enumerate();
    let next = CORNERS_M.iter().cycle().skip(1);
    let world = ArenaMap {
        landmarks: landmarks.map(|(i, at)| (LandmarkId(i as u32), point(*at))).collect(),
        beacons: beacons.map(|(i, at)| (BeaconId(10 + i as u32), point(*at))).collect(),
        walls: CORNERS_M.iter().zip(next).map(|(from, to)| Wall { from: point(*from), to: point(*to) }).collect(),
    };
    FilterConfig {
        arena_map: Arc::new(world),
        noise: SensorNoise {
            accelerometer_m_per_s2: 0.2,
            compass_rad: 3.0 * DEGREE,
            landmark_range_m: 0.03,
            landmark_bearing_rad: 2.0 * DEGREE,
            beacon_range_m: 0.05,
            wall_range_m: 0.01,
            ..config.noise
        },
        ..config.clone()
    }
}

/// The sensors, seeded: true pose in, measurements out.
pub(crate) struct SimulatedSensors {
    normals: Pcg64,
    world: Arc<ArenaMap>,
    noise: SensorNoise,
}

type Truth = (f64, f64, f64);

impl SimulatedSensors {
    pub(crate) fn new(config: &FilterConfig, seed: u64) -> Self {
        Self {
            normals: Pcg64::seed_from_u64(seed ^ 0x05e2_5e5e),
            world: Arc::clone(&config.arena_map),
            noise: config.noise,
        }
    }

    fn noisy(&mut self, value: f64, sigma: f64) -> f64 {
        let normal: f64 = self.normals.sample(StandardNormal);
        value + sigma * normal
    }

    /// Every landmark in front of the robot.
    pub(crate) fn landmarks(&mut self, (x_m, y_m, heading_rad): Truth) -> Vec<ObservationKind> {
        let world = Arc::clone(&self.world);
        let mut observations = vec![];
        for (id, position) in &world.landmarks {
            let (dx_m, dy_m) = (position.x.0 - x_m, position.y.0 - y_m);
            let bearing_rad = wrap_rad(dy_m.atan2(dx_m) - heading_rad);
            if bearing_rad.abs() < 60.0 * DEGREE {
                let range_m = self.noisy(dx_m.hypot(dy_m), self.noise.landmark_range_m);
                let bearing_rad = self.noisy(bearing_rad, self.noise.landmark_bearing_rad);
                observations.push(ObservationKind::Landmark {
                    id: *id,
                    range: Meters(range_m),
                    bearing: Radians(bearing_rad),
                });
            }
        }
        observations
    }

    /// Every beacon; ranges are true ones times (1 + scale) plus offset, each beacon with its own.
    pub(crate) fn beacons(&mut self, (x_m, y_m, _): Truth, errors: &[(f64, f64); 4]) -> Vec<ObservationKind> {
        let world = Arc::clone(&self.world);
        let of_each = world.beacons.iter().zip(errors);
        of_each
            .map(|((id, position), (offset_m, scale))| {
                let true_m = (position.x.0 - x_m).hypot(position.y.0 - y_m);
                let sigma_m = self.noise.beacon_range_m;
                ObservationKind::BeaconRange {
                    id: *id,
                    range: Meters(self.noisy(true_m * (1.0 + scale) + offset_m, sigma_m)),
                }
            })
            .collect()
    }

    /// The range straight ahead to the room's walls, whose sides lie along the arena's axes.
    pub(crate) fn wall(&mut self, (x_m, y_m, heading_rad): Truth) -> Vec<ObservationKind> {
        let (sin, cos) = heading_rad.sin_cos();
        let (low_m, high_m) = (CORNERS_M[0].0, CORNERS_M[2].0);
        let along = |at_m: f64, direction: f64| {
            let side_m = if direction > 0.0 { high_m } else { low_m };
            if direction == 0.0 { f64::INFINITY } else { (side_m - at_m) / direction }
        };
        let true_m = along(x_m, cos).min(along(y_m, sin));
        let range_m = self.noisy(true_m, self.noise.wall_range_m);
        vec![ObservationKind::WallRange(Meters(range_m.max(0.0)))]
    }

    pub(crate) fn compass(&mut self, (_, _, heading_rad): Truth) -> Vec<ObservationKind> {
        let heading_rad = self.noisy(heading_rad, self.noise.compass_rad);
        vec![ObservationKind::CompassHeading(Heading::from_rad(heading_rad))]
    }

    /// What the accelerometers feel between two steps of the same length.
    fn accelerations(&mut self, steps: [(f64, f64); 2]) -> Vec<ObservationKind> {
        let of_wheel = |side: f64| {
            let travel_m = steps.map(|(forward_m, turn_rad)| forward_m + side * turn_rad);
            (travel_m[1] - travel_m[0]) / (STEP_S * STEP_S)
        };
        let (left, right) = (of_wheel(-0.5 * TRACK_M), of_wheel(0.5 * TRACK_M));
        let sigma = self.noise.accelerometer_m_per_s2;
        vec![ObservationKind::WheelAccelerations {
            left: MetersPerSecondSquared(self.noisy(left, sigma)),
            right: MetersPerSecondSquared(self.noisy(right, sigma)),
        }]
    }
}

/// Lets a sensor measure after every so many steps of a drive, given the step's number from 1.
pub(crate) fn add(
    drive: &mut Drive,
    sensor: SensorId,
    every: usize,
    mut see: impl FnMut(usize, Truth) -> Vec<ObservationKind>,
) {
    for (index, truth) in drive.poses.iter().enumerate() {
        let step = index + 1;
        if !step.is_multiple_of(every) {
            continue;
        }
        for observed in see(step, *truth) {
            drive.arrivals.push(arrival(step, step, sensor, observed));
        }
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
}

/// Lets the accelerometers measure after every step of a drive.
pub(crate) fn add_accelerometers(drive: &mut Drive, senses: &mut SimulatedSensors) {
    let poses = drive.poses.clone();
    add(drive, SensorId::ACCELEROMETER, 1, |step, _| {
        let Some(first) = step.checked_sub(3) else {
            return vec![];
        };
        senses.accelerations([0, 1].map(|k| step_between(poses[first + k], poses[first + k + 1])))
    });
}

/// Length and turn of the step that leads from one pose to another, along its chord.
pub(crate) fn step_between(from: Truth, to: Truth) -> (f64, f64) {
    let (sin, cos) = from.2.sin_cos();
    let forward_m = cos * (to.0 - from.0) + sin * (to.1 - from.1);
    (forward_m, wrap_rad(to.2 - from.2))
}
