//! A path through poses by quintic splines, driven at a trapezoidal speed.
//!
//! ```text
//! p(u) = p0 h(u) + p1 (1 - h(u)) + t0 a(u) - t1 a(1 - u)        u from 0 to 1, second derivatives zero at both ends
//! h(u) = 1 - 10 u^3 + 15 u^4 - 6 u^5        a(u) = u - 6 u^3 + 8 u^4 - 3 u^5        t = scale |p1 - p0| (cos, sin)
//! ```
//! The Hermite basis of degree five follows from its six end conditions; the tests check them.

use posebridge_telemetry::quantities::wrap_rad;

use super::course::{Spline, distance_m};
use super::plan::{DrivePlan, StepCommand};
use super::pose::PlanarPose;

/// Points that stand for a leg of some metres; a millimetre apart.
const POINTS_PER_LEG: usize = 4_000;

/// A point of the way.
#[derive(Clone, Copy, Debug)]
struct Waypoint {
    /// Distance from the start along the way, in metres.
    along_m: f64,
    /// Direction of the way, unwrapped, in radians.
    heading_rad: f64,
}

/// The commands that follow a spline.
pub(super) fn plan(spline: &Spline, step_s: f64) -> DrivePlan {
    let way = sample_waypoints(spline);
    let length_m = way.last().map_or(0.0, |point| point.along_m);
    let profile = SpeedProfile::new(length_m, spline);
    let steps = (profile.duration_s() / step_s).ceil() as usize;
    let mut before = (0.0, heading_at(&way, 0.0));
    let commands = (1..=steps).map(|step| {
        let along_m = profile.along_m(step as f64 * step_s);
        let after = (along_m, heading_at(&way, along_m));
        let command = StepCommand { forward_m: after.0 - before.0, turn_rad: after.1 - before.1, side: None };
        before = after;
        command
    });
    let commands = commands.collect();
    let [x_m, y_m, heading_deg] = spline.poses_m_deg[0];
    DrivePlan { start: PlanarPose { x_m, y_m, heading_rad: wrap_rad(heading_deg.to_radians()) }, commands }
}

fn sample_waypoints(spline: &Spline) -> Vec<Waypoint> {
    let first_rad = spline.poses_m_deg[0][2].to_radians();
    let mut way = vec![Waypoint { along_m: 0.0, heading_rad: wrap_rad(first_rad) }];
    for (from, to) in spline.legs() {
        let tangent_m = spline.tangent_scale * distance_m(from, to);
        let mut last_m = (from[0], from[1]);
        for index in 1..=POINTS_PER_LEG {
            let u = index as f64 / POINTS_PER_LEG as f64;
            let point_m = point(from, to, tangent_m, u);
            let Some(before) = way.last().copied() else {
                break;
            };
            let (dx_m, dy_m) = (point_m.0 - last_m.0, point_m.1 - last_m.1);
            // The chord's direction is that of the way half a millimetre back, which does not matter here.
            let turn_rad = wrap_rad(dy_m.atan2(dx_m) - before.heading_rad);
            way.push(Waypoint {
                along_m: before.along_m + dx_m.hypot(dy_m),
                heading_rad: before.heading_rad + turn_rad,
            });
            last_m = point_m;
        }
    }
    way
}

/// A point of a leg.
fn point(from: [f64; 3], to: [f64; 3], tangent_m: f64, u: f64) -> (f64, f64) {
    let (begins, ends) = (position_weight(u), position_weight(1.0 - u));
    let leaves = tangent_m * tangent_weight(u);
    let arrives = -tangent_m * tangent_weight(1.0 - u);
    let (from_sin, from_cos) = from[2].to_radians().sin_cos();
    let (to_sin, to_cos) = to[2].to_radians().sin_cos();
    (
        from[0] * begins + to[0] * ends + leaves * from_cos + arrives * to_cos,
        from[1] * begins + to[1] * ends + leaves * from_sin + arrives * to_sin,
    )
}

/// h(u): 1 at 0, 0 at 1, without slope and curvature at both.
fn position_weight(u: f64) -> f64 {
    1.0 + u.powi(3) * (-10.0 + u * (15.0 - 6.0 * u))
}

/// a(u): slope 1 at 0, else zero with slope and curvature at both.
fn tangent_weight(u: f64) -> f64 {
    u + u.powi(3) * (-6.0 + u * (8.0 - 3.0 * u))
}

fn heading_at(way: &[Waypoint], along_m: f64) -> f64 {
    let index = way.partition_point(|point| point.along_m <= along_m);
    let before = way.get(index.saturating_sub(1));
    match (before, way.get(index)) {
        (Some(before), Some(after)) => {
            let share = (along_m - before.along_m) / (after.along_m - before.along_m);
            before.heading_rad + share * (after.heading_rad - before.heading_rad)
        }
        (Some(last), None) | (None, Some(last)) => last.heading_rad,
        (None, None) => 0.0,
    }
}

/// The distance over time: constant acceleration, constant speed, constant deceleration to rest.
struct SpeedProfile {
    length_m: f64,
    speed_m_per_s: f64,
    acceleration_m_per_s2: f64,
}

impl SpeedProfile {
    /// On a way that is too short for the full speed the fastest that can be reached.
    fn new(length_m: f64, spline: &Spline) -> Self {
        let reachable = (length_m * spline.acceleration_m_per_s2).sqrt();
        Self {
            length_m,
            speed_m_per_s: spline.speed_m_per_s.min(reachable).max(f64::MIN_POSITIVE),
            acceleration_m_per_s2: spline.acceleration_m_per_s2,
        }
    }

    fn ramp_s(&self) -> f64 {
        self.speed_m_per_s / self.acceleration_m_per_s2
    }

    fn duration_s(&self) -> f64 {
        self.length_m / self.speed_m_per_s + self.ramp_s()
    }

    fn along_m(&self, at_s: f64) -> f64 {
        let rest_s = (self.duration_s() - at_s).max(0.0);
        let ramp = |secs: f64| 0.5 * self.acceleration_m_per_s2 * secs * secs;
        if at_s < self.ramp_s() {
            ramp(at_s)
        } else if rest_s < self.ramp_s() {
            self.length_m - ramp(rest_s)
        } else {
            self.speed_m_per_s * (at_s - 0.5 * self.ramp_s())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope(weight: fn(f64) -> f64, u: f64) -> f64 {
        (weight(u + 1e-5) - weight(u - 1e-5)) / 2e-5
    }

    fn curvature(weight: fn(f64) -> f64, u: f64) -> f64 {
        (weight(u + 1e-4) - 2.0 * weight(u) + weight(u - 1e-4)) / 1e-8
    }

    #[test]
    fn the_weights_meet_their_six_end_conditions() {
        assert_eq!((position_weight(0.0), position_weight(1.0)), (1.0, 0.0));
        assert_eq!((tangent_weight(0.0), tangent_weight(1.0)), (0.0, 0.0));
        assert!((slope(tangent_weight, 0.0) - 1.0).abs() < 1e-6);
        for u in [0.0, 1.0] {
            assert!(slope(position_weight, u).abs() < 1e-6);
            assert!(curvature(position_weight, u).abs() < 1e-2);
            assert!(curvature(tangent_weight, u).abs() < 1e-2);
        }
        assert!(slope(tangent_weight, 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_trapezoid_covers_its_length_in_its_time() {
        let profile = SpeedProfile { length_m: 10.0, speed_m_per_s: 2.0, acceleration_m_per_s2: 2.0 };
        // 1 s and 1 m for each ramp, 8 m at 2 m/s between them.
        assert!((profile.duration_s() - 6.0).abs() < 1e-12);
        assert!((profile.along_m(1.0) - 1.0).abs() < 1e-12);
        assert!((profile.along_m(3.0) - 5.0).abs() < 1e-12);
        assert!((profile.along_m(5.5) - 9.75).abs() < 1e-12);
        assert_eq!(profile.along_m(9.0), 10.0);
    }
}
