//! The whole screen: a pure function from a model to the cells of a buffer.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Clear, Paragraph, Widget};

use super::keys::{KEYS, KeyBinding, UiAction};
use super::model::Model;
use super::panels::{PANELS, Panel};
use super::theme::{StyleRole, Theme, bytes, fixed, sanitize};

/// Below this size one panel is shown at a time, because lines would be cut.
const LEAST_FOR_ALL: (u16, u16) = (64, 16);
/// Width of the column of numbers, that of its widest table; the map has priority.
const NUMBERS_WIDTH: u16 = 52;
/// Divisor of the height for the events in the overview.
const EVENTS_SHARE: u16 = 4;
/// Border lines above and below.
const FRAME: u16 = 2;

pub fn render(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let [head, body, foot] =
        Layout::vertical([Constraint::Length(1), Constraint::Min(1), Constraint::Length(1)]).areas(area);
    head_line(model, theme).render(head, buffer);
    for (panel, panel_area) in panel_layout(model, area, body) {
        draw_panel(panel, model, theme, panel_area, buffer);
    }
    foot_line(model, theme).render(foot, buffer);
    if model.selection.has_help {
        help(theme, body, buffer);
    }
}

fn panel_layout(model: &Model, screen: Rect, body: Rect) -> Vec<(&'static Panel, Rect)> {
    let is_small = screen.width < LEAST_FOR_ALL.0 || screen.height < LEAST_FOR_ALL.1;
    let chosen = match (model.selection.panel, is_small) {
        (None, false) => return tiled_layout(model, body),
        // The pose says most where there is room for one only.
        (None, true) => 1,
        (Some(chosen), _) => chosen,
    };
    let panel = PANELS.get(chosen);
    panel.map(|panel| (panel, body)).into_iter().collect()
}

fn tiled_layout(model: &Model, body: Rect) -> Vec<(&'static Panel, Rect)> {
    let [map, numbers @ .., events] = PANELS else {
        return Vec::new();
    };
    let [upper, lower] =
        Layout::vertical([Constraint::Min(1), Constraint::Length((body.height / EVENTS_SHARE).max(1 + FRAME))])
            .areas(body);
    let width = NUMBERS_WIDTH.min(upper.width / 5 * 3);
    let [left, mut right] = Layout::horizontal([Constraint::Min(1), Constraint::Length(width)]).areas(upper);
    let mut panel_areas = vec![(map, left)];
    for (index, panel) in numbers.iter().enumerate() {
        let desired_height = u16::try_from((panel.lines)(model)).unwrap_or(u16::MAX);
        if desired_height == 0 {
            continue;
        }
        let is_last = index + 1 == numbers.len();
        let mut height = desired_height.saturating_add(FRAME).min(right.height);
        // What would be too small for the next one goes to this one.
        if is_last || right.height - height <= FRAME {
            height = right.height;
        }
        if height <= FRAME {
            break;
        }
        panel_areas.push((panel, Rect { height, ..right }));
        right = Rect { y: right.y + height, height: right.height - height, ..right };
    }
    panel_areas.push((events, lower));
    panel_areas
}

fn draw_panel(panel: &Panel, model: &Model, theme: Theme, outer: Rect, buffer: &mut Buffer) {
    // Where there are a few lines only, a frame would take them.
    if outer.height <= FRAME + 1 || outer.width <= FRAME {
        (panel.draw)(model, theme, outer, buffer);
        return;
    }
    let title = Span::styled(format!(" {} ", panel.title), theme.style(StyleRole::Strong));
    let block = Block::new().borders(Borders::ALL).border_style(theme.style(StyleRole::Quiet)).title(title);
    let inner = block.inner(outer);
    block.render(outer, buffer);
    (panel.draw)(model, theme, inner, buffer);
}

fn head_line(model: &Model, theme: Theme) -> Line<'static> {
    let mut line = vec![Span::styled("posebridge", theme.style(StyleRole::Strong))];
    let mut add = |text: String, role: StyleRole| {
        line.push(Span::raw("  "));
        line.push(Span::styled(text, theme.style(role)));
    };
    add(format!("{:.1} s", model.now_s), StyleRole::Truth);
    if let Some(known) = &model.simulator {
        add(format!("sim {}", sanitize(&known.scenario)), StyleRole::Quiet);
    }
    let shown = model.visible_robots();
    if let (Some(robot), 2..) = (model.selected_robot(), shown.len()) {
        add(format!("robot {} of {}", sanitize(robot.label()), shown.len()), StyleRole::Strong);
    }
    if let Some(errors) = model.selected_errors() {
        add(format!("estimate {} m off", fixed(errors.estimate_m, 3)), StyleRole::Estimate);
    }
    match &model.recording {
        Some(recording) => {
            let name = sanitize(&recording.name);
            add(format!("recording {name} {}", bytes(recording.bytes)), StyleRole::Quiet);
        }
        None => add("not recording".to_owned(), StyleRole::Quiet),
    }
    if model.missed > 0 {
        add(format!("{} messages missed: the terminal is slow", model.missed), StyleRole::Bad);
    }
    Line::from(line)
}

fn foot_line(model: &Model, theme: Theme) -> Line<'static> {
    let mut line = Vec::new();
    if let Some(typed) = &model.selection.typed_pose {
        let role = theme.style(StyleRole::Strong);
        line.push(Span::styled(format!("pose (x m, y m, heading °): {typed}_  "), role));
    } else if let Some(notice) = model.notice() {
        line.push(Span::styled(format!("{notice}  "), theme.style(StyleRole::Late)));
    }
    for key in keys_for(model).filter(|key| !key.label.is_empty()) {
        line.push(Span::styled(key.name, theme.style(StyleRole::Strong)));
        line.push(Span::styled(format!(" {}  ", key.label), theme.style(StyleRole::Quiet)));
    }
    Line::from(line)
}

/// The active keys: those for the simulated brick only if there is one.
fn keys_for(model: &Model) -> impl Iterator<Item = &'static KeyBinding> + use<> {
    let has_brick = model.simulator.is_some();
    KEYS.iter().filter(move |key| has_brick || !matches!(key.action, UiAction::Do(_)))
}

fn help(theme: Theme, body: Rect, buffer: &mut Buffer) {
    let lines: Vec<Line<'static>> = KEYS
        .iter()
        .map(|key| {
            let name = Span::styled(format!("{:12}", key.name), theme.style(StyleRole::Strong));
            Line::from(vec![name, Span::raw(key.help)])
        })
        .collect();
    let height = body.height.min(lines.len() as u16 + FRAME);
    let overlay = Rect { height, ..body };
    Clear.render(overlay, buffer);
    let block = Block::new().borders(Borders::ALL).title(" Keys ");
    Paragraph::new(lines).block(block).render(overlay, buffer);
}
