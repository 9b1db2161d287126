//! The panels: one file each and one table.
//!
//! A panel draws what a [`super::model::Model`] holds into a part of a buffer. It knows no terminal and no clock: the same model gives the same cells.

mod arena;
mod calibration;
mod events;
mod links;
mod panel;
mod pose;
mod robots;
mod sources;

pub use panel::Panel;

/// Every panel, in the order in which Tab shows them. Adding one: a file here and a line in this table. The first has the large place
/// where all are shown together, the last the broad one below; the others stand between as far as there is room.
pub const PANELS: &[Panel] =
    &[arena::PANEL, pose::PANEL, robots::PANEL, sources::PANEL, links::PANEL, calibration::PANEL, events::PANEL];
