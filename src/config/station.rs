//! The station section of the configuration, and its conversion to a `StationConfig`.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_link::ConnectRole;
use posebridge_protocol::dialect::ids;
use posebridge_sim::Scenario;
use posebridge_station::{DescriptionPolicy, LinkConfig, Robot, RobotBlock, RobotConfig, RpmMeaning, StationConfig};
use posebridge_telemetry::{Address, GeodeticOrigin, GeodeticPoint, Meters, Point2, Radians, SystemId, TimeDelta};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::camera::CameraConfig;
use super::camera_file::CameraChoice;
use super::fleet::FleetSection;
use super::link::{LinkSection, LinkTarget, brick_link, rules_of};
use super::robot::RobotFile;
use super::robot_blocks::RobotBlockSection;
use super::ros2::Ros2Section;
use super::routing::RoutingSection;
use super::sections::{
    DashboardSection, FilterSection, MergedSection, PlotJugglerSection, RecordSection, WorldConfig, filter_config,
};

/// Everything that a run needs to know.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Who the station is.
    pub station: StationSection,
    /// The links, in the order of their ids.
    #[serde(rename = "link")]
    pub links: Vec<LinkSection>,
    /// The robot, or every robot that has no block of its own.
    pub robot: RobotFile,
    /// Robots with a configuration of their own; in a file they may stand as `[[robot]]` with a `match`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub robots: Vec<RobotBlockSection>,
    /// The filter and its tunables.
    pub filter: FilterSection,
    /// What stands in the arena.
    pub world: WorldConfig,
    /// The camera.
    pub camera: CameraConfig,
    /// The alignment of clocks.
    pub clock: ClockConfig,
    /// What passes between the links.
    pub routing: RoutingSection,
    /// The stations that this one shares robots with.
    pub fleet: FleetSection,
    /// Topics for ROS 2.
    pub ros2: Ros2Section,
    /// The recording.
    pub record: RecordSection,
    /// The page of the station.
    pub dashboard: DashboardSection,
    /// What happens, for PlotJuggler.
    pub plotjuggler: PlotJugglerSection,
    /// The stations of a merged recording; written by `posebridge merge`, and not for a station that runs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub merged: Vec<MergedSection>,
}

/// Who the station is on its links.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
#[schemars(rename = "StationConfig")]
pub struct StationSection {
    /// MAVLink system id; that of the robot, because the station is a part of it.
    pub system: u8,
    /// MAVLink component id.
    pub component: u8,
    /// The only system that may be a robot; 0 takes every sender of odometry.
    pub robot_system: u8,
    /// Most robots at a time; strangers beyond are not followed.
    pub max_robots: u16,
    /// Where the arena lies on the Earth: then fixes of satellite receivers are used, and ground stations get the position for their
    /// maps.
    pub origin: Option<OriginSection>,
}

/// The position of the arena's origin; the arena's x is east and its y north.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct OriginSection {
    /// Degrees, north positive (WGS 84).
    pub latitude: f64,
    /// Degrees, east positive.
    pub longitude: f64,
    /// Metres above mean sea level.
    #[serde(default)]
    pub altitude: f64,
}

impl OriginSection {
    fn to_origin(self) -> Result<GeodeticOrigin> {
        let Self { latitude, longitude, altitude } = self;
        let point =
            GeodeticPoint { latitude: Radians(latitude.to_radians()), longitude: Radians(longitude.to_radians()) };
        GeodeticOrigin::new(point, Meters(altitude)).with_context(|| {
            format!(
                "`station.origin` is latitude {latitude}, longitude {longitude}, altitude {altitude}: this is no point on the Earth, \
                 or nearer than a tenth of a degree to a pole"
            )
        })
    }
}

/// The alignment of clocks.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct ClockConfig {
    /// How often to ask brick and camera for their time.
    pub timesync_period_ms: u32,
    /// At which interval the brick is asked to send its telemetry; 0 leaves it at its own.
    pub telemetry_interval_ms: u32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            station: StationSection::default(),
            links: vec![LinkSection::new("sim://square")],
            robot: RobotFile::default(),
            robots: Vec::new(),
            filter: FilterSection::default(),
            world: WorldConfig::default(),
            camera: CameraConfig::default(),
            clock: ClockConfig::default(),
            routing: RoutingSection::default(),
            fleet: FleetSection::default(),
            ros2: Ros2Section::default(),
            record: RecordSection::default(),
            dashboard: DashboardSection::default(),
            plotjuggler: PlotJugglerSection::default(),
            merged: Vec::new(),
        }
    }
}

impl Default for StationSection {
    /// 1/197: the robot's system, MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY.
    fn default() -> Self {
        Self { system: 1, component: 197, robot_system: 0, max_robots: 1_024, origin: None }
    }
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self { timesync_period_ms: 200, telemetry_interval_ms: 0 }
    }
}

/// The interval of an autopilot's sensors, unless `clock.telemetry_interval_ms` asks for another: 20 Hz of inertial readings take a third of
/// a telemetry radio of 57 600 baud.
const AUTOPILOT_INTERVAL_MS: u32 = 50;
/// Satellite receivers have hardly more.
const AUTOPILOT_FIX_INTERVAL_MS: u32 = 200;
/// How much later than `camera.json.delay_ms` the pictures of phones and network cameras come in.
const NETWORK_DELAY_SIGMA_S: f64 = 0.1;
/// How far the stamps of webcams are from their exposures: some hold a picture back for a frame, and few say so.
const WEBCAM_DELAY_SIGMA_S: f64 = 0.03;

/// How badly the delay of a camera is known whose file does not say it.
fn delay_sigma_of(url: &str) -> f64 {
    if url.contains("://") {
        NETWORK_DELAY_SIGMA_S
    } else if url.starts_with("camera:/dev/") {
        WEBCAM_DELAY_SIGMA_S
    } else {
        0.0
    }
}

impl Config {
    pub fn filter_config(&self) -> Result<FilterConfig> {
        self.filter_config_of(&self.robot)
    }

    pub fn filter_config_of(&self, robot: &RobotFile) -> Result<FilterConfig> {
        self.filter.entry()?;
        filter_config(robot, &self.filter, self.world.checked()?)
    }

    /// The robot's block, else `[robot]`, which also applies before a robot was seen.
    pub fn robot_file(&self, robot: Option<&Robot>) -> &RobotFile {
        let block = robot.and_then(Robot::block).and_then(|block| self.robots.get(block));
        block.map_or(&self.robot, |block| &block.robot)
    }

    /// The robot of a link without MAVLink: the first block that names the link, else `[robot]`.
    fn robot_of_link(&self, link: usize) -> &RobotFile {
        let names_it = |block: &&RobotBlockSection| block.matches.link.is_some_and(|named| usize::from(named) == link);
        self.robots.iter().find(names_it).map_or(&self.robot, |block| &block.robot)
    }

    fn robot_config(&self, robot: &RobotFile) -> Result<RobotConfig> {
        Ok(RobotConfig {
            name: None,
            filter: self.filter.name.clone(),
            compared_filters: self.filter.compared()?,
            filter_config: self.filter_config_of(robot)?,
            wiring: robot.wiring(),
            rpm: if robot.rpm_is_wheels { RpmMeaning::Wheels } else { RpmMeaning::Unknown },
            description: if robot.adopt_description { DescriptionPolicy::Adopt } else { DescriptionPolicy::Ignore },
            tag_in_body: Point2::new(Meters(self.camera.tag_x_m), Meters(self.camera.tag_y_m)),
            tag: None,
            thermometers: robot.thermometers()?,
            goals: robot.goals(),
        })
    }

    fn robot_blocks(&self) -> Result<Vec<RobotBlock>> {
        let blocks = self.robots.iter().map(|block| {
            let name = block.own_name(&self.robot.name)?;
            let robot = self.robot_config(&block.robot);
            let robot = robot.with_context(|| format!("the block of robot `{}`", block.robot.name))?;
            Ok(RobotBlock { matches: block.matches.to_match(), robot: RobotConfig { name, tag: block.tag, ..robot } })
        });
        blocks.collect()
    }

    /// Without the keys of signed links; see [`crate::station::signing`].
    pub fn station_config(&self) -> Result<StationConfig> {
        self.check_signing()?;
        let rules = rules_of(&self.links)?.into_iter();
        let links = self.links.iter().zip(rules).enumerate().map(|(index, (link, rules))| {
            let brick = brick_link(link, self.robot_of_link(index), &self.camera);
            let brick = brick.with_context(|| format!("link {index} `{}`", link.url))?;
            ensure!(
                brick.is_none() || self.robot_of_link(index).accepts_goals != Some(true),
                "`robot.accepts_goals` is true, but link {index} `{}` is for a brick without MAVLink, which no goal can be sent to: leave \
                 the key out, or set it in a `[[robot]]` whose `match` names another link",
                link.url
            );
            let config = link.to_link_config(index, rules)?;
            Ok(LinkConfig { brick, ..config })
        });
        let interval = TimeDelta::from_millis(i64::from(self.clock.telemetry_interval_ms));
        let intervals = match self.clock.telemetry_interval_ms {
            0 => vec![],
            _ => vec![(ids::PB_WHEEL_TICKS, interval), (ids::PB_INERTIAL, interval)],
        };
        ensure!(self.clock.timesync_period_ms >= 10, "`clock.timesync_period_ms` must be at least 10");
        Ok(StationConfig {
            own_address: Address::new(self.station.system, self.station.component),
            robot: self.robot_config(&self.robot)?,
            robots: self.robot_blocks()?,
            max_robots: usize::from(self.station.max_robots),
            robot_system: (self.station.robot_system != 0).then_some(SystemId(self.station.robot_system)),
            origin: self.station.origin.map(OriginSection::to_origin).transpose()?,
            ownership: self.fleet.ownership(),
            fix_requests: self.camera.fix_requests()?,
            timesync_period: TimeDelta::from_millis(i64::from(self.clock.timesync_period_ms)),
            brick_message_intervals: intervals,
            autopilot_message_intervals: self.autopilot_message_intervals(),
            duplicate_window: self.routing.window()?,
            links: links.collect::<Result<_>>()?,
        })
    }

    /// What an autopilot is asked for: it sends little of this by itself.
    fn autopilot_message_intervals(&self) -> Vec<(u32, TimeDelta)> {
        let asked = match self.clock.telemetry_interval_ms {
            0 => AUTOPILOT_INTERVAL_MS,
            asked => asked,
        };
        let interval = TimeDelta::from_millis(i64::from(asked));
        let slow = TimeDelta::from_millis(i64::from(asked.max(AUTOPILOT_FIX_INTERVAL_MS)));
        let has_wheel_speeds =
            self.robots.iter().map(|block| &block.robot).chain([&self.robot]).any(|robot| robot.rpm_is_wheels);
        let wheel_speeds = has_wheel_speeds.then_some((ids::RPM, interval));
        let others = [
            (ids::WHEEL_DISTANCE, interval),
            (ids::ODOMETRY, interval),
            (ids::RAW_IMU, interval),
            (ids::HIGHRES_IMU, interval),
            (ids::DISTANCE_SENSOR, interval),
            (ids::GPS_RAW_INT, slow),
        ];
        others.into_iter().chain(wheel_speeds).collect()
    }

    /// Reads the files of the cameras, so that a recording of this configuration holds what stands in them. The delay of a camera
    /// is learned, unless its file or the calibration of the robot knows it.
    pub fn with_cameras_read(mut self) -> Result<Self> {
        let mut delay_sigma_s = 0.0_f64;
        for (index, link) in self.links.iter_mut().enumerate() {
            if let Some(camera) = &mut link.camera {
                let read = camera.read().with_context(|| format!("link {index} `{}`: `camera`", link.url))?;
                if read.delay_ms.is_none() {
                    delay_sigma_s = delay_sigma_s.max(delay_sigma_of(&link.url));
                }
                *camera = CameraChoice::Camera(Box::new(read));
            }
        }
        let robots = self.robots.iter_mut().map(|block| &mut block.robot).chain([&mut self.robot]);
        for delay in robots.map(|robot| &mut robot.calibration.fix_delay_s) {
            if (delay.value, delay.sigma) == (0.0, 0.0) {
                delay.sigma = delay_sigma_s;
            }
        }
        Ok(self)
    }

    /// Takes what is known of the scenario's camera, as far as the configuration does not say it: the position of the tag, and the error
    /// that fixes from one place share.
    pub fn with_camera_of(mut self, scenario: &Scenario) -> Self {
        let camera = &scenario.camera;
        if (self.camera.tag_x_m, self.camera.tag_y_m) == (0.0, 0.0) {
            self.camera.tag_x_m = camera.tag_x_m;
            self.camera.tag_y_m = camera.tag_y_m;
        }
        let noise = &mut self.robot.noise;
        if camera.patch_sigma_m > 0.0 && noise.fix_persistent_m == 0.0 {
            noise.fix_persistent_m = camera.patch_sigma_m;
            noise.fix_persistence_m = 0.5 * camera.patch_size_m;
        }
        self
    }

    /// Rejects invalid signing; reads no key.
    fn check_signing(&self) -> Result<()> {
        let mut used = BTreeMap::new();
        for (index, link) in self.links.iter().enumerate() {
            let Some(signing) = &link.signing else {
                continue;
            };
            let name = format!("link {index} `{}`", link.url);
            ensure!(!link.send_mavlink1, "{name}: MAVLink 1 cannot be signed; take away `send_mavlink1` or `signing`");
            ensure!(
                !matches!(LinkTarget::parse(&link.url), Ok(LinkTarget::Sim(_))),
                "{name}: the simulated brick does not sign; take away `signing`"
            );
            // In a merged recording they may be of two stations.
            if let Some(other) = used.insert((&signing.key_file, signing.link_id), index)
                && self.merged.is_empty()
            {
                bail!(
                    "{name}: link {other} uses the same key with the same `signing.link_id` {}; give each link its own",
                    signing.link_id
                );
            }
        }
        Ok(())
    }

    /// Rejects a configuration that no station can run with; reads no key and opens no link.
    pub fn validate(&self) -> Result<()> {
        ensure!(
            self.merged.is_empty(),
            "`merged` is of a merged recording, which no station runs with: take the configuration of one of its stations"
        );
        self.targets()?;
        self.station_config()?;
        self.dashboard.checked()?;
        self.fleet.checked(&self.robots)?;
        self.plotjuggler.checked().map(drop)
    }

    pub fn targets(&self) -> Result<Vec<(LinkTarget, ConnectRole)>> {
        ensure!(!self.links.is_empty(), "there is no link: give `--link URL` or a `[[link]]` in the configuration");
        let target = |(index, link): (usize, &LinkSection)| {
            let target = LinkTarget::parse(&link.url).with_context(|| format!("link {index} `{}`", link.url))?;
            Ok((target, if link.listen { ConnectRole::Listen } else { ConnectRole::Dial }))
        };
        self.links.iter().enumerate().map(target).collect()
    }
}
