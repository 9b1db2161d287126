//! What each sensor contributes: how often it came, how often it was refused, and whether its innovations fit the claims.

use posebridge_analysis::Consistency;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::Text;
use ratatui::widgets::{Cell, Row, Table, Widget};

use super::Panel;
use crate::tui::look::{Look, Role};
use crate::tui::model::{Model, Source};
use crate::tui::words::harmless;

/// See [`super`].
pub(super) const PANEL: Panel = Panel {
    title: "Sources and NIS",
    lines: |model| 1 + model.robot_shown().map_or(0, |robot| robot.sources.len()),
    draw,
};

/// Name, seen, gated, NIS, claims, last: in a terminal of 80 columns `accepted` is still whole.
const WIDTHS: [Constraint; 6] = [
    Constraint::Length(9),
    Constraint::Length(5),
    Constraint::Length(5),
    Constraint::Length(4),
    Constraint::Length(10),
    Constraint::Min(0),
];

fn draw(model: &Model, look: Look, area: Rect, buffer: &mut Buffer) {
    let robot = model.robot_shown();
    let rows = robot.into_iter().flat_map(|robot| &robot.sources);
    let rows = rows.map(|(name, source)| row_of(name, source, look));
    let head = Row::new(["source", " seen", "gated", " NIS", "filter is", "last"]);
    Table::new(rows, WIDTHS)
        .header(head.style(look.style(Role::Quiet)))
        .render(area, buffer);
}

fn row_of(name: &str, source: &Source, look: Look) -> Row<'static> {
    let nis = source.nis.mean_per_degree();
    let nis = nis.map_or_else(|| "–".to_owned(), in_four);
    let (claims, role) = in_words(source.nis.verdict());
    let right = |text: String| Cell::from(Text::from(text).right_aligned());
    let last_role = match source.last_verdict.as_str() {
        "accepted" | "unused" => Role::Quiet,
        _ => Role::Bad,
    };
    Row::new([
        Cell::from(harmless(name)),
        right(source.seen.to_string()),
        right(source.gated.to_string()),
        right(nis),
        Cell::from(claims).style(look.style(role)),
        Cell::from(source.last_verdict.clone()).style(look.style(last_role)),
    ])
}

/// A number of zero or more in four characters, as long as it has no more digits than that.
fn in_four(number: f64) -> String {
    match number {
        ..9.995 => format!("{number:.2}"),
        ..99.95 => format!("{number:.1}"),
        _ => format!("{number:.0}"),
    }
}

/// What the filter is, going by one source: the words of docs/page.md, which are short.
const fn in_words(verdict: Consistency) -> (&'static str, Role) {
    match verdict {
        Consistency::OverConfident => ("too sure", Role::Bad),
        Consistency::Consistent => ("honest", Role::Good),
        Consistency::UnderConfident => ("too unsure", Role::Late),
        Consistency::Undetermined => ("–", Role::Quiet),
    }
}

#[cfg(test)]
mod tests {
    use super::in_four;

    #[test]
    fn a_number_takes_four_characters() {
        let texts = [0.0, 1.006, 9.994, 9.996, 99.94, 99.96, 9_999.0].map(in_four);
        assert_eq!(
            texts,
            ["0.00", "1.01", "9.99", "10.0", "99.9", "100", "9999"]
        );
    }
}
