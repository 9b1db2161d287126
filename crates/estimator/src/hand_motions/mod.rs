//! Geometry and wiring of a robot from three motions by hand, for `posebridge init --guide`: one wheel turned, straight on, on the spot.
//!
//! It gets the observations of one robot whose wheel angles are its raw counts, finds where a motion begins and ends from the counts, and
//! gives figures with their uncertainty. It asks nothing and prints nothing.

mod figures;
mod guide;
mod log;

#[cfg(test)]
mod tests;

pub use self::figures::{GyroScale, MotionProblem, Side, SpotTurn, StraightRoll, WheelTurn, usual_gyro_counts};
pub use self::guide::{DriveFigures, GuideEvent, GuideSettings, GuideStep, HandFigures, SetupGuide};
pub use self::log::{Motion, MotionLog, WheelUnit};
