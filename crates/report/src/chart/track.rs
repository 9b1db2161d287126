//! The front-page figure: the true path, the brick's odometry, and the station's estimates.
//!
//! A map on top with equal scales, the position errors over time below.

use posebridge_telemetry::{Arena, Point2};

use super::downsample::downsample_path;
use super::layers::{DrawableLayers, Polylines, RunLayers};
use super::legend::{LegendEntry, LegendMark, draw_start};
use super::palette::{
    BLACK, BLUE, BLUISH_GREEN, DETAIL_FRAME, ELLIPSE, ESTIMATE, FILL_OPACITY, IDEAL, INK, LATE, ODOMETRY, ORANGE,
    REJECTED, SKY_BLUE, SMOOTHED, TRUTH, VERMILLION,
};
use super::panel::{PlotPanel, round_ticks};
use super::svg::{Anchor, PixelPoint, Rect, Stroke, Svg, TextStyle};
use super::{canvas, detail, error, legend};

const HEIGHT_PX: f64 = 700.0;

const MAP: Rect = Rect { left: canvas::LEFT_PX, top: 72.0, width: 590.0, height: 372.0 };

const DETAIL: Rect = Rect { left: 728.0, top: 292.0, width: 156.0, height: 136.0 };

const ERRORS: Rect = Rect { left: canvas::LEFT_PX, top: 504.0, width: 590.0, height: 142.0 };

/// Where the legends begin, in pixels.
const LEGEND_LEFT_PX: f64 = 684.0;

pub(super) fn render(layers: &RunLayers<'_>) -> String {
    let drawable = DrawableLayers::from_layers(layers);
    let mut svg = canvas::open_figure(layers, HEIGHT_PX);
    let (x, y) = drawable.bounds();
    let map = PlotPanel::equal_scale(MAP, x, y);
    draw_map(&mut svg, &map, &drawable);
    if let Some(detail) = detail::detail_panel(DETAIL, &map, layers.estimates) {
        let ellipses = detail::ellipses(&detail, layers.estimates);
        draw_detail(&mut svg, &map, &detail, &DrawableLayers { ellipses, ..drawable.clone() });
    }
    legend::draw(&mut svg, (LEGEND_LEFT_PX, MAP.top), &entries(&drawable));
    let error_dropped = error::draw(&mut svg, ERRORS, LEGEND_LEFT_PX, layers);
    canvas::close_figure(svg, HEIGHT_PX, drawable.dropped + error_dropped)
}

fn draw_map(svg: &mut Svg, map: &PlotPanel, drawable: &DrawableLayers) {
    map.draw_grid(svg, &round_ticks(map.x, 8.0), &round_ticks(map.y, 6.0));
    svg.clip(&MAP, "map", |svg| draw_layers(svg, map, drawable));
    map.draw_border(svg);
    map.draw_names(svg, "x [m]", "y [m]");
}

/// The detail, and a frame on the map around the place that it shows.
fn draw_detail(svg: &mut Svg, map: &PlotPanel, detail: &PlotPanel, drawable: &DrawableLayers) {
    let (left, bottom) = map.to_pixels(detail.x.low, detail.y.low);
    let (right, top) = map.to_pixels(detail.x.high, detail.y.high);
    let place = Rect { left, top, width: right - left, height: bottom - top };
    svg.rect(&place, &DETAIL_FRAME);
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

/// The start, and a disc where each line ends, so that the end error can be seen.
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

/// A row for each layer that is there.
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
        (!drawable.ellipses.is_empty(), LegendEntry::new(LegendMark::Area(&ELLIPSE, SKY_BLUE), "its 2-sigma ellipses")),
        (!drawable.smoothed.is_empty(), LegendEntry::new(LegendMark::Line(&SMOOTHED), "smoothed path")),
        (used > 0, LegendEntry::new(LegendMark::Disc(BLUISH_GREEN), format!("fix, used ({used})"))),
        (refused > 0, LegendEntry::new(LegendMark::Cross(&REJECTED), format!("fix, refused ({refused})"))),
        (late > 0, LegendEntry::new(LegendMark::Ring(&LATE), format!("fix, too late ({late})"))),
    ];
    rows.into_iter().filter_map(|(is_there, entry)| is_there.then_some(entry)).collect()
}
