//! What a filter expects a sensor to say: one file per kind of observation, each with h(x), H and R.

pub mod fix;
pub mod gyro_window;
pub mod speed;
