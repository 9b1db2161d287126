//! The quadrilateral that an outline is, if it is one.

use nalgebra::{Point2, Vector2};

use crate::outline::Outline;

/// Shortest side of a quadrilateral, px.
const MIN_SIDE: f64 = 8.0;
/// The same as points of its outline, and its least area, px²: a thin one.
pub(crate) const MIN_POINTS: usize = 4 * MIN_SIDE as usize;
const MIN_AREA: f64 = MIN_SIDE * MIN_SIDE / 2.0;
/// Points of the outline that are farther away from the line between two corners are not of that side: px, and parts of the longest
/// side.
const MAX_DISTANCE: f64 = 2.0;
const MAX_RELATIVE_DISTANCE: f64 = 0.06;
/// At least this share of the line between two corners must have points of the outline. How many others lie between the corners does
/// not matter: where bright bits break a thin rim, the outline runs far around them.
const MIN_COVERED: f64 = 0.4;
/// Where an outline encloses so many times more than the quadrilateral of its corners, these are wrong: it may only bulge by pixels.
const MAX_OUTSIDE: f64 = 1.05;
/// How often the diagonals of an outline are looked for once more.
const MAX_DIAGONALS: usize = 3;
/// How much the areas of outline and quadrilateral may differ.
const MAX_AREA_DIFFERENCE: f64 = 0.4;
/// How often the sides are fitted, each time between the corners of the last time.
const FITS: usize = 2;
/// How often a ragged side is fitted: where the rim is thinner than a pixel, bright bits cut into the outline. Points that are so much
/// farther inside than the line are left out the next time, px.
const MAX_TRIMS: usize = 4;
const RAGGED: f64 = 0.6;
/// Least sine of the angle between two sides.
const MIN_SINE: f64 = 0.1;
/// This share of a side at each end is left to the corners.
const CORNER_SHARE: f64 = 0.12;

/// Corners, clockwise on the picture.
pub(crate) type Quad = [Point2<f64>; 4];

pub(crate) fn fit_quad(outline: &Outline) -> Option<Quad> {
    let area = outline.double_area as f64 / 2.0;
    if area < MIN_AREA {
        return None;
    }
    let mut corners = find_corners(outline)?;
    let mut quad = corners.map(|index| outline.point(index));
    if !is_like(&quad, area) {
        return None;
    }
    for _ in 0..FITS {
        quad = fit_sides(outline, corners, &quad)?;
        // What lies between the points next to the new corners is another part of the outline, above all at obtuse ones.
        corners = quad.map(|corner| nearest(&outline.points, corner));
    }
    is_like(&quad, area).then_some(quad)
}

/// Whether a quadrilateral is convex and has about this area.
fn is_like(quad: &Quad, area: f64) -> bool {
    let quad_area = double_area(quad) / 2.0;
    let is_convex = (0..4).all(|corner| {
        let (before, at, after) = (quad[(corner + 3) % 4], quad[corner], quad[(corner + 1) % 4]);
        (at - before).perp(&(after - at)) > 0.0
    });
    is_convex && (quad_area - area).abs() <= MAX_AREA_DIFFERENCE * quad_area
}

/// Where the lines along the four parts of the outline meet.
fn fit_sides(outline: &Outline, corners: [usize; 4], rough: &Quad) -> Option<Quad> {
    let sides = [0, 1, 2, 3].map(|side| (rough[(side + 1) % 4] - rough[side]).norm());
    let longest = sides.iter().copied().fold(0.0, f64::max);
    if sides.iter().any(|side| *side < MIN_SIDE) {
        return None;
    }
    let limit = MAX_DISTANCE.max(MAX_RELATIVE_DISTANCE * longest);
    let mut lines = [Line::default(); 4];
    for side in 0..4 {
        let (from, to) = (corners[side], corners[(side + 1) % 4]);
        lines[side] = fit_side(outline, from, to, rough[side], rough[(side + 1) % 4], limit)?;
    }
    let mut quad = *rough;
    for corner in 0..4 {
        quad[corner] = lines[(corner + 3) % 4].meet(&lines[corner])?;
        // Where two lines are nearly one, they meet anywhere.
        if (quad[corner] - rough[corner]).norm() > 2.0 + 0.2 * longest {
            return None;
        }
    }
    Some(quad)
}

fn nearest(points: &[(i32, i32)], to: Point2<f64>) -> usize {
    let at = ((2.0 * to.x) as i32, (2.0 * to.y) as i32);
    let distance = |point: &(i32, i32)| (point.0 - at.0).pow(2) + (point.1 - at.1).pow(2);
    let nearest = points.iter().enumerate().min_by_key(|(_, point)| distance(point));
    nearest.map_or(0, |(index, _)| index)
}

fn double_area(quad: &Quad) -> f64 {
    (0..4).map(|corner| quad[corner].coords.perp(&quad[(corner + 1) % 4].coords)).sum()
}

/// The numbers of the points at the corners, in their order: the ends of a diagonal, and what is farthest from it on each side. What
/// looked like a diagonal may be a side as long as it: while the corners enclose too little, what is farthest from the other diagonal
/// replaces its ends.
fn find_corners(outline: &Outline) -> Option<[usize; 4]> {
    let points = &outline.points;
    let [left, right, top, bottom] = outline.bounds();
    let middle = (i32::midpoint(left, right), i32::midpoint(top, bottom));
    let first = farthest_from(points, middle)?;
    let mut corners = [first, 0, farthest_from(points, points[first])?, 0];
    [corners[1], corners[3]] = farthest_beside(points, corners[0], corners[2]);
    for _ in 0..MAX_DIAGONALS {
        let quad = corners.map(|index| outline.point(index));
        if outline.double_area as f64 <= MAX_OUTSIDE * double_area(&quad) {
            break;
        }
        let [third, first] = farthest_beside(points, corners[1], corners[3]);
        let [second, fourth] = farthest_beside(points, first, third);
        corners = [first, second, third, fourth];
    }
    let mut order = corners.map(|corner| (corner + points.len() - corners[0]) % points.len());
    order[0] = 0;
    order.is_sorted().then_some(corners)
}

/// What is farthest from the line between two points: left and right of it. On a clockwise outline the former comes after the first
/// point; where there is nothing beside the line, it is the first point itself.
fn farthest_beside(points: &[(i32, i32)], first: usize, last: usize) -> [usize; 2] {
    let (from, to) = (points[first], points[last]);
    let (dx, dy) = (i64::from(to.0 - from.0), i64::from(to.1 - from.1));
    let (mut left, mut right) = ((0, first), (0, first));
    for (index, (x, y)) in points.iter().enumerate() {
        let distance = dx * i64::from(y - from.1) - dy * i64::from(x - from.0);
        if distance < left.0 {
            left = (distance, index);
        } else if distance > right.0 {
            right = (distance, index);
        }
    }
    [left.1, right.1]
}

fn farthest_from(points: &[(i32, i32)], from: (i32, i32)) -> Option<usize> {
    let distance = |point: &(i32, i32)| {
        let (dx, dy) = (i64::from(point.0 - from.0), i64::from(point.1 - from.1));
        dx * dx + dy * dy
    };
    let farthest = points.iter().enumerate().max_by_key(|(_, point)| distance(point));
    farthest.map(|(index, _)| index)
}

/// A line through `through` with the unit vector `along` it.
#[derive(Clone, Copy, Default)]
struct Line {
    along: Vector2<f64>,
    through: Vector2<f64>,
}

impl Line {
    fn meet(&self, other: &Self) -> Option<Point2<f64>> {
        let determinant = self.along.perp(&other.along);
        if determinant.abs() < MIN_SINE {
            return None;
        }
        let way = (other.through - self.through).perp(&other.along) / determinant;
        Some(Point2::from(self.through + self.along * way))
    }
}

/// The line that fits the points between two corners best; `None` if they are not on one.
fn fit_side(
    outline: &Outline,
    from: usize,
    to: usize,
    start: Point2<f64>,
    end: Point2<f64>,
    limit: f64,
) -> Option<Line> {
    let count = outline.points.len();
    let length = (to + count - from) % count;
    let side = (end - start).norm();
    let margin = (CORNER_SHARE * side).max(1.0);
    // An outline has a point for each step right, left, up or down.
    let steps = (end.x - start.x).abs() + (end.y - start.y).abs();
    let mut line = Line { along: (end - start) / side, through: start.coords };
    let mut inside_limit = limit;
    for _ in 0..MAX_TRIMS {
        let (mut near, mut n, mut sum, mut squares) = (0, 0.0, Vector2::zeros(), [0.0; 3]);
        for step in 0..=length {
            let offset = outline.point((from + step) % count).coords - line.through;
            // The outline is clockwise: what is right of the line is inside.
            let inside = line.along.perp(&offset);
            if inside > inside_limit || inside < -limit {
                continue;
            }
            near += 1;
            let position = line.along.dot(&offset);
            if position < margin || position > side - margin {
                continue;
            }
            n += 1.0;
            sum += offset;
            squares[0] += offset.x * offset.x;
            squares[1] += offset.x * offset.y;
            squares[2] += offset.y * offset.y;
        }
        if n < 3.0 || f64::from(near) < MIN_COVERED * steps {
            return None;
        }
        let mean = sum / n;
        let xx = squares[0] / n - mean.x * mean.x;
        let xy = squares[1] / n - mean.x * mean.y;
        let yy = squares[2] / n - mean.y * mean.y;
        // The direction of the largest spread, and the variance across it.
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let across = f64::midpoint(xx, yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        let mut along = Vector2::new(angle.cos(), angle.sin());
        if along.dot(&line.along) < 0.0 {
            along = -along;
        }
        // The positions stay those of the corners.
        let through = line.through + mean - along * along.dot(&mean);
        line = Line { along, through };
        if across < RAGGED * RAGGED {
            break;
        }
        inside_limit = RAGGED;
    }
    Some(line)
}
