//! The map: fixed objects in the arena that a robot's sensors observe.

use std::collections::BTreeMap;

use crate::ids::{BeaconId, LandmarkId};
use crate::spaces::{Arena, Point2};

/// The positions of landmarks, beacons and walls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArenaMap {
    /// Points that a robot's camera identifies.
    pub landmarks: BTreeMap<LandmarkId, Point2<Arena>>,
    /// Radio beacons.
    pub beacons: BTreeMap<BeaconId, Point2<Arena>>,
    /// Walls that a range sensor measures.
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
