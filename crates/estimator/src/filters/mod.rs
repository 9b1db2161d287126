//! The filters that a station runs: the pose filter, dead reckoning, and the thermometers of a robot.

pub mod dynamic;
pub mod odometry;
pub mod pose;
pub mod thermometer;
