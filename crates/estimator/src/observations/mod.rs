//! Observation models, each with h(x), H and R, and their interface to filters: states by name, never by the filter's
//! rows.

pub mod absolute;
pub mod fix;
pub mod gyro_window;
pub mod sensor_frame;
pub mod speed;

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::MountedSensor;

use crate::models::lie::Se2;

/// A state besides the pose that a sensor's reading may depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StateTerm {
    /// Gyro bias, rad/s.
    GyroBias,
    /// Turn since the gyro window began, by the encoders, rad.
    WindowTurn,
    /// By how much the encoders' heading was rounded where the gyro window began, rad.
    HeadingRounding,
    /// Delay of the odometer, s: the motion of the pose belongs to earlier instants by it.
    OdometryDelay,
    /// Delay of the fixes, s.
    FixDelay,
    /// Error of the tag's configured position, forward, m.
    TagForward,
    /// The same to the left, m.
    TagLeft,
    /// Offset of the ranges to one beacon, m, by its number among the beacons of the arena.
    BeaconOffset(usize),
    /// Relative error of the ranges to one beacon.
    BeaconScale(usize),
    /// Offset of the ranges to landmarks, m.
    LandmarkOffset,
    /// Relative error of the ranges to landmarks.
    LandmarkScale,
    /// Relative error of the gyro's rate.
    GyroScale,
    /// Play between each encoder and its wheel, rad.
    Backlash,
    /// Delay of a sensor's observations, s.
    Delay(MountedSensor),
    /// Where a sensor sits in the body's frame, m or rad.
    Mounting(MountedSensor, MountingAxis),
    /// Error of a landmark's position in the map along an axis of the arena, m, by its number among the landmarks of the arena.
    LandmarkPlace(usize, ArenaAxis),
    /// The error that all fixes of one source share, along an axis of the arena, m, by the number of the source.
    FixBias(usize, ArenaAxis),
}

/// A component of a sensor's mounting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountingAxis {
    Forward,
    Left,
    Yaw,
}

impl MountingAxis {
    pub const ALL: [Self; 3] = [Self::Forward, Self::Left, Self::Yaw];
}

/// An axis of the arena.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArenaAxis {
    X,
    Y,
}

impl ArenaAxis {
    pub const ALL: [Self; 2] = [Self::X, Self::Y];
}

/// The part of a filter's state that observation models use.
pub trait PoseView {
    fn pose(&self) -> Se2;

    /// The value of a state; zero where the filter does not have it.
    fn term(&self, term: StateTerm) -> f64;
}

/// No component of an observation depends on more states besides the pose: a range to a landmark does on two delays, on
/// position and yaw of its sensor, on an offset, a scale, and on the position of the landmark.
const MAX_TERMS: usize = 9;

/// A row of H by name, for the left-invariant error of the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JacobianRow {
    pub forward: f64,
    pub left: f64,
    pub heading: f64,
    /// Derivatives by other states; a filter that does not have one leaves it out.
    pub terms: [Option<(StateTerm, f64)>; MAX_TERMS],
}

impl JacobianRow {
    /// Adds a derivative.
    pub fn push(&mut self, term: StateTerm, derivative: f64) {
        let free = self.terms.iter_mut().find(|slot| slot.is_none());
        debug_assert!(free.is_some(), "a row has no more than {MAX_TERMS} terms");
        if let Some(slot) = free {
            *slot = Some((term, derivative));
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservationModel<const M: usize> {
    /// z - h(x), angles wrapped.
    pub innovation: SVector<f64, M>,
    /// H, a row per component.
    pub rows: [JacobianRow; M],
    /// R.
    pub noise: SMatrix<f64, M, M>,
}
