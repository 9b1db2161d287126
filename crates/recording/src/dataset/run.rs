//! One run of a foreign recording, ready to be replayed and scored.

use posebridge_telemetry::{
    Arena, BeaconId, BrickClock, Fix, Heading, HostClock, LandmarkId, Observation, Point2, Pose, Timestamp,
};

use super::bad_rows::BadRows;

/// One run of a foreign recording.
///
/// Brick and host stamps are on one time base, the data's own; nothing is subtracted but the descriptor's `offset_s`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DatasetRun {
    /// The run's name in its descriptor.
    pub name: String,
    /// Where the robot stood at the start, if the descriptor knows.
    pub start: Option<StartPose>,
    /// What the robot's sensors and cameras said, sorted by arrival.
    pub observations: Vec<TimedObservation>,
    /// Where the robot really was, by an instrument of its own; for scoring only.
    pub truth: Vec<TruthPose>,
    /// Fixes that were kept from the filter; for scoring only.
    pub withheld: Vec<WithheldFix>,
    /// Places of the landmarks.
    pub landmarks: Vec<(LandmarkId, Point2<Arena>)>,
    /// Places of the radio beacons.
    pub beacons: Vec<(BeaconId, Point2<Arena>)>,
    /// Rows that were left out, and why.
    pub bad_rows: BadRows,
}

/// Where a run starts, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartPose {
    /// The pose of the body at the first observation.
    pub pose: Pose<Arena>,
    /// One standard deviation of x and of y, in metres.
    pub position_sigma_m: f64,
    /// One standard deviation of the heading, in radians.
    pub heading_sigma_rad: f64,
}

/// An observation with the instant at which the host had it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedObservation {
    /// When it arrived; equal to its own stamp where the recording does not say.
    pub arrival: Timestamp<HostClock>,
    /// The observation.
    pub observation: Observation,
}

/// The true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthPose {
    /// The instant.
    pub time: Timestamp<BrickClock>,
    /// Where the body's origin was.
    pub position: Point2<Arena>,
    /// The body's heading, if the instrument measures it.
    pub heading: Option<Heading>,
}

/// A fix that the filter does not get.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithheldFix {
    /// The instant of the fix.
    pub time: Timestamp<BrickClock>,
    /// The fix; its position is that of the tag and not of the body.
    pub fix: Fix,
}
