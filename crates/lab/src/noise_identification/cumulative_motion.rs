//! How far a robot has turned and driven at any instant, by its wheels or a foreign odometer; what a camera saw of it.

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{DriveGeometry, Observation, ObservationKind};

/// Turn and path since the beginning, at instants in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CumulativeMotion {
    /// Instant in seconds, turn in radians, path in metres.
    samples: Vec<[f64; 3]>,
}

/// What a camera saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSample {
    /// When, by the clock whose delay is asked for, in seconds.
    pub at_s: f64,
    /// x and y, in metres.
    pub position_m: [f64; 2],
    /// The heading, in radians, where it was seen.
    pub heading_rad: Option<f64>,
}

/// From the wheels' counts, or a foreign odometer where there are none.
pub fn cumulative_motion_of(observations: &[Observation], geometry: &DriveGeometry) -> CumulativeMotion {
    let has_wheels =
        observations.iter().any(|observation| matches!(observation.measurement, ObservationKind::WheelAngles { .. }));
    let mut levels = CumulativeMotion::default();
    let mut last: Option<[f64; 3]> = None;
    for observation in observations {
        let at_s = observation.stamp.as_secs_f64();
        if let ObservationKind::WheelAngles { left, right } = observation.measurement {
            let (left_m, right_m) = (left.0 * geometry.left_wheel_radius.0, right.0 * geometry.right_wheel_radius.0);
            let turn_rad = (right_m - left_m) / geometry.track_width.0;
            levels.push([at_s, turn_rad, 0.5 * (left_m + right_m)]);
        } else if let ObservationKind::OdometerPose(pose) = observation.measurement
            && !has_wheels
        {
            let [x, y, heading] = [pose.x.0, pose.y.0, pose.heading.rad()];
            let (turn, path) =
                last.map_or((0.0, 0.0), |[x0, y0, heading0]| (wrap_rad(heading - heading0), (x - x0).hypot(y - y0)));
            let [_, turned, driven] = levels.samples.last().copied().unwrap_or_default();
            levels.push([at_s, turned + turn, driven + path]);
            last = Some([x, y, heading]);
        }
    }
    levels
}

impl CumulativeMotion {
    /// Later than what is there, and finite; what is not is left out.
    fn push(&mut self, sample: [f64; 3]) {
        let is_later = self.samples.last().is_none_or(|last| last[0] < sample[0]);
        if is_later && sample.iter().all(|value| value.is_finite()) {
            self.samples.push(sample);
        }
    }

    /// From the first to the last instant, in seconds.
    pub fn time_range_s(&self) -> Option<(f64, f64)> {
        Some((self.samples.first()?[0], self.samples.last()?[0]))
    }

    /// Turn (`Of::Turn`) or path at an instant, between two samples by a straight line; `None` outside.
    pub(super) fn at(&self, at_s: f64, of: MotionAxis) -> Option<f64> {
        let after = self.samples.partition_point(|sample| sample[0] < at_s);
        let column = of as usize;
        let right = self.samples.get(after)?;
        if right[0] == at_s {
            return Some(right[column]);
        }
        let left = self.samples.get(after.checked_sub(1)?)?;
        let share = (at_s - left[0]) / (right[0] - left[0]);
        Some(left[column] + share * (right[column] - left[column]))
    }
}

/// Which level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MotionAxis {
    /// How far it has turned.
    Turn = 1,
    /// How far it has driven.
    Path = 2,
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Meters, Radians, SensorId, TimeDelta, Timestamp};

    fn wheels(at_s: f64, left: f64, right: f64) -> Observation {
        Observation {
            sensor: SensorId::WHEELS,
            stamp: Timestamp::from_secs_f64(at_s),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::WheelAngles { left: Radians(left), right: Radians(right) },
        }
    }

    #[test]
    fn turn_and_path_lie_on_a_line_between_two_counts() {
        let geometry = DriveGeometry {
            left_wheel_radius: Meters(0.03),
            right_wheel_radius: Meters(0.03),
            track_width: Meters(0.1),
            tick: Radians(0.01),
        };
        let observations =
            [wheels(0.0, 0.0, 0.0), wheels(1.0, 1.0, 2.0), wheels(0.5, 9.0, 9.0), wheels(2.0, f64::NAN, 0.0)];
        let levels = cumulative_motion_of(&observations, &geometry);
        assert_eq!(levels.time_range_s(), Some((0.0, 1.0)));
        assert!((levels.at(0.5, MotionAxis::Turn).unwrap() - 0.15).abs() < 1e-12);
        assert!((levels.at(0.5, MotionAxis::Path).unwrap() - 0.0225).abs() < 1e-12);
        assert_eq!(levels.at(1.1, MotionAxis::Path), None);
        assert_eq!(levels.at(-0.1, MotionAxis::Path), None);
    }
}
