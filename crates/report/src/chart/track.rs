//! The front-page figure: the true path, the brick's odometry, and the station's estimates.
//!
//! A map on top with equal scales, the position errors over time below.

use posebridge_telemetry::{Arena, Estimate, Point2};

use super::axes::{
    BLACK, BLUE, BLUISH_GREEN, DETAIL_FRAME, ELLIPSE, ESTIMATE, FILL_OPACITY, IDEAL, INK, LATE, LegendEntry,
    LegendMark, ODOMETRY, ORANGE, PlotPanel, REJECTED, SKY_BLUE, SMOOTHED, TRUTH, VERMILLION, ValueRange,
    compared_stroke, draw_start, round_ticks,
};
use super::layers::{
    DrawableLayers, Polylines, RunLayers, downsample_path, ellipse_of, is_drawable, on_map, open_figure,
};
use super::svg::{Anchor, PixelPoint, Rect, Stroke, Svg, TextStyle};
use super::{axes, error};

const HEIGHT_PX: f64 = 700.0;

const MAP: Rect = Rect { left: axes::LEFT_PX, top: 72.0, width: 590.0, height: 372.0 };

const DETAIL: Rect = Rect { left: 728.0, top: 292.0, width: 156.0, height: 136.0 };

const ERRORS: Rect = Rect { left: axes::LEFT_PX, top: 504.0, width: 590.0, height: 142.0 };

const LEGEND_LEFT_PX: f64 = 684.0;

pub(super) fn render(layers: &RunLayers<'_>) -> String {
    let drawable = DrawableLayers::from_layers(layers);
    let mut svg = open_figure(layers, HEIGHT_PX);
    let (x, y) = drawable.bounds();
    let map = PlotPanel::equal_scale(MAP, x, y);
    draw_map(&mut svg, &map, &drawable);
    // Where filters are compared, their names stand in its place.
    let detail = drawable.compared.is_empty().then(|| detail_panel(DETAIL, &map, layers.estimates));
    if let Some(detail) = detail.flatten() {
        let ellipses = detail_ellipses(&detail, layers.estimates);
        draw_detail(&mut svg, &map, &detail, &DrawableLayers { ellipses, ..drawable.clone() });
    }
    axes::draw_legend(&mut svg, (LEGEND_LEFT_PX, MAP.top), &entries(&drawable));
    let error_dropped = error::draw(&mut svg, ERRORS, LEGEND_LEFT_PX, layers);
    svg.finish(drawable.dropped + error_dropped)
}

fn draw_map(svg: &mut Svg, map: &PlotPanel, drawable: &DrawableLayers) {
    map.draw_grid(svg, &round_ticks(map.x, 8.0), &round_ticks(map.y, 6.0));
    svg.clip(&MAP, "map", |svg| draw_layers(svg, map, drawable));
    map.draw_border(svg);
    map.draw_names(svg, "x [m]", "y [m]");
}

fn draw_detail(svg: &mut Svg, map: &PlotPanel, detail: &PlotPanel, drawable: &DrawableLayers) {
    let (left, bottom) = map.to_pixels(detail.x.low, detail.y.low);
    let (right, top) = map.to_pixels(detail.x.high, detail.y.high);
    let frame = Rect { left, top, width: right - left, height: bottom - top };
    svg.rect(&frame, &DETAIL_FRAME);
    detail.draw_grid(svg, &round_ticks(detail.x, 3.0), &round_ticks(detail.y, 4.0));
    svg.clip(&DETAIL, "detail", |svg| draw_layers(svg, detail, drawable));
    svg.rect(&DETAIL, &DETAIL_FRAME);
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Middle, weight: 400 };
    let above = (DETAIL.left + DETAIL.width / 2.0, DETAIL.top - 8.0);
    svg.text(above, &style, "where it is least sure [m]");
}

fn draw_layers(svg: &mut Svg, panel: &PlotPanel, drawable: &DrawableLayers) {
    draw_line(svg, panel, &drawable.ideal, &IDEAL);
    for corners in &drawable.ellipses {
        let corners = to_pixels(panel, corners);
        svg.polygon(&corners, SKY_BLUE, FILL_OPACITY, Some(&ELLIPSE));
    }
    let lines = |lines: &Polylines, stroke, svg: &mut Svg| {
        for line in lines {
            draw_line(svg, panel, line, stroke);
        }
    };
    lines(&drawable.truth, &TRUTH, svg);
    lines(&drawable.odometry, &ODOMETRY, svg);
    draw_fixes(svg, panel, drawable);
    for (index, (_, compared)) in drawable.compared.iter().enumerate() {
        lines(compared, compared_stroke(index), svg);
    }
    lines(&drawable.estimate, &ESTIMATE, svg);
    lines(&drawable.smoothed, &SMOOTHED, svg);
    draw_start_and_end(svg, panel, drawable);
}

fn draw_line(svg: &mut Svg, panel: &PlotPanel, line: &[Point2<Arena>], stroke: &Stroke) {
    svg.polyline(&downsample_path(&to_pixels(panel, line)), stroke);
}

fn draw_fixes(svg: &mut Svg, panel: &PlotPanel, drawable: &DrawableLayers) {
    for at in to_pixels(panel, &drawable.used_fixes) {
        svg.disc(at, 2.0, BLUISH_GREEN, None);
    }
    for at in to_pixels(panel, &drawable.rejected_fixes) {
        svg.cross(at, 4.0, &REJECTED);
    }
    for at in to_pixels(panel, &drawable.late_fixes) {
        svg.disc(at, 3.5, "none", Some(&LATE));
    }
}

/// Marks the start and the end of each line, to show the end error.
fn draw_start_and_end(svg: &mut Svg, panel: &PlotPanel, drawable: &DrawableLayers) {
    if let Some(start) = drawable.start() {
        draw_start(svg, panel.to_pixels(start.x.0, start.y.0));
    }
    for (lines, fill) in [
        (&drawable.truth, BLACK),
        (&drawable.odometry, VERMILLION),
        (&drawable.estimate, BLUE),
        (&drawable.smoothed, ORANGE),
    ] {
        if let Some(end) = lines.last().and_then(|line| line.last()) {
            svg.disc(panel.to_pixels(end.x.0, end.y.0), 4.0, fill, None);
        }
    }
}

fn to_pixels(panel: &PlotPanel, points: &[Point2<Arena>]) -> Vec<PixelPoint> {
    points.iter().map(|point| panel.to_pixels(point.x.0, point.y.0)).collect()
}

fn entries(drawable: &DrawableLayers) -> Vec<LegendEntry> {
    let used = drawable.used_fixes.len();
    let refused = drawable.rejected_fixes.len();
    let late = drawable.late_fixes.len();
    let rows = [
        (drawable.start().is_some(), LegendEntry::new(LegendMark::Start, "start")),
        (!drawable.ideal.is_empty(), LegendEntry::new(LegendMark::Line(&IDEAL), "ideal path")),
        (!drawable.truth.is_empty(), LegendEntry::new(LegendMark::Line(&TRUTH), "true path")),
        (!drawable.odometry.is_empty(), LegendEntry::new(LegendMark::Line(&ODOMETRY), "brick's odometry")),
        (!drawable.estimate.is_empty(), LegendEntry::new(LegendMark::Line(&ESTIMATE), "estimate")),
        (!drawable.ellipses.is_empty(), LegendEntry::new(LegendMark::Area(&ELLIPSE), "its 2-sigma ellipses")),
        (!drawable.smoothed.is_empty(), LegendEntry::new(LegendMark::Line(&SMOOTHED), "smoothed path")),
        (used > 0, LegendEntry::new(LegendMark::Disc(BLUISH_GREEN), format!("fix, used ({used})"))),
        (refused > 0, LegendEntry::new(LegendMark::Cross(&REJECTED), format!("fix, refused ({refused})"))),
        (late > 0, LegendEntry::new(LegendMark::Ring(&LATE), format!("fix, too late ({late})"))),
    ];
    let compared = drawable.compared.iter().enumerate().filter(|(_, (_, lines))| !lines.is_empty());
    let compared = compared.map(|(index, (filter, _))| {
        LegendEntry::new(LegendMark::Line(compared_stroke(index)), format!("filter {filter}"))
    });
    rows.into_iter().filter_map(|(is_there, entry)| is_there.then_some(entry)).chain(compared).collect()
}

// The magnified detail beside the map: on a map of metres, ellipses of millimetres are dots.
//
// It looks at the place where the estimate is least sure of itself. It draws nothing itself; the map draws its layers
// a second time through the detail's axes.

/// Width of the detail in longest half axes.
const HALF_AXES_ACROSS: f64 = 9.0;

const MIN_WIDTH_M: f64 = 0.01;

/// A detail that shows more than this share of the map magnifies nothing and is omitted.
const MAX_SHARE: f64 = 0.35;

const MAX_ELLIPSES: usize = 14;

/// Axes of the detail, around the widest ellipse; `None` if there is nothing to magnify.
fn detail_panel(area: Rect, map: &PlotPanel, estimates: &[Estimate]) -> Option<PlotPanel> {
    let is_shown = on_map(estimates);
    let (half_axis_m, center) = estimates
        .iter()
        .filter(|estimate| is_shown(estimate) && is_drawable(estimate.pose.origin()))
        .filter_map(|estimate| Some((ellipse_of(estimate)?.semi_major_m, estimate.pose.origin())))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let width_m = (HALF_AXES_ACROSS * half_axis_m).max(MIN_WIDTH_M);
    let height_m = width_m / area.width * area.height;
    let is_magnified = height_m < MAX_SHARE * map.y.extent();
    is_magnified.then(|| PlotPanel {
        area,
        x: ValueRange::around(center.x.0, width_m),
        y: ValueRange::around(center.y.0, height_m),
    })
}

/// Evenly selected ellipses whose centres lie inside the detail.
fn detail_ellipses(detail: &PlotPanel, estimates: &[Estimate]) -> Vec<Vec<Point2<Arena>>> {
    let is_shown = on_map(estimates);
    let inside: Vec<&Estimate> = estimates
        .iter()
        .filter(|estimate| {
            is_shown(estimate) && detail.x.contains(estimate.pose.x.0) && detail.y.contains(estimate.pose.y.0)
        })
        .collect();
    inside
        .iter()
        .step_by(inside.len().div_ceil(MAX_ELLIPSES).max(1))
        .filter_map(|estimate| Some(ellipse_of(estimate)?.corners(estimate.pose.origin())))
        .collect()
}
