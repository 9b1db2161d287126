//! The brick's own dead reckoning: encoder counts and the nominal geometry.

use posebridge_telemetry::{DriveGeometry, Heading, Meters, Odom, Pose};

use crate::wheels::PerWheel;

/// A pose integrated from encoder counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DeadReckoning {
    metres_per_count: PerWheel<f64>,
    track_m: f64,
    last: PerWheel<i64>,
    pose: Pose<Odom>,
}

impl DeadReckoning {
    /// Dead reckoning from the origin, with counters at zero.
    pub(crate) fn new(geometry: &DriveGeometry) -> Self {
        Self {
            metres_per_count: PerWheel {
                left: geometry.left_wheel_radius.0 * geometry.tick.0,
                right: geometry.right_wheel_radius.0 * geometry.tick.0,
            },
            track_m: geometry.track_width.0,
            last: PerWheel::default(),
            pose: Pose::default(),
        }
    }

    /// Takes the counters' totals and returns the pose.
    pub(crate) fn update(&mut self, counts: PerWheel<i64>) -> Pose<Odom> {
        let travel = counts
            .zip(self.last)
            .zip(self.metres_per_count)
            .map(|((after, before), scale)| (after - before) as f64 * scale);
        self.last = counts;
        let forward_m = 0.5 * (travel.left + travel.right);
        let turn_rad = (travel.right - travel.left) / self.track_m;
        let heading_rad = self.pose.heading.rad();
        let (sin, cos) = (heading_rad + 0.5 * turn_rad).sin_cos();
        self.pose = Pose::new(
            Meters(self.pose.x.0 + forward_m * cos),
            Meters(self.pose.y.0 + forward_m * sin),
            Heading::from_rad(heading_rad + turn_rad),
        );
        self.pose
    }

    /// The counters were zeroed: the pose stays, the next totals count from zero.
    pub(crate) fn counters_zeroed(&mut self) {
        self.last = PerWheel::default();
    }

    /// The pose since the beginning.
    pub(crate) const fn pose(&self) -> Pose<Odom> {
        self.pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    #[test]
    fn one_update_over_a_bend_goes_along_the_middle_of_it() {
        let mut reckoning = DeadReckoning::new(&Scenario::default().drive_geometry());
        // 90 degrees of the right wheel are 14 pi mm: a turn of pi/8 over 112 mm, half that way forward.
        let pose = reckoning.update(PerWheel { left: 0, right: 90 });
        let turn_rad = std::f64::consts::PI / 8.0;
        assert!((pose.heading.rad() - turn_rad).abs() < 1e-12);
        assert!((pose.y.0.atan2(pose.x.0) - 0.5 * turn_rad).abs() < 1e-12);
        assert!((pose.x.0.hypot(pose.y.0) - 0.007 * std::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn zeroed_counters_are_no_motion() {
        let mut reckoning = DeadReckoning::new(&Scenario::default().drive_geometry());
        let before = reckoning.update(PerWheel { left: 100, right: 100 });
        reckoning.counters_zeroed();
        assert_eq!(reckoning.update(PerWheel::default()), before);
    }
}
