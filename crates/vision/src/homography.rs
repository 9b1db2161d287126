//! From a tag's modules to pixels: plane perspective, and what a distorting lens adds to it.

use nalgebra::{Matrix2, Matrix3, Point2, SMatrix, SVector, Vector2, Vector3};

/// Maps points of a tag's plane, in modules, to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography(pub(crate) Matrix3<f64>);

impl Homography {
    /// The one that maps the corners (0, 0), (side, 0), (side, side) and (0, side) to those of a quadrilateral.
    pub(crate) fn of_square(side: f64, quad: &[Point2<f64>; 4]) -> Option<Self> {
        let square = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)];
        let mut system = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SVector::<f64, 8>::zeros();
        for (corner, ((u, v), pixel)) in square.into_iter().zip(quad).enumerate() {
            let (row, x, y) = (2 * corner, pixel.x, pixel.y);
            for (column, value) in [u, v, 1.0].into_iter().enumerate() {
                system[(row, column)] = value;
                system[(row + 1, column + 3)] = value;
            }
            for (column, value) in [u, v].into_iter().enumerate() {
                system[(row, column + 6)] = -x * value;
                system[(row + 1, column + 6)] = -y * value;
            }
            (right[row], right[row + 1]) = (x, y);
        }
        let h = system.lu().solve(&right)?;
        Some(Self(Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0)))
    }

    pub(crate) fn map(&self, u: f64, v: f64) -> Point2<f64> {
        let mapped = self.0 * Vector3::new(u, v, 1.0);
        Point2::new(mapped.x / mapped.z, mapped.y / mapped.z)
    }

    pub(crate) fn inverse(&self) -> Option<Self> {
        self.0.try_inverse().map(Self)
    }
}

/// Focal length of a usual webcam by the width of its picture, 64 degrees wide.
const USUAL_FOCAL: f64 = 0.8;
/// Steps of Newton's method from anywhere, and of one with a constant slope from a start that is good to a hundredth.
const NEWTON_STEPS: usize = 9;
const CHORD_STEPS: usize = 2;
/// Nearer to the axis than this, the lens hardly does anything.
const MIN_DISTANCE: f64 = 1e-3;
/// Just below what the strength comes to for a k1 without bounds.
const MAX_STRENGTH: f64 = 0.1;

/// Where the axis of the lens meets the picture, as far as nothing is known: in its middle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LensAxis {
    pub(crate) middle: Point2<f64>,
    pub(crate) focal_px: f64,
}

impl LensAxis {
    /// Of a whole picture; of a part of it, with its upper left corner.
    pub(crate) fn of_picture(width: usize, height: usize, left: usize, top: usize) -> Self {
        let middle = |size: usize, before: usize| (size as f64 - 1.0) / 2.0 - before as f64;
        Self {
            middle: Point2::new(middle(width, left), middle(height, top)),
            focal_px: USUAL_FOCAL * width.max(1) as f64,
        }
    }

    /// In focal lengths from the axis.
    pub(crate) fn ray(&self, x: f64, y: f64) -> Vector2<f64> {
        Vector2::new(x - self.middle.x, y - self.middle.y) / self.focal_px
    }
}

/// How a lens bends what is straight around one place.
///
/// The lens moves x to x (1 + k1 |x|²), in focal lengths from its axis. A homography takes over the part of this that is linear around the
/// place; only the rest is here, which leaves the place and all directions there as they are. So k1 hardly changes a homography that
/// was fitted with another one.
pub(crate) struct Bend {
    axis: LensAxis,
    k1: f64,
    /// The place in the picture, in focal lengths from the axis, and without the lens.
    place: Vector2<f64>,
    straight_place: Vector2<f64>,
    /// The linear part: lengths away from the axis and across, with it by those without it.
    linear: Matrix2<f64>,
    inverse: Matrix2<f64>,
    /// Changes with k1.
    place_by_k1: Vector2<f64>,
    linear_by_k1: Matrix2<f64>,
    distance: f64,
    straight_distance: f64,
    /// How much less far a ray is without the lens, by its squared distance with it: a series around the place.
    shortening: [f64; 3],
}

impl Bend {
    /// Around the pixel `place`. `None` where the picture is folded back.
    pub(crate) fn new(axis: LensAxis, place: Point2<f64>, k1: f64) -> Option<Self> {
        let place = axis.ray(place.x, place.y);
        let distance = place.norm();
        let straight_distance = straight_distance(k1, distance);
        let squared = straight_distance.powi(2);
        let (away, across) = (1.0 + 3.0 * k1 * squared, 1.0 + k1 * squared);
        if away <= 0.0 || across <= 0.0 {
            return None;
        }
        let direction = if distance > 0.0 { place / distance } else { Vector2::x() };
        let outer = direction * direction.transpose();
        let matrix = |away: f64, across: f64| Matrix2::identity() * across + outer * (away - across);
        let straight_place = direction * straight_distance;
        let shortening = 1.0 / across;
        let first = -k1 * shortening.powi(3) / away;
        let second = -6.0 * k1 * shortening * first * (distance.powi(2) * first + shortening) / away;
        let by_k1 = -straight_distance * squared / away;
        let squared_by_k1 = 2.0 * straight_distance * by_k1;
        Some(Self {
            axis,
            k1,
            place,
            straight_place,
            linear: matrix(away, across),
            inverse: matrix(1.0 / away, 1.0 / across),
            place_by_k1: direction * by_k1,
            linear_by_k1: matrix(3.0 * (squared + k1 * squared_by_k1), squared + k1 * squared_by_k1),
            distance,
            straight_distance,
            shortening: [shortening, first, second / 2.0],
        })
    }

    /// k1 after a step that is too large to take the bend for linear in it: near to where the picture is folded back, the bend grows much
    /// faster than k1. It is nearly linear in its strength, what the lens changes in the second order.
    pub(crate) fn k1_after(&self, step: f64) -> f64 {
        if self.distance < MIN_DISTANCE {
            return self.k1 + step;
        }
        let shift = self.k1 * self.straight_distance.powi(2);
        let strength = (strength(shift) + self.strength_by_k1(shift) * step).min(MAX_STRENGTH);
        // The inverse of `strength`.
        let shift = (6.0 * strength - 1.0 + (1.0 - 8.0 * strength).sqrt()) / (2.0 - 18.0 * strength);
        shift * (1.0 + shift).powi(2) / self.distance.powi(2)
    }

    /// The step that `k1_after` takes to `k1`.
    pub(crate) fn step_to(&self, k1: f64) -> f64 {
        if self.distance < MIN_DISTANCE {
            return k1 - self.k1;
        }
        let shift = self.k1 * self.straight_distance.powi(2);
        let shift_then = k1 * straight_distance(k1, self.distance).powi(2);
        (strength(shift_then) - strength(shift)) / self.strength_by_k1(shift)
    }

    fn strength_by_k1(&self, shift: f64) -> f64 {
        (1.0 - shift) / (1.0 + 3.0 * shift).powi(4) * self.distance.powi(2) / (1.0 + shift)
    }

    /// Where the homography has what is at a pixel, and how that changes with k1.
    pub(crate) fn straighten(&self, x: f64, y: f64) -> (Point2<f64>, Vector2<f64>) {
        let ray = self.axis.ray(x, y);
        let squared = ray.norm_squared();
        let beyond = squared - self.distance.powi(2);
        let [zeroth, first, second] = self.shortening;
        let mut shortening = zeroth + beyond * (first + beyond * second);
        // Newton's method, with the slope of the first step.
        let bent = self.k1 * squared;
        let by_slope = 1.0 / (1.0 + 3.0 * bent * shortening * shortening);
        for _ in 0..CHORD_STEPS {
            let too_much = shortening * (1.0 + bent * shortening * shortening) - 1.0;
            shortening -= too_much * by_slope;
        }
        let straight_ray = ray * shortening;
        let from_place = straight_ray - self.straight_place;
        let ray_by_k1 = straight_ray * (-squared * shortening * shortening * by_slope);
        let on_homography = self.axis.middle + (self.place + self.linear * from_place) * self.axis.focal_px;
        let by_k1 = self.linear_by_k1 * from_place + self.linear * (ray_by_k1 - self.place_by_k1);
        (on_homography, by_k1 * self.axis.focal_px)
    }

    /// The pixel of what the homography has at a point, and its derivative by the point.
    pub(crate) fn bend(&self, point: Point2<f64>) -> (Point2<f64>, Matrix2<f64>) {
        let ray = self.straight_place + self.inverse * (self.axis.ray(point.x, point.y) - self.place);
        let across = 1.0 + self.k1 * ray.norm_squared();
        let derivative = Matrix2::identity() * across + ray * ray.transpose() * (2.0 * self.k1);
        (self.axis.middle + ray * across * self.axis.focal_px, derivative * self.inverse)
    }
}

/// How strongly something is bent that the lens moves by this share of its distance from the axis: the second order, by that distance and
/// the first order.
fn strength(shift: f64) -> f64 {
    shift * (1.0 + shift) / (1.0 + 3.0 * shift).powi(2)
}

/// Distance without the lens of what is at `distance` with it.
fn straight_distance(k1: f64, distance: f64) -> f64 {
    let mut straight = distance;
    for _ in 0..NEWTON_STEPS {
        straight = newton_step(k1, distance, straight);
    }
    straight
}

/// Nearer to the distance without the lens of what is at `distance` with it.
fn newton_step(k1: f64, distance: f64, straight: f64) -> f64 {
    let bent = k1 * straight * straight;
    straight - (straight * (1.0 + bent) - distance) / (1.0 + 3.0 * bent)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bend_is_the_lens_without_its_linear_part() {
        let axis = LensAxis::of_picture(1280, 720, 0, 0);
        let place = Point2::new(1000.0, 150.0);
        for k1 in [-0.3, -0.1, 0.0, 0.2] {
            let bend = Bend::new(axis, place, k1).unwrap();
            let (same, derivative) = bend.bend(place);
            assert!((same - place).norm() < 1e-9 && (derivative - Matrix2::identity()).norm() < 1e-9, "{k1}");
            let point = Point2::new(1090.0, 120.0);
            let (pixel, derivative) = bend.bend(point);
            assert!((bend.straighten(pixel.x, pixel.y).0 - point).norm() < 1e-4, "{k1}");
            let step = 1e-3;
            for (index, offset) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
                let difference =
                    (bend.bend(point + offset * step).0 - bend.bend(point - offset * step).0) / (2.0 * step);
                assert!((difference - derivative.column(index)).norm() < 1e-6, "{k1}: {difference} {derivative}");
            }
            for then in [-0.25, 0.15] {
                assert!((bend.k1_after(bend.step_to(then)) - then).abs() < 1e-9, "{k1} {then}");
            }
            assert!((bend.k1_after(1e-5) - k1 - 1e-5).abs() < 1e-8, "{k1}");
            let straight = |k1: f64| Bend::new(axis, place, k1).unwrap().straighten(pixel.x, pixel.y).0;
            let difference = (straight(k1 + step) - straight(k1 - step)) / (2.0 * step);
            let by_k1 = bend.straighten(pixel.x, pixel.y).1;
            assert!((difference - by_k1).norm() < 4e-3 * by_k1.norm(), "{k1}: {difference} {by_k1}");
        }
    }
}
