//! Curves over common axes with a legend, for experiments that are not about one drive.
//!
//! A plot has one or more panels below each other. Non-finite values split a curve and are counted.

use super::axes;
use super::axes::{
    BLACK, BLUE, BLUISH_GREEN, FILL_OPACITY, LegendEntry, LegendMark, ORANGE, PlotPanel, REDDISH_PURPLE, SKY_BLUE,
    VERMILLION, ValueRange, round_ticks,
};
use super::layers::{MAX_COORDINATE_M, downsample_by_deviation, downsample_path, downsample_series};
use super::svg::{PixelPoint, Rect, Stroke, Svg};

const TOP_PX: f64 = 70.0;
/// Space below each panel, for its ticks and the name of its axis.
const FOOT_PX: f64 = 62.0;
const PANEL_WIDTH_PX: f64 = 590.0;
/// Margin above and below the values, relative to their range.
const MARGIN: f64 = 0.05;
const X_TICKS: f64 = 8.0;
const Y_TICKS: f64 = 6.0;

/// Strokes of the curves in order, with the colours of their discs and fills; repeats for further curves.
const STROKES: [Stroke; 7] = [
    Stroke::solid(BLACK, 2.0),
    Stroke::dashed(VERMILLION, 1.6, "9 2.5"),
    Stroke::solid(BLUE, 1.6),
    Stroke::dashed(BLUISH_GREEN, 1.6, "5 3"),
    Stroke::dashed(ORANGE, 1.8, "3 2.5"),
    Stroke::solid(REDDISH_PURPLE, 1.6),
    Stroke::solid(SKY_BLUE, 1.6),
];

/// A figure of one or more panels below each other.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    pub title: String,
    pub key_figures: String,
    pub axes: Vec<Axes>,
}

impl Plot {
    pub fn new(title: impl Into<String>, key_figures: impl Into<String>, axes: Vec<Axes>) -> Self {
        Self { title: title.into(), key_figures: key_figures.into(), axes }
    }
}

/// One panel of a plot: axes and curves.
#[derive(Clone, Debug, Default)]
pub struct Axes {
    pub(super) x_name: String,
    pub(super) y_name: String,
    pub(super) height_px: f64,
    pub(super) scaling: AxisScaling,
    /// Range of the y axis; `None` for that of the curves.
    pub(super) y: Option<ValueRange>,
    /// Later ones are drawn over earlier ones.
    pub(super) curves: Vec<Curve>,
}

impl Axes {
    /// The names of the axes include their units, as in `time [s]`.
    pub fn new(
        x_name: impl Into<String>,
        y_name: impl Into<String>,
        height_px: f64,
        curves: impl IntoIterator<Item = Curve>,
    ) -> Self {
        let curves = curves.into_iter().collect();
        Self { x_name: x_name.into(), y_name: y_name.into(), height_px, curves, ..Self::default() }
    }

    pub fn with_equal_scales(self) -> Self {
        Self { scaling: AxisScaling::Equal, ..self }
    }
}

/// A drawn shape with its name in the legend; an empty name has no entry in a narrow figure.
#[derive(Clone, Debug)]
pub struct Curve {
    pub(super) name: String,
    pub(super) shape: CurveShape,
    /// `None` for the stroke of its index.
    pub(super) stroke: Option<&'static Stroke>,
}

impl Curve {
    /// A curve with the stroke of its index.
    pub fn new(name: impl Into<String>, shape: CurveShape) -> Self {
        Self { name: name.into(), shape, stroke: None }
    }

    pub fn line(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, CurveShape::Line(points.into_iter().collect()))
    }

    pub fn dots(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, CurveShape::Dots(points.into_iter().collect()))
    }

    pub(super) fn with_stroke(self, stroke: &'static Stroke) -> Self {
        Self { stroke: Some(stroke), ..self }
    }
}

/// Coordinates are in the units of the axes.
#[derive(Clone, Debug)]
pub enum CurveShape {
    Line(Vec<(f64, f64)>),
    Dots(Vec<(f64, f64)>),
    /// An area between two values: x, lower, upper.
    Band(Vec<(f64, f64, f64)>),
    Level(f64),
    Crosses(Vec<(f64, f64)>),
    Rings(Vec<(f64, f64)>),
    /// Closed shapes, lightly filled.
    Outlines(Vec<Vec<(f64, f64)>>),
    /// Very many small dots.
    Specks(Vec<(f64, f64)>),
}

/// How lines are thinned below the visible resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CurveDownsampling {
    /// Drops points next to the last kept one.
    Near,
    /// Drops points on the line between their neighbours: for paths on a map.
    Deviation,
    /// Keeps the extremes of each pixel column, and of those the points off the line: for values over time.
    Series,
}

impl CurveDownsampling {
    fn downsample(self, points: &[PixelPoint]) -> Vec<PixelPoint> {
        match self {
            Self::Near => downsample_path(points),
            Self::Deviation => downsample_by_deviation(points, DEVIATION_PX),
            Self::Series => downsample_by_deviation(&downsample_series(points), DEVIATION_PX),
        }
    }

    /// An edge of an area; [`Self::Near`] leaves it unchanged.
    fn downsample_edge(self, points: Vec<PixelPoint>) -> Vec<PixelPoint> {
        match self {
            Self::Near => points,
            Self::Deviation | Self::Series => self.downsample(&points),
        }
    }
}

/// A smaller deviation is invisible on any screen.
const DEVIATION_PX: f64 = 0.12;

pub(super) const fn curve_stroke(index: usize) -> &'static Stroke {
    &STROKES[index % STROKES.len()]
}

pub fn render_plot(plot: &Plot) -> String {
    let heights = plot.axes.iter().map(|axes| axes.height_px + FOOT_PX);
    let height_px = TOP_PX + heights.sum::<f64>();
    let mut svg = axes::open_sheet(&plot.title, &plot.key_figures, height_px);
    let mut top = TOP_PX;
    let mut dropped = 0;
    for axes in &plot.axes {
        let area = Rect { left: axes::LEFT_PX, top, width: PANEL_WIDTH_PX, height: axes.height_px };
        dropped += draw_axes(&mut svg, area, axes);
        top += axes.height_px + FOOT_PX;
    }
    svg.finish(dropped)
}

/// Draws one panel with its legend; returns the number of omitted values.
fn draw_axes(svg: &mut Svg, area: Rect, axes: &Axes) -> usize {
    let panel = panel_of(area, axes);
    panel.draw_grid(svg, &round_ticks(panel.x, X_TICKS), &round_ticks(panel.y, Y_TICKS));
    let mut dropped = 0;
    svg.clip(&area, "curves", |svg| {
        for (index, curve) in axes.curves.iter().enumerate() {
            dropped += draw_shape(svg, &panel, curve_stroke(index), CurveDownsampling::Near, &curve.shape);
        }
    });
    panel.draw_border(svg);
    panel.draw_names(svg, &axes.x_name, &axes.y_name);
    let entries: Vec<LegendEntry> = axes
        .curves
        .iter()
        .enumerate()
        .map(|(index, curve)| LegendEntry::new(legend_mark(curve_stroke(index), &curve.shape), &curve.name))
        .collect();
    axes::draw_legend(svg, (area.right() + 22.0, area.top), &entries);
    dropped
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum AxisScaling {
    /// Equal scales, as on a map.
    Equal,
    /// Each axis fills its side of the panel.
    #[default]
    Independent,
}

pub(super) fn panel_of(area: Rect, axes: &Axes) -> PlotPanel {
    let corners: Vec<(f64, f64)> = axes.curves.iter().flat_map(|curve| corners(&curve.shape)).collect();
    let unit = ValueRange { low: 0.0, high: 1.0 };
    let drawn = |value: &f64| value.is_finite() && value.abs() <= MAX_COORDINATE_M;
    let x = ValueRange::of(corners.iter().map(|(x, _)| *x).filter(drawn)).unwrap_or(unit);
    let y = ValueRange::of(corners.iter().map(|(_, y)| *y).filter(drawn)).unwrap_or(unit);
    if axes.scaling == AxisScaling::Equal {
        return PlotPanel::equal_scale(area, x, y);
    }
    PlotPanel { area, x: with_margin(x, 0.0), y: with_margin(y, MARGIN) }
}

/// Adds a margin; a range without extent is widened by its own size, or by one.
pub(super) fn with_margin(range: ValueRange, margin: f64) -> ValueRange {
    let middle = f64::midpoint(range.low, range.high);
    if range.extent() > 0.0 {
        return ValueRange::around(middle, range.extent() * (1.0 + 2.0 * margin));
    }
    ValueRange::around(middle, if middle == 0.0 { 1.0 } else { middle.abs() })
}

/// The points that the panel must contain. A level has no x and crosses may lie anywhere, so they add none.
fn corners(shape: &CurveShape) -> Vec<(f64, f64)> {
    match shape {
        CurveShape::Line(points)
        | CurveShape::Dots(points)
        | CurveShape::Rings(points)
        | CurveShape::Specks(points) => points.clone(),
        CurveShape::Crosses(_) | CurveShape::Outlines(_) => Vec::new(),
        CurveShape::Band(band_points) => {
            band_points.iter().flat_map(|(x, low, high)| [(*x, *low), (*x, *high)]).collect()
        }
        CurveShape::Level(y) => vec![(f64::NAN, *y)],
    }
}

fn is_drawable(point: &(f64, f64)) -> bool {
    let (x, y) = point;
    x.abs() <= MAX_COORDINATE_M && y.abs() <= MAX_COORDINATE_M
}

/// Draws one shape; returns the number of omitted values.
pub(super) fn draw_shape(
    svg: &mut Svg,
    panel: &PlotPanel,
    stroke: &'static Stroke,
    thinning: CurveDownsampling,
    shape: &CurveShape,
) -> usize {
    let pixels_of =
        |points: &[(f64, f64)]| -> Vec<PixelPoint> { points.iter().map(|(x, y)| panel.to_pixels(*x, *y)).collect() };
    let left_out = |points: &[(f64, f64)]| points.iter().filter(|point| !is_drawable(point)).count();
    match shape {
        CurveShape::Line(points) => {
            for part in points.split(|point| !is_drawable(point)) {
                svg.polyline(&thinning.downsample(&pixels_of(part)), stroke);
            }
            left_out(points)
        }
        CurveShape::Dots(points) | CurveShape::Crosses(points) | CurveShape::Rings(points) => {
            for point in points.iter().filter(|point| is_drawable(point)) {
                draw_mark(svg, panel.to_pixels(point.0, point.1), stroke, shape);
            }
            left_out(points)
        }
        CurveShape::Specks(points) => {
            let drawn: Vec<(f64, f64)> = points.iter().copied().filter(is_drawable).collect();
            svg.specks(&pixels_of(&drawn), stroke.color);
            points.len() - drawn.len()
        }
        CurveShape::Band(band_points) => draw_band(svg, panel, stroke, thinning, band_points),
        CurveShape::Level(y) => {
            let ends = [(panel.x.low, *y), (panel.x.high, *y)];
            svg.polyline(&pixels_of(&ends), stroke);
            usize::from(!is_drawable(&(0.0, *y)))
        }
        CurveShape::Outlines(outlines) => {
            let is_drawn = |outline: &&Vec<(f64, f64)>| outline.iter().all(is_drawable);
            for outline in outlines.iter().filter(is_drawn) {
                svg.polygon(&pixels_of(outline), stroke.color, FILL_OPACITY, Some(stroke));
            }
            outlines.iter().filter(|outline| !is_drawn(outline)).count()
        }
    }
}

fn draw_mark(svg: &mut Svg, at: PixelPoint, stroke: &'static Stroke, shape: &CurveShape) {
    match shape {
        CurveShape::Crosses(_) => svg.cross(at, 3.5, stroke),
        CurveShape::Rings(_) => svg.disc(at, 3.5, "none", Some(stroke)),
        CurveShape::Line(_)
        | CurveShape::Dots(_)
        | CurveShape::Band(_)
        | CurveShape::Level(_)
        | CurveShape::Specks(_)
        | CurveShape::Outlines(_) => {
            svg.disc(at, 2.6, stroke.color, None);
        }
    }
}

fn draw_band(
    svg: &mut Svg,
    panel: &PlotPanel,
    stroke: &'static Stroke,
    thinning: CurveDownsampling,
    band_points: &[(f64, f64, f64)],
) -> usize {
    let is_drawn = |(x, low, high): &(f64, f64, f64)| is_drawable(&(*x, *low)) && is_drawable(&(*x, *high));
    for part in band_points.split(|point| !is_drawn(point)) {
        let lower = part.iter().map(|(x, low, _)| panel.to_pixels(*x, *low));
        let upper = part.iter().map(|(x, _, high)| panel.to_pixels(*x, *high));
        let mut outline = thinning.downsample_edge(lower.collect());
        outline.extend(thinning.downsample_edge(upper.collect()).into_iter().rev());
        svg.polygon(&outline, stroke.color, FILL_OPACITY, None);
    }
    band_points.iter().filter(|point| !is_drawn(point)).count()
}

pub(super) const fn legend_mark(stroke: &'static Stroke, shape: &CurveShape) -> LegendMark {
    match shape {
        CurveShape::Line(_) | CurveShape::Level(_) => LegendMark::Line(stroke),
        CurveShape::Dots(_) | CurveShape::Specks(_) => LegendMark::Disc(stroke.color),
        CurveShape::Crosses(_) => LegendMark::Cross(stroke),
        CurveShape::Rings(_) => LegendMark::Ring(stroke),
        CurveShape::Band(_) | CurveShape::Outlines(_) => LegendMark::Area(stroke),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(curves: Vec<(&str, CurveShape)>) -> Plot {
        let curves = curves.into_iter().map(|(name, shape)| Curve::new(name, shape));
        Plot::new("t", "", vec![Axes::new("time [s]", "value", 200.0, curves)])
    }

    #[test]
    fn every_shape_is_drawn_once_with_its_name() {
        let svg = render_plot(&of(vec![
            ("measured", CurveShape::Dots(vec![(0.0, 1.0), (1.0, 2.0)])),
            ("fitted", CurveShape::Line(vec![(0.0, 1.0), (1.0, 2.0)])),
            ("2 sigma", CurveShape::Band(vec![(0.0, 0.5, 1.5), (1.0, 1.5, 2.5)])),
            ("final", CurveShape::Level(3.0)),
        ]));
        let count = |needle: &str| svg.matches(needle).count();
        // Two of the data and one of the legend.
        assert_eq!(count("<circle"), 3);
        assert_eq!(count("<polygon"), 2);
        for name in ["measured", "fitted", "2 sigma", "final"] {
            assert_eq!(count(&format!(">{name}</text>")), 1, "{name}");
        }
        assert!(!svg.contains("left out"));
    }

    #[test]
    fn what_is_not_finite_splits_a_line_and_is_counted() {
        let points = [1.0, 2.0, f64::NAN, 4.0, f64::INFINITY, 1e300, 7.0, 8.0];
        let line = (0..).map(f64::from).zip(points).collect();
        let svg = render_plot(&of(vec![("a", CurveShape::Line(line))]));
        assert!(svg.contains("left out: 3 values"), "{svg}");
        let curves = svg.split("id=\"curves\"").nth(1).unwrap();
        let curves = curves.split("</g>").next().unwrap();
        assert_eq!(curves.matches("<polyline").count(), 2);
    }

    #[test]
    fn nothing_and_a_single_value_still_have_axes() {
        for shape in [CurveShape::Line(Vec::new()), CurveShape::Level(0.0), CurveShape::Dots(vec![(5.0, 5.0)])] {
            let svg = render_plot(&of(vec![("a", shape)]));
            assert!(!svg.contains("NaN") && svg.contains("time [s]"));
        }
    }
}
