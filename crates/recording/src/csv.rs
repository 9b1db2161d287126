//! The results of a run as CSV: one wide file per stream, for spreadsheets, pandas and PlotJuggler.
//!
//! Takes the station's events with their times; the caller opens an output for each stream. Nothing is rounded: every number reads back
//! unchanged. A missing value is an empty field.
//!
//! # Model
//! ```text
//! estimates.csv      the filter's estimates, with covariance                  t_s: the brick's clock
//! fusion.csv         the outcome of each observation: innovation, S, NIS
//! compared_estimates.csv, compared_fusion.csv   the same of filters that ran beside, with the column `filter`
//! <kind>.csv         the observations of a kind: wheel_angles, fix, ..
//! clock.csv          alignments of the brick's clock
//! temperature.csv    live thermometers; the observations of recorded ones are in temperature_observations.csv
//! links.csv          health of the links, once per second                      host_s: since the session began
//! sources.csv        counters of each sender
//! events.csv         everything else, in words
//! ```
//! The first five end in the column `robot`: its name, else `link/system/component`.
//!
//! Names of columns end in their unit, SI throughout. Positions and headings are in the arena, counter-clockwise
//! positive.
//!
//! # Sources
//! RFC 4180 for the quoting of texts.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::Write;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{
    Address, Estimate, Event, FusionRecord, Heading, HostClock, LinkCounter, LinkHealth, LinkId, LinkState,
    Observation, ObservationKind, RobotId, SourceHealth, TimeDelta, Timestamp,
};

use crate::event_json;
use crate::robot_names::RobotNames;

/// Opens a stream by its name, without file extension.
type OpenFile<'o, W> = dyn FnMut(&str) -> std::io::Result<W> + 'o;

/// Writes events to their streams; a stream without events is never opened.
pub struct CsvWriter<'o, W: Write> {
    open: Box<OpenFile<'o, W>>,
    files: BTreeMap<&'static str, (::csv::Writer<W>, u64)>,
    names: RobotNames,
}

impl<'o, W: Write> CsvWriter<'o, W> {
    pub fn new(open: impl FnMut(&str) -> std::io::Result<W> + 'o) -> Self {
        Self { open: Box::new(open), files: BTreeMap::new(), names: RobotNames::default() }
    }

    pub fn record(&mut self, now: Timestamp<HostClock>, event: &Event) -> std::io::Result<()> {
        self.names.observe(event);
        for row in rows_of(now, event) {
            self.write(row)?;
        }
        Ok(())
    }

    /// Ends all streams and returns their names and line counts, headers excluded.
    pub fn finish(self) -> std::io::Result<Vec<(String, u64)>> {
        let mut lines = Vec::new();
        for (name, (mut out, count)) in self.files {
            out.flush()?;
            lines.push((name.to_owned(), count));
        }
        Ok(lines)
    }

    fn write(&mut self, mut row: CsvRow) -> std::io::Result<()> {
        row.columns.extend(row.robot.map(|robot| ("robot", self.names.label(robot).into())));
        let (out, count) = match self.files.entry(row.stream) {
            Entry::Occupied(file) => file.into_mut(),
            Entry::Vacant(entry) => {
                let mut out = ::csv::Writer::from_writer((self.open)(row.stream)?);
                out.write_record(row.columns.iter().map(|(name, _)| *name))?;
                entry.insert((out, 0))
            }
        };
        out.write_record(row.columns.iter().map(|(_, field)| &field.0))?;
        *count += 1;
        Ok(())
    }
}

struct CsvRow {
    stream: &'static str,
    columns: Vec<(&'static str, CsvField)>,
    /// The last column, in a stream about robots.
    robot: Option<RobotId>,
}

/// Unquoted text; empty for a missing value.
#[derive(Default)]
struct CsvField(String);

impl From<f64> for CsvField {
    fn from(number: f64) -> Self {
        // What is no number is nothing to a spreadsheet.
        if number.is_finite() { Self(number.to_string()) } else { Self::default() }
    }
}

impl From<u64> for CsvField {
    fn from(count: u64) -> Self {
        Self(count.to_string())
    }
}

impl From<bool> for CsvField {
    fn from(flag: bool) -> Self {
        u64::from(flag).into()
    }
}

impl From<&str> for CsvField {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl From<String> for CsvField {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl<T: Into<Self>> From<Option<T>> for CsvField {
    fn from(value: Option<T>) -> Self {
        value.map_or_else(Self::default, Into::into)
    }
}

impl<C: Clock> From<Timestamp<C>> for CsvField {
    fn from(stamp: Timestamp<C>) -> Self {
        stamp.as_secs_f64().into()
    }
}

impl From<TimeDelta> for CsvField {
    fn from(duration: TimeDelta) -> Self {
        duration.as_secs_f64().into()
    }
}

/// The upper triangle of an estimate's covariance, row by row, over x, y, heading, forward and turn.
const COVARIANCE_COLUMNS: [&str; 15] = [
    "var_x_m2",
    "cov_x_y_m2",
    "cov_x_heading_m_rad",
    "cov_x_forward_m2_per_s",
    "cov_x_turn_m_rad_per_s",
    "var_y_m2",
    "cov_y_heading_m_rad",
    "cov_y_forward_m2_per_s",
    "cov_y_turn_m_rad_per_s",
    "var_heading_rad2",
    "cov_heading_forward_m_rad_per_s",
    "cov_heading_turn_rad2_per_s",
    "var_forward_m2_per_s2",
    "cov_forward_turn_m_rad_per_s2",
    "var_turn_rad2_per_s2",
];

/// Innovation and the upper triangle of its covariance S, in the SI units of the observation's kind.
const INNOVATION_COLUMNS: [&str; 9] =
    ["innovation_0", "innovation_1", "innovation_2", "s_00", "s_01", "s_02", "s_11", "s_12", "s_22"];

fn rows_of(now: Timestamp<HostClock>, event: &Event) -> Vec<CsvRow> {
    let row = match event {
        Event::ObservationAligned { robot, arrival, observation, .. } => observation_row(*robot, *arrival, observation),
        Event::ObservationFused { robot, record } => fusion_row(*robot, now, record),
        Event::EstimateUpdated { robot, estimate } => estimate_row(*robot, now, estimate),
        Event::ObservationCompared { robot, filter, record } => {
            compared_row("compared_fusion", filter, fusion_row(*robot, now, record))
        }
        Event::EstimateCompared { robot, filter, estimate } => {
            compared_row("compared_estimates", filter, estimate_row(*robot, now, estimate))
        }
        Event::QuantityUpdated { robot, estimate } => CsvRow {
            stream: "quantity",
            robot: Some(*robot),
            columns: vec![
                ("t_s", estimate.stamp.into()),
                ("value", estimate.value.into()),
                ("sigma", estimate.sigma.into()),
                ("rate_per_s", estimate.rate_per_s.into()),
                ("unit", estimate.unit.into()),
            ],
        },
        Event::Temperature { brick, channel, arrival, stamp, shown, verdict, settled } => CsvRow {
            stream: "temperature",
            robot: Some(*brick),
            columns: vec![
                ("t_s", (*stamp).into()),
                ("arrival_s", (*arrival).into()),
                ("channel", channel.to_string().into()),
                ("shown_deg_c", shown.0.into()),
                ("verdict", verdict.reason().into()),
                ("settled_deg_c", settled.map(|settled| settled.value).into()),
                ("settled_sigma_deg_c", settled.map(|settled| settled.sigma).into()),
                ("system", system(brick.address)),
                ("component", component(brick.address)),
            ],
        },
        Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host } => CsvRow {
            stream: "clock",
            robot: Some(*robot),
            columns: vec![
                ("host_s", (*host).into()),
                ("brick_s", (*brick).into()),
                ("offset_s", (*offset).into()),
                ("skew_ppm", (*skew_ppm).into()),
                ("uncertainty_s", (*uncertainty).into()),
                ("round_trip_s", (*round_trip).into()),
                ("system", system(robot.address)),
                ("component", component(robot.address)),
            ],
        },
        Event::Health { link, health, sources } => {
            let sources = sources.iter().map(|source| source_row(now, *link, source));
            return std::iter::once(link_row(now, *link, health)).chain(sources).collect();
        }
        Event::RobotDetected { robot } => robot_row(now, "robot_seen", *robot, String::new()),
        Event::RobotNamed { robot, name } => robot_row(now, "robot_named", *robot, name.clone()),
        Event::RobotLost { robot, silence } => {
            robot_row(now, "robot_lost", *robot, format!("silent for {} s", silence.as_secs_f64()))
        }
        Event::BrickRestarted { robot } => robot_row(now, "brick_restarted", *robot, String::new()),
        Event::CameraClockAligned { camera, offset, uncertainty, .. } => {
            let detail = format!("offset {} s, {} s either way", offset.as_secs_f64(), uncertainty.as_secs_f64());
            event_row(now, "camera_clock_aligned", None, Some(*camera), detail)
        }
        Event::Link { link, state } => {
            let name = match state {
                LinkState::Up => "link_up",
                LinkState::Down => "link_down",
            };
            event_row(now, name, Some(*link), None, String::new())
        }
        Event::ReceiveError { link, defect } => {
            event_row(now, "defect", Some(*link), None, event_json::details_of(defect))
        }
        Event::Text { source, severity, text } => {
            event_row(now, "text", None, Some(*source), format!("{severity}: {text}"))
        }
    };
    vec![row]
}

/// One stream per kind of observation.
fn observation_row(robot: RobotId, arrival: Timestamp<HostClock>, observation: &Observation) -> CsvRow {
    let mut columns = vec![
        ("t_s", observation.stamp.into()),
        ("arrival_s", arrival.into()),
        ("stamp_sigma_s", observation.stamp_sigma.into()),
        ("sensor", u64::from(observation.sensor.0).into()),
    ];
    columns.extend(measured_columns(&observation.measurement));
    // `temperature` holds the readings of live thermometers, which have other columns.
    let stream = match observation.measurement.kind() {
        "temperature" => "temperature_observations",
        kind => kind,
    };
    CsvRow { stream, columns, robot: Some(robot) }
}

fn measured_columns(observed: &ObservationKind) -> Vec<(&'static str, CsvField)> {
    match observed {
        ObservationKind::WheelAngles { left, right } => {
            vec![("left_rad", left.0.into()), ("right_rad", right.0.into())]
        }
        ObservationKind::OdometerPose(pose) => {
            vec![("x_m", pose.x.0.into()), ("y_m", pose.y.0.into()), ("heading_rad", pose.heading.rad().into())]
        }
        ObservationKind::BodyVelocity { forward, turn } => {
            vec![("forward_m_per_s", forward.0.into()), ("turn_rad_per_s", turn.0.into())]
        }
        ObservationKind::TurnRate(turn) => vec![("turn_rad_per_s", turn.0.into())],
        ObservationKind::WheelAccelerations { left, right } => {
            vec![("left_m_per_s2", left.0.into()), ("right_m_per_s2", right.0.into())]
        }
        ObservationKind::Fix(fix) => vec![
            ("x_m", fix.position.x.0.into()),
            ("y_m", fix.position.y.0.into()),
            ("heading_rad", fix.heading.map(Heading::rad).into()),
            ("var_x_m2", fix.covariance.map(|covariance| covariance.xx_m2).into()),
            ("cov_x_y_m2", fix.covariance.map(|covariance| covariance.xy_m2).into()),
            ("var_y_m2", fix.covariance.map(|covariance| covariance.yy_m2).into()),
            ("var_heading_rad2", fix.covariance.map(|covariance| covariance.heading_rad2).into()),
            ("tag_x_m", fix.tag_in_body.x.0.into()),
            ("tag_y_m", fix.tag_in_body.y.0.into()),
            ("reset_counter", u64::from(fix.reset_counter).into()),
        ],
        ObservationKind::Landmark { id, range, bearing } => {
            vec![("landmark", u64::from(id.0).into()), ("range_m", range.0.into()), ("bearing_rad", bearing.0.into())]
        }
        ObservationKind::BeaconRange { id, range } => {
            vec![("beacon", u64::from(id.0).into()), ("range_m", range.0.into())]
        }
        ObservationKind::WallRange(range) => vec![("range_m", range.0.into())],
        ObservationKind::CompassHeading(heading) => vec![("heading_rad", heading.rad().into())],
        ObservationKind::Temperature(shown) => vec![("temperature_deg_c", shown.0.into())],
    }
}

fn estimate_row(robot: RobotId, now: Timestamp<HostClock>, estimate: &Estimate) -> CsvRow {
    let mut columns: Vec<(&str, CsvField)> = vec![
        ("t_s", estimate.stamp.into()),
        ("x_m", estimate.pose.x.0.into()),
        ("y_m", estimate.pose.y.0.into()),
        ("heading_rad", estimate.pose.heading.rad().into()),
        ("forward_m_per_s", estimate.forward_speed.0.into()),
        ("turn_rad_per_s", estimate.turn_rate.0.into()),
    ];
    columns.extend(COVARIANCE_COLUMNS.into_iter().zip(upper_triangle(&estimate.covariance)));
    columns.extend([
        ("position_valid", estimate.validity.position.into()),
        ("heading_valid", estimate.validity.heading.into()),
        ("speeds_valid", estimate.validity.speeds.into()),
        ("dead_reckoning", estimate.is_dead_reckoning.into()),
        ("fix_age_s", estimate.fix_age.into()),
        ("reset_counter", u64::from(estimate.reset_counter).into()),
        ("host_s", now.into()),
    ]);
    CsvRow { stream: "estimates", columns, robot: Some(robot) }
}

fn fusion_row(robot: RobotId, now: Timestamp<HostClock>, record: &FusionRecord) -> CsvRow {
    let mut columns: Vec<(&str, CsvField)> = vec![
        ("t_s", record.stamp.into()),
        ("sensor", u64::from(record.sensor.0).into()),
        ("sensor_name", record.sensor.name().into()),
        ("kind", record.kind.into()),
        ("verdict", record.outcome.reason().into()),
        ("lag_s", record.lag.into()),
        ("degrees_of_freedom", u64::from(record.degrees_of_freedom).into()),
        ("nis", record.nis.into()),
        ("log_likelihood", record.log_likelihood.into()),
    ];
    let numbers = record.innovation.into_iter().map(CsvField::from);
    columns.extend(INNOVATION_COLUMNS.into_iter().zip(numbers.chain(upper_triangle(&record.innovation_covariance))));
    columns.push(("host_s", now.into()));
    CsvRow { stream: "fusion", columns, robot: Some(robot) }
}

/// The row of a filter that ran beside the robot's own.
fn compared_row(stream: &'static str, filter: &str, mut row: CsvRow) -> CsvRow {
    row.columns.push(("filter", filter.into()));
    CsvRow { stream, ..row }
}

fn upper_triangle<const N: usize>(matrix: &[[f64; N]; N]) -> impl Iterator<Item = CsvField> {
    matrix.iter().enumerate().flat_map(|(index, row)| row.iter().skip(index)).map(|entry| (*entry).into())
}

fn link_row(now: Timestamp<HostClock>, link: LinkId, health: &LinkHealth) -> CsvRow {
    let mut columns: Vec<(&str, CsvField)> = vec![("host_s", now.into()), ("link", u64::from(link.0).into())];
    for counter in LinkCounter::ALL {
        // Of what was not sent a table has the sum.
        let counter = if counter.key == LinkCounter::UNSENT.key { &LinkCounter::UNSENT } else { counter };
        columns.push((counter.key, (counter.read)(health).into()));
    }
    columns.extend([
        ("round_trip_s", health.round_trip.into()),
        ("clock_uncertainty_s", health.clock_uncertainty.into()),
        ("queued_frames", u64::from(health.port.queued_frames).into()),
        ("queued_bytes", u64::from(health.port.queued_bytes).into()),
    ]);
    CsvRow { stream: "links", columns, robot: None }
}

fn source_row(now: Timestamp<HostClock>, link: LinkId, source: &SourceHealth) -> CsvRow {
    CsvRow {
        stream: "sources",
        robot: None,
        columns: vec![
            ("host_s", now.into()),
            ("link", u64::from(link.0).into()),
            ("system", system(source.source)),
            ("component", component(source.source)),
            ("frames", source.frames.into()),
            ("lost", source.lost.into()),
        ],
    }
}

fn robot_row(now: Timestamp<HostClock>, name: &str, robot: RobotId, detail: String) -> CsvRow {
    event_row(now, name, Some(robot.link), Some(robot.address), detail)
}

fn event_row(
    now: Timestamp<HostClock>,
    name: &str,
    link: Option<LinkId>,
    address: Option<Address>,
    detail: String,
) -> CsvRow {
    CsvRow {
        stream: "events",
        robot: None,
        columns: vec![
            ("host_s", now.into()),
            ("event", name.into()),
            ("link", link.map(|link| u64::from(link.0)).into()),
            ("system", address.map(system).into()),
            ("component", address.map(component).into()),
            ("detail", detail.into()),
        ],
    }
}

fn system(address: Address) -> CsvField {
    u64::from(address.system.0).into()
}

fn component(address: Address) -> CsvField {
    u64::from(address.component.0).into()
}
