//! Panels below each other on a narrow sheet, each with its legend above it: the figures of a report.
//!
//! A sheet is readable on a phone, and two of them fit side by side on a screen. Shapes, axes and colours are those of
//! [`plot`](super::plot).

use super::axes;
use super::axes::{FAINT_INK, INK, LegendEntry, ValueRange, round_ticks};
use super::plot::{
    Axes, AxisScaling, Curve, CurveDownsampling, CurveShape, curve_stroke, draw_shape, legend_mark, panel_of,
    with_margin,
};
use super::svg::{Anchor, Rect, Stroke, Svg, TextStyle};

const WIDTH_PX: f64 = 540.0;
/// Space for the labels of the y axis and its name.
const LEFT_PX: f64 = 68.0;
const RIGHT_PX: f64 = 14.0;
const TOP_PX: f64 = 38.0;
const LEGEND_GAP_PX: f64 = 6.0;
/// Below a panel: tick labels, and the name of the axis below the last one.
const TICKS_PX: f64 = 26.0;
const NAME_PX: f64 = 32.0;
/// Longer titles are cut; more characters do not fit.
const TITLE_CHARACTERS: usize = 58;
const X_TICKS: f64 = 6.0;
const Y_TICKS: f64 = 5.0;

/// Draws the panels from top to bottom; returns a whole SVG document. All panels except maps have the same x axis.
pub(super) fn render_strip(title: &str, panels: &[Axes]) -> String {
    let legends: Vec<Vec<LegendEntry>> = panels.iter().map(legend_entries).collect();
    let heights = panels.iter().zip(&legends).map(|(panel, entries)| {
        axes::legend_height_px(inner_px(), entries) + LEGEND_GAP_PX + panel.height_px + TICKS_PX
    });
    let height_px = TOP_PX + heights.sum::<f64>() + NAME_PX;
    let mut svg = Svg::new(WIDTH_PX, height_px, title);
    draw_title(&mut svg, title);
    let common_x = common_x(panels);
    let mut top = TOP_PX;
    let mut dropped = 0;
    for (panel, entries) in panels.iter().zip(&legends) {
        top += axes::draw_legend_rows(&mut svg, (LEFT_PX, top), inner_px(), entries) + LEGEND_GAP_PX;
        let area = Rect { left: LEFT_PX, top, width: inner_px(), height: panel.height_px };
        dropped += draw_panel(&mut svg, area, panel, common_x);
        top += panel.height_px + TICKS_PX;
    }
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Middle, weight: 400 };
    let middle = LEFT_PX + inner_px() / 2.0;
    let x_name = panels.last().map_or("time [s]", |panel| &panel.x_name);
    svg.text((middle, top + 6.0), &style, x_name);
    svg.finish(dropped)
}

const fn inner_px() -> f64 {
    WIDTH_PX - LEFT_PX - RIGHT_PX
}

fn draw_title(svg: &mut Svg, title: &str) {
    let style = TextStyle { size_px: 15.0, color: INK, anchor: Anchor::Start, weight: 700 };
    svg.text((10.0, 24.0), &style, &axes::truncate(title, TITLE_CHARACTERS));
}

fn legend_entries(panel: &Axes) -> Vec<LegendEntry> {
    let named = panel.curves.iter().filter(|curve| !curve.name.is_empty());
    named.map(|curve| LegendEntry::new(legend_mark(stroke_of(curve), &curve.shape), &curve.name)).collect()
}

fn common_x(panels: &[Axes]) -> Option<ValueRange> {
    let over_time = panels.iter().filter(|panel| panel.scaling == AxisScaling::Independent);
    let nothing = Rect { left: 0.0, top: 0.0, width: 1.0, height: 1.0 };
    let spans = over_time
        .filter(|panel| panel.curves.iter().any(|curve| has_points(&curve.shape)))
        .map(|panel| panel_of(nothing, panel).x);
    let ends: Vec<f64> = spans.flat_map(|span| [span.low, span.high]).collect();
    ValueRange::of(ends.into_iter())
}

/// Whether a shape has x coordinates.
const fn has_points(shape: &CurveShape) -> bool {
    match shape {
        CurveShape::Line(points)
        | CurveShape::Dots(points)
        | CurveShape::Crosses(points)
        | CurveShape::Rings(points)
        | CurveShape::Specks(points) => !points.is_empty(),
        CurveShape::Band(band_points) => !band_points.is_empty(),
        CurveShape::Outlines(outlines) => !outlines.is_empty(),
        CurveShape::Level(_) => false,
    }
}

fn stroke_of(curve: &Curve) -> &'static Stroke {
    curve.stroke.unwrap_or(curve_stroke(0))
}

/// Returns the number of omitted values.
fn draw_panel(svg: &mut Svg, area: Rect, panel: &Axes, common_x: Option<ValueRange>) -> usize {
    let mut axes = panel_of(area, panel);
    if panel.scaling == AxisScaling::Independent {
        axes.x = common_x.map_or(axes.x, |x| with_margin(x, 0.0));
        axes.y = panel.y.unwrap_or(axes.y);
    }
    let y_ticks = if panel.height_px < 80.0 { 3.0 } else { Y_TICKS };
    axes.draw_grid(svg, &round_ticks(axes.x, X_TICKS), &round_ticks(axes.y, y_ticks));
    let thinning =
        if panel.scaling == AxisScaling::Equal { CurveDownsampling::Deviation } else { CurveDownsampling::Series };
    let mut dropped = 0;
    svg.clip(&area, "curves", |svg| {
        for curve in &panel.curves {
            dropped += draw_shape(svg, &axes, stroke_of(curve), thinning, &curve.shape);
        }
    });
    axes.draw_border(svg);
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Middle, weight: 400 };
    let middle = area.top + area.height / 2.0;
    svg.upright_text((15.0, middle), &style, &panel.y_name);
    if panel.curves.iter().all(|curve| !has_points(&curve.shape)) {
        let style = TextStyle { color: FAINT_INK, ..style };
        svg.text((area.left + area.width / 2.0, middle + 4.0), &style, "nothing to show");
    }
    dropped
}

#[cfg(test)]
mod tests {
    use super::*;
    fn strip(shapes: Vec<CurveShape>) -> String {
        let panels =
            shapes.into_iter().map(|shape| Axes::new("time [s]", "value", 100.0, [Curve::new("curve", shape)]));
        render_strip("a <b>", &panels.collect::<Vec<_>>())
    }

    #[test]
    fn panels_share_the_time_and_each_has_its_legend() {
        let svg = strip(vec![CurveShape::Line(vec![(0.0, 1.0), (10.0, 2.0)]), CurveShape::Specks(vec![(40.0, 3.0)])]);
        assert_eq!(svg.matches(">curve</text>").count(), 2);
        // Both reach to 40 s.
        assert_eq!(svg.matches(">40</text>").count(), 2, "{svg}");
        assert!(svg.contains("a &lt;b&gt;") && !svg.contains("<b>"));
    }

    #[test]
    fn a_panel_without_anything_says_so() {
        let svg = strip(vec![CurveShape::Line(Vec::new())]);
        assert!(svg.contains("nothing to show") && !svg.contains("NaN"));
        let level = strip(vec![CurveShape::Level(1.0)]);
        assert!(level.contains("nothing to show"));
    }

    #[test]
    fn ten_minutes_at_a_hundred_hertz_take_little_room() {
        let noisy = |step: u32| f64::from(step * 7919 % 1009) / 1009.0;
        let samples = || (0..60_000).map(|step| (f64::from(step) / 100.0, noisy(step)));
        let band = samples().map(|(t, v)| (t, v - 1.0, v + 1.0)).collect();
        let svg = strip(vec![
            CurveShape::Line(samples().collect()),
            CurveShape::Specks(samples().collect()),
            CurveShape::Band(band),
        ]);
        assert!(svg.len() < 150_000, "{} bytes", svg.len());
    }
}
