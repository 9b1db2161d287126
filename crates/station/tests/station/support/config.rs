//! The configuration of a station with one stream link, for unit tests, tests and benchmarks.

use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::{FilterConfig, Params};
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_station::{
    AcceptedVersions, DescriptionPolicy, FixRequestConfig, GoalPolicy, LinkConfig, OutputInstant, OutputKind,
    OutputStream, OwnershipPolicy, RobotConfig, RpmMeaning, StationConfig,
};
use posebridge_telemetry::{
    Address, DriveGeometry, HostClock, LinkId, Meters, Point2, Pose, Radians, SensorNoise, StartPose, TimeDelta,
    Timestamp, Wiring,
};

pub(crate) const LINK: LinkId = LinkId(3);
pub(crate) const STATION: Address = Address::new(255, 190);

pub(crate) fn at(millis: i64) -> Timestamp<HostClock> {
    Timestamp::from_millis(millis)
}

/// A station with one stream link, the pose filter and a start at the arena's origin.
pub(crate) fn config() -> StationConfig {
    StationConfig {
        own_address: STATION,
        robot: RobotConfig {
            name: None,
            filter: "pose".to_owned(),
            filter_config: FilterConfig {
                geometry: DriveGeometry {
                    left_wheel_radius: Meters(0.028),
                    right_wheel_radius: Meters(0.028),
                    track_width: Meters(0.112),
                    tick: Radians(std::f64::consts::PI / 180.0),
                },
                noise: NOISE,
                start: Some(StartPose { pose: Pose::default(), position_sigma_m: 0.01, heading_sigma_rad: 0.02 }),
                params: Params::default(),
                calibration: posebridge_telemetry::Calibration::default(),
                arena_map: std::sync::Arc::default(),
                slow_sensor: SlowSensor::UNKNOWN,
            },
            wiring: Wiring::default(),
            rpm: RpmMeaning::default(),
            description: DescriptionPolicy::Ignore,
            tag_in_body: Point2::ORIGIN,
            tag: None,
            compared_filters: vec![],
            thermometers: vec![],
            goals: GoalPolicy::ByLink,
        },
        robots: vec![],
        max_robots: 64,
        robot_system: None,
        origin: None,
        fix_requests: FixRequestConfig::default(),
        timesync_period: TimeDelta::from_millis(500),
        brick_message_intervals: vec![(42_100, TimeDelta::from_millis(50)), (42_101, TimeDelta::from_millis(50))],
        autopilot_message_intervals: vec![],
        ownership: OwnershipPolicy::Unmanaged,
        duplicate_window: TimeDelta::from_millis(15_000),
        links: vec![link(LINK, vec![stream(OutputKind::PlanarPose, 0)])],
    }
}

const NOISE: SensorNoise = SensorNoise {
    wheel_travel_m_per_sqrt_m: 0.0015,
    travel_m_per_sqrt_m: 0.005,
    turn_rad_per_sqrt_rad: 0.01,
    heading_rad_per_sqrt_m: 0.0,
    gyro_rad_per_s: 0.0105,
    gyro_resolution_rad_per_s: 0.0175,
    gyro_bias_rad_per_s: 0.0175,
    gyro_bias_walk_rad_per_s_sqrt_s: 0.000_175,
    fix_position_m: 0.005,
    fix_heading_rad: 0.0175,
    ..SensorNoise::EXACT
};

pub(crate) fn link(id: LinkId, outputs: Vec<OutputStream>) -> LinkConfig {
    LinkConfig {
        brick: None,
        id,
        framing: TransportKind::Stream,
        accepted_versions: AcceptedVersions::V2,
        send_version: WireVersion::V2,
        outputs,
        announced_as: posebridge_station::AnnouncedAs::Station,
        signing: None,
        pin: None,
        rules: posebridge_protocol::routing::LinkRules::default(),
        robots_take_goals: false,
    }
}

pub(crate) fn stream(kind: OutputKind, interval_ms: i64) -> OutputStream {
    OutputStream { kind, interval: TimeDelta::from_millis(interval_ms), instant: OutputInstant::Observed }
}
