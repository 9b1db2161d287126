//! The configuration that the unit tests begin with.

use posebridge_estimator::{FilterConfig, Params};
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_protocol::routing::LinkRules;
use posebridge_telemetry::{
    Address, Calibration, DriveGeometry, LinkId, Meters, Point2, Pose, Radians, SensorNoise, StartPose, TimeDelta,
};

use crate::config::{
    AcceptedVersions, AnnouncedAs, DescriptionPolicy, FixRequestConfig, LinkConfig, RobotConfig, StationConfig,
};

/// A station of two links and any number of robots.
pub(crate) fn station_config() -> StationConfig {
    let geometry = DriveGeometry {
        left_wheel_radius: Meters(0.028),
        right_wheel_radius: Meters(0.028),
        track_width: Meters(0.112),
        tick: Radians(0.017),
    };
    let start = Some(StartPose { pose: Pose::default(), position_sigma_m: 0.01, heading_sigma_rad: 0.02 });
    let filter_config = FilterConfig {
        geometry,
        noise: SensorNoise::EXACT,
        start,
        params: Params::default(),
        calibration: Calibration::default(),
        arena_map: std::sync::Arc::default(),
    };
    StationConfig {
        own_address: Address::new(255, 190),
        robot: RobotConfig {
            name: None,
            filter: "pose".to_owned(),
            filter_config,
            description: DescriptionPolicy::Ignore,
            tag_in_body: Point2::ORIGIN,
            tag: None,
            thermometers: Vec::new(),
        },
        robots: Vec::new(),
        max_robots: 8,
        robot_system: None,
        fix_requests: FixRequestConfig::default(),
        timesync_period: TimeDelta::from_millis(500),
        brick_message_intervals: Vec::new(),
        duplicate_window: TimeDelta::from_millis(15_000),
        links: vec![link_config(LinkId(0)), link_config(LinkId(1))],
    }
}

/// A link that sends nothing and has no limits.
pub(crate) fn link_config(id: LinkId) -> LinkConfig {
    LinkConfig {
        id,
        brick: None,
        framing: TransportKind::Datagram,
        accepted_versions: AcceptedVersions::V2,
        send_version: WireVersion::V2,
        outputs: Vec::new(),
        announced_as: AnnouncedAs::Station,
        signing: None,
        rules: LinkRules::default(),
    }
}
