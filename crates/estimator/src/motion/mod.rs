//! What is known about the wheels' travel and the gyro's rate over time, apart from any filter state.
//!
//! A filter asks these tracks for the travel between any two instants; between two readings it is linear. So a fix whose
//! stamp lies inside an encoder interval is applied at its own time, and a late reading changes nothing but the intervals
//! that it belongs to. The travel of a track depends on the readings that it holds and not on the order in which they came.
//! The tracks hold no filter state, and reject only what a wheel cannot do.

mod gyro;
mod reading;
mod search;
mod track;

pub use gyro::{GyroTrack, GyroTurn};
pub use reading::{InsertOutcome, MotionReading, MotionSource};
pub use search::count_before;
pub use track::{MotionTrack, TravelSegment};
