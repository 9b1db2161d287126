//! Panels below each other on a narrow sheet, each with its legend above it: the figures of a report.
//!
//! A sheet is as wide as a phone can show with readable letters, and two of them stand side by side on a screen. Shapes, axes and
//! colours are those of [`plot`](super::plot).

use super::canvas;
use super::legend::{self, LegendEntry};
use super::palette::{FAINT_INK, INK};
use super::panel::{PlotPanel, ValueRange, round_ticks};
use super::plot::{
    AxisScaling, CurveDownsampling, CurveShape, CurveStyle, draw_shape, legend_mark, panel_of, with_margin,
};
use super::svg::{Anchor, Rect, Svg, TextStyle};

/// Width of a sheet, in pixels.
const WIDTH_PX: f64 = 540.0;
/// Room for the labels of the y axis and its name.
const LEFT_PX: f64 = 68.0;
const RIGHT_PX: f64 = 14.0;
/// Room above the first panel.
const TOP_PX: f64 = 38.0;
/// Between a legend and its panel.
const LEGEND_GAP_PX: f64 = 6.0;
/// Below a panel: labels of its ticks, and the name of its axis below the last one.
const TICKS_PX: f64 = 26.0;
const NAME_PX: f64 = 32.0;
/// Longer titles are cut, in characters; more do not fit.
const TITLE_CHARACTERS: usize = 58;
const X_TICKS: f64 = 6.0;
const Y_TICKS: f64 = 5.0;

/// A narrow sheet.
#[derive(Debug, Default)]
pub(super) struct StripChart {
    /// What it is about; any text.
    pub(super) title: String,
    /// The name of the common x axis, with its unit.
    pub(super) x_name: String,
    /// From top to bottom.
    pub(super) panels: Vec<StripPanel>,
}

/// A panel of it.
#[derive(Debug, Default)]
pub(super) struct StripPanel {
    /// With the unit.
    pub(super) y_name: String,
    /// In pixels.
    pub(super) height_px: f64,
    /// Equal on a map.
    pub(super) scales: AxisScaling,
    /// What the y axis spans; without it, what the curves span.
    pub(super) y: Option<ValueRange>,
    /// Later ones are drawn over earlier ones.
    pub(super) curves: Vec<StyledCurve>,
}

/// A curve with its colour.
#[derive(Debug)]
pub(super) struct StyledCurve {
    /// For the legend; an empty one has no entry.
    pub(super) name: String,
    pub(super) shape: CurveShape,
    pub(super) style: CurveStyle,
}

impl StyledCurve {
    pub(super) fn new(name: impl Into<String>, shape: CurveShape, style: CurveStyle) -> Self {
        Self { name: name.into(), shape, style }
    }
}

/// Draws it; returns a whole SVG document. All panels but maps have the same x axis.
pub(super) fn render_strip(strip: &StripChart) -> String {
    let legends: Vec<Vec<LegendEntry>> = strip.panels.iter().map(legend_entries).collect();
    let heights = strip.panels.iter().zip(&legends).map(|(panel, entries)| {
        legend::rows_height_px(inner_px(), entries) + LEGEND_GAP_PX + panel.height_px + TICKS_PX
    });
    let height_px = TOP_PX + heights.sum::<f64>() + NAME_PX;
    let mut svg = Svg::new(WIDTH_PX, height_px, &strip.title);
    draw_title(&mut svg, &strip.title);
    let common_x = common_x(strip);
    let mut top = TOP_PX;
    let mut dropped = 0;
    for (panel, entries) in strip.panels.iter().zip(&legends) {
        top += legend::draw_rows(&mut svg, (LEFT_PX, top), inner_px(), entries) + LEGEND_GAP_PX;
        let area = Rect { left: LEFT_PX, top, width: inner_px(), height: panel.height_px };
        dropped += draw_panel(&mut svg, area, panel, common_x);
        top += panel.height_px + TICKS_PX;
    }
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Middle, weight: 400 };
    let middle = LEFT_PX + inner_px() / 2.0;
    svg.text((middle, top + 6.0), &style, &strip.x_name);
    canvas::close_at(svg, WIDTH_PX, height_px, dropped)
}

const fn inner_px() -> f64 {
    WIDTH_PX - LEFT_PX - RIGHT_PX
}

fn draw_title(svg: &mut Svg, title: &str) {
    let style = TextStyle { size_px: 15.0, color: INK, anchor: Anchor::Start, weight: 700 };
    svg.text((10.0, 24.0), &style, &canvas::truncate(title, TITLE_CHARACTERS));
}

fn legend_entries(panel: &StripPanel) -> Vec<LegendEntry> {
    let named = panel.curves.iter().filter(|curve| !curve.name.is_empty());
    named.map(|curve| LegendEntry::new(legend_mark(curve.style, &curve.shape), &curve.name)).collect()
}

/// What all panels that are no maps span along x.
fn common_x(strip: &StripChart) -> Option<ValueRange> {
    let over_time = strip.panels.iter().filter(|panel| panel.scales == AxisScaling::Independent);
    let nothing = Rect { left: 0.0, top: 0.0, width: 1.0, height: 1.0 };
    let spans = over_time
        .filter(|panel| panel.curves.iter().any(|curve| has_points(&curve.shape)))
        .map(|panel| panel_of(nothing, shapes(panel), AxisScaling::Independent).x);
    let ends: Vec<f64> = spans.flat_map(|span| [span.low, span.high]).collect();
    ValueRange::of(ends.into_iter())
}

/// Whether a shape lies anywhere along x.
const fn has_points(shape: &CurveShape) -> bool {
    match shape {
        CurveShape::Line(points)
        | CurveShape::Dots(points)
        | CurveShape::Crosses(points)
        | CurveShape::Rings(points)
        | CurveShape::Specks(points) => !points.is_empty(),
        CurveShape::Band(places) => !places.is_empty(),
        CurveShape::Outlines(outlines) => !outlines.is_empty(),
        CurveShape::Level(_) => false,
    }
}

fn shapes(panel: &StripPanel) -> impl Iterator<Item = &CurveShape> {
    panel.curves.iter().map(|curve| &curve.shape)
}

/// Returns how many values were left out.
fn draw_panel(svg: &mut Svg, area: Rect, panel: &StripPanel, common_x: Option<ValueRange>) -> usize {
    let mut axes: PlotPanel = panel_of(area, shapes(panel), panel.scales);
    if panel.scales == AxisScaling::Independent {
        axes.x = common_x.map_or(axes.x, |x| with_margin(x, 0.0));
        axes.y = panel.y.unwrap_or(axes.y);
    }
    let y_ticks = if panel.height_px < 80.0 { 3.0 } else { Y_TICKS };
    axes.draw_grid(svg, &round_ticks(axes.x, X_TICKS), &round_ticks(axes.y, y_ticks));
    let thinning =
        if panel.scales == AxisScaling::Equal { CurveDownsampling::Deviation } else { CurveDownsampling::Series };
    let mut dropped = 0;
    svg.clip(&area, "curves", |svg| {
        for curve in &panel.curves {
            dropped += draw_shape(svg, &axes, curve.style, thinning, &curve.shape);
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
    use super::super::palette::{BLUE, ESTIMATE};
    use super::*;

    const INK_OF_TEST: CurveStyle = CurveStyle { stroke: &ESTIMATE, color: BLUE };

    fn strip(shapes: Vec<CurveShape>) -> StripChart {
        let panels = shapes.into_iter().map(|shape| StripPanel {
            y_name: "value".to_owned(),
            height_px: 100.0,
            curves: vec![StyledCurve::new("curve", shape, INK_OF_TEST)],
            ..StripPanel::default()
        });
        StripChart { title: "a <b>".to_owned(), x_name: "time [s]".to_owned(), panels: panels.collect() }
    }

    #[test]
    fn panels_share_the_time_and_each_has_its_legend() {
        let svg = render_strip(&strip(vec![
            CurveShape::Line(vec![(0.0, 1.0), (10.0, 2.0)]),
            CurveShape::Specks(vec![(40.0, 3.0)]),
        ]));
        assert_eq!(svg.matches(">curve</text>").count(), 2);
        // Both reach to 40 s.
        assert_eq!(svg.matches(">40</text>").count(), 2, "{svg}");
        assert!(svg.contains("a &lt;b&gt;") && !svg.contains("<b>"));
    }

    #[test]
    fn a_panel_without_anything_says_so() {
        let svg = render_strip(&strip(vec![CurveShape::Line(Vec::new())]));
        assert!(svg.contains("nothing to show") && !svg.contains("NaN"));
        let level = render_strip(&strip(vec![CurveShape::Level(1.0)]));
        assert!(level.contains("nothing to show"));
    }

    #[test]
    fn ten_minutes_at_a_hundred_hertz_take_little_room() {
        let noisy = |step: u32| f64::from(step * 7919 % 1009) / 1009.0;
        let samples = || (0..60_000).map(|step| (f64::from(step) / 100.0, noisy(step)));
        let band = samples().map(|(t, v)| (t, v - 1.0, v + 1.0)).collect();
        let svg = render_strip(&strip(vec![
            CurveShape::Line(samples().collect()),
            CurveShape::Specks(samples().collect()),
            CurveShape::Band(band),
        ]));
        assert!(svg.len() < 150_000, "{} bytes", svg.len());
    }
}
