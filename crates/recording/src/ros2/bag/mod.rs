//! Bags of ROS 2 as foreign recordings: which topics there are, and the messages of each as the rows of a table.
//!
//! [`BagSummary`] lists the topics of a bag, [`BagPlan`] chooses what becomes of each and writes a descriptor for
//! [`crate::dataset`], which reads the rows through [`TopicTable`]. The bag is read in pieces: a chunk of it is in memory.

mod bag_reader;
mod sensor_messages;
mod summary;
mod topic_choice;
mod topic_table;

pub use bag_reader::BagError;
pub use summary::{BagSummary, TopicSummary};
pub use topic_choice::{BagPlan, BagPlanError, WheelGeometry};
pub(crate) use topic_table::DAMAGED;
pub use topic_table::{BagTopic, TopicTable};

use crate::container::fields;

/// Whether a file that begins with these bytes says that it is a bag of ROS 2: the profile in its header, the first record.
pub fn is_bag(beginning: &[u8]) -> bool {
    fields::profile(beginning) == Some("ros2")
}
