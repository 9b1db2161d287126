//! What people see of a run: the live status block, the table and the pictures at the end.

pub mod chronicle;
pub mod happenings;
pub mod json;
pub mod links;
pub mod live;
pub mod off;
pub mod run;
pub mod session_json;
pub mod session_page;
pub mod story;
