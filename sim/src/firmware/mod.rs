//! The brick: the program on the robot.
//!
//! It reads its own clock, encoder counts and inertial readings, the nominal geometry, and the station's messages, never the true
//! state. The [`Program`] drives, the same on every brick; [`BrickMessenger`] sends its MAVLink messages. Other protocols are
//! [personalities](crate::personality).

mod follower;
mod messages;
mod onboard_pose;
mod program;
mod speed_control;

pub(crate) use self::follower::Twist;
pub use self::messages::BRICK;
pub(crate) use self::messages::BrickMessenger;
pub(crate) use self::program::Program;
pub(crate) use self::speed_control::SpeedControl;
