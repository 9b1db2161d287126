//! Laps of a square on a grid by a robot whose geometry its configuration does not know, with the motion and the sensors of
//! `drive`.
//!
//! Even laps turn left and odd ones right, with one more quarter turn between laps. On the straights a controller that knows the
//! truth keeps the robot on the grid, so that runs of any length stay comparable.

use std::f64::consts::FRAC_PI_2;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{Calibration, DriveGeometry, Meters, UncertainValue, quantities::wrap_rad};

use super::drive::{Camera, Drive, RobotSimulation, STEP_S};
use super::robot::{RADIUS_M, TRACK_M, config};

const SIDE_M: f64 = 3.0;
const SPEED_M_PER_S: f64 = 0.2;
const TURN_RAD_PER_S: f64 = 1.0;

/// How wrong the geometry may be: one standard deviation, relative.
#[derive(Clone, Copy)]
pub(crate) struct GeometrySigmas {
    pub(crate) radius_scale: f64,
    pub(crate) radius_difference: f64,
    pub(crate) track_scale: f64,
}

/// A kit's wheels and a track that was measured with a ruler.
pub(crate) const KIT: GeometrySigmas =
    GeometrySigmas { radius_scale: 0.005, radius_difference: 0.005, track_scale: 0.03 };

/// The robot's configuration, told how wrong its geometry may be.
pub(crate) fn config_with(spread: GeometrySigmas) -> FilterConfig {
    let unknown = |sigma| UncertainValue { value: 0.0, sigma };
    FilterConfig {
        calibration: Calibration {
            radius_scale: unknown(spread.radius_scale),
            radius_difference: unknown(spread.radius_difference),
            track_scale: unknown(spread.track_scale),
            ..Calibration::default()
        },
        ..config()
    }
}

/// Drives laps with a geometry that is drawn for the run.
pub(crate) fn drive_on_grid(
    laps: usize,
    spread: GeometrySigmas,
    camera: Option<Camera>,
    seed: u64,
) -> (Drive, DriveGeometry) {
    let mut world = RobotSimulation::new(seed);
    let mean = 1.0 + spread.radius_scale * world.normal();
    let half_difference = 0.5 * spread.radius_difference * world.normal();
    world.geometry = DriveGeometry {
        left_wheel_radius: Meters(RADIUS_M * (mean - half_difference)),
        right_wheel_radius: Meters(RADIUS_M * (mean + half_difference)),
        track_width: Meters(TRACK_M * (1.0 + spread.track_scale * world.normal())),
        ..world.geometry
    };
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
        for part in ramped(turn_rad.abs(), TURN_RAD_PER_S) {
            self.step(0.0, part.copysign(turn_rad));
        }
        self.target_rad = wrap_rad(self.target_rad + turn_rad);
    }

    fn straight(&mut self) {
        let (sin, cos) = self.target_rad.sin_cos();
        for part in ramped(SIDE_M, SPEED_M_PER_S) {
            let (dx_m, dy_m) = (self.world.x_m - self.corner_m.0, self.world.y_m - self.corner_m.1);
            let left_m = cos * dy_m - sin * dx_m;
            let turn_rad = 0.1 * wrap_rad(self.target_rad - self.world.heading_rad) - 0.5 * left_m * 4.0 * STEP_S;
            self.step(part, turn_rad.clamp(-0.03, 0.03));
        }
        self.corner_m.0 += SIDE_M * cos;
        self.corner_m.1 += SIDE_M * sin;
    }
}

/// The parts of an amount that is covered at a speed, six steps longer for the ramps at both ends.
fn ramped(amount: f64, speed: f64) -> Vec<f64> {
    let total = (amount / (speed * STEP_S)).round() as usize + 6;
    let shares: Vec<f64> = (0..total).map(|k| (k + 1).min(total - k).min(7) as f64 / 7.0).collect();
    let sum: f64 = shares.iter().sum();
    shares.iter().map(|share| amount * share / sum).collect()
}
