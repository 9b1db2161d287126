//! The small sections of a configuration: `[filter]`, `[world]`, `[record]`, `[dashboard]`, `[plotjuggler]`.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_dashboard::ListenAddress;
use posebridge_estimator::{
    EstimatedQuantity, FILTERS, FilterConfig, FilterEntry, Initialization, Params, find_filter,
};
use posebridge_telemetry::{Arena, ArenaMap, BeaconId, LandmarkId, Meters, Point2, TimeDelta, Wall};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::robot::RobotFile;

/// The filter and its tunables.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default)]
pub struct FilterSection {
    /// Name of a filter.
    pub name: String,
    /// Filters that follow each robot beside it, to compare them; their estimates are shown and recorded, not sent.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub compare: Vec<String>,
    /// Its tunables, by key.
    #[serde(flatten)]
    pub params: BTreeMap<String, f64>,
}

impl Default for FilterSection {
    fn default() -> Self {
        Self { name: "pose".to_owned(), compare: Vec::new(), params: BTreeMap::new() }
    }
}

impl FilterSection {
    pub fn entry(&self) -> Result<&'static FilterEntry> {
        find_filter(&self.name)
            .ok_or_else(|| anyhow!("`filter.name` is `{}`; there are: {}", self.name, names_of_filters()))
    }

    /// The filters to compare, without the one whose estimates are sent.
    pub fn compared(&self) -> Result<Vec<String>> {
        let mut compared: Vec<String> = Vec::new();
        for name in &self.compare {
            let entry = find_filter(name)
                .ok_or_else(|| anyhow!("`filter.compare` has `{name}`; there are: {}", names_of_filters()))?;
            ensure!(
                entry.quantity == EstimatedQuantity::Pose,
                "`filter.compare` has `{name}`, which estimates one quantity and no pose: leave it out"
            );
            if *name != self.name && !compared.contains(name) {
                compared.push(name.clone());
            }
        }
        Ok(compared)
    }

    /// Warns if this filter can never produce a pose, with a remedy.
    pub fn warning(&self, robot: &RobotFile) -> Option<String> {
        let name = &self.name;
        match find_filter(name)?.initialization {
            Initialization::Start if robot.start.is_none() => Some(format!(
                "the filter `{name}` uses no fixes and has no configured start, so it never gets a pose: give `[robot.start]` with x_m, \
                 y_m, heading_deg, position_sigma_m and heading_sigma_deg, or take another filter, such as `pose`"
            )),
            Initialization::NotApplicable => {
                Some(format!("the filter `{name}` estimates one quantity and no pose; `pose` does"))
            }
            Initialization::Fix | Initialization::Start => None,
        }
    }

    /// With defaults for missing ones.
    pub fn params(&self) -> Result<Params> {
        let mut params = Params::default();
        for (key, value) in &self.params {
            params.set(key, *value).context("`[filter]`")?;
        }
        Ok(params)
    }
}

pub fn names_of_filters() -> String {
    let names: Vec<_> = FILTERS.iter().map(|entry| entry.name).collect();
    names.join(", ")
}

/// The filter's configuration for a robot, used by both live stations and replays, so that the same files give the same filter.
pub fn filter_config(robot: &RobotFile, filter: &FilterSection, world: ArenaMap) -> Result<FilterConfig> {
    Ok(FilterConfig {
        geometry: robot.geometry()?,
        noise: robot.noise()?,
        start: robot.start()?,
        params: filter.params()?,
        calibration: robot.calibration()?,
        arena_map: Arc::new(world),
        slow_sensor: robot.slow_sensor()?,
    })
}

/// What stands in the arena.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct WorldConfig {
    /// Points that a robot's camera can tell apart.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub landmarks: Vec<NumberedPlace>,
    /// Radio beacons.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub beacons: Vec<NumberedPlace>,
    /// Walls that a range sensor can meet.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub walls: Vec<WallPlace>,
}

/// The place of a landmark or of a beacon.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct NumberedPlace {
    /// The number under which it is seen.
    pub id: u32,
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
}

/// A straight wall between two points.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct WallPlace {
    /// One end.
    pub from: PointPlace,
    /// The other end.
    pub to: PointPlace,
}

/// A point of the arena.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, expecting = "a table { x_m, y_m }")]
pub struct PointPlace {
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
}

impl WorldConfig {
    pub fn checked(&self) -> Result<ArenaMap> {
        let landmarks = parse_points("landmarks", &self.landmarks)?;
        let beacons = parse_points("beacons", &self.beacons)?;
        let walls = self.walls.iter().enumerate().map(|(index, segment)| {
            let key = format!("walls, number {}", index + 1);
            let (from, to) = (parse_point(&key, segment.from)?, parse_point(&key, segment.to)?);
            ensure!(from != to, "`[world]` {key}: it has no length");
            Ok(Wall { from, to })
        });
        Ok(ArenaMap {
            landmarks: by_id(&landmarks, LandmarkId),
            beacons: by_id(&beacons, BeaconId),
            walls: walls.collect::<Result<_>>()?,
        })
    }
}

fn parse_points(key: &str, points: &[NumberedPlace]) -> Result<BTreeMap<u32, Point2<Arena>>> {
    let mut known = BTreeMap::new();
    for &NumberedPlace { id, x_m, y_m } in points {
        let at = parse_point(&format!("{key}, id {id}"), PointPlace { x_m, y_m })?;
        ensure!(known.insert(id, at).is_none(), "`[world]` {key}: the id {id} is there twice");
    }
    Ok(known)
}

fn by_id<K: Ord>(points: &BTreeMap<u32, Point2<Arena>>, id: fn(u32) -> K) -> BTreeMap<K, Point2<Arena>> {
    points.iter().map(|(key, at)| (id(*key), *at)).collect()
}

fn parse_point(key: &str, point: PointPlace) -> Result<Point2<Arena>> {
    let PointPlace { x_m, y_m } = point;
    ensure!(x_m.is_finite() && y_m.is_finite(), "`[world]` {key}: it lies at ({x_m}, {y_m}): both must be finite");
    Ok(Point2::new(Meters(x_m), Meters(y_m)))
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
    pub fn limits(&self) -> RecordingLimits {
        const MEGABYTE: u64 = 1_000_000;
        let limit = |number: u32| (number != 0).then_some(number);
        RecordingLimits {
            part_bytes: limit(self.part_max_mb).map(|mb| u64::from(mb) * MEGABYTE),
            part_duration: limit(self.part_max_minutes)
                .map(|minutes| TimeDelta::from_millis(i64::from(minutes) * 60_000)),
            min_free_bytes: u64::from(self.min_free_mb) * MEGABYTE,
            output_interval: TimeDelta::from_millis(i64::from(self.outputs_interval_ms)),
        }
    }
}

/// Limits of a recording's parts, disk space and output rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordingLimits {
    pub part_bytes: Option<u64>,
    pub part_duration: Option<TimeDelta>,
    /// The recording ends when the disk has less free space.
    pub min_free_bytes: u64,
    /// Minimum interval between stored estimates.
    pub output_interval: TimeDelta,
}

impl Default for RecordingLimits {
    fn default() -> Self {
        RecordSection::default().limits()
    }
}

/// Default address of the dashboard: loopback, at a port that IANA has not assigned.
const DEFAULT_LISTEN: &str = "127.0.0.1:4680";

/// The dashboard.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct DashboardSection {
    /// Whether there is one.
    pub enabled: bool,
    /// IP address and port. At the default the next free port is taken if this one is in use; another one is taken as it is. A
    /// browser on another computer needs the token that is printed at the start.
    pub listen: String,
    /// Whether the token is needed on this computer as well, because it has several users.
    pub always_token: bool,
    /// A file of tokens, one a line behind the role that it gives, `operator` or `reader`; made at the start if it is missing, and read again
    /// while the station runs. Without it the tokens are new with every start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token_file: Option<String>,
    /// Names, each perhaps with a port, under which a reverse proxy serves the page, with TLS for instance. Every request needs a token then.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub public_names: Vec<String>,
}

impl Default for DashboardSection {
    fn default() -> Self {
        Self {
            enabled: true,
            listen: DEFAULT_LISTEN.to_owned(),
            always_token: false,
            token_file: None,
            public_names: Vec::new(),
        }
    }
}

impl DashboardSection {
    pub fn checked(&self) -> Result<ListenAddress> {
        let address: SocketAddr = self.listen.parse().with_context(|| {
            format!("`dashboard.listen` is `{}`; give an IP address and a port, such as {DEFAULT_LISTEN}", self.listen)
        })?;
        if let Some(name) = self.public_names.iter().find(|name| !is_host(name)) {
            bail!(
                "`dashboard.public_names` has `{name}`; give the name that people open, without a scheme and a path, such as \
                 robots.example.org or robots.example.org:8443"
            );
        }
        ensure!(
            self.token_file.as_deref() != Some(""),
            "`dashboard.token_file` is empty; give the path of a file, or leave the key out"
        );
        Ok(if self.listen == DEFAULT_LISTEN {
            ListenAddress::FirstFree(address)
        } else {
            ListenAddress::Exact(address)
        })
    }
}

/// Whether this is a name or an address, perhaps with a port.
fn is_host(text: &str) -> bool {
    let (name, port) = match text.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') => (name, Some(port)),
        _ => (text, None),
    };
    let is_part = |c: char| c.is_ascii_alphanumeric() || "-._[]:".contains(c);
    !name.is_empty() && name.chars().all(is_part) && port.is_none_or(|port| port.parse::<u16>().is_ok())
}

/// Default address of PlotJuggler's UDP server. Source: its plugin `DataStreamUDP`.
pub const PLOTJUGGLER_ADDRESS: &str = "127.0.0.1:9870";

/// JSON datagrams for PlotJuggler.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct PlotJugglerSection {
    /// Whether they are sent.
    pub enabled: bool,
    /// IP address and UDP port of PlotJuggler's UDP server.
    pub address: String,
}

impl Default for PlotJugglerSection {
    fn default() -> Self {
        Self { enabled: false, address: PLOTJUGGLER_ADDRESS.to_owned() }
    }
}

impl PlotJugglerSection {
    pub fn checked(&self) -> Result<SocketAddr> {
        let address: SocketAddr = self.address.parse().with_context(|| {
            format!(
                "`plotjuggler.address` is `{}`; give an IP address and a port, such as {PLOTJUGGLER_ADDRESS}",
                self.address
            )
        })?;
        ensure!(
            address.port() != 0,
            "`plotjuggler.address` is `{address}`: port 0 has no listener; PlotJuggler's UDP server shows its port, 9870 at first"
        );
        Ok(address)
    }
}

/// A station whose recording is part of a merged one. Its links stand behind those of the stations before it.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct MergedSection {
    /// Its id in the fleet, else the name of its recording.
    pub station: String,
    /// How many links it had.
    pub links: u16,
    /// Its host clock minus that of the merged recording.
    pub clock_ahead_ns: i64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world(text: &str) -> Result<ArenaMap> {
        toml::from_str::<WorldConfig>(text).unwrap().checked()
    }

    #[test]
    fn places_and_walls_reach_the_filter() {
        let world = world(
            "landmarks = [{ id = 6, x_m = 1.0, y_m = 2.0 }]\n\
             beacons = [{ id = 0, x_m = -1.0, y_m = 0.5 }]\n\
             walls = [{ from = { x_m = 0.0, y_m = 0.0 }, to = { x_m = 2.0, y_m = 0.0 } }]\n",
        )
        .unwrap();
        assert_eq!(world.landmarks[&LandmarkId(6)], Point2::new(Meters(1.0), Meters(2.0)));
        assert_eq!(world.beacons[&BeaconId(0)], Point2::new(Meters(-1.0), Meters(0.5)));
        assert_eq!(world.walls[0].to, Point2::new(Meters(2.0), Meters(0.0)));
    }

    #[test]
    fn the_default_may_move_on_and_another_address_is_taken_as_it_is() {
        let listen = |text: &str| {
            let section = DashboardSection { listen: text.to_owned(), ..DashboardSection::default() };
            section.checked()
        };
        let default = DashboardSection::default().checked().unwrap();
        assert_eq!(default, ListenAddress::FirstFree("127.0.0.1:4680".parse().unwrap()));
        let other = "0.0.0.0:80".parse().unwrap();
        assert_eq!(listen("0.0.0.0:80").unwrap(), ListenAddress::Exact(other));
    }

    #[test]
    fn a_public_name_is_a_host_and_perhaps_a_port() {
        let checked = |name: &str| {
            DashboardSection { public_names: vec![name.to_owned()], ..DashboardSection::default() }.checked()
        };
        for name in
            ["robots.example.org", "robots.example.org:8443", "192.0.2.7:443", "[2001:db8::7]", "[2001:db8::7]:443"]
        {
            assert!(checked(name).is_ok(), "{name}");
        }
        for name in ["", "https://robots.example.org", "robots.example.org/", "a b", "robots:99999", "u@robots", ":80"]
        {
            assert!(checked(name).is_err(), "{name}");
        }
    }

    #[test]
    fn an_address_is_an_ip_address_with_a_port() {
        let checked =
            |text: &str| PlotJugglerSection { address: text.to_owned(), ..PlotJugglerSection::default() }.checked();
        let default = PlotJugglerSection::default().checked().unwrap();
        assert_eq!(default, "127.0.0.1:9870".parse().unwrap());
        assert_eq!(checked("[::1]:80").unwrap(), "[::1]:80".parse().unwrap());
    }
}
