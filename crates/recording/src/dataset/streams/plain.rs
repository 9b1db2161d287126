//! Streams whose rows stand for themselves: rates, speeds, accelerations, a wall's distance, a compass, a temperature.

use posebridge_telemetry::{
    Celsius, DriveGeometry, MetersPerSecond, MetersPerSecondSquared, Observed, RadiansPerSecond,
};

use super::super::bad_rows::Fault;
use super::super::load::LoadError;
use super::super::schema::{Accelerometers, BodyVelocity, Compass, Gyro, Thermometer, WallRange};
use super::super::table::{Row, Table};
use super::Reader;
use super::ranges::Limits;

/// A reader of rows that need an interval and nothing else from the row before.
fn rows(mut read: impl FnMut(&Row<'_>) -> Result<Observed, Fault> + 'static) -> Reader<Observed> {
    Box::new(move |row, step| {
        let observed = read(row)?;
        step.interval_s()?;
        Ok(Some(observed))
    })
}

/// Lets only values through that differ from the one before, where a log repeats a slow sensor.
fn only_changes(mut reader: Reader<Observed>) -> Reader<Observed> {
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
    table: &Table,
) -> Result<Reader<Observed>, LoadError> {
    if let (Some(forward), Some(turn)) = (&stream.forward, &stream.turn) {
        let (forward, turn) = (table.bind(forward)?, table.bind(turn)?);
        return Ok(rows(move |row| {
            Ok(Observed::BodyVelocity {
                forward: MetersPerSecond(forward.read(row)?),
                turn: RadiansPerSecond(turn.read(row)?),
            })
        }));
    }
    let left = table.bind_some(stream.left.as_ref())?;
    let right = table.bind_some(stream.right.as_ref())?;
    Ok(rows(move |row| {
        let left = left.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        let right = right.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        Ok(Observed::BodyVelocity {
            forward: MetersPerSecond(f64::midpoint(left, right)),
            turn: RadiansPerSecond((right - left) / geometry.track_width.0),
        })
    }))
}

/// Binds the column of a `[[gyro]]` stream.
pub(in super::super) fn gyro(stream: &Gyro, table: &Table) -> Result<Reader<Observed>, LoadError> {
    let rate = table.bind(&stream.turn_rate)?;
    let reader = rows(move |row| Ok(Observed::TurnRate(RadiansPerSecond(rate.read(row)?))));
    Ok(if stream.only_changes { only_changes(reader) } else { reader })
}

/// Binds the columns of an `[[accelerometers]]` stream.
pub(in super::super) fn accelerometers(stream: &Accelerometers, table: &Table) -> Result<Reader<Observed>, LoadError> {
    let (left, right) = (table.bind(&stream.left)?, table.bind(&stream.right)?);
    Ok(rows(move |row| {
        Ok(Observed::WheelAccelerations {
            left: MetersPerSecondSquared(left.read(row)?),
            right: MetersPerSecondSquared(right.read(row)?),
        })
    }))
}

/// Binds the column of a `[[wall_range]]` stream.
pub(in super::super) fn wall_range(stream: &WallRange, table: &Table) -> Result<Reader<Observed>, LoadError> {
    let range = table.bind(&stream.range)?;
    let limits = Limits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    let reader = rows(move |row| Ok(Observed::WallRange(limits.check(range.read(row)?)?)));
    Ok(if stream.only_changes { only_changes(reader) } else { reader })
}

/// Binds the columns of a `[[compass]]` stream.
pub(in super::super) fn compass(stream: &Compass, table: &Table) -> Result<Reader<Observed>, LoadError> {
    let heading = table.bind_heading(&stream.heading)?;
    let reader = rows(move |row| Ok(Observed::CompassHeading(heading.read(row)?)));
    Ok(if stream.only_changes { only_changes(reader) } else { reader })
}

/// Binds the column of a `[[temperature]]` stream.
pub(in super::super) fn temperature(stream: &Thermometer, table: &Table) -> Result<Reader<Observed>, LoadError> {
    let temperature = table.bind(&stream.temperature)?;
    let reader = rows(move |row| Ok(Observed::Temperature(Celsius(temperature.read(row)?))));
    Ok(if stream.only_changes { only_changes(reader) } else { reader })
}
