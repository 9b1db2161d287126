//! ROS 2 bags without ROS: the station's outputs as standard messages in an MCAP file that `ros2 bag`, Foxglove and rosbags read.
//!
//! [`RosBagWriter`] takes the station's events. Pure: the caller opens files and gives times.
//!
//! # Model
//! ```text
//! /NAME/odom      nav_msgs/msg/Odometry                     each estimate, in `map`; in `NAME/odom` while it is relative
//! /NAME/pose      geometry_msgs/msg/PoseWithCovarianceStamped   the same, once it is in `map`
//! /NAME/imu       sensor_msgs/msg/Imu                       turn rates of gyros, as they came
//! /tf             tf2_msgs/msg/TFMessage                    map -> NAME/odom -> NAME/base_link
//! /diagnostics    diagnostic_msgs/msg/DiagnosticArray       links once per second, robots and texts as they come
//! log time        UTC of the arrival
//! header stamp    UTC = start of the session + t_host, t_host by the last alignment of the robot's clock
//! ```
//! `map` is the arena: x east, y north. A robot without a name has no part NAME.
//!
//! # Sources
//! REP 103 and REP 105 for axes and frames; the MCAP profile `ros2`; rosbag2's storage plugin for the metadata of channels.

pub mod bag;
mod cdr;
mod cdr_reader;
mod definitions;
mod encoder;
mod frames;
mod messages;
mod metadata;
mod names;
mod requests;
mod writer;

pub use cdr_reader::CdrError;
pub use definitions::MessageType;
pub use encoder::{RosEncoder, RosMessage};
pub use requests::{REQUEST_TOPICS, RosRequest, RosRequestError, RosRequestType};
pub use writer::{RosBagError, RosBagWriter};

/// Ends the name of a bag beside the recording that it was made of or with.
pub const BAG_SUFFIX: &str = "-ros2.mcap";
