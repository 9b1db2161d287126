//! Streams with independent rows: rates, speeds, accelerations, compass and temperature; ranges to walls, landmarks (with bearing) and
//! radio beacons. Several rows of landmarks or beacons may share a timestamp: one image shows several landmarks.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{
    BeaconId, Celsius, DriveGeometry, LandmarkId, Meters, MetersPerSecond, MetersPerSecondSquared, ObservationKind,
    Radians, RadiansPerSecond,
};

use super::super::run::{BadRowReason, LoadError, RowError};
use super::super::schema::{
    Accelerometers, BeaconRanges, BodyVelocity, Compass, Gyro, LandmarkSightings, Thermometer, WallRange,
};
use super::super::table::{DatasetTable, TableRow};
use super::RowReader;

/// A reader of rows that need only the interval to the previous row.
fn interval_reader(
    mut read: impl FnMut(&TableRow<'_>) -> Result<ObservationKind, RowError> + 'static,
) -> RowReader<ObservationKind> {
    Box::new(move |row, step| {
        let observed = read(row)?;
        step.interval_s()?;
        Ok(Some(observed))
    })
}

/// Drops values equal to the previous one, for logs that repeat a slow sensor.
fn changes_only(mut reader: RowReader<ObservationKind>) -> RowReader<ObservationKind> {
    let mut last = None;
    Box::new(move |row, step| {
        let observed = reader(row, step)?;
        if observed == last {
            return Ok(None);
        }
        last = observed;
        Ok(observed)
    })
}

pub(in super::super) fn body_velocity(
    stream: &BodyVelocity,
    geometry: DriveGeometry,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    if let (Some(forward), Some(turn)) = (&stream.forward, &stream.turn) {
        let (forward, turn) = (table.bind(forward)?, table.bind(turn)?);
        return Ok(interval_reader(move |row| {
            Ok(ObservationKind::BodyVelocity {
                forward: MetersPerSecond(forward.read(row)?),
                turn: RadiansPerSecond(turn.read(row)?),
            })
        }));
    }
    let left = table.bind_optional(stream.left.as_ref())?;
    let right = table.bind_optional(stream.right.as_ref())?;
    Ok(interval_reader(move |row| {
        let left = left.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        let right = right.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        Ok(ObservationKind::BodyVelocity {
            forward: MetersPerSecond(f64::midpoint(left, right)),
            turn: RadiansPerSecond((right - left) / geometry.track_width.0),
        })
    }))
}

pub(in super::super) fn gyro(stream: &Gyro, table: &DatasetTable) -> Result<RowReader<ObservationKind>, LoadError> {
    let rate = table.bind(&stream.turn_rate)?;
    let reader = interval_reader(move |row| Ok(ObservationKind::TurnRate(RadiansPerSecond(rate.read(row)?))));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

pub(in super::super) fn accelerometers(
    stream: &Accelerometers,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let (left, right) = (table.bind(&stream.left)?, table.bind(&stream.right)?);
    Ok(interval_reader(move |row| {
        Ok(ObservationKind::WheelAccelerations {
            left: MetersPerSecondSquared(left.read(row)?),
            right: MetersPerSecondSquared(right.read(row)?),
        })
    }))
}

pub(in super::super) fn wall_range(
    stream: &WallRange,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let range = table.bind(&stream.range)?;
    let limits = RangeLimits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    let reader = interval_reader(move |row| Ok(ObservationKind::WallRange(limits.check(range.read(row)?)?)));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

pub(in super::super) fn compass(
    stream: &Compass,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let heading = table.bind_heading(&stream.heading)?;
    let reader = interval_reader(move |row| Ok(ObservationKind::CompassHeading(heading.read(row)?)));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

pub(in super::super) fn temperature(
    stream: &Thermometer,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let temperature = table.bind(&stream.temperature)?;
    let reader = interval_reader(move |row| Ok(ObservationKind::Temperature(Celsius(temperature.read(row)?))));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

/// Mapping of ids to those of a map.
pub(in super::super) struct IdMapping {
    /// From the ids of the rows to those of the map; `None` if they are equal.
    pub(in super::super) ids: Option<BTreeMap<u32, u32>>,
    pub(in super::super) known: BTreeSet<u32>,
}

impl IdMapping {
    /// The id in the map's numbering, known or not; ids outside the mapping are kept.
    fn map_id(&self, raw: u32) -> u32 {
        let ids = self.ids.as_ref();
        ids.and_then(|ids| ids.get(&raw).copied()).unwrap_or(raw)
    }

    fn resolve_id(&self, raw: u32) -> Result<u32, RowError> {
        let id = match &self.ids {
            None => Some(raw),
            Some(ids) => ids.get(&raw).copied(),
        };
        id.filter(|id| self.known.contains(id)).ok_or_else(|| RowError::new(BadRowReason::UnknownId, raw.to_string()))
    }
}

/// Ranges outside are rejected.
#[derive(Clone, Copy, Debug)]
struct RangeLimits {
    min_m: f64,
    max_m: f64,
}

impl RangeLimits {
    fn new(min_m: Option<f64>, max_m: Option<f64>) -> Self {
        Self { min_m: min_m.unwrap_or(f64::NEG_INFINITY), max_m: max_m.unwrap_or(f64::INFINITY) }
    }

    fn check(self, range_m: f64) -> Result<Meters, RowError> {
        if range_m >= self.min_m && range_m <= self.max_m {
            return Ok(Meters(range_m));
        }
        let detail = format!("{range_m} m, the limits are {} to {}", self.min_m, self.max_m);
        Err(RowError::new(BadRowReason::OutOfRange, detail))
    }
}

pub(in super::super) fn landmarks(
    stream: &LandmarkSightings,
    names: IdMapping,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let id = table.bind(&stream.id)?;
    let range = table.bind(&stream.range)?;
    let bearing = table.bind(&stream.bearing)?;
    let limits = RangeLimits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    let ignored: BTreeSet<u32> = stream.ignore.iter().copied().collect();
    Ok(Box::new(move |row, step| {
        step.require_in_order()?;
        let raw = id.read_id(row)?;
        if ignored.contains(&names.map_id(raw)) {
            return Ok(None);
        }
        Ok(Some(ObservationKind::Landmark {
            id: LandmarkId(names.resolve_id(raw)?),
            range: limits.check(range.read(row)?)?,
            bearing: Radians(bearing.read(row)?),
        }))
    }))
}

pub(in super::super) fn beacons(
    stream: &BeaconRanges,
    names: IdMapping,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let id = table.bind(&stream.id)?;
    let range = table.bind(&stream.range)?;
    let limits = RangeLimits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    Ok(Box::new(move |row, step| {
        step.require_in_order()?;
        Ok(Some(ObservationKind::BeaconRange {
            id: BeaconId(names.resolve_id(id.read_id(row)?)?),
            range: limits.check(range.read(row)?)?,
        }))
    }))
}
