//! The panels and their table.
//!
//! A panel draws a [`Model`] into a part of a buffer. It has no terminal and no clock: the same model gives the same cells.

use posebridge_dashboard::model::{CalibrationRow, ClockRow, EstimatePoint, LinkRow, LogLine, Number, QuantityPoint};
use posebridge_telemetry::QuantitySteps;
use posebridge_telemetry::severity::WARNING;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::{Cell, Paragraph, Row, Table, Widget};

use super::model::{Model, Robot, SourceModel};
use super::theme::{StyleRole, Theme, degrees, fixed, sanitize, signed};
use super::{arena, fleet_panel};

pub struct Panel {
    pub title: &'static str,
    pub lines: fn(&Model) -> usize,
    pub draw: fn(&Model, Theme, Rect, &mut Buffer),
}

/// In the order of the Tab key. Adding one: a function here and a row in this table. In the overview the first panel has the large
/// area, the last the wide one at the bottom; the others are between as far as they fit.
pub const PANELS: &[Panel] = &[
    Panel { title: "Arena", lines: |_| usize::from(u16::MAX), draw: arena::draw },
    Panel { title: "Pose", lines: |_| 4, draw: draw_pose },
    Panel { title: "Set-up", lines: |model| model.setup_rows().len(), draw: draw_setup },
    Panel { title: "Robots", lines: robot_lines, draw: draw_robots },
    Panel { title: "Fleet", lines: fleet_panel::lines, draw: fleet_panel::draw },
    Panel {
        title: "Sources and NIS",
        lines: |model| 1 + model.selected_robot().map_or(0, |robot| robot.sources.len()),
        draw: draw_sources,
    },
    Panel { title: "Filters compared", lines: comparison_lines, draw: draw_comparison },
    Panel { title: "Links and clock", lines: |model| 1 + 2 * model.links.len(), draw: draw_links },
    Panel { title: "Biases and calibration", lines: |model| learned(model).count().max(1), draw: draw_calibration },
    Panel { title: "Events", lines: |model| model.log.len().max(1), draw: draw_events },
];

fn draw_pose(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let robot = model.selected_robot();
    let mut lines = vec![error_line(model, theme)];
    match robot.map(|robot| (robot.estimates.last(), &robot.quantity, &robot.reading_verdict)) {
        Some((Some(estimate), _, _)) => lines.extend(pose_lines(estimate, theme)),
        Some((None, Some(quantity), verdict)) => lines.extend(quantity_lines(quantity, verdict)),
        Some((None, None, _)) | None => lines.push(Line::styled("no estimate yet", theme.style(StyleRole::Quiet))),
    }
    Paragraph::new(lines).render(area, buffer);
}

/// Errors of odometry and estimate; unknown for a real robot.
fn error_line(model: &Model, theme: Theme) -> Line<'static> {
    match model.selected_errors() {
        Some(errors) => Line::from(vec![
            Span::styled(format!("odometry {} m off", fixed(errors.odometry_m, 2)), theme.style(StyleRole::Odometry)),
            Span::raw(", "),
            Span::styled(format!("estimate {} m off", fixed(errors.estimate_m, 3)), theme.style(StyleRole::Estimate)),
        ]),
        None => Line::styled("no truth to compare with", theme.style(StyleRole::Quiet)),
    }
}

fn pose_lines(estimate: &EstimatePoint, theme: Theme) -> [Line<'static>; 3] {
    let quiet = |text: &'static str| Span::styled(text, theme.style(StyleRole::Quiet));
    let mut position = vec![
        quiet("x "),
        Span::raw(signed(estimate.x_m, 3)),
        quiet("  y "),
        Span::raw(signed(estimate.y_m, 3)),
        quiet(" m  95 % within "),
        Span::raw(format!("{} m", fixed(estimate.major_m, 3))),
    ];
    let heading = vec![
        quiet("heading "),
        Span::raw(if estimate.is_heading_known {
            format!("{} ± {}°", degrees(estimate.heading_rad, 1), degrees(estimate.heading_sigma_rad, 1))
        } else {
            "unknown".to_owned()
        }),
        quiet("  "),
        Span::raw(format!("{} m/s {}°/s", fixed(estimate.forward_m_per_s, 2), degrees(estimate.turn_rad_per_s, 0))),
    ];
    if estimate.is_relative {
        position.push(Span::styled("  from its start", theme.style(StyleRole::Bad)));
    }
    let fix = match (estimate.is_dead_reckoning, estimate.fix_age_s.get()) {
        (true, _) => Span::styled("dead reckoning", theme.style(StyleRole::Bad)),
        (false, None) => Span::styled("no fix yet", theme.style(StyleRole::Quiet)),
        (false, Some(age_s)) => Span::raw(format!("last fix {age_s:.1} s ago")),
    };
    let resets = Span::raw(format!("  resets {}", estimate.reset_counter));
    [Line::from(position), Line::from(heading), Line::from(vec![fix, resets])]
}

/// The estimate of a filter of one quantity.
fn quantity_lines(point: &QuantityPoint, verdict: &str) -> [Line<'static>; 2] {
    let unit = sanitize(&point.unit);
    let value = format!("{} ± {} {unit} (95 %)", fixed(point.estimate, 3), fixed(point.bound_95, 3));
    let rate = format!("  {} {unit}/s", signed(point.rate_per_s, 3));
    let steps = QuantitySteps::describe(&sanitize(verdict), point.steps, point.predicted);
    [Line::from(value + &rate), Line::from(steps)]
}

/// State, step, and what to do, or the figure where nothing is left to do.
fn draw_setup(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let lines = model.setup_rows().into_iter().map(|row| {
        let role = match row.state.as_str() {
            "ok" => StyleRole::Good,
            "problem" => StyleRole::Bad,
            "waiting" => StyleRole::Late,
            _ => StyleRole::Quiet,
        };
        let is_open = matches!(row.state.as_str(), "problem" | "waiting");
        let detail = if is_open { &row.advice } else { &row.figure };
        Line::from(vec![
            Span::styled(format!("{:<8} ", row.state), theme.style(role)),
            Span::raw(format!("{}: {}", row.step, sanitize(detail))),
        ])
    });
    Paragraph::new(lines.collect::<Vec<_>>()).render(area, buffer);
}

/// Robots listed in the overview; the full-screen panel shows as many as fit.
const MAX_LINES: usize = 8;
/// Age of the last estimate from which a robot counts as silent, as on the page (web/model/silence.js).
const SILENT_FROM_S: f64 = 1.0;
const NAME_WIDTH: usize = 16;

fn robot_lines(model: &Model) -> usize {
    match model.visible_robots().len() {
        0 | 1 => 0,
        count => count.min(MAX_LINES),
    }
}

fn draw_robots(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let robots = model.visible_robots();
    let selected = model.selected_robot().map(|robot| robot.id.as_str());
    let index = robots.iter().position(|robot| Some(robot.id.as_str()) == selected).unwrap_or(0);
    let height = usize::from(area.height).max(1);
    // The chosen one is always among those that are shown.
    let first = (index + 1).saturating_sub(height);
    let rows = robots.iter().skip(first).take(height);
    let lines: Vec<Line<'static>> = rows.map(|robot| robot_row(robot, model.now_s, selected, theme)).collect();
    Paragraph::new(lines).render(area, buffer);
}

fn robot_row(robot: &Robot, now_s: f64, selected: Option<&str>, theme: Theme) -> Line<'static> {
    let is_selected = Some(robot.id.as_str()) == selected;
    let label: String = sanitize(robot.label()).chars().take(NAME_WIDTH).collect();
    let name = format!("{} {label:<NAME_WIDTH$} ", if is_selected { "▸" } else { " " });
    let role = if is_selected { StyleRole::Strong } else { StyleRole::Truth };
    let mut spans = vec![Span::styled(name, theme.style(role))];
    let latest = robot.estimates.last();
    let Some(last_s) = latest.map(|latest| latest.t_s).or(robot.quantity.as_ref().map(|point| point.t_s)) else {
        spans.push(Span::styled("no estimate yet", theme.style(StyleRole::Quiet)));
        return Line::from(spans);
    };
    let silence_s = now_s - last_s;
    if silence_s >= SILENT_FROM_S {
        spans.push(Span::styled(format!("silent for {silence_s:.0} s"), theme.style(StyleRole::Bad)));
        return Line::from(spans);
    }
    spans.push(Span::styled("live ", theme.style(StyleRole::Good)));
    let Some(latest) = latest else {
        return Line::from(spans);
    };
    let fix = match latest.fix_age_s.get() {
        Some(age_s) => format!("fix {age_s:.1} s ago"),
        None => "no fix".to_owned(),
    };
    spans.push(Span::raw(format!("± {} m  {fix}", fixed(latest.major_m, 3))));
    Line::from(spans)
}

/// Seen, gated, NIS, consistency, last.
const SOURCE_WIDTHS: [u16; 5] = [5, 5, 4, 15, 8];
const GAPS: u16 = SOURCE_WIDTHS.len() as u16;
/// `landmarks`: this width leaves the other columns complete in a terminal of 80 columns.
const NAME_AT_LEAST: usize = 9;

fn draw_sources(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let sources: Vec<_> = model.selected_robot().into_iter().flat_map(|robot| &robot.sources).collect();
    let longest = sources.iter().map(|(name, _)| name.chars().count()).max();
    let remaining = area.width.saturating_sub(SOURCE_WIDTHS.iter().sum::<u16>() + GAPS);
    let most = usize::from(remaining).max(NAME_AT_LEAST);
    let name_width = longest.unwrap_or(0).clamp(NAME_AT_LEAST, most);
    let rows = sources.into_iter().map(|(name, source)| source_row(truncate(name, name_width), source, theme));
    let head = Row::new(["source", " seen", "gated", " NIS", "verdict", "last"]);
    let [observed, gated, nis, claims, _last] = SOURCE_WIDTHS.map(Constraint::Length);
    let name = Constraint::Length(name_width as u16);
    Table::new(rows, [name, observed, gated, nis, claims, Constraint::Min(0)])
        .header(head.style(theme.style(StyleRole::Quiet)))
        .render(area, buffer);
}

/// Cuts a name to `columns`, with a mark.
fn truncate(name: &str, columns: usize) -> String {
    let name = sanitize(name);
    if name.chars().count() <= columns {
        return name;
    }
    name.chars().take(columns - 1).chain(['…']).collect()
}

fn source_row(name: String, source: &SourceModel, theme: Theme) -> Row<'static> {
    let nis = source.nis.map_or_else(|| "–".to_owned(), four_digits);
    let role = match source.consistency.as_ref() {
        "consistent" => StyleRole::Good,
        "over-confident" => StyleRole::Bad,
        "under-confident" => StyleRole::Late,
        _ => StyleRole::Quiet,
    };
    let right = |text: String| Cell::from(Text::from(text).right_aligned());
    let last_role = match source.last_verdict.as_ref() {
        "accepted" | "unused" => StyleRole::Quiet,
        _ => StyleRole::Bad,
    };
    Row::new([
        Cell::from(name),
        right(source.count.to_string()),
        right(source.gated.to_string()),
        right(nis),
        Cell::from(source.consistency.clone()).style(theme.style(role)),
        Cell::from(source.last_verdict.clone()).style(theme.style(last_role)),
    ])
}

/// A non-negative number in four characters, if it has no more digits.
fn four_digits(number: f64) -> String {
    match number {
        ..9.995 => format!("{number:.2}"),
        ..99.95 => format!("{number:.1}"),
        _ => format!("{number:.0}"),
    }
}

fn comparison_lines(model: &Model) -> usize {
    model.selected_robot().map_or(0, |robot| match robot.comparison.len() {
        0 => 0,
        filters => 1 + filters,
    })
}

/// Error, its rms, NIS, gated.
const FILTER_WIDTHS: [u16; 4] = [9, 9, 5, 5];

fn draw_comparison(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let rows = model.selected_robot().into_iter().flat_map(|robot| &robot.comparison);
    let right = |text: String| Cell::from(Text::from(text).right_aligned());
    let rows = rows.map(|row| {
        let name = if row.filter.is_empty() { "sent".to_owned() } else { sanitize(&row.filter) };
        let nis = row.nis.get().map_or_else(|| "–".to_owned(), four_digits);
        let metres = |length_m: Number| format!("{} m", fixed(length_m, 3));
        Row::new([
            Cell::from(name),
            right(metres(row.error_m)),
            right(metres(row.error_rms_m)),
            right(nis),
            right(row.gated.to_string()),
        ])
    });
    let head = Row::new(["filter", "    error", "      rms", "  NIS", "gated"]);
    let [error, rms, nis, gated] = FILTER_WIDTHS.map(Constraint::Length);
    Table::new(rows, [Constraint::Min(0), error, rms, nis, gated])
        .header(head.style(theme.style(StyleRole::Quiet)))
        .render(area, buffer);
}

fn draw_links(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let mut lines = vec![clock_line(model.clock.as_ref(), theme)];
    lines.extend(model.links.iter().flat_map(|link| link_lines(link, theme)));
    Paragraph::new(lines).render(area, buffer);
}

fn clock_line(clock: Option<&ClockRow>, theme: Theme) -> Line<'static> {
    let Some(clock) = clock else {
        return Line::styled("clock not aligned", theme.style(StyleRole::Bad));
    };
    Line::from(format!(
        "clock {:+.3} s {} ppm ± {} ms, {}",
        clock.offset_s,
        signed(clock.skew_ppm, 0),
        fixed(clock.uncertainty_ms, 2),
        clock.method
    ))
}

fn link_lines(link: &LinkRow, theme: Theme) -> [Line<'static>; 2] {
    let role = if link.state == "up" { StyleRole::Good } else { StyleRole::Bad };
    let state = Span::styled(link.state.to_uppercase(), theme.style(role));
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
        theme.style(StyleRole::Quiet),
    );
    [head, counts]
}

/// Value, sigma, name.
const CALIBRATION_WIDTHS: [Constraint; 3] = [Constraint::Length(9), Constraint::Length(10), Constraint::Min(0)];

/// Estimated constants; those without a sigma are fixed.
fn learned(model: &Model) -> impl Iterator<Item = &CalibrationRow> {
    let robot = model.selected_robot().into_iter();
    let rows = robot.flat_map(|robot| &robot.calibration);
    rows.filter(|row| row.sigma > 0.0)
}

fn draw_calibration(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let rows: Vec<Row<'static>> = learned(model).map(|row| calibration_row(row, theme)).collect();
    if rows.is_empty() {
        Text::styled("nothing learned yet", theme.style(StyleRole::Quiet)).render(area, buffer);
        return;
    }
    Table::new(rows, CALIBRATION_WIDTHS).render(area, buffer);
}

fn calibration_row(row: &CalibrationRow, theme: Theme) -> Row<'static> {
    Row::new([
        Cell::from(Text::from(format!("{:+.5}", row.value)).right_aligned()),
        Cell::from(format!("± {:.5}", row.sigma)),
        Cell::from(row.name.clone()).style(theme.style(StyleRole::Quiet)),
    ])
}

fn draw_events(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let from = model.log.len().saturating_sub(usize::from(area.height));
    let lines = model.log.iter().skip(from).map(|line| event_line(line, theme));
    let lines: Vec<Line<'static>> = lines.collect();
    Paragraph::new(lines).render(area, buffer);
}

fn event_line(line: &LogLine, theme: Theme) -> Line<'static> {
    // Severities up to this one mean that something is wrong.
    let (mark, role) = if line.severity <= WARNING { ("! ", StyleRole::Bad) } else { ("  ", StyleRole::Truth) };
    Line::from(vec![
        Span::styled(format!("{:8.1} s ", line.t_s), theme.style(StyleRole::Quiet)),
        Span::styled(mark, theme.style(role)),
        Span::styled(sanitize(&line.text), theme.style(role)),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_whole_or_says_that_it_is_cut() {
        assert_eq!(truncate("landmarks", 9), "landmarks");
        assert_eq!(truncate("accelerometer", 9), "accelero…");
        assert_eq!(truncate("accelerometer", 13), "accelerometer");
    }

    #[test]
    fn a_number_takes_four_characters() {
        let texts = [0.0, 1.006, 9.994, 9.996, 99.94, 99.96, 9_999.0].map(four_digits);
        assert_eq!(texts, ["0.00", "1.01", "9.99", "10.0", "99.9", "100", "9999"]);
    }
}
