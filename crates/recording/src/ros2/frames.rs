//! The two frames between `map` and the robot.
//!
//! # Model
//! ```text
//! odom -> base_link    continuous: the estimate's speeds integrated, d = v dt sinc(w dt / 2) along the heading in the middle of dt
//! map  -> odom         the rest: T_map_base_link * inverse(T_odom_base_link); it takes the jumps of the estimate
//! ```
//! While the estimate is relative, it is itself `odom -> base_link`, and there is no `map`.
//!
//! # Sources
//! REP 105: `odom` is continuous and drifts, `map` does not drift and may jump.

use posebridge_telemetry::{
    Arena, Body, BrickClock, Estimate, Heading, Meters, Odom, Pose, TimeDelta, Timestamp, Transform2,
};

/// Over a longer gap nothing is known of the motion: `odom` stands still, and `map -> odom` takes it.
const LONGEST_STEP: TimeDelta = TimeDelta::from_millis(1_000);

/// The odometry frame of a robot.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OdometryFrame {
    odom_from_body: Pose<Odom>,
    last: Option<Speeds>,
}

#[derive(Clone, Copy, Debug)]
struct Speeds {
    stamp: Timestamp<BrickClock>,
    forward_m_per_s: f64,
    turn_rad_per_s: f64,
}

impl OdometryFrame {
    /// Moves the robot in its odometry frame to the instant of the estimate.
    pub(super) fn advance(&mut self, estimate: &Estimate) {
        let is_moving = estimate.validity.speeds;
        let now = Speeds {
            stamp: estimate.stamp,
            forward_m_per_s: if is_moving { estimate.forward_speed.0 } else { 0.0 },
            turn_rad_per_s: if is_moving { estimate.turn_rate.0 } else { 0.0 },
        };
        if estimate.is_relative() {
            let Pose { x, y, heading, .. } = estimate.pose;
            self.odom_from_body = Pose::new(x, y, heading);
        } else if let Some(last) = self.last {
            self.integrate(last, now);
        }
        self.last = Some(now);
    }

    fn integrate(&mut self, last: Speeds, now: Speeds) {
        let step = now.stamp - last.stamp;
        // A late fix makes a second estimate for an instant; the clock of a robot that restarted begins anew.
        if step <= TimeDelta::ZERO || step > LONGEST_STEP {
            return;
        }
        let seconds = step.as_secs_f64();
        let way_m = 0.5 * (last.forward_m_per_s + now.forward_m_per_s) * seconds;
        let turn_rad = 0.5 * (last.turn_rad_per_s + now.turn_rad_per_s) * seconds;
        let chord_m = way_m * sinc(0.5 * turn_rad);
        let (sin, cos) = (0.5 * turn_rad).sin_cos();
        let moved = Pose::<Body>::new(Meters(chord_m * cos), Meters(chord_m * sin), Heading::from_rad(turn_rad));
        self.odom_from_body = self.odom_from_body * moved;
    }

    pub(super) const fn odom_from_body(&self) -> Pose<Odom> {
        self.odom_from_body
    }

    /// Where the odometry frame lies, when the robot has this pose in the arena.
    pub(super) fn arena_from_odom(&self, arena_from_body: Pose<Arena>) -> Transform2<Arena, Odom> {
        arena_from_body * self.odom_from_body.inverse()
    }
}

fn sinc(angle_rad: f64) -> f64 {
    if angle_rad.abs() < 1e-4 { 1.0 - angle_rad * angle_rad / 6.0 } else { angle_rad.sin() / angle_rad }
}
