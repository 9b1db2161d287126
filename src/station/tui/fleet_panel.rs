//! The panel of the fleet: its stations in a line, its robots as a table.

use posebridge_dashboard::model::{FleetEstimateRow, FleetRobotRow, FleetState, FleetStationRow};
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::{Line, Text};
use ratatui::widgets::{Cell, Row, Table, Widget};

use super::model::Model;
use super::theme::{StyleRole, Theme, degrees, fixed, sanitize};

/// The line of stations and the head of the table.
const HEAD_LINES: usize = 2;
/// Robots in the overview; the full-screen panel shows as many as fit.
const MAX_ROBOTS: usize = 8;
/// Name, owner, age, lost.
const WIDTHS: [u16; 4] = [10, 8, 6, 4];
/// Age of an estimate from which its robot counts as silent, as in the list of robots.
const SILENT_FROM_S: f64 = 1.0;

/// None for a station that is in no fleet.
pub(super) fn lines(model: &Model) -> usize {
    model.fleet().map_or(0, |fleet| HEAD_LINES + fleet.robots.len().min(MAX_ROBOTS))
}

pub(super) fn draw(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    let Some(fleet) = model.fleet() else {
        Text::styled("this station is in no fleet: run --fleet NAME", theme.style(StyleRole::Quiet))
            .render(area, buffer);
        return;
    };
    stations_line(fleet).render(Rect { height: area.height.min(1), ..area }, buffer);
    let below = Rect { y: area.y.saturating_add(1), height: area.height.saturating_sub(1), ..area };
    let [name, owner, age, lost] = WIDTHS.map(Constraint::Length);
    let head = Row::new(["robot", "owner", "   age", "lost", "x y m, heading"]);
    Table::new(fleet.robots.iter().map(|robot| robot_row(robot, theme)), [name, owner, age, lost, Constraint::Min(0)])
        .header(head.style(theme.style(StyleRole::Quiet)))
        .render(below, buffer);
}

/// Each station with how well its clock is known.
fn stations_line(fleet: &FleetState) -> Line<'static> {
    let station = |station: &FleetStationRow| {
        let name = sanitize(&station.name);
        match (station.is_this, station.clock_uncertainty_s) {
            (true, _) => format!("{name} (this)"),
            (false, Some(uncertainty_s)) => format!("{name} ± {:.1} ms", 1e3 * uncertainty_s),
            (false, None) => format!("{name} ± ?"),
        }
    };
    let stations: Vec<String> = fleet.stations.iter().map(station).collect();
    Line::from(format!("{}: {}", sanitize(&fleet.name), stations.join(", ")))
}

fn robot_row(robot: &FleetRobotRow, theme: Theme) -> Row<'static> {
    let right = |text: String| Cell::from(Text::from(text).right_aligned());
    let owner = robot.owner.as_ref();
    let (owner_text, owner_role) = match owner {
        Some(owner) if owner.is_this => ("this".to_owned(), StyleRole::Good),
        Some(owner) => (sanitize(&owner.name), StyleRole::Truth),
        None => ("nobody".to_owned(), StyleRole::Bad),
    };
    let estimate = robot.estimate.as_ref();
    let age = estimate.map_or_else(|| "–".to_owned(), age);
    let is_silent = estimate.is_none_or(|estimate| estimate.age_s >= SILENT_FROM_S);
    let age_role = if is_silent { StyleRole::Bad } else { StyleRole::Good };
    Row::new([
        Cell::from(sanitize(&robot.name)),
        Cell::from(owner_text).style(theme.style(owner_role)),
        right(age).style(theme.style(age_role)),
        right((robot.lost + robot.stale).to_string()),
        Cell::from(pose(estimate)),
    ])
}

fn age(estimate: &FleetEstimateRow) -> String {
    if estimate.age_s < SILENT_FROM_S {
        format!("{:.0} ms", 1e3 * estimate.age_s)
    } else {
        format!("{:.0} s", estimate.age_s)
    }
}

fn pose(estimate: Option<&FleetEstimateRow>) -> String {
    match estimate {
        None => "no estimate".to_owned(),
        Some(estimate) if !estimate.is_position_valid => "from its start".to_owned(),
        Some(estimate) => {
            let heading = if estimate.is_heading_valid { degrees(estimate.heading_rad, 0) } else { "–".to_owned() };
            format!("{} {} {heading}°", fixed(estimate.x_m, 2), fixed(estimate.y_m, 2))
        }
    }
}
