//! The program on the brick and its MAVLink messages; other protocols are [personalities](crate::personality). It reads its own clock,
//! encoder counts and inertial readings, the nominal geometry, and the station's messages, never the true state.

mod follower;
mod messages;
mod onboard_pose;
mod speed_control;

use posebridge_protocol::message::{Message, Setpoint, WireStamp};
use posebridge_telemetry::simulator::DRIVE_HOLD_TIME;
use posebridge_telemetry::{Address, Arena, BrickClock, DriveGeometry, Point2, Pose, TimeDelta, Timestamp, Transform2};

use self::follower::Follower;
use self::onboard_pose::{DeadReckoning, OnboardPose};
use self::speed_control::PERIOD;
use crate::clock::register_micros;
use crate::path::Path;
use crate::scenario::Scenario;
use crate::wheels::PerWheel;

pub(crate) use self::follower::Twist;
pub use self::messages::BRICK;
pub(crate) use self::messages::BrickMessenger;
pub(crate) use self::speed_control::SpeedControl;

/// The driving program: odometry, path following and speed control, corrected by the station's estimates. It runs every 10 ms and is the
/// same on every brick.
#[derive(Debug)]
pub(crate) struct Program {
    geometry: DriveGeometry,
    dead_reckoning: DeadReckoning,
    pub(crate) onboard: OnboardPose,
    pub(crate) follower: Follower,
    control: PerWheel<SpeedControl>,
    control_due: Timestamp<BrickClock>,
    duty: PerWheel<f64>,
    /// Counter totals when the speed control began.
    control_zero: PerWheel<i64>,
}

impl Program {
    /// Ready at `now`, with the robot at the start of `path`.
    pub(crate) fn new(scenario: &Scenario, path: Path, now: Timestamp<BrickClock>) -> Self {
        let geometry = scenario.drive_geometry();
        let control = SpeedControl::new(&scenario.robot);
        Self {
            geometry,
            dead_reckoning: DeadReckoning::new(&geometry),
            onboard: OnboardPose::new(scenario.steering, path.start()),
            follower: Follower::new(scenario.drive, path),
            control: PerWheel { left: control.clone(), right: control },
            control_due: now,
            duty: PerWheel::default(),
            control_zero: PerWheel::default(),
        }
    }

    /// One control step at `now`, given the totals of the counters; returns the duty of both motors.
    pub(crate) fn step(&mut self, now: Timestamp<BrickClock>, counts: PerWheel<i64>) -> PerWheel<f64> {
        if self.is_due(now) {
            self.update_odometry(now, counts);
            let twist = self.follower.command(now, self.onboard.pose());
            self.duty = self
                .control
                .as_mut()
                .zip(wheel_speeds(twist, &self.geometry))
                .zip(counts.zip(self.control_zero))
                .map(|((control, target), (count, zero))| control.duty(target, count - zero));
        }
        self.duty
    }

    /// One control step while the program is stopped: odometry without steering, for the dead reckoning in the truth log.
    pub(crate) fn observe_odometry(&mut self, now: Timestamp<BrickClock>, counts: PerWheel<i64>) {
        if self.is_due(now) {
            self.update_odometry(now, counts);
        }
    }

    /// Applies an estimate for the instant `stamp`; returns that instant on the brick's clock.
    pub(crate) fn apply_estimate(
        &mut self,
        now: Timestamp<BrickClock>,
        stamp: WireStamp,
        pose: Pose<Arena>,
    ) -> Timestamp<BrickClock> {
        let instant = unwrap_near(stamp, now);
        self.onboard.apply_estimate(now, instant, pose);
        instant
    }

    /// A power cycle: clock and counters begin at zero. Progress on the path and odometry are kept, as a program that stores them
    /// would.
    pub(crate) fn restart(&mut self, now: Timestamp<BrickClock>) {
        self.dead_reckoning.counters_zeroed();
        self.onboard.clock_restarted();
        self.begin(now, PerWheel::default());
    }

    /// Starts the program at rest, with the counters at `counts`. Progress on the path, odometry and clock are kept.
    pub(crate) fn begin(&mut self, now: Timestamp<BrickClock>, counts: PerWheel<i64>) {
        self.follower.clock_restarted();
        self.control.as_mut().map(SpeedControl::restart);
        self.control_due = now;
        self.control_zero = counts;
        self.duty = PerWheel::default();
    }

    /// The pose by dead reckoning alone from `start`.
    pub(crate) fn odometry(&self, start: Pose<Arena>) -> Pose<Arena> {
        let moved = self.dead_reckoning.pose;
        start * Transform2::new(moved.x, moved.y, moved.heading)
    }

    pub(crate) fn drive_manually(&mut self, now: Timestamp<BrickClock>, command: Twist) {
        self.follower.drive_manually(command, now + DRIVE_HOLD_TIME);
    }

    /// Drives as a message of a ground station asks. Other messages are left.
    pub(crate) fn steer(&mut self, now: Timestamp<BrickClock>, own: Address, message: &Message) {
        let is_for_us = |target: Address| {
            target.system == own.system && (target.component == own.component || target.component.0 == 0)
        };
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "only these steer, however many kinds of messages there are"
        )]
        match message {
            Message::ManualControl(control) if control.system == own.system => {
                let full = self.follower.full_speed();
                let twist = Twist {
                    forward_m_per_s: control.forward.unwrap_or_default() * full.forward_m_per_s,
                    turn_rad_per_s: control.turn.unwrap_or_default() * full.turn_rad_per_s,
                };
                self.drive_manually(now, twist);
            }
            Message::PositionTarget(request) if is_for_us(request.target) => match request.setpoint {
                Setpoint::Position { x, y } => self.follower.go_to(Point2::new(x, y)),
                Setpoint::BodyVelocity { forward, turn } => {
                    let full = self.follower.full_speed();
                    let twist = Twist {
                        forward_m_per_s: forward.0.clamp(-full.forward_m_per_s, full.forward_m_per_s),
                        turn_rad_per_s: turn.0.clamp(-full.turn_rad_per_s, full.turn_rad_per_s),
                    };
                    self.drive_manually(now, twist);
                }
                Setpoint::Unsupported => {}
            },
            _ => {}
        }
    }

    pub(crate) fn rejoin(&mut self) {
        self.follower.rejoin(self.onboard.pose());
    }

    fn is_due(&mut self, now: Timestamp<BrickClock>) -> bool {
        let is_due = now >= self.control_due;
        if is_due {
            self.control_due = self.control_due + PERIOD;
        }
        is_due
    }

    fn update_odometry(&mut self, now: Timestamp<BrickClock>, counts: PerWheel<i64>) {
        let odom = self.dead_reckoning.update(counts);
        self.onboard.record(now, odom);
    }
}

/// Wheel speeds in rad/s by the nominal geometry.
fn wheel_speeds(twist: Twist, geometry: &DriveGeometry) -> PerWheel<f64> {
    let half_track_m = 0.5 * geometry.track_width.0;
    PerWheel {
        left: (twist.forward_m_per_s - twist.turn_rad_per_s * half_track_m) / geometry.left_wheel_radius.0,
        right: (twist.forward_m_per_s + twist.turn_rad_per_s * half_track_m) / geometry.right_wheel_radius.0,
    }
}

/// The instant nearest to `now` that a timestamp of this brick's clock can mean.
fn unwrap_near(stamp: WireStamp, now: Timestamp<BrickClock>) -> Timestamp<BrickClock> {
    match stamp {
        WireStamp::Micros32(micros) => {
            now - TimeDelta::from_nanos(now.as_nanos().rem_euclid(1_000))
                + TimeDelta::from_micros(i64::from(micros.wrapping_sub(register_micros(now)) as i32))
        }
        WireStamp::Millis32(millis) => {
            let own = (now.as_micros() / 1_000) as u32;
            now + TimeDelta::from_millis(i64::from(millis.wrapping_sub(own) as i32))
        }
        WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => {
            Timestamp::from_micros(i64::try_from(stamp.as_micros()).unwrap_or(i64::MAX))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_register_stamp_means_the_instant_next_to_now() {
        let now = Timestamp::<BrickClock>::from_micros((1 << 32) + 40);
        assert_eq!(unwrap_near(WireStamp::Micros32(u32::MAX - 9), now), now - TimeDelta::from_micros(50));
        assert_eq!(unwrap_near(WireStamp::Micros32(140), now), now + TimeDelta::from_micros(100));
    }

    #[test]
    fn a_left_turn_runs_the_right_wheel_forward() {
        let geometry = Scenario::default().drive_geometry();
        let speeds = wheel_speeds(Twist { forward_m_per_s: 0.0, turn_rad_per_s: 1.0 }, &geometry);
        assert!((speeds.right - 2.0).abs() < 1e-12 && (speeds.left + 2.0).abs() < 1e-12);
    }
}
