//! The links of a station: transport, protocol, outputs, signing and routing.

use std::fmt;
use std::net::IpAddr;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_link::{LinkUrl, Transport, UrlError, VERSION};
use posebridge_protocol::bricks::camera_json::CameraJsonSettings;
use posebridge_protocol::bricks::{BRICK_PROTOCOLS, CodecSettings, brick_protocol};
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_protocol::routing::{ForwardPolicy, ForwardedDialects, LinkRules};
use posebridge_sim::Scenario;
use posebridge_sim::impairment::LinkProfile;
use posebridge_station::{
    AcceptedVersions, AnnouncedAs, BrickLink, LinkConfig, OUTPUTS, OutputInstant, OutputStream, PinPolicy,
};
use posebridge_telemetry::{LinkId, TimeDelta};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::camera::CameraConfig;
use super::camera_file::{CameraChoice, CameraFile};
use super::robot::RobotFile;
use super::routing::{DialectChoice, ForwardChoice, FrameFilterSection, LimitsSection};
use super::signing::SigningSection;
use crate::text_file::read_text;

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
    /// What the brick at its other end speaks, if it is no MAVLink: docs/protocols/mavlink.md.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brick: Option<String>,
    /// Where a camera at its other end stands: its file of `posebridge camera calibrate` (docs/camera.md).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraChoice>,
    /// Accept MAVLink 1 too.
    #[serde(default)]
    pub accept_mavlink1: bool,
    /// Send MAVLink 1. It has no message ids above 255: choose outputs such as local_position and attitude.
    #[serde(default)]
    pub send_mavlink1: bool,
    /// Ground stations are at its other end: the station speaks there as the robot, too (docs/ground-stations.md).
    #[serde(default)]
    pub ground_station: bool,
    /// Of which dialects others' frames are passed on to it: `stock` (without our own messages) or `all`. Without it a link for ground
    /// stations has `stock`: a program that does not know a message counts it as lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dialects: Option<DialectChoice>,
    /// What is sent there; without it planar_pose, or on a link for ground stations what they draw.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outputs: Option<Vec<OutputSection>>,
    /// How its frames are signed; without it frames of any sender that reaches the link are accepted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signing: Option<SigningSection>,
    /// Who may speak for a robot: first, address or key (docs/routing.md). Without it the station goes by what senders do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pin: Option<PinChoice>,
    /// Links with the same name lead to one robot, and one may stand in for another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// What of the others' frames is passed on to it.
    #[serde(default)]
    pub forward: ForwardChoice,
    /// Which of its frames are accepted and forwarded.
    #[serde(default)]
    pub filter_in: FrameFilterSection,
    /// What of the others' frames may leave on it.
    #[serde(default)]
    pub filter_out: FrameFilterSection,
    /// How much of the others' frames and of our estimates may leave on it.
    #[serde(default)]
    pub limits: LimitsSection,
}

/// Who may speak for a robot on a link.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum PinChoice {
    /// The UDP port or TCP connection that used its ids first, until it is silent for half a minute.
    First,
    /// The network address that did; the robot may come back from another port.
    Address,
    /// Whoever signs: on a link with `signing` that also takes unsigned frames, those speak for no robot.
    Key,
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

impl LinkSection {
    /// A link for ground stations. TCP listens, and so does UDP at an address of this computer.
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

    /// Whether this program looks for tags in the pictures of a camera there.
    pub fn has_pictures(&self) -> bool {
        matches!(LinkTarget::parse(&self.url), Ok(LinkTarget::Url(url)) if url.transport() == Transport::Camera)
    }

    /// Whether the URL asks for MAVLink 1.
    fn is_version_1(&self) -> bool {
        matches!(LinkTarget::parse(&self.url), Ok(LinkTarget::Url(url)) if url.option_text(&VERSION) == "1")
    }

    /// A link to a camera: by the file of a calibrated one, or by the source of its pictures.
    pub fn for_camera(file_or_source: &str) -> Result<Self> {
        let section = |source: &str| Self { outputs: Some(Vec::new()), ..Self::new(&format!("camera:{source}")) };
        if !is_toml_file(file_or_source) {
            return Ok(section(file_or_source));
        }
        let camera = CameraFile::read(Path::new(file_or_source))?;
        let source = camera.source.clone().context(
            "the file does not say where the pictures come from: add a line such as `source = \"/dev/video0\"`",
        )?;
        Ok(Self { camera: Some(CameraChoice::Camera(Box::new(camera))), ..section(&source) })
    }

    fn outputs(&self) -> Vec<OutputSection> {
        match (&self.outputs, self.ground_station) {
            (Some(outputs), _) => outputs.clone(),
            (None, true) => outputs_for_ground_stations(),
            (None, false) => outputs_for_bricks(),
        }
    }

    pub fn new(url: &str) -> Self {
        Self {
            url: url.to_owned(),
            listen: false,
            brick: None,
            camera: None,
            accept_mavlink1: false,
            send_mavlink1: false,
            ground_station: false,
            dialects: None,
            outputs: Some(outputs_for_bricks()),
            signing: None,
            pin: None,
            group: None,
            forward: ForwardChoice::default(),
            filter_in: FrameFilterSection::default(),
            filter_out: FrameFilterSection::default(),
            limits: LimitsSection::default(),
        }
    }
}

fn outputs_for_bricks() -> Vec<OutputSection> {
    vec![output("planar_pose", 0)]
}

/// The outputs for the displays of ground stations: 10 Hz look smooth, and together they take about 4 kB/s.
fn outputs_for_ground_stations() -> Vec<OutputSection> {
    vec![
        output("attitude", 100),
        output("local_position", 100),
        output("global_position", 200),
        output("vfr_hud", 250),
        output("odometry", 100),
        output("distance_sensor", 200),
        output("estimator_status", 1_000),
    ]
}

fn output(message: &str, interval_ms: u32) -> OutputSection {
    OutputSection { message: message.to_owned(), interval_ms, at: AtInstant::Observed }
}

impl LinkSection {
    pub(super) fn to_link_config(&self, index: usize, rules: LinkRules) -> Result<LinkConfig> {
        let outputs = self.outputs();
        let outputs = outputs.iter().map(OutputSection::to_output_stream);
        let is_version_1 = self.is_version_1();
        Ok(LinkConfig {
            brick: None,
            id: LinkId(index as u16),
            framing: framing_of(&self.url),
            accepted_versions: if self.accept_mavlink1 || is_version_1 {
                AcceptedVersions::V1AndV2
            } else {
                AcceptedVersions::V2
            },
            send_version: if self.send_mavlink1 || is_version_1 { WireVersion::V1 } else { WireVersion::V2 },
            outputs: outputs.collect::<Result<_>>().with_context(|| format!("link {index} `{}`", self.url))?,
            pin: self.pin_policy().with_context(|| format!("link {index} `{}`", self.url))?,
            announced_as: if self.ground_station { AnnouncedAs::StationAndVehicle } else { AnnouncedAs::Station },
            signing: None,
            rules,
            robots_take_goals: matches!(LinkTarget::parse(&self.url), Ok(LinkTarget::Sim(_))),
        })
    }
}

impl LinkSection {
    fn pin_policy(&self) -> Result<Option<PinPolicy>> {
        let is_signed = self.signing.is_some();
        ensure!(
            self.pin != Some(PinChoice::Key) || is_signed,
            "`pin = \"key\"` needs a key: add `signing`, or write `pin = \"address\"`"
        );
        Ok(self.pin.map(|pin| match pin {
            PinChoice::First => PinPolicy::First,
            PinChoice::Address => PinPolicy::Address,
            PinChoice::Key => PinPolicy::Key,
        }))
    }
}

impl OutputSection {
    fn to_output_stream(&self) -> Result<OutputStream> {
        let Some(output) = OUTPUTS.iter().find(|output| output.name == self.message) else {
            let known: Vec<_> = OUTPUTS.iter().map(|output| output.name).collect();
            bail!("`outputs.message` is `{}`; there are: {}", self.message, known.join(", "));
        };
        Ok(OutputStream {
            kind: output.kind,
            interval: TimeDelta::from_millis(i64::from(self.interval_ms)),
            instant: match self.at {
                AtInstant::Observed => OutputInstant::Observed,
                AtInstant::Arrival => OutputInstant::Arrival,
            },
        })
    }
}

pub(super) fn framing_of(url: &str) -> TransportKind {
    match LinkTarget::parse(url) {
        Ok(LinkTarget::Url(url)) if is_datagram(&url) => TransportKind::Datagram,
        _ => TransportKind::Stream,
    }
}

fn is_datagram(url: &LinkUrl) -> bool {
    url.transport().is_datagram()
}

pub(super) fn rules_of(links: &[LinkSection]) -> Result<Vec<LinkRules>> {
    let mut groups: Vec<&str> = Vec::new();
    let mut rules = Vec::with_capacity(links.len());
    for (index, link) in links.iter().enumerate() {
        let group = link.group.as_deref().map(|name| {
            let known = groups.iter().position(|group| *group == name);
            known.unwrap_or_else(|| {
                groups.push(name);
                groups.len() - 1
            }) as u16
        });
        let of_link = rules_of_link(link, group).with_context(|| format!("link {index} `{}`", link.url))?;
        rules.push(of_link);
    }
    Ok(rules)
}

fn rules_of_link(link: &LinkSection, group: Option<u16>) -> Result<LinkRules> {
    ensure!(link.group.as_deref() != Some(""), "`group` is empty; leave it out where a link stands alone");
    Ok(LinkRules {
        group,
        forward: match link.forward {
            ForwardChoice::ByRole => ForwardPolicy::ByRole,
            ForwardChoice::All => ForwardPolicy::All,
            ForwardChoice::Targeted => ForwardPolicy::Targeted,
            ForwardChoice::None => ForwardPolicy::Disabled,
        },
        inward: link.filter_in.filter().context("`filter_in`")?,
        outward: link.filter_out.filter().context("`filter_out`")?,
        dialects: match (link.dialects, link.ground_station) {
            (Some(DialectChoice::Stock), _) | (None, true) => ForwardedDialects::Stock,
            (Some(DialectChoice::All), _) | (None, false) => ForwardedDialects::All,
        },
        limits: link.limits.limits().context("`limits`")?,
    })
}

const SIM_SCHEME: &str = "sim://";

#[derive(Clone, Debug)]
pub enum LinkTarget {
    Url(LinkUrl),
    /// A simulated brick in this process: the scenario's name or file.
    Sim(String),
}

impl LinkTarget {
    /// Parses `sim://NAME`, `sim://FILE.toml` and the URLs of every transport.
    pub fn parse(text: &str) -> Result<Self, UrlError> {
        if let Some(scenario) = text.strip_prefix(SIM_SCHEME) {
            return Ok(Self::Sim(scenario.to_owned()));
        }
        match LinkUrl::parse(text) {
            Ok(url) => Ok(Self::Url(url)),
            Err(UrlError::UnknownScheme { scheme, known }) => {
                let known = format!("sim, {known}");
                Err(UrlError::UnknownScheme { scheme, known })
            }
            Err(error) => Err(error),
        }
    }
}

impl fmt::Display for LinkTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Url(url) => write!(f, "{url}"),
            Self::Sim(scenario) => write!(f, "{SIM_SCHEME}{scenario}"),
        }
    }
}

fn is_toml_file(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension == "toml")
}

/// A bundled scenario by its name, or one from a TOML file.
pub fn load_scenario(name_or_file: &str) -> Result<Scenario> {
    if !is_toml_file(name_or_file) {
        return Ok(Scenario::bundled(name_or_file)?);
    }
    let text = read_text(name_or_file).with_context(|| format!("reading scenario `{name_or_file}`"))?;
    // A way-points file lies beside its scenario unless its path says otherwise.
    let folder = Path::new(name_or_file).parent().unwrap_or(Path::new(""));
    let mut read = |path: &Path| read_text(folder.join(path));
    Scenario::from_toml_with(&text, &mut read).with_context(|| format!("scenario `{name_or_file}`"))
}

/// A bundled link profile by its name (`none` has no impairments), or one from a TOML file.
pub fn load_link_profile(name_or_file: &str) -> Result<LinkProfile> {
    if !is_toml_file(name_or_file) {
        return Ok(LinkProfile::bundled(name_or_file)?);
    }
    let text = read_text(name_or_file).with_context(|| format!("reading the link profile `{name_or_file}`"))?;
    LinkProfile::from_toml(&text).with_context(|| format!("`{name_or_file}`"))
}

/// The protocol that needs no brick codec.
const MAVLINK: &str = "mavlink";
/// The protocol that reads numbers by their order and no names.
const COLUMNS: &str = "columns";

/// The protocol of a link to a camera.
const CAMERA_JSON: &str = "camera-json";

/// `None` for MAVLink.
pub(super) fn brick_link(link: &LinkSection, robot: &RobotFile, cameras: &CameraConfig) -> Result<Option<BrickLink>> {
    let has_pictures = link.has_pictures();
    let Some(name) = link.brick.as_deref().or(has_pictures.then_some(CAMERA_JSON)) else {
        ensure!(link.camera.is_none(), "`camera` belongs to `brick = \"{CAMERA_JSON}\"`, or to a URL of `camera:`");
        return Ok(None);
    };
    ensure!(
        name == CAMERA_JSON || !(has_pictures || link.camera.is_some()),
        "`brick = \"{name}\"` is no camera: take `brick` away, or `camera`"
    );
    let Some(protocol) = brick_protocol(name) else {
        let known: Vec<&str> = BRICK_PROTOCOLS.iter().map(|row| row.name).collect();
        bail!("`brick` is `{name}`; there are: {}", known.join(", "));
    };
    if protocol.name == MAVLINK {
        return Ok(None);
    }
    for (key, is_set) in [
        ("signing", link.signing.is_some()),
        ("ground_station", link.ground_station),
        ("accept_mavlink1", link.accept_mavlink1),
        ("send_mavlink1", link.send_mavlink1),
        ("group", link.group.is_some()),
    ] {
        ensure!(!is_set, "`{key}` belongs to MAVLink, and `brick = \"{name}\"` speaks none; take one of them away");
    }
    let has_keys = robot.line.as_ref().is_some_and(|line| !line.keys.is_empty());
    ensure!(
        name != COLUMNS || !has_keys,
        "`[robot.line]` has `keys`, which `brick = \"{name}\"` does not read: write `brick = \"line\"`, or `columns` in place of `keys`"
    );
    let camera = link.camera.as_ref().map(CameraChoice::read).transpose().context("`camera`")?;
    let fixes = cameras.json_settings(camera.as_ref())?;
    let settings = CodecSettings {
        fixes: CameraJsonSettings { framing: framing_of(&link.url), ..fixes },
        ..codec_settings(robot)?
    };
    Ok(Some(BrickLink { protocol, settings }))
}

fn codec_settings(robot: &RobotFile) -> Result<CodecSettings> {
    let nxt = robot.nxt.clone().unwrap_or_default();
    let ev3 = robot.ev3.clone().unwrap_or_default();
    let line = robot.line.clone().unwrap_or_default();
    Ok(CodecSettings {
        nxt: nxt.settings().context("`[robot.nxt]`")?,
        ev3: ev3.settings().context("`[robot.ev3]`")?,
        line: line.settings().context("`[robot.line]`")?,
        ..CodecSettings::default()
    })
}
