//! What a robot sends that could move a filter, and in one line what is missing.
//!
//! A robot without wheels is not an error, and most robots send wheels on request: so the line comes once, after the requests.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::message::{ImuMessage, Message};
use posebridge_telemetry::{
    Address, GeodeticOrigin, GeodeticPoint, HostClock, LinkId, ObservationKind, SensorId, TimeDelta, Timestamp,
};

use crate::observation_extractor::UnalignedObservation;

/// How long to listen before something is called missing: the requests for messages are sent and answered by then.
const LISTENING_TIME: TimeDelta = TimeDelta::from_millis(5_000);
/// Vehicles that are followed at a time.
const MAX_VEHICLES: usize = 64;
/// A vehicle that is silent for this long makes room for another one.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(60_000);

#[derive(Debug, Default)]
pub(crate) struct SensorInventory {
    vehicles: BTreeMap<(LinkId, Address), VehicleSensors>,
}

#[expect(clippy::struct_excessive_bools, reason = "what was heard, each for itself")]
#[derive(Debug)]
struct VehicleSensors {
    since: Timestamp<HostClock>,
    last: Timestamp<HostClock>,
    has_reported: bool,
    has_wheels: bool,
    has_ground_speed: bool,
    /// It places itself by something other than satellites.
    has_fixes: bool,
    /// It sends speeds that are not configured as those of wheels.
    has_unused_rpm: bool,
    imus: BTreeSet<ImuMessage>,
    /// Beside inertial units and satellites.
    sensors: BTreeSet<SensorId>,
    satellite_position: Option<GeodeticPoint>,
}

impl SensorInventory {
    /// Takes a message of a sender and what it observes; returns the line about the sender when it is due.
    pub(crate) fn observe(
        &mut self,
        now: Timestamp<HostClock>,
        (link, sender): (LinkId, Address),
        message: &Message,
        observations: &[Option<UnalignedObservation>],
        origin: Option<GeodeticOrigin>,
    ) -> Option<String> {
        if let Message::Heartbeat(heartbeat) = message
            && heartbeat.is_vehicle()
        {
            if self.vehicles.len() >= MAX_VEHICLES {
                self.vehicles.retain(|_, vehicle| now - vehicle.last < MAX_SILENCE);
            }
            if self.vehicles.len() < MAX_VEHICLES {
                self.vehicles.entry((link, sender)).or_insert_with(|| VehicleSensors::new(now));
            }
        }
        let vehicle = self.vehicles.get_mut(&(link, sender))?;
        vehicle.last = now;
        vehicle.observe(message, observations);
        if vehicle.has_reported || now - vehicle.since < LISTENING_TIME {
            return None;
        }
        vehicle.has_reported = true;
        vehicle.missing(sender, origin)
    }

    /// The lines about all vehicles that are followed.
    pub(crate) fn missing(&self, origin: Option<GeodeticOrigin>) -> Vec<String> {
        self.vehicles.iter().filter_map(|((_, sender), vehicle)| vehicle.missing(*sender, origin)).collect()
    }
}

impl VehicleSensors {
    const fn new(since: Timestamp<HostClock>) -> Self {
        Self {
            since,
            last: since,
            has_reported: false,
            has_wheels: false,
            has_ground_speed: false,
            has_fixes: false,
            has_unused_rpm: false,
            imus: BTreeSet::new(),
            sensors: BTreeSet::new(),
            satellite_position: None,
        }
    }

    fn observe(&mut self, message: &Message, observations: &[Option<UnalignedObservation>]) {
        if let Message::GnssFix(fix) = message {
            // Without an origin it observes nothing.
            self.satellite_position = Some(fix.position);
        }
        let mut observes_nothing = true;
        for observation in observations.iter().flatten() {
            observes_nothing = false;
            if observation.sensor == SensorId::GNSS {
                self.has_ground_speed |= observation.is_of_wheels();
                continue;
            }
            self.has_wheels |= observation.is_of_wheels();
            self.has_fixes |= matches!(
                observation.observed,
                ObservationKind::Fix(_) | ObservationKind::Landmark { .. } | ObservationKind::BeaconRange { .. }
            );
            match observation.imu {
                Some(imu) => self.imus.insert(imu),
                None => self.sensors.insert(observation.sensor),
            };
        }
        self.has_unused_rpm |= observes_nothing && matches!(message, Message::WheelSpeeds { .. });
    }

    fn has_gyro(&self) -> bool {
        !self.imus.is_empty() || self.sensors.contains(&SensorId::GYRO)
    }

    /// `None` when nothing is missing.
    fn missing(&self, sender: Address, origin: Option<GeodeticOrigin>) -> Option<String> {
        let unplaced = self.satellite_position.filter(|_| origin.is_none());
        // A ground speed needs the turn of a gyro.
        let has_motion = self.has_wheels || (self.has_ground_speed && self.has_gyro());
        if has_motion && unplaced.is_none() {
            return None;
        }
        let imus = self.imus.iter().map(|imu| imu_name(*imu));
        let satellites = self.satellite_position.map(|_| "GPS_RAW_INT");
        let heard: Vec<&str> = imus.chain(satellites).chain(self.sensors.iter().map(|sensor| sensor.name())).collect();
        let mut text = if heard.is_empty() {
            format!("{sender}: heard nothing that moves a filter")
        } else {
            format!("{sender}: heard {}", heard.join(", "))
        };
        if self.imus.len() > 1 {
            // The first of the set, as in `MotionSourceSelector`.
            let used = self.imus.first().map_or("", |imu| imu_name(*imu));
            text = format!("{text} ({used} is used)");
        }
        if !has_motion {
            text += ", no wheels: posebridge needs WHEEL_DISTANCE, ODOMETRY, PB_WHEEL_TICKS, or RPM with robot.rpm_is_wheels";
            if self.has_gyro() && !self.has_fixes && self.satellite_position.is_none() {
                text += ", or fixes beside the gyro";
            }
            if self.has_unused_rpm {
                text += " (it sends RPM)";
            }
        }
        if let Some(GeodeticPoint { latitude, longitude }) = unplaced {
            let [latitude, longitude] = [latitude, longitude].map(|angle| angle.0.to_degrees());
            text = format!(
                "{text}; to use GPS_RAW_INT set the arena's origin: --set station.origin.latitude={latitude:.7} \
                 --set station.origin.longitude={longitude:.7}"
            );
        }
        Some(text)
    }
}

const fn imu_name(message: ImuMessage) -> &'static str {
    match message {
        ImuMessage::Highres => "HIGHRES_IMU",
        ImuMessage::Scaled => "SCALED_IMU",
        ImuMessage::Raw => "RAW_IMU",
        ImuMessage::Scaled2 => "SCALED_IMU2",
        ImuMessage::Scaled3 => "SCALED_IMU3",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{RobotConfig, RpmMeaning};
    use crate::observation_extractor::ObservationExtractor;
    use crate::test_config::config;
    use posebridge_protocol::message::{GnssFix, Heartbeat, Inertial, PlanarImu, WireStamp};
    use posebridge_telemetry::{Meters, MetersPerSecond, Radians, RadiansPerSecond};

    const STAMP: WireStamp = WireStamp::Micros64(1);

    fn heard_after(messages: &[Message]) -> Option<String> {
        heard_with(&config().robot, messages)
    }

    fn heard_with(robot: &RobotConfig, messages: &[Message]) -> Option<String> {
        let mut sensors = SensorInventory::default();
        let heartbeat = Message::Heartbeat(Heartbeat::ROVER);
        let extractor = ObservationExtractor::new(robot, None);
        let mut observe = |millis, message: &Message| {
            let (now, robot) = (Timestamp::from_millis(millis), (LinkId(0), Address::new(1, 1)));
            sensors.observe(now, robot, message, &extractor.extract(now, message), None)
        };
        assert_eq!(observe(0, &heartbeat), None);
        assert!(messages.iter().all(|message| observe(0, message).is_none()));
        let line = observe(5_000, &heartbeat);
        assert_eq!(observe(9_000, &heartbeat), None, "once");
        line
    }

    fn imu(message: ImuMessage) -> Message {
        let turn_rate = Some(RadiansPerSecond(0.0));
        Message::Imu(PlanarImu { message, stamp: STAMP, turn_rate, forward_acceleration: None })
    }

    fn satellites(ground_speed: Option<MetersPerSecond>) -> Message {
        let position = GeodeticPoint { latitude: Radians(0.5), longitude: Radians(-1.0) };
        Message::GnssFix(GnssFix { stamp: STAMP, position, sigma: None, ground_speed })
    }

    #[test]
    fn what_is_missing_is_said_once_with_what_is_heard() {
        let wheels = Message::WheelDistance { stamp: STAMP, left: Meters(0.0), right: Meters(0.0) };
        assert_eq!(heard_after(&[wheels.clone(), imu(ImuMessage::Raw)]), None);
        let imus = [ImuMessage::Scaled3, ImuMessage::Raw, ImuMessage::Scaled2].map(imu);
        assert_eq!(
            heard_after(&imus).unwrap(),
            "1/1: heard RAW_IMU, SCALED_IMU2, SCALED_IMU3 (RAW_IMU is used), no wheels: posebridge needs WHEEL_DISTANCE, ODOMETRY, \
             PB_WHEEL_TICKS, or RPM with robot.rpm_is_wheels, or fixes beside the gyro"
        );
        assert_eq!(
            heard_after(&[wheels, satellites(None)]).unwrap(),
            "1/1: heard GPS_RAW_INT, wheels; to use GPS_RAW_INT set the arena's origin: --set station.origin.latitude=28.6478898 \
             --set station.origin.longitude=-57.2957795"
        );
        assert!(heard_after(&[]).unwrap().starts_with("1/1: heard nothing that moves a filter, no wheels"));
    }

    #[test]
    fn a_gyro_in_our_own_message_and_a_ground_speed_beside_it_are_heard() {
        let gyro = Message::Inertial(Inertial {
            stamp: STAMP,
            turn_rate: Some(RadiansPerSecond(0.0)),
            turn: None,
            wheel_accelerations: None,
        });
        assert!(heard_after(std::slice::from_ref(&gyro)).unwrap().starts_with("1/1: heard gyro, no wheels"));
        let moving = satellites(Some(MetersPerSecond(1.0)));
        assert!(heard_after(std::slice::from_ref(&moving)).unwrap().contains("no wheels"), "its turn is unknown");
        assert!(!heard_after(&[gyro, moving]).unwrap().contains("no wheels"));
    }

    #[test]
    fn speeds_of_rotors_are_wheels_only_where_the_configuration_says_so() {
        let speeds = Message::WheelSpeeds { left: RadiansPerSecond(1.0), right: RadiansPerSecond(1.0) };
        assert!(heard_after(std::slice::from_ref(&speeds)).unwrap().ends_with("(it sends RPM)"));
        let robot = RobotConfig { rpm: RpmMeaning::Wheels, ..config().robot };
        assert_eq!(heard_with(&robot, &[speeds]), None);
    }
}
