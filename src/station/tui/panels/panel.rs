//! What a panel is.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use crate::station::tui::model::Model;
use crate::station::tui::theme::Theme;

/// A panel.
pub struct Panel {
    /// What stands above it.
    pub title: &'static str,
    /// The number of lines that it needs to show everything.
    pub lines: fn(&Model) -> usize,
    /// Draws it.
    pub draw: fn(&Model, Theme, Rect, &mut Buffer),
}
