//! Positions and poses: fixes from outside, the truth, and what a foreign odometer has integrated.

use posebridge_telemetry::{
    Arena, Body, Fix, Heading, Meters, Observed, Odom, Point2, Pose, PositionCovariance, Transform2,
};

use super::super::bad_rows::{Fault, Reason};
use super::super::column::{Column, Length};
use super::super::load::LoadError;
use super::super::schema::{Fixes, Odometer, TagPlace, Truth};
use super::super::table::{Bound, Row, Table};
use super::{Reader, Step};

/// Two columns that make a point, and the speed beyond which its motion is not believed.
struct Points {
    x: Bound<Length>,
    y: Bound<Length>,
    max_speed_m_per_s: Option<f64>,
    last: Option<(f64, f64)>,
}

impl Points {
    fn bind(
        table: &Table,
        columns: (&Column<Length>, &Column<Length>),
        max_speed_m_per_s: Option<f64>,
    ) -> Result<Self, LoadError> {
        Ok(Self {
            x: table.bind(columns.0)?,
            y: table.bind(columns.1)?,
            max_speed_m_per_s,
            last: None,
        })
    }

    fn read<S>(&mut self, row: &Row<'_>, interval_s: Option<f64>) -> Result<Point2<S>, Fault> {
        let (x_m, y_m) = (self.x.read(row)?, self.y.read(row)?);
        if let (Some(last), Some(interval_s), Some(limit)) =
            (self.last, interval_s, self.max_speed_m_per_s)
        {
            let speed = (x_m - last.0).hypot(y_m - last.1) / interval_s;
            if speed > limit {
                let detail = format!("{speed:.2} m/s, the limit is {limit}");
                return Err(Fault::new(Reason::ImpossibleJump, detail));
            }
        }
        self.last = Some((x_m, y_m));
        Ok(Point2::new(Meters(x_m), Meters(y_m)))
    }
}

/// Binds the columns of a `[[fixes]]` stream; `tag` is where the observed point sits on the body.
pub(in super::super) fn fixes(
    stream: &Fixes,
    tag: TagPlace,
    table: &Table,
) -> Result<Reader<Fix>, LoadError> {
    let limit = stream.max_speed_m_per_s.map(|limit| limit.0);
    let mut points = Points::bind(table, (&stream.x, &stream.y), limit)?;
    let heading = match &stream.heading {
        Some(columns) => Some(table.bind_heading(columns)?),
        None => None,
    };
    let tag_in_body = Point2::<Body>::new(Meters(tag.x_m.0), Meters(tag.y_m.0));
    let covariance = stream.position_sigma_m.map(|sigma| PositionCovariance {
        xx_m2: sigma.0 * sigma.0,
        xy_m2: 0.0,
        yy_m2: sigma.0 * sigma.0,
        heading_rad2: stream
            .heading_sigma_rad
            .map_or(f64::INFINITY, |sigma| sigma.0 * sigma.0),
    });
    Ok(Box::new(move |row, step| {
        if step == Step::Same {
            let detail = "the stamp of the fix before";
            return Err(Fault::new(Reason::RepeatedStamp, detail));
        }
        let interval_s = step.interval_s()?;
        let heading = match &heading {
            Some(heading) => Some(heading.read(row)?),
            None => None,
        };
        Ok(Some(Fix {
            position: points.read(row, interval_s)?,
            heading,
            covariance,
            tag_in_body,
            reset_counter: 0,
        }))
    }))
}

/// Where the body was, and where it pointed if the instrument can tell.
type TruePose = (Point2<Arena>, Option<Heading>);

/// Binds the columns of a `[[truth]]` stream.
pub(in super::super) fn truth(
    stream: &Truth,
    table: &Table,
) -> Result<Reader<TruePose>, LoadError> {
    let limit = stream.max_speed_m_per_s.map(|limit| limit.0);
    let mut points = Points::bind(table, (&stream.x, &stream.y), limit)?;
    let heading = match &stream.heading {
        Some(columns) => Some(table.bind_heading(columns)?),
        None => None,
    };
    Ok(Box::new(move |row, step| {
        let interval_s = step.interval_s()?;
        let heading = match &heading {
            Some(heading) => Some(heading.read(row)?),
            None => None,
        };
        Ok(Some((points.read(row, interval_s)?, heading)))
    }))
}

/// Binds the columns of an `[[odometer]]` stream: poses, or distances and turns to add up.
pub(in super::super) fn odometer(
    stream: &Odometer,
    table: &Table,
) -> Result<Reader<Observed>, LoadError> {
    if let (Some(x), Some(y), Some(heading)) = (&stream.x, &stream.y, &stream.heading) {
        let limit = stream.max_speed_m_per_s.map(|limit| limit.0);
        let mut points = Points::bind(table, (x, y), limit)?;
        let heading = table.bind_heading(heading)?;
        return Ok(Box::new(move |row, step| {
            let interval_s = step.interval_s()?;
            let heading = heading.read(row)?;
            let at: Point2<Odom> = points.read(row, interval_s)?;
            let pose = Pose::new(at.x, at.y, heading);
            Ok(Some(Observed::OdometerPose(pose)))
        }));
    }
    increments(stream, table)
}

fn increments(stream: &Odometer, table: &Table) -> Result<Reader<Observed>, LoadError> {
    let distance = table.bind_some(stream.distance.as_ref())?;
    let turn = table.bind_some(stream.turn.as_ref())?;
    let limit = stream.max_speed_m_per_s.map(|limit| limit.0);
    let mut pose = Pose::<Odom>::default();
    Ok(Box::new(move |row, step| {
        let distance_m = distance
            .as_ref()
            .map_or(Ok(0.0), |column| column.read(row))?;
        let turn_rad = turn.as_ref().map_or(Ok(0.0), |column| column.read(row))?;
        // The first increments belong to an interval before the recording.
        if step != Step::First {
            if let (Step::Forward { interval_s }, Some(limit)) = (step, limit) {
                let speed = (distance_m / interval_s).abs();
                if speed > limit {
                    let detail = format!("{speed:.2} m/s, the limit is {limit}");
                    return Err(Fault::new(Reason::ImpossibleJump, detail));
                }
            }
            pose = advance(pose, distance_m, turn_rad);
        }
        // A row without an interval is left out, but its motion is not: the next row carries it.
        step.interval_s()?;
        Ok(Some(Observed::OdometerPose(pose)))
    }))
}

/// Moves a pose along a short arc, at the heading of its middle.
fn advance(pose: Pose<Odom>, distance_m: f64, turn_rad: f64) -> Pose<Odom> {
    let (sin, cos) = (pose.heading.rad() + turn_rad / 2.0).sin_cos();
    Transform2::new(
        Meters(pose.x.0 + distance_m * cos),
        Meters(pose.y.0 + distance_m * sin),
        Heading::from_rad(pose.heading.rad() + turn_rad),
    )
}
