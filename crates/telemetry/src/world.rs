//! What stands still in the arena and can be seen or measured from a robot.

use std::collections::BTreeMap;

use crate::ids::{BeaconId, LandmarkId};
use crate::spaces::{Arena, Point2};

/// The places of landmarks, beacons and walls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// Points that a robot's camera can tell apart.
    pub landmarks: BTreeMap<LandmarkId, Point2<Arena>>,
    /// Radio beacons.
    pub beacons: BTreeMap<BeaconId, Point2<Arena>>,
    /// Walls that a range sensor can meet.
    pub walls: Vec<Wall>,
}

/// A straight wall between two points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// One end.
    pub from: Point2<Arena>,
    /// The other end.
    pub to: Point2<Arena>,
}
