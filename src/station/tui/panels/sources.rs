//! What each sensor contributes: how often it came, how often it was refused, and whether its innovations fit the claims.

use posebridge_report::Consistency;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::Text;
use ratatui::widgets::{Cell, Row, Table, Widget};

use super::panel::Panel;
use crate::station::tui::format::sanitize;
use crate::station::tui::model::{Model, SourceModel};
use crate::station::tui::theme::{StyleRole, Theme};

/// See [`super`].
pub(super) const PANEL: Panel = Panel {
    title: "Sources and NIS",
    lines: |model| 1 + model.selected_robot().map_or(0, |robot| robot.sources.len()),
    draw,
};

/// Seen, gated, NIS, claims, last.
const WIDTHS: [u16; 5] = [5, 5, 4, 10, 8];
/// Blanks between the columns.
const GAPS: u16 = WIDTHS.len() as u16;
/// `landmarks`: in a terminal of 80 columns so long a name leaves the other columns whole.
const NAME_AT_LEAST: usize = 9;

fn draw(model: &Model, look: Theme, area: Rect, buffer: &mut Buffer) {
    let sources: Vec<_> = model.selected_robot().into_iter().flat_map(|robot| &robot.sources).collect();
    let longest = sources.iter().map(|(name, _)| name.chars().count()).max();
    let room = area.width.saturating_sub(WIDTHS.iter().sum::<u16>() + GAPS);
    let most = usize::from(room).max(NAME_AT_LEAST);
    let name_width = longest.unwrap_or(0).clamp(NAME_AT_LEAST, most);
    let rows = sources.into_iter().map(|(name, source)| row_of(truncate(name, name_width), source, look));
    let head = Row::new(["source", " seen", "gated", " NIS", "filter is", "last"]);
    let [seen, gated, nis, claims, _last] = WIDTHS.map(Constraint::Length);
    let name = Constraint::Length(name_width as u16);
    Table::new(rows, [name, seen, gated, nis, claims, Constraint::Min(0)])
        .header(head.style(look.style(StyleRole::Quiet)))
        .render(area, buffer);
}

/// A name in this number of columns, with a sign where it is cut.
fn truncate(name: &str, columns: usize) -> String {
    let name = sanitize(name);
    if name.chars().count() <= columns {
        return name;
    }
    name.chars().take(columns - 1).chain(['…']).collect()
}

fn row_of(name: String, source: &SourceModel, look: Theme) -> Row<'static> {
    let nis = source.nis.mean_per_degree();
    let nis = nis.map_or_else(|| "–".to_owned(), four_digits);
    let (claims, role) = consistency_label(source.nis.consistency());
    let right = |text: String| Cell::from(Text::from(text).right_aligned());
    let last_role = match source.last_verdict.as_str() {
        "accepted" | "unused" => StyleRole::Quiet,
        _ => StyleRole::Bad,
    };
    Row::new([
        Cell::from(name),
        right(source.count.to_string()),
        right(source.gated.to_string()),
        right(nis),
        Cell::from(claims).style(look.style(role)),
        Cell::from(source.last_verdict.clone()).style(look.style(last_role)),
    ])
}

/// A number of zero or more in four characters, as long as it has no more digits than that.
fn four_digits(number: f64) -> String {
    match number {
        ..9.995 => format!("{number:.2}"),
        ..99.95 => format!("{number:.1}"),
        _ => format!("{number:.0}"),
    }
}

/// What the filter is, going by one source: the words of docs/dashboard.md, which are short.
const fn consistency_label(verdict: Consistency) -> (&'static str, StyleRole) {
    match verdict {
        Consistency::OverConfident => ("too sure", StyleRole::Bad),
        Consistency::Consistent => ("honest", StyleRole::Good),
        Consistency::UnderConfident => ("too unsure", StyleRole::Late),
        Consistency::Undetermined => ("–", StyleRole::Quiet),
    }
}

#[cfg(test)]
mod tests {
    use super::{four_digits, truncate};

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
