//! How a robot moves, and what a sensor or a motor does over time: one file per model. None of them knows a filter.

pub mod differential_drive;
pub mod dynamic_measurement;
pub mod lie;
pub mod planar_speeds;
pub mod se2;
pub mod slow_sensor;
pub mod wall_approach;
