//! Counters of wheels, and streams with independent rows: rates, speeds, accelerations, compass and temperature; ranges to walls, landmarks (with bearing) and
//! radio beacons. Several rows of landmarks or beacons may share a timestamp: one image shows several landmarks.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{
    BeaconId, Celsius, DriveGeometry, LandmarkId, Meters, MetersPerSecond, MetersPerSecondSquared, ObservationKind,
    Radians, RadiansPerSecond,
};

use super::super::column::{Column, WheelTurn};
use super::super::run::{BadRowReason, LoadError, RowError};
use super::super::schema::{
    Accelerometers, BeaconRanges, BodyVelocity, Compass, Counting, Gyro, LandmarkSightings, Thermometer, WallRange,
    Wheels,
};
use super::super::table::{BoundColumn, DatasetTable, TableRow};
use super::{RowReader, TimeStep};

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

/// Converts wheel counts, totals or increments, to the total rotation of each wheel.
///
/// Counts are summed in the file's own unit, in which ticks are exact integers, and converted to radians at the end. A row without an
/// interval is dropped, but its counts are not: the next row includes them.
pub(in super::super) fn wheels(
    stream: &Wheels,
    geometry: DriveGeometry,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let (left_m, right_m) = (geometry.left_wheel_radius.0, geometry.right_wheel_radius.0);
    let mut wheels = WheelReader {
        left: table.bind(&stream.left)?,
        right: table.bind(&stream.right)?,
        rad_per_left: rad_per_unit(&stream.left, left_m, geometry.tick),
        rad_per_right: rad_per_unit(&stream.right, right_m, geometry.tick),
        counting: stream.counting,
        wrap: stream.wrap_bits.map(|bits| f64::from(bits).exp2()),
        max_rad_per_s: stream.max_wheel_rad_per_s.map(|limit| limit.0),
        last: None,
        pending: [0.0; 2],
        total: [0.0; 2],
    };
    Ok(Box::new(move |row, step| wheels.read(row, step).map(Some)))
}

/// Radians per unit of the column: ticks, metres or radians.
fn rad_per_unit(column: &Column<WheelTurn>, radius_m: f64, tick: Radians) -> f64 {
    match column.unit.name {
        "ticks" => tick.0,
        "m" | "mm" => 1.0 / radius_m,
        _ => 1.0,
    }
}

#[derive(Debug)]
struct WheelReader {
    left: BoundColumn<WheelTurn>,
    right: BoundColumn<WheelTurn>,
    rad_per_left: f64,
    rad_per_right: f64,
    counting: Counting,
    /// Counts per wrap of the counter; `None` if it does not wrap.
    wrap: Option<f64>,
    max_rad_per_s: Option<f64>,
    last: Option<[f64; 2]>,
    /// Since the last good row.
    pending: [f64; 2],
    /// Until the last good row; for absolute counters relative to the first counts.
    total: [f64; 2],
}

impl WheelReader {
    fn read(&mut self, row: &TableRow<'_>, step: TimeStep) -> Result<ObservationKind, RowError> {
        let counts = [self.left.read(row)?, self.right.read(row)?];
        if step == TimeStep::First {
            self.reset_counts(counts);
        } else {
            self.add_counts(counts);
            if let Some(interval_s) = step.interval_s()? {
                self.check_speed(interval_s)?;
            }
            self.total = [self.total[0] + self.pending[0], self.total[1] + self.pending[1]];
            self.pending = [0.0; 2];
        }
        Ok(ObservationKind::WheelAngles {
            left: Radians(self.total[0] * self.rad_per_left),
            right: Radians(self.total[1] * self.rad_per_right),
        })
    }

    fn reset_counts(&mut self, counts: [f64; 2]) {
        match self.counting {
            Counting::Absolute => {
                self.last = Some(counts);
                self.total = counts;
            }
            // They belong to an interval before the recording.
            Counting::Increments => self.total = [0.0; 2],
        }
    }

    fn add_counts(&mut self, counts: [f64; 2]) {
        let last = match self.counting {
            Counting::Absolute => self.last.replace(counts).unwrap_or(counts),
            Counting::Increments => [0.0; 2],
        };
        for ((pending, count), last) in self.pending.iter_mut().zip(counts).zip(last) {
            let step = count - last;
            *pending += match self.wrap {
                None => step,
                Some(turn) => step - (step / turn).round() * turn,
            };
        }
    }

    /// Rejects and drops motion above the speed limit: the return of a spike cancels it.
    fn check_speed(&mut self, interval_s: f64) -> Result<(), RowError> {
        let Some(limit) = self.max_rad_per_s else {
            return Ok(());
        };
        let left = (self.pending[0] * self.rad_per_left / interval_s).abs();
        let right = (self.pending[1] * self.rad_per_right / interval_s).abs();
        if left.max(right) <= limit {
            return Ok(());
        }
        self.pending = [0.0; 2];
        let detail = format!("wheels at {left:.1} and {right:.1} rad/s, the limit is {limit}");
        Err(RowError::new(BadRowReason::ImpossibleJump, detail))
    }
}
