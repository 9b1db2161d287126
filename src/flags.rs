//! Flags that several commands share, and their value types.

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use posebridge_estimator::params::ParamError;
use posebridge_estimator::{PARAMS, Params};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkOpenConfig, LinkUrl};
use posebridge_telemetry::LinkId;

use crate::config::Setting;

/// Flags that change the configuration.
#[derive(Args, Clone, Debug, Default)]
pub struct ConfigFlags {
    /// Configuration file. Default: the built-in configuration, printed by `posebridge config print`.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set one key of the configuration, e.g. robot.track_width_m=0.112. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
}

/// How much a command that evaluates a run prints.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct DetailFlags {
    /// Print the tables of sources and links as well.
    #[arg(long, short)]
    pub verbose: bool,
}

/// Flags that choose what to read of a recording of a real robot.
#[derive(Args, Clone, Debug)]
pub struct DataFlags {
    /// Folder for the relative paths of a descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Read the runs of a descriptor whose names begin with this text.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Option<String>,
    /// Give the filter every n-th fix and score it on the others; 0 gives it none. Default: as in the descriptor.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot, e.g. track_width_m=0.155 or noise.fix_position_m=0.02, or one parameter of the filter, e.g.
    /// filter.gate_prob=0.99. For a posebridge recording: one key of its configuration. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
}

/// Which recording goes through the engine, which part of it counts, and what is changed.
#[derive(Args, Clone, Debug)]
pub struct SessionFlags {
    /// A recording (*.mcap), a telemetry log (*.tlog) or a recording's descriptor (*.toml).
    pub recording: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Use the `[robot]` and `[filter]` tables of this profile instead of the recording's. --set overrides both.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
    /// What is known of a slow sensor: a file of `posebridge identify step --save` (docs/lab/thermometer.md).
    #[arg(long, value_name = "FILE.toml")]
    pub sensor: Option<PathBuf>,
    /// Set one parameter of the filter, e.g. gate_prob=0.99. Overrides every other source. Can be repeated.
    #[arg(long = "param", value_name = "KEY=VALUE", value_parser = a_param)]
    pub params: Vec<Setting>,
    /// Ground truth from `posebridge sim --truth`. Default: the ground truth in the recording.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Key file of a signed link. Default: the key file that was used while recording. Can be repeated.
    #[arg(long = "key", value_name = "FILE")]
    pub keys: Vec<PathBuf>,
    /// Evaluate from this time on, in seconds after the beginning. The filter still gets everything before it.
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub from: Option<f64>,
    /// Stop at this time, in seconds after the beginning. The filter gets nothing after it.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub to: Option<f64>,
}

/// The one link of a brick to its station.
#[derive(Args, Clone, Debug)]
#[group(required = true, multiple = false)]
pub struct StationLink {
    /// Wait for the station to connect on this link, e.g. pty:brick.tty or tcp://127.0.0.1:5760.
    #[arg(long, value_name = "URL")]
    pub listen: Option<String>,
    /// Connect to the station on this link, e.g. udp://127.0.0.1:14550.
    #[arg(long, value_name = "URL")]
    pub link: Option<String>,
}

impl StationLink {
    pub(crate) fn flag(&self) -> Result<LinkFlag> {
        LinkFlag::from_values(self.listen.as_deref(), self.link.as_deref()).context("give --listen URL or --link URL")
    }
}

/// A link of the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkFlag {
    pub url: String,
    pub role: ConnectRole,
}

impl LinkFlag {
    pub(crate) fn from_values(listen: Option<&str>, dial: Option<&str>) -> Option<Self> {
        let listen = listen.map(|url| (url, ConnectRole::Listen));
        let (url, role) = listen.or(dial.map(|url| (url, ConnectRole::Dial)))?;
        Some(Self { url: url.to_owned(), role })
    }

    /// Opens the link, or keeps retrying if that may help, and describes where it is. Fails on permanent errors: an address in use, no
    /// permission.
    pub(crate) async fn open(&self, timer: HostTimer) -> Result<(Link, String)> {
        let config = LinkOpenConfig { id: LinkId(0), url: LinkUrl::parse(&self.url)?, role: self.role };
        let mut link = Link::new(config, timer);
        let name = link.url().to_string();
        link.try_open().await.with_context(|| format!("opening `{name}`"))?;
        let address = link.local_address().filter(|_| self.role == ConnectRole::Listen);
        let place = address.map_or_else(|| format!("on {name}"), |address| format!("listening on {address}"));
        Ok((link, place))
    }
}

/// The links of these arguments in the order of the command line; a derived parser keeps the order within one argument only.
pub(crate) fn links_in_order(matches: &ArgMatches, ids: [(&str, ConnectRole); 2]) -> Vec<LinkFlag> {
    let mut indexed = Vec::new();
    for (id, role) in ids {
        let urls = matches.get_many::<String>(id).unwrap_or_default();
        let flags = urls.map(|url| LinkFlag { url: url.clone(), role });
        indexed.extend(matches.indices_of(id).into_iter().flatten().zip(flags));
    }
    indexed.sort_by_key(|(index, _)| *index);
    indexed.into_iter().map(|(_, flag)| flag).collect()
}

const LINK: &str = "link";
const LISTEN: &str = "listen";

/// `--link URL` and `--listen URL` of a run. `--brick` applies to the first of them, and reports number them, so their order must not
/// depend on which end connects.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LinkFlags(pub Vec<LinkFlag>);

impl FromArgMatches for LinkFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self(links_in_order(matches, [(LINK, ConnectRole::Dial), (LISTEN, ConnectRole::Listen)])))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for LinkFlags {
    fn augment_args(command: Command) -> Command {
        let flag = |name: &'static str, help: &'static str| {
            Arg::new(name).long(name).value_name("URL").action(ArgAction::Append).help(help)
        };
        command.args([
            flag(
                LINK,
                "Connect to this link. Can be repeated. Replaces the addresses of the links in the configuration",
            ),
            flag(LISTEN, "Wait for a connection on this link. Can be repeated"),
        ])
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

/// Whether there is a page, and where (docs/dashboard.md).
#[derive(Args, Clone, Debug, Default)]
pub struct DashboardFlags {
    /// Serve the dashboard on this address, e.g. 0.0.0.0:4680 for other computers. They open one of the printed addresses, which
    /// contain a token. Port 0 selects a free port.
    #[arg(long, value_name = "IP:PORT", conflicts_with = "no_dashboard")]
    pub dashboard: Option<SocketAddr>,
    /// Serve no dashboard.
    #[arg(long)]
    pub no_dashboard: bool,
    /// Open the dashboard in a browser.
    #[arg(long, conflicts_with = "no_dashboard")]
    pub open: bool,
    /// Serve the files of the page from this folder instead of the built-in ones, to edit them.
    #[arg(long, value_name = "DIR", conflicts_with = "no_dashboard")]
    pub ui_dir: Option<PathBuf>,
}

pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "must be a number of more than zero".to_owned())
}

pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| "must be a number of zero or more".to_owned())
}

/// Parses `KEY=VALUE` of a filter tunable.
fn a_param(text: &str) -> Result<Setting, String> {
    let setting = Setting::parse(text)?;
    let (key, value) = (setting.path.join("."), setting.value.to_string());
    let value: f64 = value.parse().map_err(|_not_a_number| format!("`{key}`: `{value}` is no number"))?;
    Params::default().set(&key, value).map_err(|error| {
        let known: Vec<&str> = PARAMS.iter().map(|param| param.key).collect();
        if matches!(error, ParamError::Unknown { .. }) {
            format!("{error}; there are: {}", known.join(", "))
        } else {
            error.to_string()
        }
    })?;
    Ok(Setting { path: vec!["filter".to_owned(), key], value: toml::Value::Float(value) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_stand_in_the_order_of_the_command_line() {
        let command = LinkFlags::augment_args(Command::new("run"));
        let line = ["run", "--listen", "a", "--link", "b", "--link", "c", "--listen", "d"];
        let matches = command.try_get_matches_from(line).unwrap();
        let flags = LinkFlags::from_arg_matches(&matches).unwrap();
        let order: Vec<(&str, ConnectRole)> = flags.0.iter().map(|flag| (flag.url.as_str(), flag.role)).collect();
        let expected = [
            ("a", ConnectRole::Listen),
            ("b", ConnectRole::Dial),
            ("c", ConnectRole::Dial),
            ("d", ConnectRole::Listen),
        ];
        assert_eq!(order, expected);
    }
}
