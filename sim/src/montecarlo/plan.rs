//! The plan of a drive, step by step: laps of a square, a weave, or splines through poses at a trapezoidal speed.
//!
//! ```text
//! p(u) = p0 h(u) + p1 (1 - h(u)) + t0 a(u) - t1 a(1 - u)        u from 0 to 1, second derivatives zero at both ends
//! h(u) = 1 - 10 u^3 + 15 u^4 - 6 u^5        a(u) = u - 6 u^3 + 8 u^4 - 3 u^5        t = scale |p1 - p0| (cos, sin)
//! ```
//! The Hermite basis of degree five follows from its six end conditions; the tests check them.

use std::f64::consts::FRAC_PI_2;

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Arena, Heading, Meters, Pose};

use super::scenario::{Course, Laps, Spline, Weave, distance_m};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PlanarPose {
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    pub(super) heading_rad: f64,
}

impl PlanarPose {
    /// The pose `step` seen from this one, in the frame of this one.
    pub(super) fn compose(self, step: Self) -> Self {
        let (sin, cos) = self.heading_rad.sin_cos();
        Self {
            x_m: self.x_m + cos * step.x_m - sin * step.y_m,
            y_m: self.y_m + sin * step.x_m + cos * step.y_m,
            heading_rad: wrap_rad(self.heading_rad + step.heading_rad),
        }
    }

    pub(super) fn inverse(self) -> Self {
        let back = Self { heading_rad: -self.heading_rad, ..Self::default() };
        back.compose(Self { x_m: -self.x_m, y_m: -self.y_m, heading_rad: 0.0 })
    }
}

impl From<PlanarPose> for Pose<Arena> {
    fn from(pose: PlanarPose) -> Self {
        Self::new(Meters(pose.x_m), Meters(pose.y_m), Heading::from_rad(pose.heading_rad))
    }
}

/// Tolerance when an instant is compared with a step, in steps: decimal seconds are not exact in binary.
const SAME_STEP: f64 = 1e-6;

pub(super) fn first_step_from(at_s: f64, step_s: f64) -> usize {
    (at_s / step_s - SAME_STEP).ceil() as usize
}

pub(super) fn last_step_until(at_s: f64, step_s: f64) -> usize {
    (at_s / step_s + SAME_STEP).floor() as usize
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct StepCommand {
    pub(super) forward_m: f64,
    pub(super) turn_rad: f64,
    /// The line to follow; `None` except on a side.
    pub(super) side: Option<LineTracker>,
}

/// A controller that keeps the robot on a directed line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LineTracker {
    pub(super) from_m: (f64, f64),
    pub(super) heading_rad: f64,
    pub(super) heading_gain: f64,
    pub(super) lateral_gain_rad_per_m: f64,
    pub(super) most_turn_rad: f64,
}

impl LineTracker {
    pub(super) fn correction_rad(&self, pose: &PlanarPose) -> f64 {
        let (sin, cos) = self.heading_rad.sin_cos();
        let left_of_line_m = cos * (pose.y_m - self.from_m.1) - sin * (pose.x_m - self.from_m.0);
        let target_rad = self.heading_gain * wrap_rad(self.heading_rad - pose.heading_rad)
            - self.lateral_gain_rad_per_m * left_of_line_m;
        target_rad.clamp(-self.most_turn_rad, self.most_turn_rad)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct DrivePlan {
    pub(super) start: PlanarPose,
    pub(super) commands: Vec<StepCommand>,
}

impl DrivePlan {
    pub(super) fn new(course: &Course, step_s: f64) -> Self {
        match course {
            Course::Laps(laps) => Self::from_laps(laps, step_s),
            Course::Weave(weave) => Self::from_weave(weave, step_s),
            Course::Spline(spline) => spline_plan(spline, step_s),
        }
    }

    fn from_laps(laps: &Laps, step_s: f64) -> Self {
        let mut route = LapPlanner { laps: *laps, step_s, at_m: (0.0, 0.0), heading_rad: 0.0, commands: Vec::new() };
        route.push_rest(laps.rest_s);
        for lap in 0..laps.laps {
            // Left and right in turn, so that a wrong track width and unequal wheels do not look alike.
            let left = if lap % 2 == 0 { 1.0 } else { -1.0 };
            for _ in 0..4 {
                route.push_side();
                route.push_rest(laps.rest_after_side_s);
                route.push_turn(left * FRAC_PI_2);
                route.push_rest(laps.rest_after_turn_s);
            }
            route.push_turn(left * FRAC_PI_2);
            route.push_rest(laps.rest_after_lap_s);
        }
        Self { start: PlanarPose::default(), commands: route.commands }
    }

    fn from_weave(weave: &Weave, step_s: f64) -> Self {
        let steps = (weave.duration_s / step_s).round() as usize;
        let commands = (0..steps).map(|step| {
            let middle_s = (step as f64 + 0.5) * step_s;
            let rate = (weave.turn_pulsation_rad_per_s * middle_s).sin();
            StepCommand {
                forward_m: weave.speed_m_per_s * step_s,
                turn_rad: weave.turn_amplitude_rad_per_s * rate * step_s,
                side: None,
            }
        });
        Self { start: PlanarPose::default(), commands: commands.collect() }
    }
}

struct LapPlanner {
    laps: Laps,
    step_s: f64,
    at_m: (f64, f64),
    heading_rad: f64,
    commands: Vec<StepCommand>,
}

impl LapPlanner {
    fn push_rest(&mut self, rest_s: f64) {
        let steps = (rest_s / self.step_s).round() as usize;
        self.commands.extend(std::iter::repeat_n(StepCommand::default(), steps));
    }

    fn push_side(&mut self) {
        let laps = self.laps;
        let side = LineTracker {
            from_m: self.at_m,
            heading_rad: self.heading_rad,
            heading_gain: laps.heading_gain,
            lateral_gain_rad_per_m: laps.lateral_gain_rad_per_m,
            most_turn_rad: laps.most_turn_rad,
        };
        let parts = ramped(laps.side_m, laps.speed_m_per_s * self.step_s, laps.ramp_steps);
        self.commands.extend(parts.into_iter().map(|forward_m| StepCommand {
            forward_m,
            side: Some(side),
            ..StepCommand::default()
        }));
        let (sin, cos) = self.heading_rad.sin_cos();
        self.at_m.0 += laps.side_m * cos;
        self.at_m.1 += laps.side_m * sin;
    }

    fn push_turn(&mut self, turn_rad: f64) {
        let parts = ramped(turn_rad.abs(), self.laps.turn_rate_rad_per_s * self.step_s, self.laps.ramp_steps);
        let sign = turn_rad.signum();
        self.commands
            .extend(parts.into_iter().map(|part| StepCommand { turn_rad: sign * part, ..StepCommand::default() }));
        self.heading_rad = wrap_rad(self.heading_rad + turn_rad);
    }
}

/// Splits an amount into steps of about `per_step`; it ramps up and down over `ramp_steps`, which adds as many steps.
fn ramped(amount: f64, per_step: f64, ramp_steps: u32) -> Vec<f64> {
    let ramp = ramp_steps as usize;
    let total = ((amount / per_step).round() as usize).max(1) + ramp;
    let share = |step: usize| ((step + 1).min(total - step) as f64 / (ramp + 1) as f64).min(1.0);
    let whole: f64 = (0..total).map(share).sum();
    (0..total).map(|step| share(step) * amount / whole).collect()
}

/// Samples of a leg of some metres: about a millimetre apart.
const POINTS_PER_LEG: usize = 4_000;

#[derive(Clone, Copy, Debug)]
struct Waypoint {
    along_m: f64,
    /// Tangent of the path, unwrapped.
    heading_rad: f64,
}

fn spline_plan(spline: &Spline, step_s: f64) -> DrivePlan {
    let waypoints = sample_waypoints(spline);
    let length_m = waypoints.last().map_or(0.0, |point| point.along_m);
    let profile = SpeedProfile::new(length_m, spline);
    let steps = (profile.duration_s() / step_s).ceil() as usize;
    let mut before = (0.0, heading_at(&waypoints, 0.0));
    let commands = (1..=steps).map(|step| {
        let along_m = profile.along_m(step as f64 * step_s);
        let after = (along_m, heading_at(&waypoints, along_m));
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
    let mut waypoints = vec![Waypoint { along_m: 0.0, heading_rad: wrap_rad(first_rad) }];
    for (from, to) in spline.legs() {
        let tangent_m = spline.tangent_scale * distance_m(from, to);
        let mut last_m = (from[0], from[1]);
        for index in 1..=POINTS_PER_LEG {
            let u = index as f64 / POINTS_PER_LEG as f64;
            let point_m = point(from, to, tangent_m, u);
            let Some(before) = waypoints.last().copied() else {
                break;
            };
            let (dx_m, dy_m) = (point_m.0 - last_m.0, point_m.1 - last_m.1);
            // The chord's direction is that of the way half a millimetre back, which does not matter here.
            let turn_rad = wrap_rad(dy_m.atan2(dx_m) - before.heading_rad);
            waypoints.push(Waypoint {
                along_m: before.along_m + dx_m.hypot(dy_m),
                heading_rad: before.heading_rad + turn_rad,
            });
            last_m = point_m;
        }
    }
    waypoints
}

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

fn heading_at(waypoints: &[Waypoint], along_m: f64) -> f64 {
    let index = waypoints.partition_point(|point| point.along_m <= along_m);
    let before = waypoints.get(index.saturating_sub(1));
    match (before, waypoints.get(index)) {
        (Some(before), Some(after)) => {
            let share = (along_m - before.along_m) / (after.along_m - before.along_m);
            before.heading_rad + share * (after.heading_rad - before.heading_rad)
        }
        (Some(last), None) | (None, Some(last)) => last.heading_rad,
        (None, None) => 0.0,
    }
}

/// Trapezoidal speed profile: constant acceleration, constant speed, constant deceleration to rest.
struct SpeedProfile {
    length_m: f64,
    speed_m_per_s: f64,
    acceleration_m_per_s2: f64,
}

impl SpeedProfile {
    /// A path that is too short for full speed reaches the highest speed possible.
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

    #[test]
    fn a_ramped_amount_is_whole_six_steps_longer_and_even_in_the_middle() {
        let parts = ramped(3.0, 0.01, 6);
        assert_eq!(parts.len(), 306);
        // By hand: six parts of 1/7 to 6/7 at each end are worth six whole ones.
        assert!((parts[0] - 0.01 / 7.0).abs() < 1e-12);
        assert!((parts[6] - 0.01).abs() < 1e-12);
        assert_eq!(parts[5], parts[300]);
        for amount in [3.0, 1e-9, 0.02, 0.05] {
            let sum: f64 = ramped(amount, 0.01, 6).iter().sum();
            assert!((sum / amount - 1.0).abs() < 1e-12, "{amount} m, shorter than its ramps or not");
        }
    }

    #[test]
    fn left_of_the_line_the_controller_turns_right() {
        let side = LineTracker {
            from_m: (3.0, 0.0),
            heading_rad: FRAC_PI_2,
            heading_gain: 0.1,
            lateral_gain_rad_per_m: 0.1,
            most_turn_rad: 0.03,
        };
        // Heading north: 0.1 m west of the line is left of it; then off by 0.2 rad, and by more than can be corrected.
        for (x_m, heading_rad, expected_rad) in
            [(2.9, FRAC_PI_2, -0.01), (3.0, FRAC_PI_2 - 0.2, 0.02), (3.0, 0.0, 0.03)]
        {
            let correction_rad = side.correction_rad(&PlanarPose { x_m, y_m: 1.0, heading_rad });
            assert!((correction_rad - expected_rad).abs() < 1e-12, "{correction_rad}");
        }
    }

    #[test]
    fn the_weights_meet_their_six_end_conditions() {
        let slope = |weight: fn(f64) -> f64, u: f64| (weight(u + 1e-5) - weight(u - 1e-5)) / 2e-5;
        let curvature = |weight: fn(f64) -> f64, u: f64| (weight(u + 1e-4) - 2.0 * weight(u) + weight(u - 1e-4)) / 1e-8;
        for (weight, values, slopes) in
            [(position_weight as fn(f64) -> f64, [1.0, 0.0], [0.0, 0.0]), (tangent_weight, [0.0, 0.0], [1.0, 0.0])]
        {
            assert_eq!([weight(0.0), weight(1.0)], values);
            for (u, expected) in [0.0, 1.0].into_iter().zip(slopes) {
                assert!((slope(weight, u) - expected).abs() < 1e-6);
                assert!(curvature(weight, u).abs() < 1e-2);
            }
        }
    }

    #[test]
    fn a_trapezoid_covers_its_length_in_its_time() {
        let profile = SpeedProfile { length_m: 10.0, speed_m_per_s: 2.0, acceleration_m_per_s2: 2.0 };
        // 1 s and 1 m for each ramp, 8 m at 2 m/s between them.
        assert!((profile.duration_s() - 6.0).abs() < 1e-12);
        for (at_s, along_m) in [(1.0, 1.0), (3.0, 5.0), (5.5, 9.75), (9.0, 10.0)] {
            assert!((profile.along_m(at_s) - along_m).abs() < 1e-12, "{at_s} s");
        }
    }
}
