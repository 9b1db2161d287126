//! What robots, ground stations and the station itself say; the newest line is the last.

use posebridge_dashboard::model::LogLine;
use posebridge_telemetry::severity::WARNING;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::panel::Panel;
use crate::station::tui::format::sanitize;
use crate::station::tui::model::Model;
use crate::station::tui::theme::{StyleRole, Theme};

/// See [`super`].
pub(super) const PANEL: Panel = Panel { title: "Events", lines: |model| model.log.len().max(1), draw };

fn draw(model: &Model, look: Theme, area: Rect, buffer: &mut Buffer) {
    let from = model.log.len().saturating_sub(usize::from(area.height));
    let lines = model.log.iter().skip(from).map(|line| line_of(line, look));
    let lines: Vec<Line<'static>> = lines.collect();
    Paragraph::new(lines).render(area, buffer);
}

fn line_of(line: &LogLine, look: Theme) -> Line<'static> {
    // Severities up to this one mean that something is wrong.
    let (mark, role) = if line.severity <= WARNING { ("! ", StyleRole::Bad) } else { ("  ", StyleRole::Truth) };
    Line::from(vec![
        Span::styled(format!("{:8.1} s ", line.t_s), look.style(StyleRole::Quiet)),
        Span::styled(mark, look.style(role)),
        Span::styled(sanitize(&line.text), look.style(role)),
    ])
}
