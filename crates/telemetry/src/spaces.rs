//! Spaces (coordinate frames) in the type system, and the transforms between them.
//!
//! A transform is named target-from-source, and its type repeats it, so that a wrong chain does not build:
//!
//! ```
//! use posebridge_telemetry::{Arena, Body, Heading, Meters, Point2, Tag, Transform2};
//! let arena_from_body = Transform2::<Arena, Body>::new(Meters(1.0), Meters(2.0), Heading::from_rad(0.0));
//! let body_from_tag = Transform2::<Body, Tag>::new(Meters(0.03), Meters(0.0), Heading::from_rad(0.0));
//! let tag_in_arena = arena_from_body * body_from_tag * Point2::<Tag>::ORIGIN;
//! assert!((tag_in_arena.x.0 - 1.03).abs() < 1e-12);
//! ```
//!
//! ```compile_fail
//! use posebridge_telemetry::{Arena, Body, Tag, Transform2};
//! fn wrong(arena_from_body: Transform2<Arena, Body>, body_from_tag: Transform2<Body, Tag>) {
//!     let nonsense = body_from_tag * arena_from_body; // the spaces do not touch: this must not build
//! }
//! ```
//!
//! What the types do not protect: a `Body` at another time, a tag that was re-mounted, the drift of `Odom`.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Mul;

use serde::{Deserialize, Serialize};

use crate::quantities::{Heading, Meters};

/// A space; implemented only by the five spaces of this module.
pub trait Space: Copy + fmt::Debug {
    /// The space's name in messages to people.
    const NAME: &'static str;
}

macro_rules! space {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum $name {}
        impl Space for $name {
            const NAME: &'static str = stringify!($name);
        }
    };
}

space!(/// Fixed to the floor: x east, y north.
    Arena);
space!(/// Continuous, fixed where the robot started, drifts against `Arena`.
    Odom);
space!(/// Fixed to the robot: origin mid-axle, x forward, y left.
    Body);
space!(/// Fixed to an overhead camera.
    Camera);
space!(/// Fixed to the marker on the robot that the camera sees.
    Tag);

/// A point in the space `S`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct Point2<S> {
    pub x: Meters,
    pub y: Meters,
    space: PhantomData<S>,
}

impl<S> Point2<S> {
    pub const ORIGIN: Self = Self::new(Meters(0.0), Meters(0.0));

    pub const fn new(x: Meters, y: Meters) -> Self {
        Self { x, y, space: PhantomData }
    }

    pub fn distance(self, other: Self) -> Meters {
        Meters((self.x.0 - other.x.0).hypot(self.y.0 - other.y.0))
    }
}

impl<S> Clone for Point2<S> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<S> Copy for Point2<S> {}
impl<S> PartialEq for Point2<S> {
    fn eq(&self, other: &Self) -> bool {
        self.x == other.x && self.y == other.y
    }
}
impl<S> Default for Point2<S> {
    fn default() -> Self {
        Self::ORIGIN
    }
}

/// The rigid transform that turns coordinates in `Source` into coordinates in `Target`: a rotation, then a translation.
#[derive(Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct Transform2<Target, Source> {
    /// Position of the origin of `Source` in `Target`.
    pub x: Meters,
    pub y: Meters,
    /// Direction of the x axis of `Source` in `Target`.
    pub heading: Heading,
    spaces: PhantomData<(Target, Source)>,
}

/// Position and heading of a body in the space `S`.
pub type Pose<S> = Transform2<S, Body>;

impl<Target, Source> Transform2<Target, Source> {
    /// The transform whose source origin lies at (x, y) in the target and whose source x axis has this heading there.
    pub const fn new(x: Meters, y: Meters, heading: Heading) -> Self {
        Self { x, y, heading, spaces: PhantomData }
    }

    pub fn inverse(self) -> Transform2<Source, Target> {
        let (sin, cos) = self.heading.rad().sin_cos();
        Transform2::new(
            Meters(-cos * self.x.0 - sin * self.y.0),
            Meters(sin * self.x.0 - cos * self.y.0),
            Heading::from_rad(-self.heading.rad()),
        )
    }

    pub const fn origin(self) -> Point2<Target> {
        Point2::new(self.x, self.y)
    }
}

impl<Target, Source> Clone for Transform2<Target, Source> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<Target, Source> Copy for Transform2<Target, Source> {}
impl<Target, Source> PartialEq for Transform2<Target, Source> {
    fn eq(&self, other: &Self) -> bool {
        self.x == other.x && self.y == other.y && self.heading == other.heading
    }
}
impl<Target, Source> Default for Transform2<Target, Source> {
    fn default() -> Self {
        Self::new(Meters(0.0), Meters(0.0), Heading::default())
    }
}

impl<A, B, C> Mul<Transform2<B, C>> for Transform2<A, B> {
    type Output = Transform2<A, C>;
    fn mul(self, inner: Transform2<B, C>) -> Transform2<A, C> {
        let origin = self * inner.origin();
        let heading = Heading::from_rad(self.heading.rad() + inner.heading.rad());
        Transform2::new(origin.x, origin.y, heading)
    }
}

impl<A, B> Mul<Point2<B>> for Transform2<A, B> {
    type Output = Point2<A>;
    fn mul(self, point: Point2<B>) -> Point2<A> {
        let (sin, cos) = self.heading.rad().sin_cos();
        Point2::new(
            Meters(self.x.0 + cos * point.x.0 - sin * point.y.0),
            Meters(self.y.0 + sin * point.x.0 + cos * point.y.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transform_times_its_inverse_is_the_identity() {
        let arena_from_body = Pose::<Arena>::new(Meters(1.5), Meters(-0.7), Heading::from_rad(2.9));
        let identity = arena_from_body * arena_from_body.inverse();
        assert!(identity.x.0.abs() < 1e-12 && identity.y.0.abs() < 1e-12 && identity.heading.rad().abs() < 1e-12);
    }

    #[test]
    fn a_point_on_the_left_of_a_body_that_looks_north_lies_west() {
        let arena_from_body =
            Pose::<Arena>::new(Meters(2.0), Meters(1.0), Heading::from_rad(std::f64::consts::FRAC_PI_2));
        let in_arena = arena_from_body * Point2::<Body>::new(Meters(0.0), Meters(0.5));
        assert!((in_arena.x.0 - 1.5).abs() < 1e-12 && (in_arena.y.0 - 1.0).abs() < 1e-12);
    }
}
