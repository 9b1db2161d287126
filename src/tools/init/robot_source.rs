//! What is known of a robot before it moves: its link, its protocol, its columns, and the bundled robot whose other values it takes.

use anyhow::{Context, Result, ensure};
use posebridge_protocol::bricks::BRICK_PROTOCOLS;
use posebridge_protocol::bricks::text_line::Column;
use posebridge_protocol::detect::Protocol;
use posebridge_protocol::text_columns::{ColumnGuess, ColumnTable};
use posebridge_station::{DescriptionPolicy, StationConfig};
use posebridge_telemetry::{DriveGeometry, Meters, Radians};

use crate::config::{BundledRobot, Config, LineSection, LinkSection, RobotProfile, RobotWiring, TemplateLink};

#[derive(Clone, Debug)]
pub(super) struct RobotSource {
    pub(super) link: TemplateLink,
    /// For people, such as `MAVLink 2`.
    pub(super) speaks: String,
    /// A row of [`BRICK_PROTOCOLS`].
    pub(super) brick: &'static str,
    pub(super) accept_mavlink1: bool,
    /// The robot whose noise, ports and geometry hold where nothing was measured.
    pub(super) base: BundledRobot,
    /// Of a board that prints.
    pub(super) line: Option<LineSection>,
}

const MAVLINK: &str = "mavlink";

impl RobotSource {
    /// `base` is the robot that the user named.
    pub(super) fn new(link: TemplateLink, speaks: String, brick: &str, base: Option<BundledRobot>) -> Result<Self> {
        let known = BRICK_PROTOCOLS.iter().find(|protocol| protocol.name == brick && brick != "camera-json");
        let brick = known.map(|protocol| protocol.name).with_context(|| {
            let robots = BRICK_PROTOCOLS.iter().map(|protocol| protocol.name).filter(|name| *name != "camera-json");
            format!("`--brick {brick}`: there are: {}", robots.collect::<Vec<_>>().join(", "))
        })?;
        let base = match base {
            Some(base) => base,
            None => BundledRobot::from_name(match brick {
                "nxt" | "nxt-push" => "nxt-56mm",
                "ev3" => "ev3-educator",
                _ => "arduino-2wd",
            })?,
        };
        Ok(Self { link, speaks, brick, accept_mavlink1: false, base, line: None })
    }

    pub(super) fn reads_text(&self) -> bool {
        matches!(self.brick, "line" | "columns")
    }

    /// LEGO's motors count degrees.
    pub(super) fn known_ticks_per_turn(&self) -> Option<f64> {
        matches!(self.brick, "nxt" | "nxt-push" | "ev3").then_some(360.0)
    }

    /// Takes these quantities for the columns.
    pub(super) fn set_columns(&mut self, columns: Vec<String>) {
        self.line = Some(LineSection { columns, ..self.line.take().unwrap_or_default() });
    }

    /// The profile of the base robot.
    pub(super) fn base_profile(&self) -> Result<RobotProfile> {
        RobotProfile::from_toml(self.base.text).with_context(|| self.base.name.to_owned())
    }

    /// A station that reads the robot's raw counts: one count is one radian of a wheel of one metre, so that a robot that reports metres
    /// gives metres. It sends the robot no estimate.
    pub(super) fn station_config(&self) -> Result<StationConfig> {
        let link = LinkSection {
            listen: self.link.is_listening,
            brick: (self.brick != MAVLINK).then(|| self.brick.to_owned()),
            accept_mavlink1: self.accept_mavlink1,
            outputs: Some(Vec::new()),
            ..LinkSection::new(&self.link.url)
        };
        let mut profile = self.base_profile()?;
        profile.robot.line.clone_from(&self.line);
        profile.robot.wiring = RobotWiring::default();
        let config = Config { links: vec![link], ..Config::default() }.with_robot(profile);
        Ok(with_raw_counts(config.station_config()?))
    }
}

/// The same station with the robots' counts as angles.
pub(super) fn with_raw_counts(mut config: StationConfig) -> StationConfig {
    config.robots.clear();
    config.robot.description = DescriptionPolicy::Ignore;
    config.robot.wiring = RobotWiring::default().to_wiring();
    config.robot.compared_filters.clear();
    config.robot.filter_config.geometry = RAW_COUNTS;
    config
}

const RAW_COUNTS: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(1.0),
    right_wheel_radius: Meters(1.0),
    track_width: Meters(1.0),
    tick: Radians(1.0),
};

/// The name of the protocol's codec; an error says what to do with one that is not decoded.
pub(super) fn brick_of(protocol: Protocol) -> Result<&'static str> {
    let remedy = match protocol {
        Protocol::Nmea => "this is a satellite receiver: the robot is on another port",
        Protocol::Rosserial | Protocol::MicroRos => {
            "posebridge does not read ROS messages: let the board send MAVLink, or print its counts (docs/protocols/boards.md)"
        }
        Protocol::Text => {
            "no numbers stand in columns there: print one line of numbers for each reading (docs/protocols/boards.md), or \
             name the layout in [robot.line] of a file by `posebridge init NAME`, without the guide"
        }
        Protocol::NoData => {
            "is the robot on and its program running? A LEGO brick without a program answers only when it is asked: --probe asks"
        }
        Protocol::Unrecognized => "check the speed, the wires (ground too) and that nothing else uses the port",
        Protocol::Mavlink2 | Protocol::Mavlink1 | Protocol::Nxt | Protocol::Ev3 | Protocol::Columns => "",
    };
    ensure!(remedy.is_empty(), "{}: {remedy}", protocol.name());
    protocol.codec().context("no codec")
}

/// A table of the columns: an example, what each is taken for, and why.
pub(super) fn column_lines(table: &ColumnTable, guesses: &[ColumnGuess]) -> Vec<String> {
    let head = format!("  {:>2}  {:<10} {:>12}  {:<16} because", "", "name", "last value", "taken for");
    let rows = table.columns.iter().zip(guesses).zip(1..).map(|((column, guess), number)| {
        let last = column.values.last().map_or_else(String::new, f64::to_string);
        let name: String = column.name.chars().filter(|c| !c.is_control()).take(10).collect();
        let taken_for = guess.column.to_string();
        format!("  {number:>2}  {name:<10} {last:>12.12}  {taken_for:<16} {}", guess.reason)
    });
    std::iter::once(head).chain(rows).collect()
}

/// Checks the names of columns that a user gives.
pub(super) fn check_columns(names: &[String], count: usize) -> Result<()> {
    ensure!(
        names.len() == count,
        "{} columns are named, and a line has {count} numbers; write `ignore` for those that are not used",
        names.len()
    );
    for name in names {
        ensure!(
            Column::from_name(name).is_some(),
            "`{name}` is no quantity; docs/protocols/boards.md has the list, such as left_ticks and ignore"
        );
    }
    Ok(())
}
