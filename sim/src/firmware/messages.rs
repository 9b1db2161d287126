//! The messages of a brick that sends MAVLink 2, as component 1 of its system: wheels, inertial readings, its build.
//!
//! Its inputs are the brick's clock, the sensors and the station's messages, never the true state.

use posebridge_protocol::message::{Heartbeat, Message, OdometryPose, PlanarImu, RobotDescription, WireStamp};
use posebridge_telemetry::{
    Address, Arena, BrickClock, Celsius, ChannelName, DriveGeometry, Meters, MetersPerSecondSquared, Pose,
    RadiansPerSecond, SensorNoise, Timestamp,
};

use super::compact;
use super::schedule::{Schedule, Topic};
use crate::clock::register_micros;
use crate::mavlink_node::MavlinkNode;
use crate::scenario::{BrickSettings, Scenario, ThermometerSettings, Wire};
use crate::sensors::SensorBoard;
use crate::wheels::PerWheel;

/// The brick's address on the link, unless its scenario gives it another system.
pub const BRICK: Address = Address::new(1, 1);
/// MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, MAV_STATE_ACTIVE (minimal.xml).
const HEARTBEAT: Heartbeat = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };
/// The name in PB_ROBOT_DESCRIPTION.
const NAME: &str = "simulated brick";

/// The talking half of a brick.
#[derive(Debug)]
pub(crate) struct BrickMessenger {
    settings: BrickSettings,
    thermometer: Option<ThermometerSettings>,
    geometry: DriveGeometry,
    noise: SensorNoise,
    node: MavlinkNode<BrickClock>,
    schedule: Schedule,
    /// Where the counters stood when those that are sent were zeroed.
    zero: PerWheel<i64>,
}

impl BrickMessenger {
    /// A brick that is switched on at `now`.
    pub(crate) fn new(scenario: &Scenario, now: Timestamp<BrickClock>) -> Self {
        let thermometer = scenario.thermometer.clone();
        let schedule = Schedule::new(&scenario.brick, thermometer.as_ref(), now);
        Self {
            settings: scenario.brick,
            thermometer,
            geometry: scenario.drive_geometry(),
            noise: scenario.sensor_noise(),
            node: MavlinkNode::new(
                scenario.brick.address_of(BRICK),
                HEARTBEAT,
                register_time_of(scenario.brick.wire, now),
                &schedule.message_ids(),
            ),
            schedule,
            zero: PerWheel::default(),
        }
    }

    /// Says what is due at `now`.
    pub(crate) fn step(&mut self, now: Timestamp<BrickClock>, board: &mut SensorBoard) {
        for request in self.node.tick(self.register_time(now)) {
            self.schedule.apply_request(request, now);
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
    }

    /// Takes a message from the link. Returns the content of a usable estimate.
    pub(crate) fn handle(
        &mut self,
        now: Timestamp<BrickClock>,
        from: Address,
        message: &Message,
    ) -> Option<(WireStamp, Pose<Arena>)> {
        for request in self.node.handle(self.register_time(now), from, message) {
            self.schedule.apply_request(request, now);
        }
        usable_estimate(message)
    }

    /// A power cycle or a program begun anew: session and message intervals begin anew, and what is sent counts from `zero`.
    pub(crate) fn restart(&mut self, now: Timestamp<BrickClock>, zero: PerWheel<i64>) {
        self.schedule = Schedule::new(&self.settings, self.thermometer.as_ref(), now);
        let own = self.settings.address_of(BRICK);
        self.node = MavlinkNode::new(own, HEARTBEAT, self.register_time(now), &self.schedule.message_ids());
        self.zero = zero;
    }

    /// The bytes that wait to be sent.
    pub(crate) fn next_bytes(&mut self) -> Option<Vec<u8>> {
        self.node.next_bytes()
    }

    /// The same, each frame for itself.
    pub(crate) fn take_frames(&mut self) -> Vec<Vec<u8>> {
        self.node.take_frames()
    }

    fn register_time(&self, now: Timestamp<BrickClock>) -> Timestamp<BrickClock> {
        register_time_of(self.settings.wire, now)
    }

    fn send_wheels(&mut self, now: Timestamp<BrickClock>, counts: PerWheel<i64>) {
        let counts = counts.zip(self.zero).map(|(count, zero)| count - zero);
        match self.settings.wire {
            Wire::Compact => {
                let ticks = compact::wheel_ticks(register_micros(now), counts);
                self.node.send_with_sdk(|link, sink| link.wheel_ticks(&ticks, sink));
            }
            Wire::Standard => {
                let rolled = |radius: Meters, count: i64| radius * (self.geometry.tick.0 * count as f64);
                self.node.send(&Message::WheelDistance {
                    stamp: WireStamp::Micros64(now.as_micros() as u64),
                    left: rolled(self.geometry.left_wheel_radius, counts.left),
                    right: rolled(self.geometry.right_wheel_radius, counts.right),
                });
            }
        }
    }

    fn send_inertial(&mut self, now: Timestamp<BrickClock>, board: &mut SensorBoard) {
        let reading = board.read_inertial();
        match self.settings.wire {
            Wire::Compact => {
                let inertial = compact::inertial(register_micros(now), &reading);
                self.node.send_with_sdk(|link, sink| link.inertial(&inertial, sink));
            }
            Wire::Standard => {
                let wheels = reading.wheels_m_per_s2;
                self.node.send(&Message::ScaledImu(PlanarImu {
                    stamp: WireStamp::Millis32((now.as_micros() / 1_000) as u32),
                    turn_rate: Some(RadiansPerSecond(reading.turn_rate_rad_per_s)),
                    forward_acceleration: Some(MetersPerSecondSquared(0.5 * (wheels.left + wheels.right))),
                }));
            }
        }
    }

    fn temperature(&self, now: Timestamp<BrickClock>, board: &mut SensorBoard) -> Option<Message> {
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
fn register_time_of(wire: Wire, now: Timestamp<BrickClock>) -> Timestamp<BrickClock> {
    match wire {
        Wire::Compact => Timestamp::from_micros(i64::from(register_micros(now))),
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
        Message::PlanarPose(estimate) => {
            (estimate.flags.position_valid && estimate.flags.heading_valid).then_some((estimate.stamp, estimate.pose))
        }
        Message::Odometry(estimate) => match estimate.pose {
            // Quality -1 means that the sender's estimator has failed.
            OdometryPose::Arena(pose) if estimate.quality >= 0 => Some((estimate.stamp, pose)),
            OdometryPose::Arena(_) | OdometryPose::Odom(_) => None,
        },
        _ => None,
    }
}
