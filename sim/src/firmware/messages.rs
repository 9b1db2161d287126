//! The MAVLink 2 messages of a brick, as component 1 of its system: wheels, inertial readings, battery, description.
//!
//! Compact readings are encoded by the SDK of real robots, so that each run tests it. The station decodes with `protocol`, which is an
//! independent implementation.

use posebridge_brick::{Inertial, InertialParts, Sides, WheelTicks};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    Battery, Heartbeat, ImuMessage, Message, OdometryPose, PlanarImu, RobotDescription, WireStamp,
};
use posebridge_telemetry::{
    Address, Arena, BrickClock, Celsius, ChannelName, DriveGeometry, Meters, MetersPerSecondSquared, Pose,
    RadiansPerSecond, SensorNoise, TimeDelta, Timestamp,
};

use crate::clock::{STEP, register_micros};
use crate::mavlink_node::{IntervalRequest, MavlinkNode};
use crate::scenario::{BrickSettings, Personality, Scenario, ThermometerSettings, Wire};
use crate::sensors::{InertialReading, SensorBoard};
use crate::wheels::PerWheel;

/// The brick's address on the link, unless its scenario gives it another system.
pub const BRICK: Address = Address::new(1, 1);
const NAME: &str = "simulated brick";
const BATTERY_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// Two lithium cells, empty and full: 3.2 and 4.2 V each.
const EMPTY_V: f64 = 6.4;
const FULL_V: f64 = 8.4;

#[derive(Debug)]
pub(crate) struct BrickMessenger {
    settings: BrickSettings,
    thermometer: Option<ThermometerSettings>,
    geometry: DriveGeometry,
    noise: SensorNoise,
    pub(crate) node: MavlinkNode<BrickClock>,
    schedule: Vec<ScheduledMessage>,
    /// Counter totals at the last reset; messages count from here.
    zero: PerWheel<i64>,
    /// The highest epoch of an estimate since power-up.
    epoch: u32,
    /// Number of estimates with a lower one, which were dropped.
    pub(crate) outdated_estimates: u64,
}

impl BrickMessenger {
    pub(crate) fn new(scenario: &Scenario, now: Timestamp<BrickClock>) -> Self {
        let thermometer = scenario.thermometer.clone();
        let schedule = schedule(&scenario.brick, thermometer.as_ref(), now);
        Self {
            settings: scenario.brick,
            thermometer,
            geometry: scenario.drive_geometry(),
            noise: scenario.sensor_noise(),
            node: node(&scenario.brick, &schedule, now),
            schedule,
            zero: PerWheel::default(),
            epoch: 0,
            outdated_estimates: 0,
        }
    }

    pub(crate) fn address(&self) -> Address {
        self.settings.address_of(BRICK)
    }

    pub(crate) fn step(&mut self, now: Timestamp<BrickClock>, board: &mut SensorBoard, battery_v: f64) {
        let requests = self.node.tick(register_time(self.settings.wire, now));
        self.apply_requests(now, &requests);
        let next = |message: &mut ScheduledMessage| message.take_due(now).then_some(message.topic);
        while let Some(topic) = self.schedule.iter_mut().find_map(next) {
            match topic {
                Topic::Wheels => self.send_wheels(now, board.counts()),
                Topic::Inertial => self.send_inertial(now, board),
                Topic::Battery => self.node.send(&battery_status(battery_v)),
                Topic::Description => self.node.send(&self.description()),
                Topic::Thermometer => {
                    if let Some(message) = self.temperature(now, board) {
                        self.node.send(&message);
                    }
                }
            }
        }
    }

    /// Handles a message from the link. Returns the timestamp and pose of a usable estimate.
    pub(crate) fn handle(
        &mut self,
        now: Timestamp<BrickClock>,
        from: Address,
        message: &Message,
    ) -> Option<(WireStamp, Pose<Arena>)> {
        let requests = self.node.handle(register_time(self.settings.wire, now), from, message);
        self.apply_requests(now, &requests);
        if self.is_outdated(message) {
            self.outdated_estimates += 1;
            return None;
        }
        usable_estimate(message)
    }

    /// Whether an estimate is of a station that has owned the robot before another one did.
    fn is_outdated(&mut self, message: &Message) -> bool {
        let Message::PlanarPose(estimate) = message else {
            return false;
        };
        let is_outdated = estimate.epoch < self.epoch;
        self.epoch = self.epoch.max(estimate.epoch);
        is_outdated
    }

    pub(crate) fn restart(&mut self, now: Timestamp<BrickClock>, zero: PerWheel<i64>) {
        self.schedule = schedule(&self.settings, self.thermometer.as_ref(), now);
        self.node = node(&self.settings, &self.schedule, now);
        self.zero = zero;
        self.epoch = 0;
    }

    /// Requests for messages that the brick does not have are ignored.
    fn apply_requests(&mut self, now: Timestamp<BrickClock>, requests: &[IntervalRequest]) {
        for request in requests {
            for message in self.schedule.iter_mut().filter(|message| message.message_id == request.message_id) {
                message.interval = request.interval_or(message.default).map(|interval| interval.max(STEP));
                message.due = now;
            }
        }
    }

    fn send_wheels(&mut self, now: Timestamp<BrickClock>, counts: PerWheel<i64>) {
        let counts = counts.zip(self.zero).map(|(count, zero)| count - zero);
        match self.settings.wire {
            Wire::Compact => {
                let ticks = wheel_ticks(register_micros(now), counts);
                self.node.send_with_sdk(|link, mut sink| link.wheel_ticks(&ticks, &mut sink));
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
                let inertial = inertial(register_micros(now), &reading);
                self.node.send_with_sdk(|link, mut sink| link.inertial(&inertial, &mut sink));
            }
            Wire::Standard => {
                let wheels = reading.wheels_m_per_s2;
                self.node.send(&Message::Imu(PlanarImu {
                    message: ImuMessage::Scaled,
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

fn battery_status(voltage_v: f64) -> Message {
    let share = (voltage_v - EMPTY_V) / (FULL_V - EMPTY_V);
    Message::BatteryStatus(Battery {
        voltage_v: Some(voltage_v),
        current_a: None,
        remaining: Some(share.clamp(0.0, 1.0)),
    })
}

/// The brick's clock as other systems read it: a register that wraps, or 64 bits that do not.
fn register_time(wire: Wire, now: Timestamp<BrickClock>) -> Timestamp<BrickClock> {
    match wire {
        Wire::Compact => Timestamp::from_micros(i64::from(register_micros(now))),
        Wire::Standard => now,
    }
}

/// An estimate of the pose that its sender does not mark invalid.
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

/// Short enough that a station that starts late receives the description soon.
const DESCRIPTION_PERIOD: TimeDelta = TimeDelta::from_millis(5_000);

#[derive(Clone, Copy, Debug)]
enum Topic {
    Wheels,
    Inertial,
    Battery,
    Description,
    Thermometer,
}

#[derive(Clone, Copy, Debug)]
struct ScheduledMessage {
    topic: Topic,
    message_id: u32,
    default: TimeDelta,
    interval: Option<TimeDelta>,
    due: Timestamp<BrickClock>,
}

impl ScheduledMessage {
    /// Whether it is due at `now`; then it is due again after its interval.
    fn take_due(&mut self, now: Timestamp<BrickClock>) -> bool {
        let Some(interval) = self.interval.filter(|_| self.due <= now) else {
            return false;
        };
        self.due = self.due + interval;
        if self.due <= now {
            self.due = now + interval;
        }
        true
    }
}

/// The schedule of a brick that was powered up at `now`; everything is due at once.
fn schedule(
    settings: &BrickSettings,
    thermometer: Option<&ThermometerSettings>,
    now: Timestamp<BrickClock>,
) -> Vec<ScheduledMessage> {
    let message =
        |topic, message_id, default| ScheduledMessage { topic, message_id, default, interval: Some(default), due: now };
    let telemetry = TimeDelta::from_secs_f64(1.0 / settings.telemetry_hz);
    let (wheels, inertial) = match settings.wire {
        Wire::Compact => (ids::PB_WHEEL_TICKS, ids::PB_INERTIAL),
        Wire::Standard => (ids::WHEEL_DISTANCE, ids::SCALED_IMU),
    };
    let mut schedule = vec![
        message(Topic::Description, ids::PB_ROBOT_DESCRIPTION, DESCRIPTION_PERIOD),
        message(Topic::Wheels, wheels, telemetry),
        message(Topic::Inertial, inertial, telemetry),
    ];
    // The program of an NXT leaves that to the firmware, which is asked.
    if settings.personality == Personality::Mavlink {
        schedule.push(message(Topic::Battery, ids::BATTERY_STATUS, BATTERY_PERIOD));
    }
    schedule.extend(thermometer.map(|settings| {
        let message_id = if settings.is_scaled_pressure() { ids::SCALED_PRESSURE } else { ids::NAMED_VALUE_FLOAT };
        message(Topic::Thermometer, message_id, TimeDelta::from_secs_f64(1.0 / settings.rate_hz))
    }));
    schedule
}

fn node(
    settings: &BrickSettings,
    schedule: &[ScheduledMessage],
    now: Timestamp<BrickClock>,
) -> MavlinkNode<BrickClock> {
    let offered: Vec<u32> = schedule.iter().map(|message| message.message_id).collect();
    MavlinkNode::new(settings.address_of(BRICK), Heartbeat::ROVER, register_time(settings.wire, now), &offered)
}

const TURN_RATE_UNIT_RAD_PER_S: f64 = 0.5e-3;
/// Unit of PB_INERTIAL.turn_urad.
const TURN_UNIT_RAD: f64 = 1e-6;
/// Unit of PB_INERTIAL.accel_left and accel_right, m/s².
const ACCELERATION_UNIT_M_PER_S2: f64 = 1e-3;

pub(super) const fn wheel_ticks(time_us: u32, counts: PerWheel<i64>) -> WheelTicks {
    WheelTicks { time_us, left: counts.left as i32, right: counts.right as i32, valid: Sides::BOTH }
}

/// A reading that ends at `time_us`. Rates saturate, the total turn wraps.
pub(super) fn inertial(time_us: u32, reading: &InertialReading) -> Inertial {
    let acceleration = |m_per_s2: f64| (m_per_s2 / ACCELERATION_UNIT_M_PER_S2).round() as i16;
    Inertial {
        time_us,
        // Through 64 bits, so that the total wraps instead of saturating.
        turn_urad: (reading.turn_rad / TURN_UNIT_RAD).round() as i64 as i32,
        turn_rate: (reading.turn_rate_rad_per_s / TURN_RATE_UNIT_RAD_PER_S).round() as i16,
        accel_left: acceleration(reading.wheels_m_per_s2.left),
        accel_right: acceleration(reading.wheels_m_per_s2.right),
        valid: InertialParts::GYRO | InertialParts::ACCELERATIONS,
    }
}

#[cfg(test)]
mod tests {
    use posebridge_brick::Link;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message;
    use posebridge_telemetry::{EncoderTicks, Radians};

    use super::*;

    /// Compares the frame of the station's own encoder with that of the SDK.
    fn assert_same_frame(message: &Message, write: impl FnOnce(&mut Link, &mut dyn FnMut(&[u8]))) {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        Encoder::new(WireVersion::V2).encode(BRICK, message, &mut ours);
        write(&mut Link::new(1, 1), &mut |bytes| theirs.extend_from_slice(bytes));
        assert_eq!(ours, theirs, "{message:?}");
    }

    #[test]
    fn readings_are_the_frames_that_the_station_would_make() {
        for (left, right) in [(0, 0), (360, -360), (1 << 31, -(1 << 31) - 1), (5, 1 << 40)] {
            let message = Message::WheelTicks(message::WheelTicks {
                stamp: WireStamp::Micros32(4_294_967_290),
                left: EncoderTicks(left),
                right: EncoderTicks(right),
            });
            let ticks = wheel_ticks(4_294_967_290, PerWheel { left, right });
            assert_same_frame(&message, |link, mut sink| link.wheel_ticks(&ticks, &mut sink));
        }
        for (rate, turn, acceleration) in
            [(0.0, 0.0, 0.0), (0.123_456, -7.654_321, 0.981), (-20.0, 5_000.0, -40.0), (20.0, -5_000.0, 40.0)]
        {
            let message = Message::Inertial(message::Inertial {
                stamp: WireStamp::Micros32(77),
                turn_rate: Some(RadiansPerSecond(rate)),
                turn: Some(Radians(turn)),
                wheel_accelerations: Some((
                    MetersPerSecondSquared(acceleration),
                    MetersPerSecondSquared(-acceleration),
                )),
            });
            let reading = InertialReading {
                turn_rate_rad_per_s: rate,
                turn_rad: turn,
                wheels_m_per_s2: PerWheel { left: acceleration, right: -acceleration },
            };
            let inertial = inertial(77, &reading);
            assert_same_frame(&message, |link, mut sink| link.inertial(&inertial, &mut sink));
        }
    }
}
