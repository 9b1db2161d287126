//! All robots in a list, with their state; the chosen one is marked.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::panel::Panel;
use crate::station::tui::format::{fixed, sanitize};
use crate::station::tui::model::{Model, Robot};
use crate::station::tui::theme::{StyleRole, Theme};

/// See [`super`]. One robot needs no list beside the other panels.
pub(super) const PANEL: Panel = Panel { title: "Robots", lines, draw };

/// Most robots with a line beside the other panels; the panel on the whole screen shows as many as fit.
const MAX_LINES: usize = 8;
/// A robot whose last estimate is older is silent; as on the page (web/model/silence.js).
const SILENT_FROM_S: f64 = 1.0;
/// The column of names, in characters.
const NAME_WIDTH: usize = 16;

fn lines(model: &Model) -> usize {
    match model.visible_robots().len() {
        0 | 1 => 0,
        count => count.min(MAX_LINES),
    }
}

fn draw(model: &Model, look: Theme, area: Rect, buffer: &mut Buffer) {
    let robots = model.visible_robots();
    let selected = model.selected_robot().map(|robot| robot.id.as_str());
    let index = robots.iter().position(|robot| Some(robot.id.as_str()) == selected).unwrap_or(0);
    let height = usize::from(area.height).max(1);
    // The chosen one is always among those that are shown.
    let first = (index + 1).saturating_sub(height);
    let rows = robots.iter().skip(first).take(height);
    let lines: Vec<Line<'static>> = rows.map(|robot| row(robot, model.now_s, selected, look)).collect();
    Paragraph::new(lines).render(area, buffer);
}

fn row(robot: &Robot, now_s: f64, selected: Option<&str>, look: Theme) -> Line<'static> {
    let is_selected = Some(robot.id.as_str()) == selected;
    let label: String = sanitize(robot.label()).chars().take(NAME_WIDTH).collect();
    let name = format!("{} {label:<NAME_WIDTH$} ", if is_selected { "▸" } else { " " });
    let role = if is_selected { StyleRole::Strong } else { StyleRole::Truth };
    let mut spans = vec![Span::styled(name, look.style(role))];
    let Some(latest) = robot.estimates.last() else {
        spans.push(Span::styled("no estimate yet", look.style(StyleRole::Quiet)));
        return Line::from(spans);
    };
    let silence_s = now_s - latest.t_s;
    if silence_s >= SILENT_FROM_S {
        spans.push(Span::styled(format!("silent for {silence_s:.0} s"), look.style(StyleRole::Bad)));
        return Line::from(spans);
    }
    spans.push(Span::styled("live ", look.style(StyleRole::Good)));
    let fix = match latest.fix_age_s.get() {
        Some(age_s) => format!("fix {age_s:.1} s ago"),
        None => "no fix".to_owned(),
    };
    spans.push(Span::raw(format!("± {} m  {fix}", fixed(latest.major_m, 3))));
    Line::from(spans)
}
