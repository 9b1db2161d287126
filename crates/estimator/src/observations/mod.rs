//! Observation models: one file per kind of observation, each with h(x), H and R.

pub mod accelerometer;
pub mod beacon;
pub mod compass;
pub mod fix;
pub mod gyro_window;
pub mod landmark;
pub mod model;
pub mod speed;
pub mod wall;
