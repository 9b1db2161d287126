//! The panels: one file each and one table.
//!
//! A panel draws what a [`Model`] holds into a part of a buffer. It knows no terminal and no clock: the same model gives the same cells.

mod arena;
mod calibration;
mod events;
mod links;
mod pose;
mod sources;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use super::look::Look;
use super::model::Model;

/// A panel.
pub struct Panel {
    /// What stands above it.
    pub title: &'static str,
    /// So many lines it needs to show everything.
    pub lines: fn(&Model) -> usize,
    /// Draws it.
    pub draw: fn(&Model, Look, Rect, &mut Buffer),
}

/// Every panel, in the order in which Tab shows them. Adding one: a file here and a line in this table. The first has the large place
/// where all are shown together, the last the broad one below; the others stand between as far as there is room.
pub const PANELS: &[Panel] =
    &[arena::PANEL, pose::PANEL, sources::PANEL, links::PANEL, calibration::PANEL, events::PANEL];
