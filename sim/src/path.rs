//! The ideal path: straight pieces and arcs in the arena, grouped into legs that are driven without a stop.
//!
//! Both the follower (estimated pose) and the truth log (true pose) query distances from it; it stores neither pose.

use std::f64::consts::{FRAC_PI_2, TAU};

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Arena, Body, Heading, Meters, Point2, Pose, Transform2};

use crate::scenario::{Course, DriveEnd, Scenario};

/// Spacing of the points of [`Path::polyline`] on arcs.
const POLYLINE_STEP_M: f64 = 0.02;
/// Largest distance from end to start of a closed path.
const CLOSED_M: f64 = 1e-3;
/// Search window behind and ahead of the last projection, so that a crossing path does not capture it.
const SEARCH_BACK_M: f64 = 0.05;
const SEARCH_AHEAD_M: f64 = 0.30;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Projection {
    pub(crate) along_m: f64,
    /// Lateral distance of the point, positive to the left of the leg.
    pub(crate) left_m: f64,
    pub(crate) heading: Heading,
    /// Positive to the left.
    pub(crate) curvature_per_m: f64,
    pub(crate) distance_m: f64,
}

/// A straight piece or an arc of at most a quarter turn.
#[derive(Clone, Copy, Debug)]
struct Segment {
    start: Pose<Arena>,
    length_m: f64,
    curvature_per_m: f64,
}

impl Segment {
    fn at(&self, along_m: f64) -> Pose<Arena> {
        let turn = self.curvature_per_m * along_m;
        let (ahead, left) = if self.curvature_per_m == 0.0 {
            (along_m, 0.0)
        } else {
            (turn.sin() / self.curvature_per_m, (1.0 - turn.cos()) / self.curvature_per_m)
        };
        self.start * Transform2::<Body, Body>::new(Meters(ahead), Meters(left), Heading::from_rad(turn))
    }

    fn project(&self, point: Point2<Arena>) -> Projection {
        let local = self.start.inverse() * point;
        let foot_m = if self.curvature_per_m == 0.0 {
            local.x.0
        } else {
            let to_left = self.curvature_per_m.signum();
            let radius_m = 1.0 / self.curvature_per_m.abs();
            // Seen from the centre, the start lies at angle zero and the arc runs with growing angle.
            local.x.0.atan2(radius_m - to_left * local.y.0) * radius_m
        };
        let along_m = foot_m.max(0.0).min(self.length_m);
        let foot = self.at(along_m);
        let offset = foot.inverse() * point;
        Projection {
            along_m,
            left_m: offset.y.0,
            heading: foot.heading,
            curvature_per_m: self.curvature_per_m,
            distance_m: offset.x.0.hypot(offset.y.0),
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct PathLeg {
    segments: Vec<Segment>,
}

impl PathLeg {
    fn straight(start: Pose<Arena>, length_m: f64) -> Self {
        Self { segments: vec![Segment { start, length_m, curvature_per_m: 0.0 }] }
    }

    pub(crate) fn length_m(&self) -> f64 {
        self.segments.iter().map(|s| s.length_m).sum()
    }

    pub(crate) fn start(&self) -> Pose<Arena> {
        self.segments.first().map_or_else(Pose::default, |s| s.start)
    }

    fn end(&self) -> Pose<Arena> {
        self.segments.last().map_or_else(Pose::default, |s| s.at(s.length_m))
    }

    /// The nearest point to `point`, close to `near_m` along the leg.
    pub(crate) fn project(&self, point: Point2<Arena>, near_m: f64) -> Projection {
        let mut begin_m = 0.0;
        let mut best: Option<Projection> = None;
        for segment in &self.segments {
            let end_m = begin_m + segment.length_m;
            if begin_m <= near_m + SEARCH_AHEAD_M && end_m >= near_m - SEARCH_BACK_M {
                let mut found = segment.project(point);
                found.along_m += begin_m;
                if best.is_none_or(|b| found.distance_m < b.distance_m) {
                    best = Some(found);
                }
            }
            begin_m = end_m;
        }
        best.unwrap_or_else(|| Projection {
            along_m: begin_m,
            left_m: 0.0,
            heading: self.end().heading,
            curvature_per_m: 0.0,
            distance_m: 0.0,
        })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Path {
    pub(crate) legs: Vec<PathLeg>,
    lap: Vec<Segment>,
    /// Legs per lap; a path without a stop has a single leg for all of its laps.
    pub(crate) lap_legs: usize,
    pub(crate) is_closed: bool,
}

/// Stored laps of an endless path without a stop; the follower goes back by one after each.
const SMOOTH_LAPS: usize = 2;

impl Path {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let (laps, smooth_laps, is_endless) = match scenario.drive.end {
            DriveEnd::LastLap => (scenario.drive.laps as usize, scenario.drive.laps as usize, false),
            DriveEnd::Never => (1, SMOOTH_LAPS, true),
        };
        let start = scenario.start.pose();
        match &scenario.path {
            Course::Square { side_m, direction } => {
                let lap = square(start, *side_m, direction.sign() * FRAC_PI_2);
                let lap_legs = lap.len();
                let legs = lap.into_iter().cycle().take(laps * lap_legs).collect();
                Self::from_legs(legs, lap_legs)
            }
            Course::Circle { radius_m, direction } => Self::smooth(start, smooth_laps, &[direction.sign() / radius_m]),
            Course::FigureEight { radius_m } => Self::smooth(start, smooth_laps, &[1.0 / radius_m, -1.0 / radius_m]),
            Course::Waypoints { points_m } if is_endless => round_trip(start, points_m),
            Course::Waypoints { points_m } => waypoints(start, points_m, laps),
            // The hand does not follow a path.
            Course::ByHand(_) => Self { legs: Vec::new(), lap: Vec::new(), lap_legs: 0, is_closed: false },
        }
    }

    /// Legs with a stop between them; the first `lap_legs` are one lap.
    fn from_legs(legs: Vec<PathLeg>, lap_legs: usize) -> Self {
        let lap = legs.iter().take(lap_legs).flat_map(|leg| leg.segments.iter().copied()).collect();
        let first = legs.first().map(PathLeg::start).unwrap_or_default();
        let last = legs.last().map(PathLeg::end).unwrap_or_default();
        Self { legs, lap, lap_legs, is_closed: first.origin().distance(last.origin()).0 < CLOSED_M }
    }

    /// One leg of full circles with these curvatures, repeated `laps` times.
    fn smooth(start: Pose<Arena>, laps: usize, curvatures_per_m: &[f64]) -> Self {
        let mut at = start;
        let mut lap = Vec::new();
        for curvature_per_m in curvatures_per_m.iter().copied() {
            // In quarters, so that every projection on a piece is unique.
            for _ in 0..4 {
                let segment = Segment { start: at, length_m: TAU / 4.0 / curvature_per_m.abs(), curvature_per_m };
                at = segment.at(segment.length_m);
                lap.push(segment);
            }
        }
        Self { legs: vec![PathLeg { segments: lap.repeat(laps) }], lap, lap_legs: 1, is_closed: true }
    }

    pub(crate) fn start(&self) -> Pose<Arena> {
        self.legs.first().map_or_else(Pose::default, PathLeg::start)
    }

    pub(crate) fn length_m(&self) -> f64 {
        self.legs.iter().map(PathLeg::length_m).sum()
    }

    pub(crate) fn lap_length_m(&self) -> f64 {
        self.lap.iter().map(|segment| segment.length_m).sum()
    }

    /// The nearest point on the lap of `leg`: its leg, and the distance along it in metres.
    pub(crate) fn nearest(&self, leg: usize, point: Point2<Arena>) -> (usize, f64) {
        let first = leg - leg % self.lap_legs.max(1);
        let mut best = (first, 0.0, f64::INFINITY);
        for (index, leg) in self.legs.iter().enumerate().skip(first).take(self.lap_legs) {
            let mut begin_m = 0.0;
            for segment in &leg.segments {
                let found = segment.project(point);
                if found.distance_m < best.2 {
                    best = (index, begin_m + found.along_m, found.distance_m);
                }
                begin_m += segment.length_m;
            }
        }
        (best.0, best.1)
    }

    /// Zero where there is no path to be off.
    pub(crate) fn distance_m(&self, point: Point2<Arena>) -> f64 {
        if self.lap.is_empty() {
            return 0.0;
        }
        self.lap.iter().map(|segment| segment.project(point).distance_m).fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn polyline(&self) -> Vec<Point2<Arena>> {
        let mut points = vec![self.start().origin()];
        for segment in &self.lap {
            let step_count = if segment.curvature_per_m == 0.0 {
                1.0
            } else {
                (segment.length_m / POLYLINE_STEP_M).ceil().clamp(2.0, 256.0)
            };
            let step_m = segment.length_m / step_count;
            points.extend((1..=step_count as u32).map(|i| segment.at(f64::from(i) * step_m).origin()));
        }
        points
    }
}

fn square(start: Pose<Arena>, side_m: f64, turn_rad: f64) -> Vec<PathLeg> {
    let mut at = start;
    let corner = Transform2::<Body, Body>::new(Meters(side_m), Meters(0.0), Heading::from_rad(turn_rad));
    let mut sides = Vec::new();
    for _ in 0..4 {
        sides.push(PathLeg::straight(at, side_m));
        at = at * corner;
    }
    sides
}

fn waypoints(start: Pose<Arena>, points_m: &[[f64; 2]], laps: usize) -> Path {
    let points: Vec<Point2<Arena>> =
        points_m.iter().map(|[x, y]| start * Point2::<Body>::new(Meters(*x), Meters(*y))).collect();
    let lap: Vec<PathLeg> = points.windows(2).map(|w| straight(w[0], w[1])).collect();
    let return_leg = match points.as_slice() {
        [first, .., last] if laps > 1 && first.distance(*last).0 >= CLOSED_M => Some(straight(*last, *first)),
        _ => None,
    };
    let mut legs = lap.clone();
    for _ in 1..laps {
        legs.extend(return_leg.clone());
        legs.extend(lap.iter().cloned());
    }
    Path::from_legs(legs, lap.len() + usize::from(return_leg.is_some()))
}

/// A closed lap through the points and back to the first.
fn round_trip(start: Pose<Arena>, points_m: &[[f64; 2]]) -> Path {
    let mut points_m = points_m.to_vec();
    let ends = points_m.first().copied().zip(points_m.last().copied());
    if let Some((first, _)) = ends.filter(|(first, last)| (first[0] - last[0]).hypot(first[1] - last[1]) >= CLOSED_M) {
        points_m.push(first);
    }
    waypoints(start, &points_m, 1)
}

fn straight(from: Point2<Arena>, to: Point2<Arena>) -> PathLeg {
    let heading = Heading::from_rad(wrap_rad((to.y - from.y).0.atan2((to.x - from.x).0)));
    PathLeg::straight(Pose::new(from.x, from.y, heading), from.distance(to).0)
}

#[cfg(test)]
mod tests {
    use crate::scenario::{Direction, StartPose};

    use super::*;

    fn path(course: Course) -> Path {
        Path::new(&Scenario { path: course, ..Scenario::default() })
    }

    fn point(x_m: f64, y_m: f64) -> Point2<Arena> {
        Point2::new(Meters(x_m), Meters(y_m))
    }

    #[test]
    fn a_square_is_closed_and_has_four_sides() {
        let square = path(Course::Square { side_m: 1.0, direction: Direction::Left });
        assert!(square.is_closed && (square.length_m() - 4.0).abs() < 1e-12);
        assert_eq!(square.polyline().len(), 5);
        assert!((square.distance_m(point(0.5, 0.5)) - 0.5).abs() < 1e-12);
        assert!((square.distance_m(point(1.03, 0.4)) - 0.03).abs() < 1e-12);
        let start = StartPose { x_m: 2.0, y_m: 1.0, heading_deg: 90.0 };
        let corner = Path::new(&Scenario { start, ..Scenario::default() }).polyline()[1];
        assert!(corner.distance(point(2.0, 2.0)).0 < 1e-9, "the start pose moves the path");
    }

    #[test]
    fn an_arc_knows_its_left_and_its_curvature() {
        let circle = path(Course::Circle { radius_m: 0.5, direction: Direction::Left });
        let leg = &circle.legs[0];
        // Half way round, at (0, 1); a point inside the circle lies to the left.
        let half = leg.project(point(0.0, 0.9), 0.5 * leg.length_m());
        assert!((half.along_m - 0.5 * leg.length_m()).abs() < 1e-9);
        assert!((half.left_m - 0.1).abs() < 1e-9 && (half.curvature_per_m - 2.0).abs() < 1e-12);
        assert!((half.heading.rad().abs() - std::f64::consts::PI).abs() < 1e-9);

        let right = path(Course::Circle { radius_m: 0.5, direction: Direction::Right });
        assert!(right.distance_m(point(0.0, -1.0)) < 1e-9);
        let quarter = right.legs[0].project(point(0.5, -0.5), 0.7);
        assert!(quarter.distance_m < 1e-9 && (quarter.along_m - 0.5 * FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn a_projection_near_the_crossing_stays_on_its_own_lobe() {
        let eight = path(Course::FigureEight { radius_m: 0.5 });
        let leg = &eight.legs[0];
        for near_m in [0.0, 0.5 * leg.length_m()] {
            assert!((leg.project(point(0.0, 0.0), near_m).along_m - near_m).abs() < 1e-6);
        }
        assert!(eight.is_closed);
    }

    #[test]
    fn further_laps_of_open_way_points_come_back_first() {
        let path = Course::Waypoints { points_m: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]] };
        let scenario = Scenario { path, ..Scenario::default() };
        assert!(!Path::new(&scenario).is_closed);
        let two = Path::new(&scenario.with_laps(2));
        assert!((two.length_m() - (4.0 + 2.0_f64.sqrt())).abs() < 1e-9);
    }
}
