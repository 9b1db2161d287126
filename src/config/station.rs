//! The station's own part of the configuration, and how it becomes a pipeline.

use std::net::IpAddr;

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_link::{LinkUrl, Role};
use posebridge_pipeline::{
    AcceptedVersions, DescriptionPolicy, FixRequestConfig, LinkConfig, OUTPUTS, OutputInstant, OutputStream,
    PipelineConfig, Voices,
};
use posebridge_protocol::framing::{Framing, WireVersion};
use posebridge_protocol::routing::LinkRules;
use posebridge_sim::Scenario;
use posebridge_telemetry::{Address, LinkId, Meters, Point2, Span, SystemId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bricks::{FixSection, brick_link};
use super::dashboard::DashboardSection;
use super::filter::{FilterSection, filter_config};
use super::plotjuggler::PlotJugglerSection;
use super::robot::RobotFile;
use super::routing::{ForwardChoice, FrameFilterSection, LimitsSection, RoutingSection, rules_of};
use super::signing::SigningSection;
use super::world::WorldConfig;
use crate::link_target::LinkTarget;
use crate::tasks::parts::Limits;

/// Everything that a run needs to know.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Who the station is.
    pub station: StationConfig,
    /// The links, in the order of their ids.
    #[serde(rename = "link")]
    pub links: Vec<LinkSection>,
    /// The robot.
    pub robot: RobotFile,
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
    /// The recording.
    pub record: RecordSection,
    /// The page of the station.
    pub dashboard: DashboardSection,
    /// What happens, for PlotJuggler.
    pub plotjuggler: PlotJugglerSection,
}

/// Who the station is on its links.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct StationConfig {
    /// MAVLink system id; that of the robot, because the station is a part of it.
    pub system: u8,
    /// MAVLink component id.
    pub component: u8,
    /// Which system is the robot; 0 takes the first that speaks.
    pub robot_system: u8,
}

/// One link.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
#[expect(clippy::struct_excessive_bools, reason = "four independent keys of a file, each with a name")]
pub struct LinkSection {
    /// What to open; see `posebridge run --help` for the kinds.
    pub url: String,
    /// Wait for the other side to call instead of calling it.
    #[serde(default)]
    pub listen: bool,
    /// What the brick at its other end speaks, if it is no MAVLink: docs/protocols/README.md.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brick: Option<String>,
    /// Accept MAVLink 1 too.
    #[serde(default)]
    pub accept_mavlink1: bool,
    /// Send MAVLink 1. It has no message ids above 255: choose outputs such as local_position and attitude.
    #[serde(default)]
    pub send_mavlink1: bool,
    /// Ground stations are at its other end: the station speaks there as the robot, too (docs/ground-stations.md).
    #[serde(default)]
    pub ground_station: bool,
    /// What is sent there; without it planar_pose, or on a link for ground stations what they draw.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outputs: Option<Vec<OutputSection>>,
    /// How its frames are signed; without it anybody who reaches the link is believed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signing: Option<SigningSection>,
    /// Links with the same name lead to one robot, and one may stand in for another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// What of the others' frames is passed on to it.
    #[serde(default)]
    pub forward: ForwardChoice,
    /// What is believed and passed on of what comes from it.
    #[serde(default)]
    pub filter_in: FrameFilterSection,
    /// What of the others' frames may leave on it.
    #[serde(default)]
    pub filter_out: FrameFilterSection,
    /// How much of the others' frames and of our estimates may leave on it.
    #[serde(default)]
    pub limits: LimitsSection,
}

/// One kind of message that leaves on a link.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct OutputSection {
    /// planar_pose, odometry, local_position, attitude, estimator_status, fusion_health, distance_sensor, named_value_float or
    /// debug_float_array.
    pub message: String,
    /// At least this long between two of them; 0 sends one with every estimate.
    #[serde(default)]
    pub interval_ms: u32,
    /// For which instant.
    #[serde(default)]
    pub at: AtInstant,
}

/// For which instant an estimate is sent.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum AtInstant {
    /// That of the last observation.
    #[default]
    Observed,
    /// That at which it will arrive, by prediction.
    Arrival,
}

/// The camera.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// Where the tag sits, forward of mid-axle.
    pub tag_x_m: f64,
    /// Where the tag sits, left of mid-axle.
    pub tag_y_m: f64,
    /// Ask cameras that answer for a fix when the position's standard deviation is above this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ask_above_m: Option<f64>,
    /// Ask them when the heading's standard deviation is above this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ask_above_deg: Option<f64>,
    /// Not sooner after the last request.
    pub ask_interval_ms: u32,
    /// How cameras that speak JSON are heard.
    pub json: FixSection,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            tag_x_m: 0.0,
            tag_y_m: 0.0,
            ask_above_m: None,
            ask_above_deg: None,
            ask_interval_ms: 250,
            json: FixSection::default(),
        }
    }
}

impl CameraConfig {
    /// When cameras are asked for a fix.
    fn fix_requests(&self) -> Result<FixRequestConfig> {
        for (key, limit) in [("ask_above_m", self.ask_above_m), ("ask_above_deg", self.ask_above_deg)] {
            ensure!(
                limit.is_none_or(|limit| limit.is_finite() && limit > 0.0),
                "`camera.{key}` is {}, must be more than zero; leave it out to ask nobody",
                limit.unwrap_or_default()
            );
        }
        ensure!(self.ask_interval_ms >= 10, "`camera.ask_interval_ms` must be at least 10");
        Ok(FixRequestConfig {
            above_m: self.ask_above_m,
            above_rad: self.ask_above_deg.map(f64::to_radians),
            interval: Span::from_millis(i64::from(self.ask_interval_ms)),
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

/// The recording.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RecordSection {
    /// Whether to record.
    pub enabled: bool,
    /// The folder that holds one folder per run.
    pub directory: String,
    /// The recording goes on in a new file when the old one is so large, in MB of a million bytes; 0: never.
    pub part_max_mb: u32,
    /// The recording goes on in a new file when the old one is so old; 0: never.
    pub part_max_minutes: u32,
    /// The recording ends when the disk has less room than this, in MB of a million bytes.
    pub min_free_mb: u32,
    /// Estimates beside the inputs, for viewers, lie at least so far apart; 0: all of them. A replay is exact whatever stands here.
    pub outputs_interval_ms: u32,
    /// Whether to write a telemetry log (.tlog) beside the recording.
    pub tlog: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            station: StationConfig::default(),
            links: vec![LinkSection::new("sim://square")],
            robot: RobotFile::default(),
            filter: FilterSection::default(),
            world: WorldConfig::default(),
            camera: CameraConfig::default(),
            clock: ClockConfig::default(),
            routing: RoutingSection::default(),
            record: RecordSection::default(),
            dashboard: DashboardSection::default(),
            plotjuggler: PlotJugglerSection::default(),
        }
    }
}

impl Default for StationConfig {
    /// 1/197: the same system as the robot, MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY.
    fn default() -> Self {
        Self { system: 1, component: 197, robot_system: 0 }
    }
}

impl LinkSection {
    /// A link for ground stations. TCP waits for their calls, and so does UDP at an address of this computer.
    ///
    /// # Errors
    /// It is no URL of a link, or opens what no ground station speaks through.
    pub fn for_ground_stations(url: &str) -> Result<Self> {
        let LinkTarget::Url(parsed) = LinkTarget::parse(url)? else {
            bail!("`{url}` is a simulated brick; a ground station is reached by udp:// or tcp://");
        };
        let host = parsed.host_and_port().0;
        let any_address = host.parse().is_ok_and(|ip: IpAddr| ip.is_unspecified());
        Ok(Self {
            listen: parsed.transport().scheme() == "tcp" || any_address,
            ground_station: true,
            outputs: None,
            ..Self::new(url)
        })
    }

    /// What is sent there.
    fn outputs(&self) -> Vec<OutputSection> {
        match (&self.outputs, self.ground_station) {
            (Some(outputs), _) => outputs.clone(),
            (None, true) => outputs_for_ground_stations(),
            (None, false) => outputs_for_bricks(),
        }
    }

    /// A link with the usual outputs.
    #[must_use]
    pub fn new(url: &str) -> Self {
        Self {
            url: url.to_owned(),
            listen: false,
            brick: None,
            accept_mavlink1: false,
            send_mavlink1: false,
            ground_station: false,
            outputs: Some(outputs_for_bricks()),
            signing: None,
            group: None,
            forward: ForwardChoice::default(),
            filter_in: FrameFilterSection::default(),
            filter_out: FrameFilterSection::default(),
            limits: LimitsSection::default(),
        }
    }
}

/// What a brick needs to steer by.
fn outputs_for_bricks() -> Vec<OutputSection> {
    vec![output("planar_pose", 0)]
}

/// What ground stations draw: 10 Hz are smooth to the eye, and together they take about 4 kB/s.
fn outputs_for_ground_stations() -> Vec<OutputSection> {
    vec![
        output("attitude", 100),
        output("local_position", 100),
        output("odometry", 100),
        output("distance_sensor", 200),
        output("estimator_status", 1_000),
    ]
}

fn output(message: &str, interval_ms: u32) -> OutputSection {
    OutputSection { message: message.to_owned(), interval_ms, at: AtInstant::Observed }
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self { timesync_period_ms: 200, telemetry_interval_ms: 0 }
    }
}

impl Default for RecordSection {
    fn default() -> Self {
        Self {
            enabled: true,
            directory: "posebridge-runs".to_owned(),
            part_max_mb: 1_000,
            part_max_minutes: 5,
            min_free_mb: 200,
            outputs_interval_ms: 100,
            tlog: false,
        }
    }
}

impl RecordSection {
    /// As the recorder takes them.
    #[must_use]
    pub fn limits(&self) -> Limits {
        const MEGABYTE: u64 = 1_000_000;
        let limit = |number: u32| (number != 0).then_some(number);
        Limits {
            part_bytes: limit(self.part_max_mb).map(|mb| u64::from(mb) * MEGABYTE),
            part_span: limit(self.part_max_minutes).map(|minutes| Span::from_millis(i64::from(minutes) * 60_000)),
            floor_bytes: u64::from(self.min_free_mb) * MEGABYTE,
            output_spacing: Span::from_millis(i64::from(self.outputs_interval_ms)),
        }
    }
}

impl Config {
    /// The filter's configuration.
    ///
    /// # Errors
    /// A value makes no sense; the message names its key.
    pub fn filter_config(&self) -> Result<FilterConfig> {
        self.filter.entry()?;
        filter_config(&self.robot, &self.filter, self.world.checked()?)
    }

    /// The pipeline's configuration, without the keys of signed links; see [`crate::signing`].
    ///
    /// # Errors
    /// A value makes no sense; the message names its key.
    pub fn pipeline(&self) -> Result<PipelineConfig> {
        self.check_signing()?;
        let rules = rules_of(&self.links)?.into_iter();
        let links = self.links.iter().zip(rules).enumerate().map(|(index, (link, rules))| {
            let brick = brick_link(link, &self.robot, &self.camera.json);
            let brick = brick.with_context(|| format!("link {index} `{}`", link.url))?;
            let pipeline = link.pipeline(index, rules)?;
            Ok(LinkConfig { brick, ..pipeline })
        });
        let interval = Span::from_millis(i64::from(self.clock.telemetry_interval_ms));
        let wanted = match self.clock.telemetry_interval_ms {
            0 => vec![],
            _ => vec![
                (posebridge_protocol::dialect::ids::PB_WHEEL_TICKS, interval),
                (posebridge_protocol::dialect::ids::PB_INERTIAL, interval),
            ],
        };
        ensure!(self.clock.timesync_period_ms >= 10, "`clock.timesync_period_ms` must be at least 10");
        Ok(PipelineConfig {
            own: Address::new(self.station.system, self.station.component),
            filter: self.filter.name.clone(),
            filter_config: self.filter_config()?,
            description: if self.robot.adopt_description {
                DescriptionPolicy::Adopt
            } else {
                DescriptionPolicy::Ignore
            },
            robot_system: (self.station.robot_system != 0).then_some(SystemId(self.station.robot_system)),
            tag_in_body: Point2::new(Meters(self.camera.tag_x_m), Meters(self.camera.tag_y_m)),
            fix_requests: self.camera.fix_requests()?,
            timesync_period: Span::from_millis(i64::from(self.clock.timesync_period_ms)),
            wanted,
            duplicate_window: self.routing.window()?,
            thermometers: super::thermometer::checked(&self.robot.thermometers)?,
            links: links.collect::<Result<_>>()?,
        })
    }

    /// A simulated robot's tag is where its scenario says, unless the configuration says otherwise.
    #[must_use]
    pub fn with_tag_of(mut self, scenario: &Scenario) -> Self {
        if (self.camera.tag_x_m, self.camera.tag_y_m) == (0.0, 0.0) {
            self.camera.tag_x_m = scenario.camera.tag_x_m;
            self.camera.tag_y_m = scenario.camera.tag_y_m;
        }
        self
    }

    /// What each link opens.
    ///
    /// # Errors
    /// A URL cannot be understood; the message names the link.
    pub fn targets(&self) -> Result<Vec<(LinkTarget, Role)>> {
        ensure!(!self.links.is_empty(), "there is no link: give `--link URL` or a `[[link]]` in the configuration");
        let target = |(index, link): (usize, &LinkSection)| {
            let target = LinkTarget::parse(&link.url).with_context(|| format!("link {index} `{}`", link.url))?;
            Ok((target, if link.listen { Role::Listen } else { Role::Dial }))
        };
        self.links.iter().enumerate().map(target).collect()
    }
}

impl LinkSection {
    fn pipeline(&self, index: usize, rules: LinkRules) -> Result<LinkConfig> {
        let outputs = self.outputs();
        let outputs = outputs.iter().map(OutputSection::pipeline);
        Ok(LinkConfig {
            brick: None,
            id: LinkId(index as u16),
            framing: framing_of(&self.url),
            version: if self.accept_mavlink1 { AcceptedVersions::V1AndV2 } else { AcceptedVersions::V2 },
            speaks: if self.send_mavlink1 { WireVersion::V1 } else { WireVersion::V2 },
            outputs: outputs.collect::<Result<_>>().with_context(|| format!("link {index} `{}`", self.url))?,
            voices: if self.ground_station { Voices::OwnAndRobot } else { Voices::Own },
            signing: None,
            rules,
        })
    }
}

/// Whether a chunk from there is a datagram.
pub(super) fn framing_of(url: &str) -> Framing {
    match LinkTarget::parse(url) {
        Ok(LinkTarget::Url(url)) if is_datagram(&url) => Framing::Datagram,
        _ => Framing::Stream,
    }
}

fn is_datagram(url: &LinkUrl) -> bool {
    url.transport().is_datagram()
}

impl OutputSection {
    fn pipeline(&self) -> Result<OutputStream> {
        let Some((_, kind)) = OUTPUTS.iter().find(|(name, _)| *name == self.message) else {
            let known: Vec<_> = OUTPUTS.iter().map(|(name, _)| *name).collect();
            bail!("`outputs.message` is `{}`; there are: {}", self.message, known.join(", "));
        };
        Ok(OutputStream {
            kind: *kind,
            interval: Span::from_millis(i64::from(self.interval_ms)),
            instant: match self.at {
                AtInstant::Observed => OutputInstant::Observed,
                AtInstant::Arrival => OutputInstant::Arrival,
            },
        })
    }
}
