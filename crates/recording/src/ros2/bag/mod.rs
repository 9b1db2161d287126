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

use mcap::MAGIC;

use super::cdr_reader;
use crate::container::fields;

/// Opcode and length before the content of a record.
const RECORD_HEADER_BYTES: usize = 9;

/// Whether a file that begins with these bytes says that it is a bag of ROS 2: the profile in its header, behind the magic.
pub fn is_bag(beginning: &[u8]) -> bool {
    let header = beginning.strip_prefix(MAGIC).and_then(|records| records.get(RECORD_HEADER_BYTES..));
    header.and_then(fields::profile) == Some("ros2")
}
