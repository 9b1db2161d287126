//! How a robot moves: one file per model. None of them knows a sensor.

pub mod differential_drive;
pub mod lie;
pub mod planar_speed;
pub mod planar_speeds;
pub mod se2;
