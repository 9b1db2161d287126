//! Streams whose rows are independent: rates, speeds, accelerations, the range to a wall, a compass, a temperature.

use posebridge_telemetry::{
    Celsius, DriveGeometry, MetersPerSecond, MetersPerSecondSquared, ObservationKind, RadiansPerSecond,
};

use super::super::bad_rows::RowError;
use super::super::error::LoadError;
use super::super::schema::{Accelerometers, BodyVelocity, Compass, Gyro, Thermometer, WallRange};
use super::super::table::{DatasetTable, TableRow};
use super::RowReader;
use super::ranges::RangeLimits;

/// A reader of rows that need an interval and nothing else from the row before.
fn interval_reader(
    mut read: impl FnMut(&TableRow<'_>) -> Result<ObservationKind, RowError> + 'static,
) -> RowReader<ObservationKind> {
    Box::new(move |row, step| {
        let observed = read(row)?;
        step.interval_s()?;
        Ok(Some(observed))
    })
}

/// Lets only values through that differ from the one before, where a log repeats a slow sensor.
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

/// Binds the columns of a `[[body_velocity]]` stream.
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

/// Binds the column of a `[[gyro]]` stream.
pub(in super::super) fn gyro(stream: &Gyro, table: &DatasetTable) -> Result<RowReader<ObservationKind>, LoadError> {
    let rate = table.bind(&stream.turn_rate)?;
    let reader = interval_reader(move |row| Ok(ObservationKind::TurnRate(RadiansPerSecond(rate.read(row)?))));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

/// Binds the columns of an `[[accelerometers]]` stream.
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

/// Binds the column of a `[[wall_range]]` stream.
pub(in super::super) fn wall_range(
    stream: &WallRange,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let range = table.bind(&stream.range)?;
    let limits = RangeLimits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    let reader = interval_reader(move |row| Ok(ObservationKind::WallRange(limits.check(range.read(row)?)?)));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

/// Binds the columns of a `[[compass]]` stream.
pub(in super::super) fn compass(
    stream: &Compass,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let heading = table.bind_heading(&stream.heading)?;
    let reader = interval_reader(move |row| Ok(ObservationKind::CompassHeading(heading.read(row)?)));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}

/// Binds the column of a `[[temperature]]` stream.
pub(in super::super) fn temperature(
    stream: &Thermometer,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let temperature = table.bind(&stream.temperature)?;
    let reader = interval_reader(move |row| Ok(ObservationKind::Temperature(Celsius(temperature.read(row)?))));
    Ok(if stream.only_changes { changes_only(reader) } else { reader })
}
