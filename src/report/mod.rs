//! What people see of a run: the live status block, the table and the pictures at the end.

pub mod json;
pub mod links;
pub mod live;
pub mod run;
