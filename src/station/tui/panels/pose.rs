//! The estimate in numbers, with what it claims and how far off it really is.

use posebridge_dashboard::model::EstimatePoint;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::panel::Panel;
use crate::station::tui::format::{degrees, fixed, signed};
use crate::station::tui::model::Model;
use crate::station::tui::theme::{StyleRole, Theme};

/// See [`super`].
pub(super) const PANEL: Panel = Panel { title: "Pose", lines: |_| 4, draw };

fn draw(model: &Model, look: Theme, area: Rect, buffer: &mut Buffer) {
    let latest = model.selected_robot().and_then(|robot| robot.estimates.last());
    let mut lines = vec![error_line(model, look)];
    match latest {
        Some(estimate) => lines.extend(lines_of(estimate, look)),
        None => lines.push(Line::styled("no estimate yet", look.style(StyleRole::Quiet))),
    }
    Paragraph::new(lines).render(area, buffer);
}

/// How far odometry and estimate are from the truth; that of a real robot is unknown.
fn error_line(model: &Model, look: Theme) -> Line<'static> {
    match model.selected_errors() {
        Some(errors) => Line::from(vec![
            Span::styled(format!("odometry {} m off", fixed(errors.odometry_m, 2)), look.style(StyleRole::Odometry)),
            Span::raw(", "),
            Span::styled(format!("estimate {} m off", fixed(errors.estimate_m, 3)), look.style(StyleRole::Estimate)),
        ]),
        None => Line::styled("no truth to compare with", look.style(StyleRole::Quiet)),
    }
}

fn lines_of(estimate: &EstimatePoint, look: Theme) -> [Line<'static>; 3] {
    let quiet = |text: &'static str| Span::styled(text, look.style(StyleRole::Quiet));
    let place = vec![
        quiet("x "),
        Span::raw(signed(estimate.x_m, 3)),
        quiet("  y "),
        Span::raw(signed(estimate.y_m, 3)),
        quiet(" m  95 % within "),
        Span::raw(format!("{} m", fixed(estimate.major_m, 3))),
    ];
    let heading = vec![
        quiet("heading "),
        Span::raw(format!("{} ± {}°", degrees(estimate.heading_rad, 1), degrees(estimate.heading_sigma_rad, 1))),
        quiet("  "),
        Span::raw(format!("{} m/s {}°/s", fixed(estimate.forward_m_per_s, 2), degrees(estimate.turn_rad_per_s, 0))),
    ];
    let fix = match (estimate.is_dead_reckoning, estimate.fix_age_s.get()) {
        (true, _) => Span::styled("dead reckoning", look.style(StyleRole::Bad)),
        (false, None) => Span::styled("no fix yet", look.style(StyleRole::Quiet)),
        (false, Some(age_s)) => Span::raw(format!("last fix {age_s:.1} s ago")),
    };
    let resets = Span::raw(format!("  resets {}", estimate.reset_counter));
    [Line::from(place), Line::from(heading), Line::from(vec![fix, resets])]
}
