//! One scenario for several robots, side by side in one arena.

use super::{Scenario, ScenarioError};
use crate::config_file::LAST_VEHICLE_SYSTEM;
use crate::path::Path;

/// Robots and cameras are switched on one after the other: offset between the clocks of neighbours.
const SWITCHED_ON_APART_MICROS: u64 = 1_234_567;
/// Distance between the paths of two robots, relative to the extent of a path.
const SPACING: f64 = 1.5;

/// Largest relative difference of a robot's wheel radii from the scenario's, and between its two wheels: what UMBmark reports find for
/// LEGO tyres.
const RADIUS_SPREAD: f64 = 0.005;
/// Largest relative difference of the track.
const TRACK_SPREAD: f64 = 0.02;

/// A number in -1 to 1 for each robot, 0 for the first; evenly distributed, because multiples of an irrational `step` are.
fn spread(index: u8, step: f64) -> f64 {
    let turns = f64::from(index) * step;
    2.0 * (turns - turns.round())
}

impl Scenario {
    /// The scenario for `count` robots in rows and columns. Each has its own seed and MAVLink system, counted up from those of the
    /// scenario, a clock offset, and its own wheels and track. The first is the scenario itself.
    ///
    /// # Errors
    /// [`ScenarioError::TooManyRobots`] if there are not enough systems for vehicles.
    pub fn side_by_side(&self, count: u8) -> Result<Vec<Self>, ScenarioError> {
        let systems = (LAST_VEHICLE_SYSTEM + 1).saturating_sub(self.brick.system);
        if count > systems {
            return Err(ScenarioError::TooManyRobots { count, first: self.brick.system, most: systems });
        }
        let columns = f64::from(count).sqrt().ceil() as u8;
        let distance_m = SPACING * self.extent_m();
        let robots = (0..count).map(|index| {
            let mut robot = self.clone().with_seed(self.seed.wrapping_add(u64::from(index)));
            robot.brick.system += index;
            let switched_on_before = u64::from(index) * SWITCHED_ON_APART_MICROS;
            robot.brick.clock_start_micros += switched_on_before;
            robot.camera.clock_start_micros += switched_on_before;
            robot.errors.radius_error += RADIUS_SPREAD * spread(index, 0.618);
            robot.errors.radius_mismatch += RADIUS_SPREAD * spread(index, 0.414);
            robot.errors.track_error += TRACK_SPREAD * spread(index, 0.732);
            robot.start.x_m += f64::from(index % columns) * distance_m;
            robot.start.y_m += f64::from(index / columns) * distance_m;
            robot
        });
        Ok(robots.collect())
    }

    /// Longer side of the bounding box of the path.
    fn extent_m(&self) -> f64 {
        let points = Path::new(self).polyline();
        let extent = |coordinates: &mut dyn Iterator<Item = f64>| {
            let (low, high) = coordinates
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
            high - low
        };
        let along_x = extent(&mut points.iter().map(|point| point.x.0));
        let along_y = extent(&mut points.iter().map(|point| point.y.0));
        along_x.max(along_y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_differ_in_system_seed_clock_wheels_and_place_and_the_first_is_the_scenario() {
        let scenario = Scenario::default().with_seed(7);
        let robots = scenario.side_by_side(5).unwrap();
        assert_eq!(robots[0], scenario);
        // A square of one metre, three in a row.
        let positions = [(0.0, 0.0), (1.5, 0.0), (3.0, 0.0), (0.0, 1.5), (1.5, 1.5)];
        for ((index, robot), (x_m, y_m)) in (0_u8..).zip(&robots).zip(positions) {
            assert_eq!((robot.brick.system, robot.seed), (1 + index, 7 + u64::from(index)));
            assert!((robot.start.x_m - x_m).hypot(robot.start.y_m - y_m) < 1e-9, "{:?}", robot.start);
        }
        assert!(robots.is_sorted_by(|one, next| one.brick.clock_start_micros < next.brick.clock_start_micros));
        let mut radii: Vec<f64> = robots.iter().map(|robot| robot.errors.radius_error).collect();
        radii.sort_by(f64::total_cmp);
        assert!(radii.windows(2).all(|pair| pair[1] - pair[0] > 1e-4), "{radii:?}");
    }

    #[test]
    fn more_robots_than_systems_are_refused() {
        let mut scenario = Scenario::default();
        assert_eq!(scenario.side_by_side(250).unwrap().last().unwrap().brick.system, 250);
        scenario.brick.system = 240;
        let message = scenario.side_by_side(12).unwrap_err().to_string();
        assert!(message.contains("12 robots") && message.contains("at most 11"), "{message}");
        // Of ground stations; no file may give it.
        scenario.brick.system = 255;
        let message = scenario.side_by_side(1).unwrap_err().to_string();
        assert!(message.contains("at most 0"), "{message}");
    }
}
