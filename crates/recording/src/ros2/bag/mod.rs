//! Bags of ROS 2 as foreign recordings: which topics there are, and the messages of each as the rows of a table.
//!
//! [`BagSummary`] lists the topics of a bag, [`BagPlan`] chooses what becomes of each and writes a descriptor for
//! [`crate::dataset`], which reads the rows through [`TopicTable`]. The bag is read in pieces: a chunk of it is in memory.

mod incoming;
mod plan;
mod records;
mod summary;
mod table;

pub use plan::{BagPlan, BagPlanError, WheelGeometry};
pub use summary::{BagSummary, TopicSummary};
pub(crate) use table::DAMAGED;
pub use table::{BagTopic, TopicTable};

pub use records::BagError;

use super::cdr_reader;
use crate::container::fields;

/// Whether a file that begins with these bytes says that it is a bag of ROS 2: the profile in its header, the first record.
pub fn is_bag(beginning: &[u8]) -> bool {
    fields::profile(beginning) == Some("ros2")
}
