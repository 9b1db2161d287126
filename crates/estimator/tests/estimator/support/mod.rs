//! What the tests share: the robot, its simulation, its observations, and what a filter makes of them.

pub(crate) mod alter;
pub(crate) mod any;
pub(crate) mod filters;
pub(crate) mod observe;
pub(crate) mod odd;
pub(crate) mod robot;
pub(crate) mod score;
pub(crate) mod simulation;
pub(crate) mod steady;
pub(crate) mod textbook;
