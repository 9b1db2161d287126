//! What a robot sends that could move a filter, and in one line what is missing.
//!
//! A robot without wheels is not an error, and most of them only have to be asked: so the line comes once, when it has had time to send.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::message::{ImuMessage, Message};
use posebridge_telemetry::{Address, GeodeticOrigin, GeodeticPoint, HostClock, LinkId, TimeDelta, Timestamp};

/// How long to listen before something is called missing: the requests for messages are sent and answered by then.
const LISTENING_TIME: TimeDelta = TimeDelta::from_millis(5_000);
/// Most senders that are told of.
const MAX_SENDERS: usize = 64;
/// MAV_AUTOPILOT_INVALID and MAV_TYPE_GCS: senders that are no vehicles.
const NOT_AN_AUTOPILOT: u8 = 8;
const GROUND_STATION: u8 = 6;

#[derive(Debug, Default)]
pub(crate) struct HeardSensors {
    vehicles: BTreeMap<(LinkId, Address), HeardVehicle>,
}

#[derive(Debug)]
struct HeardVehicle {
    since: Timestamp<HostClock>,
    has_reported: bool,
    has_motion: bool,
    imus: BTreeSet<ImuMessage>,
    /// Names of the messages that locate it.
    fixes: BTreeSet<&'static str>,
    satellite_position: Option<GeodeticPoint>,
}

impl HeardSensors {
    /// Takes a message of a sender; returns the line about it when it is due.
    pub(crate) fn observe(
        &mut self,
        now: Timestamp<HostClock>,
        (link, sender): (LinkId, Address),
        message: &Message,
        origin: Option<GeodeticOrigin>,
    ) -> Option<String> {
        if let Message::Heartbeat(heartbeat) = message
            && heartbeat.autopilot != NOT_AN_AUTOPILOT
            && heartbeat.vehicle_type != GROUND_STATION
            && self.vehicles.len() < MAX_SENDERS
        {
            self.vehicles.entry((link, sender)).or_insert_with(|| HeardVehicle::new(now));
        }
        let vehicle = self.vehicles.get_mut(&(link, sender))?;
        vehicle.observe(message);
        if vehicle.has_reported || now - vehicle.since < LISTENING_TIME {
            return None;
        }
        vehicle.has_reported = true;
        vehicle.missing(sender, origin)
    }

    /// The lines about all vehicles so far.
    pub(crate) fn missing(&self, origin: Option<GeodeticOrigin>) -> Vec<String> {
        self.vehicles.iter().filter_map(|((_, sender), vehicle)| vehicle.missing(*sender, origin)).collect()
    }
}

impl HeardVehicle {
    const fn new(since: Timestamp<HostClock>) -> Self {
        Self {
            since,
            has_reported: false,
            has_motion: false,
            imus: BTreeSet::new(),
            fixes: BTreeSet::new(),
            satellite_position: None,
        }
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "most messages move no filter")]
    fn observe(&mut self, message: &Message) {
        match message {
            Message::WheelTicks(_)
            | Message::WheelDistance { .. }
            | Message::WheelSpeeds { .. }
            | Message::Odometry(_) => self.has_motion = true,
            Message::Imu(imu) => {
                self.imus.insert(imu.message);
            }
            Message::GnssFix(fix) => self.satellite_position = Some(fix.position),
            Message::VisionPosition(_) => {
                self.fixes.insert("VISION_POSITION_ESTIMATE");
            }
            Message::MocapPosition(_) => {
                self.fixes.insert("ATT_POS_MOCAP");
            }
            Message::LandmarkSighting(_) => {
                self.fixes.insert("LANDING_TARGET");
            }
            _ => {}
        }
    }

    /// `None` when nothing is missing.
    fn missing(&self, sender: Address, origin: Option<GeodeticOrigin>) -> Option<String> {
        let unplaced = self.satellite_position.filter(|_| origin.is_none());
        if self.has_motion && unplaced.is_none() {
            return None;
        }
        let imus = self.imus.iter().map(|imu| imu_name(*imu));
        let satellites = self.satellite_position.map(|_| "GPS_RAW_INT");
        let heard: Vec<&str> = imus.chain(satellites).chain(self.fixes.iter().copied()).collect();
        let mut text = if heard.is_empty() {
            format!("{sender}: heard nothing that moves a filter")
        } else {
            format!("{sender}: heard {}", heard.join(", "))
        };
        if self.imus.len() > 1 {
            // The first of the set, as in `MotionSource`.
            let used = self.imus.first().map_or("", |imu| imu_name(*imu));
            text = format!("{text} ({used} is used)");
        }
        if !self.has_motion {
            text += ", no wheels: posebridge needs WHEEL_DISTANCE, RPM, ODOMETRY or PB_WHEEL_TICKS";
            if !self.imus.is_empty() && self.fixes.is_empty() && self.satellite_position.is_none() {
                text += ", or fixes beside the gyro";
            }
        }
        if let Some(GeodeticPoint { latitude, longitude }) = unplaced {
            let [latitude, longitude] = [latitude, longitude].map(|angle| angle.0.to_degrees());
            text = format!(
                "{text}; GPS_RAW_INT needs the arena's place: --set station.origin.latitude={latitude:.7} \
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
    use posebridge_protocol::message::{GnssFix, Heartbeat, PlanarImu, WireStamp};
    use posebridge_telemetry::{Meters, Radians};

    const ROBOT: (LinkId, Address) = (LinkId(0), Address::new(1, 1));

    fn heard_after(messages: &[Message], origin: Option<GeodeticOrigin>) -> Option<String> {
        let mut sensors = HeardSensors::default();
        let heartbeat = Message::Heartbeat(Heartbeat::ROVER);
        let all = [std::slice::from_ref(&heartbeat), messages].concat();
        for message in &all {
            assert_eq!(sensors.observe(Timestamp::ZERO, ROBOT, message, origin), None);
        }
        let line = sensors.observe(Timestamp::from_millis(5_000), ROBOT, &heartbeat, origin);
        assert_eq!(sensors.observe(Timestamp::from_millis(9_000), ROBOT, &heartbeat, origin), None, "once");
        line
    }

    fn imu(message: ImuMessage) -> Message {
        Message::Imu(PlanarImu { message, stamp: WireStamp::Micros64(1), turn_rate: None, forward_acceleration: None })
    }

    #[test]
    fn what_is_missing_is_said_once_with_what_is_heard() {
        let wheels = Message::WheelDistance { stamp: WireStamp::Micros64(1), left: Meters(0.0), right: Meters(0.0) };
        let position = GeodeticPoint { latitude: Radians(0.5), longitude: Radians(-1.0) };
        let satellites =
            Message::GnssFix(GnssFix { stamp: WireStamp::Micros64(1), position, sigma: None, ground_speed: None });
        assert_eq!(heard_after(&[wheels.clone(), imu(ImuMessage::Raw)], None), None);
        let imus = [ImuMessage::Scaled3, ImuMessage::Raw, ImuMessage::Scaled2].map(imu);
        assert_eq!(
            heard_after(&imus, None).unwrap(),
            "1/1: heard RAW_IMU, SCALED_IMU2, SCALED_IMU3 (RAW_IMU is used), no wheels: posebridge needs WHEEL_DISTANCE, RPM, ODOMETRY or \
             PB_WHEEL_TICKS, or fixes beside the gyro"
        );
        assert_eq!(
            heard_after(&[wheels, satellites], None).unwrap(),
            "1/1: heard GPS_RAW_INT; GPS_RAW_INT needs the arena's place: --set station.origin.latitude=28.6478898 \
             --set station.origin.longitude=-57.2957795"
        );
        assert!(heard_after(&[], None).unwrap().starts_with("1/1: heard nothing that moves a filter, no wheels"));
    }
}
