//! The arena from above, in braille dots: path, truth, odometry, estimate with its ellipse, fixes.

use posebridge_dashboard::model::{EstimatePoint, FixPoint, Number};
use posebridge_telemetry::{Ellipse, Meters, Point2};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::symbols::Marker;
use ratatui::text::Span;
use ratatui::widgets::Widget;
use ratatui::widgets::canvas::{Canvas, Context, Line, Points};

use super::model::{Model, RecentPoints, Robot};
use super::theme::{StyleRole, Theme, sanitize};

/// Display duration of fixes, as on the page.
const FIX_WINDOW_S: f64 = 20.0;
/// Lag behind the filter's time from which an accepted fix counts as late, as on the page (web/model/marks.js).
const LATE_FROM_S: f64 = 0.15;
/// Half width of the map without data.
const LEAST_HALF_WIDTH_M: f64 = 0.5;
/// Margin around the content, as a factor.
const MARGIN: f64 = 1.08;
/// Braille dots per cell, horizontal and vertical; their spacing is about equal.
const DOTS: (u16, u16) = (2, 4);
/// Dashes of the odometry: points drawn, and as many omitted.
const DASH: usize = 12;

type MapPoint = (f64, f64);

pub(super) fn draw(model: &Model, theme: Theme, area: Rect, buffer: &mut Buffer) {
    if area.is_empty() {
        return;
    }
    let map = Map::of(model);
    let (x_bounds, y_bounds) = bounds(&map, area);
    Canvas::default()
        .marker(Marker::Braille)
        .x_bounds(x_bounds)
        .y_bounds(y_bounds)
        .paint(|context| map.paint(theme, context))
        .render(area, buffer);
    let scale = format!("{:.1} m across", x_bounds[1] - x_bounds[0]);
    if usize::from(area.width) > scale.len() + LEGEND_WIDTH {
        legend(theme, area, buffer);
    }
    let row = area.bottom().saturating_sub(1);
    buffer.set_stringn(area.x, row, scale, usize::from(area.width), theme.style(StyleRole::Quiet));
}

const LEGEND_WIDTH: usize = 46;

fn legend(theme: Theme, area: Rect, buffer: &mut Buffer) {
    let words = [
        ("T truth", StyleRole::Truth),
        ("O odometry", StyleRole::Odometry),
        ("→ estimate", StyleRole::Estimate),
        ("+ fix", StyleRole::Good),
        ("x gated", StyleRole::Bad),
    ];
    let width: usize = words.iter().map(|(word, _)| word.chars().count() + 1).sum();
    let row = area.bottom().saturating_sub(1);
    let mut column = area.right().saturating_sub(width as u16);
    for (word, role) in words {
        let (next, _) = buffer.set_stringn(column, row, word, word.len(), theme.style(role));
        column = next + 1;
    }
}

struct Map<'a> {
    path: Vec<MapPoint>,
    truth: Vec<MapPoint>,
    odometry: Vec<MapPoint>,
    estimate: Vec<MapPoint>,
    /// Of all filters that run beside the one that sends.
    compared: Vec<MapPoint>,
    ellipse: Vec<MapPoint>,
    fixes: Vec<&'a FixPoint>,
    latest: Option<&'a EstimatePoint>,
    others: Vec<OtherRobot>,
}

/// A robot that is not selected: position and label.
struct OtherRobot {
    position: MapPoint,
    heading_rad: Number,
    label: String,
}

impl OtherRobot {
    fn of(robot: &Robot) -> Option<Self> {
        let latest = robot.estimates.last()?;
        let position = map_point(latest.x_m, latest.y_m)?;
        Some(Self { position, heading_rad: latest.heading_rad, label: sanitize(robot.label()) })
    }
}

impl<'a> Map<'a> {
    fn of(model: &'a Model) -> Self {
        let robot = model.selected_robot();
        let latest = robot.and_then(|robot| robot.estimates.last());
        let fixes = robot.into_iter().flat_map(|robot| robot.fixes.iter());
        let fixes = fixes.filter(|fix| model.now_s - fix.t_s <= FIX_WINDOW_S);
        let selected = robot.map(|robot| robot.id.as_str());
        let others = model.visible_robots().into_iter().filter(|robot| Some(robot.id.as_str()) != selected);
        let path = model.simulator.as_ref().map_or(&[][..], |known| known.path.as_slice());
        let truth = model.selected_truth();
        let odometry = truth.iter().flat_map(|truth| truth.iter()).filter_map(|point| point.odometry);
        Self {
            path: path.iter().map(|[x_m, y_m]| (*x_m, *y_m)).collect(),
            truth: map_points(truth.iter().flat_map(|truth| truth.iter()).map(|point| (point.x_m, point.y_m))),
            odometry: map_points(odometry.map(|[x_m, y_m, _]| (x_m, y_m))),
            estimate: robot
                .map_or_else(Vec::new, |robot| map_points(robot.estimates.iter().map(|point| (point.x_m, point.y_m)))),
            compared: robot.map_or_else(Vec::new, |robot| {
                map_points(robot.compared.values().flat_map(RecentPoints::iter).map(|point| (point.x_m, point.y_m)))
            }),
            ellipse: latest.and_then(ellipse_of).unwrap_or_default(),
            fixes: fixes.collect(),
            latest,
            others: others.filter_map(OtherRobot::of).collect(),
        }
    }

    /// Points that the map must contain; fixes are excluded, because they may be anywhere.
    fn visible_points(&self) -> impl Iterator<Item = &MapPoint> {
        let lines = [&self.path, &self.truth, &self.odometry, &self.estimate, &self.compared];
        lines.into_iter().flatten().chain(self.others.iter().map(|other| &other.position))
    }

    fn paint(&self, theme: Theme, context: &mut Context<'_>) {
        context.draw(&Points { coords: &self.path, color: theme.colour(StyleRole::Path) });
        context.draw(&Points { coords: &self.compared, color: theme.colour(StyleRole::Late) });
        context.layer();
        let dashes = self.odometry.chunks(DASH).step_by(2);
        dashes.for_each(|dash| draw_polyline(dash, theme, StyleRole::Odometry, context));
        context.layer();
        draw_polyline(&self.truth, theme, StyleRole::Truth, context);
        context.layer();
        draw_polyline(&self.estimate, theme, StyleRole::Estimate, context);
        draw_polyline(&self.ellipse, theme, StyleRole::Estimate, context);
        for fix in &self.fixes {
            let (sign, role) = mark_of(fix);
            if let Some((x, y)) = map_point(fix.x_m, fix.y_m) {
                context.print(x, y, Span::styled(sign, theme.style(role)));
            }
        }
        for other in &self.others {
            let (x, y) = other.position;
            let text = format!("{} {}", arrow_of(other.heading_rad), other.label);
            context.print(x, y, Span::styled(text, theme.style(StyleRole::Quiet)));
        }
        let ends = [("T", &self.truth, StyleRole::Truth), ("O", &self.odometry, StyleRole::Odometry)];
        for (letter, trail, role) in ends {
            if let Some((x, y)) = trail.last() {
                context.print(*x, *y, Span::styled(letter, theme.style(role)));
            }
        }
        if let Some(latest) = self.latest
            && let Some((x, y)) = map_point(latest.x_m, latest.y_m)
        {
            let arrow = arrow_of(latest.heading_rad);
            context.print(x, y, Span::styled(arrow, theme.style(StyleRole::Estimate)));
        }
    }
}

fn draw_polyline(points: &[MapPoint], theme: Theme, role: StyleRole, context: &mut Context<'_>) {
    let color = theme.colour(role);
    for pair in points.windows(2) {
        let [(x1, y1), (x2, y2)] = *pair else {
            continue;
        };
        context.draw(&Line { x1, y1, x2, y2, color });
    }
}

/// Outline of the 95 % ellipse, closed.
fn ellipse_of(estimate: &EstimatePoint) -> Option<Vec<MapPoint>> {
    let (x_m, y_m) = map_point(estimate.x_m, estimate.y_m)?;
    let ellipse = Ellipse {
        semi_major_m: estimate.major_m.get()?,
        semi_minor_m: estimate.minor_m.get()?,
        direction_rad: estimate.axis_rad.get()?,
    };
    let corners = ellipse.corners(Point2::new(Meters(x_m), Meters(y_m)));
    let closed = corners.iter().chain(corners.first());
    Some(closed.map(|corner| (corner.x.0, corner.y.0)).collect())
}

fn mark_of(fix: &FixPoint) -> (&'static str, StyleRole) {
    let is_late = fix.lag_s.get().is_some_and(|lag_s| lag_s >= LATE_FROM_S);
    match &*fix.verdict {
        "accepted" if is_late => ("◇", StyleRole::Late),
        "accepted" => ("+", StyleRole::Good),
        "gated" => ("x", StyleRole::Bad),
        "reset to" => ("*", StyleRole::Strong),
        _ => ("□", StyleRole::Quiet),
    }
}

/// The arrow nearest to a heading, counter-clockwise from east.
fn arrow_of(heading_rad: Number) -> &'static str {
    const ARROWS: [&str; 8] = ["→", "↗", "↑", "↖", "←", "↙", "↓", "↘"];
    let eighths = heading_rad.get().map(|heading_rad| (heading_rad.to_degrees() / 45.0).round() as i64);
    let index = eighths.map(|eighths| eighths.rem_euclid(8) as usize);
    index.and_then(|index| ARROWS.get(index)).copied().unwrap_or("●")
}

fn map_points(points: impl Iterator<Item = (Number, Number)>) -> Vec<MapPoint> {
    points.filter_map(|(x_m, y_m)| map_point(x_m, y_m)).collect()
}

fn map_point(x_m: Number, y_m: Number) -> Option<MapPoint> {
    Some((x_m.get()?, y_m.get()?))
}

/// Axis limits: all required points, with equal scales.
fn bounds(map: &Map<'_>, area: Rect) -> ([f64; 2], [f64; 2]) {
    let (mut least, mut most) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    for (x, y) in map.visible_points() {
        least = (least.0.min(*x), least.1.min(*y));
        most = (most.0.max(*x), most.1.max(*y));
    }
    if least.0 > most.0 {
        (least, most) = ((0.0, 0.0), (0.0, 0.0));
    }
    let dots = |cells: u16, dots: u16| f64::from(cells.max(1)) * f64::from(dots);
    let across = dots(area.width, DOTS.0);
    let up = dots(area.height, DOTS.1);
    let half = |least: f64, most: f64| ((most - least) / 2.0 * MARGIN).max(LEAST_HALF_WIDTH_M);
    let per_dot = (half(least.0, most.0) / across).max(half(least.1, most.1) / up);
    let around = |least: f64, most: f64, dots: f64| {
        let middle = f64::midpoint(least, most);
        [middle - per_dot * dots, middle + per_dot * dots]
    };
    (around(least.0, most.0, across), around(least.1, most.1, up))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn arrows_turn_counter_clockwise() {
        let cases = [(0.0, "→"), (FRAC_PI_2, "↑"), (PI, "←"), (-PI, "←"), (-FRAC_PI_2, "↓"), (-0.8, "↘")];
        for (heading_rad, arrow) in cases {
            assert_eq!(arrow_of(heading_rad.into()), arrow, "{heading_rad}");
        }
        assert_eq!(arrow_of(f64::NAN.into()), "●");
    }

    #[test]
    fn late_and_refused_fixes_have_marks_of_their_own() {
        let fix = |verdict: &'static str, lag_s: f64| FixPoint {
            verdict: verdict.into(),
            lag_s: lag_s.into(),
            ..FixPoint::default()
        };
        let signs: Vec<&str> =
            [fix("accepted", 0.1), fix("accepted", 0.2), fix("gated", 0.0), fix("too old", 3.0), fix("reset to", 0.0)]
                .iter()
                .map(|fix| mark_of(fix).0)
                .collect();
        assert_eq!(signs, ["+", "◇", "x", "□", "*"]);
    }

    #[test]
    fn a_metre_is_as_many_dots_across_as_up() {
        let model = Model::default();
        let (x, y) = bounds(&Map::of(&model), Rect::new(0, 0, 40, 10));
        let across = (x[1] - x[0]) / 80.0;
        let up = (y[1] - y[0]) / 40.0;
        assert!((across - up).abs() < 1e-12, "{across} {up}");
        assert!(y[1] - y[0] >= 2.0 * LEAST_HALF_WIDTH_M);
    }
}
