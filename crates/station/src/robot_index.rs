//! How the parts of a station name its robots to each other.

/// Which robot of the [`RobotTable`](crate::robot_table::RobotTable).
pub(crate) type RobotIndex = usize;
