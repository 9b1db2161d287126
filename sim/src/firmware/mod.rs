//! The brick: what runs on the robot itself.
//!
//! It has its own clock, its encoder counts and inertial readings, the nominal geometry, and whatever the station sends. The
//! [`Program`] drives, the same on every brick; [`Talk`] is what it says where it speaks MAVLink. Other ways of speaking are
//! [personalities](crate::personality). Nothing here sees the world.

mod belief;
mod compact;
mod follower;
mod odometry;
mod program;
mod schedule;
mod speed_control;
mod talk;

pub(crate) use self::follower::Twist;
pub(crate) use self::program::Program;
pub(crate) use self::speed_control::SpeedControl;
pub use self::talk::BRICK;
pub(crate) use self::talk::Talk;
