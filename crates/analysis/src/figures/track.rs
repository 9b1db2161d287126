//! The front-page figure: where the robot was, where the brick believed it was, and where the station did.
//!
//! A map on top with equal scales, the position errors over time below.

use posebridge_telemetry::{Arena, Point2};

use super::layers::{Drawable, Lines};
use super::legend::{Entry, Mark, draw_start};
use super::palette::{
    BLACK, BLUE, BLUISH_GREEN, DETAIL_FRAME, ELLIPSE, ESTIMATE, FILL_OPACITY, IDEAL, INK, LATE, ODOMETRY, ORANGE,
    REFUSED, SKY_BLUE, SMOOTHED, TRUTH, VERMILLION,
};
use super::panel::{Panel, round_ticks};
use super::svg::{Anchor, Px, Rect, Stroke, Svg, TextStyle};
use super::thin::thin_path;
use super::{Figure, RunLayers, canvas, detail, error, legend};

/// The map of a run with its errors over time.
pub const TRACK: Figure = Figure {
    name: "track",
    doc: "Map of the ideal path, truth, odometry, estimate with 2-sigma ellipses, smoothed path and fixes; position error over time.",
    render,
};

const HEIGHT_PX: f64 = 700.0;

const MAP: Rect = Rect { left: canvas::LEFT_PX, top: 72.0, width: 590.0, height: 372.0 };

const DETAIL: Rect = Rect { left: 728.0, top: 292.0, width: 156.0, height: 136.0 };

const ERRORS: Rect = Rect { left: canvas::LEFT_PX, top: 504.0, width: 590.0, height: 142.0 };

/// Where the legends begin, in pixels.
const LEGEND_LEFT_PX: f64 = 684.0;

fn render(layers: &RunLayers<'_>) -> String {
    let drawable = Drawable::of(layers);
    let mut svg = canvas::open(layers, HEIGHT_PX);
    let (x, y) = drawable.bounds();
    let map = Panel::equal_scale(MAP, x, y);
    draw_map(&mut svg, &map, &drawable);
    if let Some(detail) = detail::panel(DETAIL, &map, layers.estimates) {
        let ellipses = detail::ellipses(&detail, layers.estimates);
        draw_detail(&mut svg, &map, &detail, &Drawable { ellipses, ..drawable.clone() });
    }
    legend::draw(&mut svg, (LEGEND_LEFT_PX, MAP.top), &entries(&drawable));
    let error_dropped = error::draw(&mut svg, ERRORS, LEGEND_LEFT_PX, layers);
    canvas::close(svg, HEIGHT_PX, drawable.dropped + error_dropped)
}

fn draw_map(svg: &mut Svg, map: &Panel, drawable: &Drawable) {
    map.draw_grid(svg, &round_ticks(map.x, 8.0), &round_ticks(map.y, 6.0));
    svg.clipped(&MAP, "map", |svg| draw_layers(svg, map, drawable));
    map.draw_border(svg);
    map.draw_names(svg, "x [m]", "y [m]");
}

/// The detail, and a frame on the map around the place that it shows.
fn draw_detail(svg: &mut Svg, map: &Panel, detail: &Panel, drawable: &Drawable) {
    let (left, bottom) = map.place(detail.x.low, detail.y.low);
    let (right, top) = map.place(detail.x.high, detail.y.high);
    let place = Rect { left, top, width: right - left, height: bottom - top };
    svg.rect(&place, &DETAIL_FRAME);
    detail.draw_grid(svg, &round_ticks(detail.x, 3.0), &round_ticks(detail.y, 4.0));
    svg.clipped(&DETAIL, "detail", |svg| draw_layers(svg, detail, drawable));
    svg.rect(&DETAIL, &DETAIL_FRAME);
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Middle, weight: 400 };
    let above = (DETAIL.left + DETAIL.width / 2.0, DETAIL.top - 8.0);
    svg.text(above, &style, "where it is least sure [m]");
}

fn draw_layers(svg: &mut Svg, panel: &Panel, drawable: &Drawable) {
    draw_line(svg, panel, &drawable.ideal, &IDEAL);
    for corners in &drawable.ellipses {
        let corners = placed(panel, corners);
        svg.polygon(&corners, SKY_BLUE, FILL_OPACITY, Some(&ELLIPSE));
    }
    let lines = |lines: &Lines, stroke, svg: &mut Svg| {
        for line in lines {
            draw_line(svg, panel, line, stroke);
        }
    };
    lines(&drawable.truth, &TRUTH, svg);
    lines(&drawable.odometry, &ODOMETRY, svg);
    draw_fixes(svg, panel, drawable);
    lines(&drawable.estimate, &ESTIMATE, svg);
    lines(&drawable.smoothed, &SMOOTHED, svg);
    draw_ends(svg, panel, drawable);
}

fn draw_line(svg: &mut Svg, panel: &Panel, line: &[Point2<Arena>], stroke: &Stroke) {
    svg.polyline(&thin_path(&placed(panel, line)), stroke);
}

fn draw_fixes(svg: &mut Svg, panel: &Panel, drawable: &Drawable) {
    for at in placed(panel, &drawable.used_fixes) {
        svg.disc(at, 2.0, BLUISH_GREEN, None);
    }
    for at in placed(panel, &drawable.refused_fixes) {
        svg.cross(at, 4.0, &REFUSED);
    }
    for at in placed(panel, &drawable.late_fixes) {
        svg.disc(at, 3.5, "none", Some(&LATE));
    }
}

/// The start, and a disc where each line ends, so that the end error can be seen.
fn draw_ends(svg: &mut Svg, panel: &Panel, drawable: &Drawable) {
    if let Some(start) = drawable.start() {
        draw_start(svg, panel.place(start.x.0, start.y.0));
    }
    for (lines, fill) in [
        (&drawable.truth, BLACK),
        (&drawable.odometry, VERMILLION),
        (&drawable.estimate, BLUE),
        (&drawable.smoothed, ORANGE),
    ] {
        if let Some(end) = lines.last().and_then(|line| line.last()) {
            svg.disc(panel.place(end.x.0, end.y.0), 4.0, fill, None);
        }
    }
}

fn placed(panel: &Panel, points: &[Point2<Arena>]) -> Vec<Px> {
    points.iter().map(|point| panel.place(point.x.0, point.y.0)).collect()
}

/// A row for each layer that is there.
fn entries(drawable: &Drawable) -> Vec<Entry> {
    let used = drawable.used_fixes.len();
    let refused = drawable.refused_fixes.len();
    let late = drawable.late_fixes.len();
    let rows = [
        (drawable.start().is_some(), Entry::new(Mark::Start, "start")),
        (!drawable.ideal.is_empty(), Entry::new(Mark::Line(&IDEAL), "ideal path")),
        (!drawable.truth.is_empty(), Entry::new(Mark::Line(&TRUTH), "true path")),
        (!drawable.odometry.is_empty(), Entry::new(Mark::Line(&ODOMETRY), "brick's odometry")),
        (!drawable.estimate.is_empty(), Entry::new(Mark::Line(&ESTIMATE), "estimate")),
        (!drawable.ellipses.is_empty(), Entry::new(Mark::Area(&ELLIPSE, SKY_BLUE), "its 2-sigma ellipses")),
        (!drawable.smoothed.is_empty(), Entry::new(Mark::Line(&SMOOTHED), "smoothed path")),
        (used > 0, Entry::new(Mark::Disc(BLUISH_GREEN), format!("fix, used ({used})"))),
        (refused > 0, Entry::new(Mark::Cross(&REFUSED), format!("fix, refused ({refused})"))),
        (late > 0, Entry::new(Mark::Ring(&LATE), format!("fix, too late ({late})"))),
    ];
    rows.into_iter().filter_map(|(is_there, entry)| is_there.then_some(entry)).collect()
}
