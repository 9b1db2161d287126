//! Positions and poses: external fixes, ground truth, and integrated poses of a foreign odometer.

use std::f64::consts::FRAC_PI_2;

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{
    Arena, Body, Fix, Heading, Meters, ObservationKind, Odom, Point2, Pose, PositionCovariance, Transform2,
};

use super::super::column::{Angle, AngleVariance, Area, Column, FiniteNumber, Length};
use super::super::run::{BadRowReason, LoadError, RowError};
use super::super::schema::{Fixes, Odometer, TagPosition, Truth};
use super::super::table::{BoundColumn, DatasetTable, TableRow};
use super::{RowReader, TimeStep};

enum PositionColumns {
    /// In the arena.
    Plane { x: BoundColumn<Length>, y: BoundColumn<Length> },
    /// On the earth.
    Earth { latitude: BoundColumn<Angle>, longitude: BoundColumn<Angle>, plane: LocalPlane },
}

impl PositionColumns {
    /// x and y in metres.
    fn read(&self, row: &TableRow<'_>) -> Result<(f64, f64), RowError> {
        match self {
            Self::Plane { x, y } => Ok((x.read(row)?, y.read(row)?)),
            Self::Earth { latitude, longitude, plane } => plane.project(latitude.read(row)?, longitude.read(row)?),
        }
    }
}

/// Points of a stream, with the limit of their speed.
struct PositionReader {
    columns: PositionColumns,
    max_speed_m_per_s: Option<f64>,
    last: Option<(f64, f64)>,
}

impl PositionReader {
    fn new(columns: PositionColumns, max_speed_m_per_s: Option<FiniteNumber>) -> Self {
        Self { columns, max_speed_m_per_s: max_speed_m_per_s.map(|limit| limit.0), last: None }
    }

    fn bind(
        table: &DatasetTable,
        x: &Column<Length>,
        y: &Column<Length>,
        max_speed_m_per_s: Option<FiniteNumber>,
    ) -> Result<Self, LoadError> {
        Ok(Self::new(PositionColumns::Plane { x: table.bind(x)?, y: table.bind(y)? }, max_speed_m_per_s))
    }

    fn read<S>(&mut self, row: &TableRow<'_>, interval_s: Option<f64>) -> Result<Point2<S>, RowError> {
        let (x_m, y_m) = self.columns.read(row)?;
        if let (Some(last), Some(interval_s), Some(limit)) = (self.last, interval_s, self.max_speed_m_per_s) {
            let speed = (x_m - last.0).hypot(y_m - last.1) / interval_s;
            if speed > limit {
                let detail = format!("{speed:.2} m/s, the limit is {limit}");
                return Err(RowError::new(BadRowReason::ImpossibleJump, detail));
            }
        }
        self.last = Some((x_m, y_m));
        Ok(Point2::new(Meters(x_m), Meters(y_m)))
    }
}

struct UncertaintyColumns {
    /// Constant for all rows, each axis.
    position_sigma_m: Option<f64>,
    variances: Option<(BoundColumn<Area>, BoundColumn<Area>)>,
    heading_sigma_rad: Option<f64>,
    heading_variance: Option<BoundColumn<AngleVariance>>,
}

impl UncertaintyColumns {
    fn bind(stream: &Fixes, table: &DatasetTable) -> Result<Self, LoadError> {
        let x = table.bind_optional(stream.variance_x.as_ref())?;
        let y = table.bind_optional(stream.variance_y.as_ref())?;
        Ok(Self {
            position_sigma_m: stream.position_sigma_m.map(|sigma| sigma.0),
            variances: x.zip(y),
            heading_sigma_rad: stream.heading_sigma_rad.map(|sigma| sigma.0),
            heading_variance: table.bind_optional(stream.variance_heading.as_ref())?,
        })
    }

    fn read(&self, row: &TableRow<'_>) -> Result<Option<PositionCovariance>, RowError> {
        let (xx_m2, yy_m2) = match (&self.variances, self.position_sigma_m) {
            (Some((x, y)), _) => (x.read(row)?, y.read(row)?),
            (None, Some(sigma_m)) => (sigma_m * sigma_m, sigma_m * sigma_m),
            (None, None) => return Ok(None),
        };
        let heading_rad2 = match (&self.heading_variance, self.heading_sigma_rad) {
            (Some(column), _) => column.read(row)?,
            (None, Some(sigma_rad)) => sigma_rad * sigma_rad,
            (None, None) => f64::INFINITY,
        };
        if heading_rad2 <= 0.0 {
            let detail = format!("a variance of the heading of {heading_rad2} rad2");
            return Err(RowError::new(BadRowReason::OutOfRange, detail));
        }
        if xx_m2 <= 0.0 || yy_m2 <= 0.0 {
            let detail = format!("variances of {xx_m2} and {yy_m2} m2");
            return Err(RowError::new(BadRowReason::OutOfRange, detail));
        }
        Ok(Some(PositionCovariance { xx_m2, xy_m2: 0.0, yy_m2, heading_rad2 }))
    }
}

/// The columns of a fix's position; the descriptor's check guarantees that they are complete.
fn bind_position(stream: &Fixes, table: &DatasetTable) -> Result<Option<PositionColumns>, LoadError> {
    if let (Some(x), Some(y)) = (&stream.x, &stream.y) {
        return Ok(Some(PositionColumns::Plane { x: table.bind(x)?, y: table.bind(y)? }));
    }
    let (Some(latitude), Some(longitude), Some(origin)) = (&stream.latitude, &stream.longitude, stream.origin) else {
        return Ok(None);
    };
    Ok(Some(PositionColumns::Earth {
        latitude: table.bind(latitude)?,
        longitude: table.bind(longitude)?,
        plane: LocalPlane::new(origin.latitude_deg.0.to_radians(), origin.longitude_deg.0.to_radians()),
    }))
}

/// `tag` is the position of the observed point on the body.
pub(in super::super) fn fixes(
    stream: &Fixes,
    tag: TagPosition,
    table: &DatasetTable,
) -> Result<RowReader<Fix>, LoadError> {
    let Some(bound_columns) = bind_position(stream, table)? else {
        return Ok(Box::new(|_, _| Ok(None)));
    };
    let mut points = PositionReader::new(bound_columns, stream.max_speed_m_per_s);
    let heading = stream.heading.as_ref().map(|columns| table.bind_heading(columns)).transpose()?;
    let tag_in_body = Point2::<Body>::new(Meters(tag.x_m.0), Meters(tag.y_m.0));
    let claims = UncertaintyColumns::bind(stream, table)?;
    Ok(Box::new(move |row, step| {
        if step == TimeStep::Repeated {
            let detail = "the stamp of the fix before";
            return Err(RowError::new(BadRowReason::RepeatedTimestamp, detail));
        }
        let interval_s = step.interval_s()?;
        let heading = heading.as_ref().map(|heading| heading.read(row)).transpose()?;
        let covariance = claims.read(row)?;
        Ok(Some(Fix { position: points.read(row, interval_s)?, heading, covariance, tag_in_body, reset_counter: 0 }))
    }))
}

/// Position of the body, and heading if the instrument measures it.
type TruthColumnsPose = (Point2<Arena>, Option<Heading>);

pub(in super::super) fn truth(stream: &Truth, table: &DatasetTable) -> Result<RowReader<TruthColumnsPose>, LoadError> {
    let mut points = PositionReader::bind(table, &stream.x, &stream.y, stream.max_speed_m_per_s)?;
    let heading = stream.heading.as_ref().map(|columns| table.bind_heading(columns)).transpose()?;
    Ok(Box::new(move |row, step| {
        let interval_s = step.interval_s()?;
        let heading = heading.as_ref().map(|heading| heading.read(row)).transpose()?;
        Ok(Some((points.read(row, interval_s)?, heading)))
    }))
}

/// Poses, or distances and turns to integrate.
pub(in super::super) fn odometer(
    stream: &Odometer,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    if let (Some(x), Some(y), Some(heading)) = (&stream.x, &stream.y, &stream.heading) {
        let mut points = PositionReader::bind(table, x, y, stream.max_speed_m_per_s)?;
        let heading = table.bind_heading(heading)?;
        return Ok(Box::new(move |row, step| {
            let interval_s = step.interval_s()?;
            let heading = heading.read(row)?;
            let at: Point2<Odom> = points.read(row, interval_s)?;
            let pose = Pose::new(at.x, at.y, heading);
            Ok(Some(ObservationKind::OdometerPose(pose)))
        }));
    }
    bind_increments(stream, table)
}

fn bind_increments(stream: &Odometer, table: &DatasetTable) -> Result<RowReader<ObservationKind>, LoadError> {
    let distance = table.bind_optional(stream.distance.as_ref())?;
    let turn = table.bind_optional(stream.turn.as_ref())?;
    let limit = stream.max_speed_m_per_s.map(|limit| limit.0);
    let mut pose = Pose::<Odom>::default();
    Ok(Box::new(move |row, step| {
        let distance_m = distance.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        let turn_rad = turn.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        // The first increments belong to an interval before the recording.
        if step != TimeStep::First {
            if let (TimeStep::Forward { interval_s }, Some(limit)) = (step, limit) {
                let speed = (distance_m / interval_s).abs();
                if speed > limit {
                    let detail = format!("{speed:.2} m/s, the limit is {limit}");
                    return Err(RowError::new(BadRowReason::ImpossibleJump, detail));
                }
            }
            pose = advance(pose, distance_m, turn_rad);
        }
        // A row without an interval is left out, but its motion is not: the next row carries it.
        step.interval_s()?;
        Ok(Some(ObservationKind::OdometerPose(pose)))
    }))
}

/// Moves a pose along a short arc by its mean heading.
fn advance(pose: Pose<Odom>, distance_m: f64, turn_rad: f64) -> Pose<Odom> {
    let (sin, cos) = (pose.heading.rad() + turn_rad / 2.0).sin_cos();
    Transform2::new(
        Meters(pose.x.0 + distance_m * cos),
        Meters(pose.y.0 + distance_m * sin),
        Heading::from_rad(pose.heading.rad() + turn_rad),
    )
}

/// WGS 84.
const SEMI_MAJOR_AXIS_M: f64 = 6_378_137.0;
/// WGS 84.
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_14e-3;

/// A flat arena around a point of the earth: latitude and longitude as metres east and north of an origin.
///
/// ```text
/// N = a / sqrt(1 - e² sin² φ0)                  radius of curvature across the meridian, m
/// M = a (1 - e²) / (1 - e² sin² φ0)^(3/2)       along it, m
/// east = N cos φ0 (λ - λ0)      north = M (φ - φ0)
/// ```
///
/// The ellipsoid is approximated by its tangent plane at the origin (φ0, λ0), without height. The error is about `east
/// * north * tan φ0 / M`: 4 mm at 150 m, 0.15 m at 1 km, both ways, at 43 degrees.
///
/// Sources: a and e² of WGS 84, NIMA TR8350.2, 3rd edition, tables 3.1 and 3.3; the radii of curvature, J. P. Snyder,
/// Map Projections - A Working Manual, USGS Professional Paper 1395 (1987), pages 24 and 25.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LocalPlane {
    latitude_rad: f64,
    longitude_rad: f64,
    /// Metres per radian of longitude.
    east_scale: f64,
    /// Metres per radian of latitude.
    north_scale: f64,
}

impl LocalPlane {
    /// Tangent plane at a latitude and longitude.
    fn new(latitude_rad: f64, longitude_rad: f64) -> Self {
        let (sin, cos) = latitude_rad.sin_cos();
        let flattened = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        Self {
            latitude_rad,
            longitude_rad,
            east_scale: SEMI_MAJOR_AXIS_M / flattened.sqrt() * cos,
            north_scale: SEMI_MAJOR_AXIS_M * (1.0 - ECCENTRICITY_SQUARED) / (flattened * flattened.sqrt()),
        }
    }

    /// Metres east and north of the origin, the short way around the earth.
    fn project(&self, latitude_rad: f64, longitude_rad: f64) -> Result<(f64, f64), RowError> {
        if latitude_rad.abs() > FRAC_PI_2 {
            let detail = format!("a latitude of {} degrees", latitude_rad.to_degrees());
            return Err(RowError::new(BadRowReason::OutOfRange, detail));
        }
        Ok((
            self.east_scale * wrap_rad(longitude_rad - self.longitude_rad),
            self.north_scale * (latitude_rad - self.latitude_rad),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Metres per degree of longitude and of latitude.
    fn per_degree(latitude_deg: f64) -> (f64, f64) {
        let plane = LocalPlane::new(latitude_deg.to_radians(), 0.0);
        let degree = 1.0_f64.to_radians();
        (plane.east_scale * degree, plane.north_scale * degree)
    }

    #[test]
    fn a_degree_is_as_long_as_the_tables_say() {
        // Length of a degree on WGS 84 in km, to the metre, as geodetic tables print it.
        for (latitude_deg, east_m, north_m) in [
            (0.0, 111_320.0, 110_574.0),
            (15.0, 107_550.0, 110_649.0),
            (45.0, 78_847.0, 111_132.0),
            (60.0, 55_800.0, 111_412.0),
        ] {
            let (east, north) = per_degree(latitude_deg);
            assert!((east - east_m).abs() < 1.0, "{latitude_deg}: {east}");
            assert!((north - north_m).abs() < 1.0, "{latitude_deg}: {north}");
        }
    }

    #[test]
    fn the_date_line_is_no_journey_around_the_earth() {
        let plane = LocalPlane::new(0.0, 179.999_f64.to_radians());
        let (east, north) = plane.project(0.0, -179.999_f64.to_radians()).unwrap();
        assert!((east - 222.64).abs() < 0.01, "{east}");
        assert_eq!(north, 0.0);
    }

    #[test]
    fn there_is_nothing_behind_the_pole() {
        let plane = LocalPlane::new(0.5, 0.5);
        assert!(plane.project(91.0_f64.to_radians(), 0.5).is_err());
    }
}
