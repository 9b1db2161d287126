//! What the filter has learned about the robot.

use posebridge_dashboard::model::CalibrationRow;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::Text;
use ratatui::widgets::{Cell, Row, Table, Widget};

use super::panel::Panel;
use crate::station::tui::model::Model;
use crate::station::tui::theme::{StyleRole, Theme};

/// See [`super`].
pub(super) const PANEL: Panel =
    Panel { title: "Biases and calibration", lines: |model| learned(model).count().max(1), draw };

/// Value, sigma, name.
const WIDTHS: [Constraint; 3] = [Constraint::Length(9), Constraint::Length(10), Constraint::Min(0)];

/// Numbers with a sigma: the others are taken as given.
fn learned(model: &Model) -> impl Iterator<Item = &CalibrationRow> {
    let robot = model.selected_robot().into_iter();
    let rows = robot.flat_map(|robot| &robot.calibration);
    rows.filter(|row| row.sigma > 0.0)
}

fn draw(model: &Model, look: Theme, area: Rect, buffer: &mut Buffer) {
    let rows: Vec<Row<'static>> = learned(model).map(|row| row_of(row, look)).collect();
    if rows.is_empty() {
        Text::styled("nothing learned yet", look.style(StyleRole::Quiet)).render(area, buffer);
        return;
    }
    Table::new(rows, WIDTHS).render(area, buffer);
}

fn row_of(row: &CalibrationRow, look: Theme) -> Row<'static> {
    Row::new([
        Cell::from(Text::from(format!("{:+.5}", row.value)).right_aligned()),
        Cell::from(format!("± {:.5}", row.sigma)),
        Cell::from(row.name.clone()).style(look.style(StyleRole::Quiet)),
    ])
}
