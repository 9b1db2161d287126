//! Landmarks, beacons, walls and a compass for the robot of `drive`: a furnished world, and what sensors say of it.

use std::sync::Arc;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{
    ArenaMap, BeaconId, Heading, LandmarkId, Meters, MetersPerSecondSquared, Observation, ObservationKind, Point2,
    Radians, SensorId, SensorNoise, TimeDelta, Wall, quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::drive::{Arrival, Drive, STEP_S, stamp};
use super::robot::{DEGREE, TRACK_M};

/// Landmarks and beacons around the square that is driven.
const PLACES_M: [(f64, f64); 4] = [(-1.0, -1.2), (4.1, -0.9), (3.9, 4.0), (-1.1, 4.2)];
/// The corners of the room, a wall between each and the next.
const CORNERS_M: [(f64, f64); 4] = [(-1.5, -1.5), (4.5, -1.5), (4.5, 4.5), (-1.5, 4.5)];

/// The world and the noise of its sensors, added to a configuration.
pub(crate) fn furnished(config: &FilterConfig) -> FilterConfig {
    let place = |(x, y)| Point2::new(Meters(x), Meters(y));
    let landmarks = PLACES_M.iter().enumerate();
    let beacons = PLACES_M.iter().enumerate();
    let next = CORNERS_M.iter().cycle().skip(1);
    let world = ArenaMap {
        landmarks: landmarks.map(|(i, at)| (LandmarkId(i as u32), place(*at))).collect(),
        beacons: beacons.map(|(i, at)| (BeaconId(10 + i as u32), place(*at))).collect(),
        walls: CORNERS_M.iter().zip(next).map(|(from, to)| Wall { from: place(*from), to: place(*to) }).collect(),
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

/// The sensors, seeded: true pose in, what they say out.
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
        let mut seen = vec![];
        for (id, place) in &world.landmarks {
            let (dx_m, dy_m) = (place.x.0 - x_m, place.y.0 - y_m);
            let bearing_rad = wrap_rad(dy_m.atan2(dx_m) - heading_rad);
            if bearing_rad.abs() < 60.0 * DEGREE {
                let range_m = self.noisy(dx_m.hypot(dy_m), self.noise.landmark_range_m);
                let bearing_rad = self.noisy(bearing_rad, self.noise.landmark_bearing_rad);
                seen.push(ObservationKind::Landmark { id: *id, range: Meters(range_m), bearing: Radians(bearing_rad) });
            }
        }
        seen
    }

    /// Every beacon; ranges are true ones times (1 + scale) plus offset, each beacon with its own.
    pub(crate) fn beacons(&mut self, (x_m, y_m, _): Truth, errors: &[(f64, f64); 4]) -> Vec<ObservationKind> {
        let world = Arc::clone(&self.world);
        let of_each = world.beacons.iter().zip(errors);
        of_each
            .map(|((id, place), (offset_m, scale))| {
                let true_m = (place.x.0 - x_m).hypot(place.y.0 - y_m);
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
    pub(crate) fn accelerations(&mut self, steps: [(f64, f64); 2]) -> Vec<ObservationKind> {
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

/// Lets a sensor speak after every so many steps of a drive, told the step's number from 1.
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
            let observation =
                Observation { sensor, stamp: stamp(step), stamp_sigma: TimeDelta::ZERO, measurement: observed };
            drive.arrivals.push(Arrival { step, observation });
        }
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
}

/// Length and turn of the step that leads from one pose to another, along its chord.
pub(crate) fn step_between(from: Truth, to: Truth) -> (f64, f64) {
    let (sin, cos) = from.2.sin_cos();
    let forward_m = cos * (to.0 - from.0) + sin * (to.1 - from.1);
    (forward_m, wrap_rad(to.2 - from.2))
}
