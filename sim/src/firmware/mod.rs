//! The brick: what runs on the robot itself.
//!
//! It has its own clock, its encoder counts and inertial readings, the nominal geometry, and whatever the station sends.
//! Every 10 ms it integrates its odometry, follows the path and controls both wheels; it talks MAVLink 2 as system 1,
//! component 1. It never sees the world.

mod belief;
mod compact;
mod follower;
mod odometry;
mod schedule;
mod speed_control;

use posebridge_protocol::message::{
    Heartbeat, Message, OdometryPose, PlanarImu, RobotDescription, WireStamp,
};
use posebridge_telemetry::{
    Address, Arena, BrickClock, Celsius, ChannelName, DriveGeometry, Meters,
    MetersPerSecondSquared, Pose, RadiansPerSecond, SensorNoise, Span, Stamp,
};

use self::belief::Belief;
use self::follower::{Follower, Twist};
use self::odometry::DeadReckoning;
use self::schedule::{Schedule, Topic};
use self::speed_control::SpeedControl;
use crate::clock::register_micros;
use crate::node::Node;
use crate::path::Path;
use crate::scenario::{BrickSettings, Scenario, Steering, ThermometerSettings, Wire};
use crate::sensors::SensorBoard;
use crate::wheels::Pair;

/// The brick's address on the link.
pub const BRICK: Address = Address::new(1, 1);
/// MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, MAV_STATE_ACTIVE (minimal.xml).
const HEARTBEAT: Heartbeat = Heartbeat {
    vehicle_type: 10,
    autopilot: 0,
    base_mode: 0,
    system_status: 4,
};
/// The name in PB_ROBOT_DESCRIPTION.
const NAME: &str = "simulated brick";
/// Time between two control steps.
const CONTROL_PERIOD: Span = Span::from_millis(10);

/// The program and the state of a brick.
#[derive(Debug)]
pub(crate) struct Firmware {
    settings: BrickSettings,
    thermometer: Option<ThermometerSettings>,
    geometry: DriveGeometry,
    noise: SensorNoise,
    node: Node<BrickClock>,
    schedule: Schedule,
    reckoning: DeadReckoning,
    belief: Belief,
    follower: Follower,
    control: Pair<SpeedControl>,
    control_due: Stamp<BrickClock>,
    duty: Pair<f64>,
    fresh_control: SpeedControl,
}

impl Firmware {
    /// A brick that is switched on at `now` with the robot at the beginning of `path`.
    pub(crate) fn new(scenario: &Scenario, path: Path, now: Stamp<BrickClock>) -> Self {
        let geometry = scenario.drive_geometry();
        let control = SpeedControl::new(&scenario.robot);
        let thermometer = scenario.thermometer.clone();
        let schedule = Schedule::new(&scenario.brick, thermometer.as_ref(), now);
        Self {
            settings: scenario.brick,
            thermometer,
            geometry,
            noise: scenario.sensor_noise(),
            node: Node::new(
                BRICK,
                HEARTBEAT,
                shown(scenario.brick.wire, now),
                &schedule.message_ids(),
            ),
            schedule,
            reckoning: DeadReckoning::new(&geometry),
            belief: Belief::new(scenario.steering, path.start()),
            follower: Follower::new(scenario.drive, path),
            control: Pair {
                left: control.clone(),
                right: control.clone(),
            },
            control_due: now,
            duty: Pair::default(),
            fresh_control: control,
        }
    }

    /// One pass of the program at `now`; returns the duty of both motors.
    pub(crate) fn step(&mut self, now: Stamp<BrickClock>, board: &mut SensorBoard) -> Pair<f64> {
        if now >= self.control_due {
            self.control_due = self.control_due + CONTROL_PERIOD;
            self.drive(now, board.counts());
        }
        for request in self.node.tick(self.shown(now)) {
            self.schedule.follow(request, now);
        }
        while let Some(topic) = self.schedule.next(now) {
            match topic {
                Topic::Wheels => self.send_wheels(now, board.counts()),
                Topic::Inertial => self.send_inertial(now, board),
                Topic::Description => self.node.send(&self.description()),
                Topic::Thermometer => {
                    if let Some(message) = self.temperature(now, board) {
                        self.node.send(&message);
                    }
                }
            }
        }
        self.duty
    }

    /// Takes a message from the link. If it is an estimate, returns the instant and the pose of which it speaks.
    pub(crate) fn handle(
        &mut self,
        now: Stamp<BrickClock>,
        from: Address,
        message: &Message,
    ) -> Option<(Stamp<BrickClock>, Pose<Arena>)> {
        for request in self.node.handle(self.shown(now), from, message) {
            self.schedule.follow(request, now);
        }
        let (stamp, pose) = usable_estimate(message)?;
        let instant = unwrap_near(stamp, now);
        self.belief.take(now, instant, pose);
        Some((instant, pose))
    }

    /// A power cycle: clock, counters, session and message intervals begin anew. The program's place on the path and its
    /// odometry are kept, as a program that stores its progress would keep them.
    pub(crate) fn restart(&mut self, now: Stamp<BrickClock>) {
        self.schedule = Schedule::new(&self.settings, self.thermometer.as_ref(), now);
        self.node = Node::new(
            BRICK,
            HEARTBEAT,
            self.shown(now),
            &self.schedule.message_ids(),
        );
        self.reckoning.counters_zeroed();
        self.belief.clock_restarted();
        self.follower.clock_restarted();
        self.control = Pair {
            left: self.fresh_control.clone(),
            right: self.fresh_control.clone(),
        };
        self.control_due = now;
        self.duty = Pair::default();
    }

    /// The bytes that wait to be sent.
    pub(crate) fn take(&mut self) -> Option<Vec<u8>> {
        self.node.take()
    }

    /// Where dead reckoning alone believes to be, if it began at `start`.
    pub(crate) fn odometry(&self, start: Pose<Arena>) -> Pose<Arena> {
        let moved = self.reckoning.pose();
        start * posebridge_telemetry::Transform2::new(moved.x, moved.y, moved.heading)
    }

    /// Where the program believes the robot to be.
    pub(crate) fn belief(&self) -> Pose<Arena> {
        self.belief.pose()
    }

    /// What the program steers by at this moment.
    pub(crate) fn steering(&self, now: Stamp<BrickClock>) -> Steering {
        self.belief.steering(now)
    }

    /// How much of the path is driven, 0 to 1.
    pub(crate) fn progress(&self) -> f64 {
        self.follower.progress()
    }

    /// Whether the program is at its end.
    pub(crate) fn is_finished(&self) -> bool {
        self.follower.is_finished()
    }

    fn shown(&self, now: Stamp<BrickClock>) -> Stamp<BrickClock> {
        shown(self.settings.wire, now)
    }

    fn drive(&mut self, now: Stamp<BrickClock>, counts: Pair<i64>) {
        let odom = self.reckoning.update(counts);
        self.belief.record(now, odom);
        let twist = self.follower.command(now, self.belief.pose());
        self.duty = self
            .control
            .as_mut()
            .zip(wheel_speeds(twist, &self.geometry))
            .zip(counts)
            .map(|((control, wanted), count)| control.duty(wanted, count));
    }

    fn send_wheels(&mut self, now: Stamp<BrickClock>, counts: Pair<i64>) {
        match self.settings.wire {
            Wire::Compact => {
                let ticks = compact::wheel_ticks(register_micros(now), counts);
                self.node
                    .send_by_sdk(|link, sink| link.wheel_ticks(&ticks, sink));
            }
            Wire::Standard => {
                let rolled =
                    |radius: Meters, count: i64| radius * (self.geometry.tick.0 * count as f64);
                self.node.send(&Message::WheelDistance {
                    stamp: WireStamp::Micros64(now.as_micros() as u64),
                    left: rolled(self.geometry.left_wheel_radius, counts.left),
                    right: rolled(self.geometry.right_wheel_radius, counts.right),
                });
            }
        }
    }

    fn send_inertial(&mut self, now: Stamp<BrickClock>, board: &mut SensorBoard) {
        let reading = board.read_inertial();
        match self.settings.wire {
            Wire::Compact => {
                let inertial = compact::inertial(register_micros(now), &reading);
                self.node
                    .send_by_sdk(|link, sink| link.inertial(&inertial, sink));
            }
            Wire::Standard => {
                let wheels = reading.wheels_m_per_s2;
                self.node.send(&Message::ScaledImu(PlanarImu {
                    stamp: WireStamp::Millis32((now.as_micros() / 1_000) as u32),
                    turn_rate: Some(RadiansPerSecond(reading.turn_rate_rad_per_s)),
                    forward_acceleration: Some(MetersPerSecondSquared(
                        0.5 * (wheels.left + wheels.right),
                    )),
                }));
            }
        }
    }

    fn temperature(&self, now: Stamp<BrickClock>, board: &mut SensorBoard) -> Option<Message> {
        let channel = &self.thermometer.as_ref()?.channel;
        Some(Message::Thermometer {
            stamp: WireStamp::Millis32((now.as_micros() / 1_000) as u32),
            channel: ChannelName::from_bytes(channel.as_bytes()),
            temperature: Celsius(board.read_temperature()?),
        })
    }

    fn description(&self) -> Message {
        Message::RobotDescription(RobotDescription {
            name: NAME.to_owned(),
            left_wheel_radius: self.geometry.left_wheel_radius,
            right_wheel_radius: self.geometry.right_wheel_radius,
            track_width: self.geometry.track_width,
            ticks_per_turn: (std::f64::consts::TAU / self.geometry.tick.0).round(),
            gyro_sigma: RadiansPerSecond(self.noise.gyro_rad_per_s),
            gyro_resolution: RadiansPerSecond(self.noise.gyro_resolution_rad_per_s),
        })
    }
}

/// What a brick's clock shows to others: the register that wraps, or 64 bits that do not.
fn shown(wire: Wire, now: Stamp<BrickClock>) -> Stamp<BrickClock> {
    match wire {
        Wire::Compact => Stamp::from_micros(i64::from(register_micros(now))),
        Wire::Standard => now,
    }
}

/// An estimate of the pose that its sender does not call invalid.
fn usable_estimate(message: &Message) -> Option<(WireStamp, Pose<Arena>)> {
    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "a brick has no use for most messages, however many kinds there are"
    )]
    match message {
        Message::PlanarPose(estimate) => (estimate.flags.position_valid
            && estimate.flags.heading_valid)
            .then_some((estimate.stamp, estimate.pose)),
        Message::Odometry(estimate) => match estimate.pose {
            // Quality -1 means that the sender's estimator has failed.
            OdometryPose::Arena(pose) if estimate.quality >= 0 => Some((estimate.stamp, pose)),
            OdometryPose::Arena(_) | OdometryPose::Odom(_) => None,
        },
        _ => None,
    }
}

/// Wheel speeds in radians per second for a motion of the body, by the nominal geometry.
fn wheel_speeds(twist: Twist, geometry: &DriveGeometry) -> Pair<f64> {
    let half_track_m = 0.5 * geometry.track_width.0;
    Pair {
        left: (twist.forward_m_per_s - twist.turn_rad_per_s * half_track_m)
            / geometry.left_wheel_radius.0,
        right: (twist.forward_m_per_s + twist.turn_rad_per_s * half_track_m)
            / geometry.right_wheel_radius.0,
    }
}

/// The instant next to `now` that a stamp of this brick's own clock can mean.
fn unwrap_near(stamp: WireStamp, now: Stamp<BrickClock>) -> Stamp<BrickClock> {
    match stamp {
        WireStamp::Micros32(micros) => {
            now - Span::from_nanos(now.as_nanos().rem_euclid(1_000))
                + Span::from_micros(i64::from(micros.wrapping_sub(register_micros(now)) as i32))
        }
        WireStamp::Millis32(millis) => {
            let own = (now.as_micros() / 1_000) as u32;
            now + Span::from_millis(i64::from(millis.wrapping_sub(own) as i32))
        }
        WireStamp::Micros64(micros) => {
            Stamp::from_micros(i64::try_from(micros).unwrap_or(i64::MAX))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_register_stamp_means_the_instant_next_to_now() {
        let now = Stamp::<BrickClock>::from_micros((1 << 32) + 40);
        assert_eq!(
            unwrap_near(WireStamp::Micros32(u32::MAX - 9), now),
            now - Span::from_micros(50)
        );
        assert_eq!(
            unwrap_near(WireStamp::Micros32(140), now),
            now + Span::from_micros(100)
        );
    }

    #[test]
    fn a_left_turn_runs_the_right_wheel_forward() {
        let geometry = Scenario::default().drive_geometry();
        let speeds = wheel_speeds(
            Twist {
                forward_m_per_s: 0.0,
                turn_rad_per_s: 1.0,
            },
            &geometry,
        );
        assert!((speeds.right - 2.0).abs() < 1e-12 && (speeds.left + 2.0).abs() < 1e-12);
    }
}
