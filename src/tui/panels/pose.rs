//! The estimate in numbers, with what it claims and how far off it really is.

use posebridge_dashboard::model::EstimatePoint;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::Panel;
use crate::tui::look::{Look, Role};
use crate::tui::model::Model;
use crate::tui::words::{degrees, fixed, signed};

/// See [`super`].
pub(super) const PANEL: Panel = Panel { title: "Pose", lines: |_| 4, draw };

fn draw(model: &Model, look: Look, area: Rect, buffer: &mut Buffer) {
    let latest = model.robot_shown().and_then(|robot| robot.estimates.last());
    let mut lines = vec![off_line(model, look)];
    match latest {
        Some(estimate) => lines.extend(lines_of(estimate, look)),
        None => lines.push(Line::styled("no estimate yet", look.style(Role::Quiet))),
    }
    Paragraph::new(lines).render(area, buffer);
}

/// How far odometry and estimate are from the truth; of a real robot nobody knows.
fn off_line(model: &Model, look: Look) -> Line<'static> {
    match &model.errors {
        Some(errors) => Line::from(vec![
            Span::styled(format!("odometry {} m off", fixed(errors.odometry_m, 2)), look.style(Role::Odometry)),
            Span::raw(", "),
            Span::styled(format!("estimate {} m off", fixed(errors.estimate_m, 3)), look.style(Role::Estimate)),
        ]),
        None => Line::styled("no truth to compare with", look.style(Role::Quiet)),
    }
}

fn lines_of(estimate: &EstimatePoint, look: Look) -> [Line<'static>; 3] {
    let quiet = |text: &'static str| Span::styled(text, look.style(Role::Quiet));
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
        (true, _) => Span::styled("dead reckoning", look.style(Role::Bad)),
        (false, None) => Span::styled("no fix yet", look.style(Role::Quiet)),
        (false, Some(age_s)) => Span::raw(format!("last fix {age_s:.1} s ago")),
    };
    let resets = Span::raw(format!("  resets {}", estimate.reset_counter));
    [Line::from(place), Line::from(heading), Line::from(vec![fix, resets])]
}
