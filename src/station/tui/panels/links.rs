//! How well each link does, and how well the robot's clock is known.

use posebridge_dashboard::model::{ClockRow, LinkRow};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::panel::Panel;
use crate::station::tui::format::{fixed, sanitize, signed};
use crate::station::tui::model::Model;
use crate::station::tui::theme::{StyleRole, Theme};

/// See [`super`].
pub(super) const PANEL: Panel = Panel { title: "Links and clock", lines: |model| 1 + 2 * model.links.len(), draw };

fn draw(model: &Model, look: Theme, area: Rect, buffer: &mut Buffer) {
    let mut lines = vec![clock_line(model.clock.as_ref(), look)];
    lines.extend(model.links.iter().flat_map(|link| link_lines(link, look)));
    Paragraph::new(lines).render(area, buffer);
}

fn clock_line(clock: Option<&ClockRow>, look: Theme) -> Line<'static> {
    let Some(clock) = clock else {
        return Line::styled("clock not aligned", look.style(StyleRole::Bad));
    };
    Line::from(format!(
        "clock {:+.3} s {} ppm ± {} ms, {}",
        clock.offset_s,
        signed(clock.skew_ppm, 0),
        fixed(clock.uncertainty_ms, 2),
        clock.method
    ))
}

fn link_lines(link: &LinkRow, look: Theme) -> [Line<'static>; 2] {
    let role = if link.state == "up" { StyleRole::Good } else { StyleRole::Bad };
    let state = Span::styled(link.state.to_uppercase(), look.style(role));
    let head = Line::from(vec![
        Span::raw(format!("{} ", link.id)),
        state,
        Span::raw(format!(
            " {} B/s {} frames/s  {}",
            fixed(link.bytes_in_per_s, 0),
            fixed(link.frames_in_per_s, 0),
            sanitize(&link.name)
        )),
    ]);
    let counts = Line::styled(
        format!(
            "  lost {} damaged {} unsent {}  round trip {} ms",
            link.lost,
            link.checksum_errors,
            link.drops_out,
            fixed(link.round_trip_ms, 1)
        ),
        look.style(StyleRole::Quiet),
    );
    [head, counts]
}
