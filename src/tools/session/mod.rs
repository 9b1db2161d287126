//! What a recorded session was, for `posebridge report`.

pub mod history;
pub mod json;
pub mod page;
pub mod summary;
pub mod timeline;
