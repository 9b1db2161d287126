//! Comparison of estimators over many scenarios: one small panel per scenario, one line per estimator.
//!
//! ```text
//! dot       root mean square position error, on a logarithmic axis that all panels share
//! diamond   what the estimator claims: sqrt(mean(P_xx + P_yy))
//! between   red where the claim is smaller than the error, blue where it is larger
//! ```
//! The numbers stand beside the marks, so that the picture can be read without the table.

use super::axes::{BLUE, FAINT_INK, GRID, INK, PlotPanel, SKY_BLUE, Tick, VERMILLION, ValueRange};
use super::svg::{Anchor, BACKGROUND, PixelPoint, Rect, Stroke, Svg, TextStyle};
use crate::tables::{millimetres_three_digits, three_digits};

/// True and claimed error of one estimator in one scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct AccuracyMark {
    pub name: String,
    /// Root mean square position error; `None` is not drawn.
    pub rms_m: Option<f64>,
    /// Root mean square position error by the claimed covariance.
    pub claimed_m: Option<f64>,
    /// Average normalised estimation error squared over 3.
    pub anees: Option<f64>,
}

/// One scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct AccuracyPanel {
    /// Scenario name and further text.
    pub title: String,
    pub marks: Vec<AccuracyMark>,
}

/// One panel per scenario with the errors of all estimators.
#[derive(Clone, Debug, PartialEq)]
pub struct AccuracyChart {
    pub title: String,
    /// Row by row, two per row.
    pub panels: Vec<AccuracyPanel>,
}

const WIDTH_PX: f64 = 1200.0;
const MARGIN_PX: f64 = 24.0;
const HEAD_PX: f64 = 92.0;
const COLUMNS: usize = 2;
const COLUMN_PX: f64 = (WIDTH_PX - 2.0 * MARGIN_PX) / COLUMNS as f64;
/// From a panel's top to its first line, and from its last line to the next panel.
const PANEL_HEAD_PX: f64 = 26.0;
const PANEL_FOOT_PX: f64 = 40.0;
const LINE_PX: f64 = 18.0;
/// Names left of the axis, numbers right of it.
const NAMES_PX: f64 = 136.0;
const NUMBERS_PX: f64 = 176.0;
const NUMBER_PX: f64 = 54.0;

/// Axis limits as powers of ten of metres (0.1 mm and 1 km); errors beyond are drawn at the edge.
const DECADES: ValueRange = ValueRange { low: -4.0, high: 3.0 };

const TOO_SMALL: Stroke = Stroke::solid(VERMILLION, 2.4);
const TOO_LARGE: Stroke = Stroke::solid(SKY_BLUE, 2.4);
const CLAIM_OUTLINE: Stroke = Stroke::solid(INK, 1.2);

pub fn render_accuracy_chart(chart: &AccuracyChart) -> String {
    let axis = decade_range(chart);
    let heights: Vec<f64> = chart
        .panels
        .chunks(COLUMNS)
        .map(|row| {
            let lines = row.iter().map(|panel| panel.marks.len()).max().unwrap_or(0);
            PANEL_HEAD_PX + lines as f64 * LINE_PX + PANEL_FOOT_PX
        })
        .collect();
    let height_px = HEAD_PX + heights.iter().sum::<f64>() + MARGIN_PX / 2.0;
    let mut svg = Svg::new(WIDTH_PX, height_px, &chart.title);
    draw_head(&mut svg, &chart.title);
    let mut top = HEAD_PX;
    for (row, height_px) in chart.panels.chunks(COLUMNS).zip(heights) {
        for (column, panel) in row.iter().enumerate() {
            let left = MARGIN_PX + column as f64 * COLUMN_PX;
            draw_panel(&mut svg, left, top, panel, axis);
        }
        top += height_px;
    }
    svg.finish(0)
}

/// The decades that contain every error and claim, at least two.
fn decade_range(chart: &AccuracyChart) -> ValueRange {
    let marks = chart.panels.iter().flat_map(|panel| &panel.marks);
    let values = marks
        .flat_map(|mark| [mark.rms_m, mark.claimed_m])
        .flatten()
        .filter(|metres| *metres > 0.0)
        .map(|metres| metres.log10().clamp(DECADES.low, DECADES.high));
    let range = ValueRange::of(values).unwrap_or(ValueRange { low: -3.0, high: 0.0 });
    let low = range.low.floor();
    ValueRange { low, high: range.high.ceil().max(low + 2.0) }
}

const fn style(size_px: f64, color: &'static str, anchor: Anchor, weight: u16) -> TextStyle {
    TextStyle { size_px, color, anchor, weight }
}

fn draw_head(svg: &mut Svg, title: &str) {
    svg.text((MARGIN_PX, 34.0), &style(20.0, INK, Anchor::Start, 700), title);
    let words = style(13.5, INK, Anchor::Start, 400);
    let y = 62.0;
    let mut x = MARGIN_PX + 6.0;
    svg.disc((x, y), 4.5, BLUE, None);
    svg.text((x + 12.0, y + 4.5), &words, "root mean square position error");
    x += 244.0;
    draw_claim(svg, (x, y));
    svg.text((x + 12.0, y + 4.5), &words, "what the estimator claims it is");
    x += 240.0;
    svg.line((x, y), (x + 26.0, y), &TOO_SMALL);
    svg.text((x + 34.0, y + 4.5), &words, "claims too little");
    x += 152.0;
    svg.line((x, y), (x + 26.0, y), &TOO_LARGE);
    svg.text((x + 34.0, y + 4.5), &words, "claims too much");
}

fn draw_panel(svg: &mut Svg, left: f64, top: f64, panel: &AccuracyPanel, axis: ValueRange) {
    let lines = panel.marks.len() as f64;
    let axes = PlotPanel {
        area: Rect {
            left: left + NAMES_PX,
            top: top + PANEL_HEAD_PX,
            width: COLUMN_PX - NAMES_PX - NUMBERS_PX,
            height: lines * LINE_PX,
        },
        x: axis,
        y: ValueRange { low: 0.0, high: lines.max(1.0) },
    };
    let heading = style(14.5, INK, Anchor::Start, 700);
    svg.text((left, top + 12.0), &heading, &panel.title);
    axes.draw_grid(svg, &decade_ticks(axis), &[]);
    let faint = style(11.0, FAINT_INK, Anchor::End, 400);
    for (column, name) in ["rms mm", "claim", "ANEES"].into_iter().enumerate() {
        let x = number_right(&axes, column);
        svg.text((x, axes.area.top - 6.0), &faint, name);
    }
    for (index, mark) in panel.marks.iter().enumerate() {
        let y = axes.area.top + (index as f64 + 0.5) * LINE_PX;
        draw_mark(svg, &axes, y, mark);
    }
    axes.draw_border(svg);
}

fn number_right(axes: &PlotPanel, column: usize) -> f64 {
    axes.area.right() + (column + 1) as f64 * NUMBER_PX
}

fn draw_mark(svg: &mut Svg, axes: &PlotPanel, y: f64, mark: &AccuracyMark) {
    let name = style(12.5, INK, Anchor::End, 400);
    svg.text((axes.area.left - 8.0, y + 4.2), &name, &mark.name);
    svg.line((axes.area.left, y), (axes.area.right(), y), &GRID);
    let pixel_x = |metres: f64| {
        let decade = metres.log10().clamp(axes.x.low, axes.x.high);
        axes.to_pixels(decade, 0.0).0
    };
    let positive = |metres: &f64| *metres > 0.0;
    let error_x = mark.rms_m.filter(positive).map(pixel_x);
    let claim_x = mark.claimed_m.filter(positive).map(pixel_x);
    if let (Some(error), Some(claim)) = (error_x, claim_x) {
        let stroke = if claim < error { &TOO_SMALL } else { &TOO_LARGE };
        svg.line((claim, y), (error, y), stroke);
    }
    if let Some(x) = claim_x {
        draw_claim(svg, (x, y));
    }
    if let Some(x) = error_x {
        svg.disc((x, y), 4.5, BLUE, None);
    }
    let bold = style(12.5, INK, Anchor::End, 700);
    let plain = style(12.5, FAINT_INK, Anchor::End, 400);
    let cells = [
        (&bold, millimetres_three_digits(mark.rms_m)),
        (&plain, millimetres_three_digits(mark.claimed_m)),
        (&plain, three_digits(mark.anees)),
    ];
    for (column, (style, cell)) in cells.into_iter().enumerate() {
        svg.text((number_right(axes, column), y + 4.2), style, &cell);
    }
}

fn draw_claim(svg: &mut Svg, at: PixelPoint) {
    const HALF_SIZE_PX: f64 = 5.2;
    let (x, y) = at;
    let corners = [(x - HALF_SIZE_PX, y), (x, y - HALF_SIZE_PX), (x + HALF_SIZE_PX, y), (x, y + HALF_SIZE_PX)];
    svg.polygon(&corners, BACKGROUND, 1.0, Some(&CLAIM_OUTLINE));
}

fn decade_ticks(range: ValueRange) -> Vec<Tick> {
    let decades = range.low as i32..=range.high as i32;
    decades
        .map(|decade| Tick {
            at: f64::from(decade),
            label: match decade {
                ..-3 => format!("{} mm", 10_f64.powi(decade + 3)),
                -3..0 => format!("{:.0} mm", 10_f64.powi(decade + 3)),
                _ => format!("{:.0} m", 10_f64.powi(decade)),
            },
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mark(rms_m: Option<f64>, claimed_m: Option<f64>) -> AccuracyMark {
        AccuracyMark { name: "pose <1>".to_owned(), rms_m, claimed_m, anees: Some(1.04) }
    }

    fn chart(marks: Vec<AccuracyMark>) -> AccuracyChart {
        let panel = AccuracyPanel { title: "no-camera".to_owned(), marks };
        AccuracyChart { title: "Accuracy".to_owned(), panels: vec![panel] }
    }

    #[test]
    fn the_axis_holds_errors_and_claims_in_whole_decades() {
        for (rms_m, claimed_m, decades) in [
            (Some(0.224), Some(0.0044), (-3.0, 0.0)),
            (Some(f64::MAX), Some(0.0), (3.0, 5.0)),
            (None, None, (-3.0, 0.0)),
        ] {
            let range = decade_range(&chart(vec![mark(rms_m, claimed_m)]));
            assert_eq!((range.low, range.high), decades);
        }
    }

    #[test]
    fn a_claim_below_the_error_is_red_and_one_above_is_blue() {
        let red = render_accuracy_chart(&chart(vec![mark(Some(0.2), Some(0.1))]));
        let blue = render_accuracy_chart(&chart(vec![mark(Some(0.1), Some(0.2))]));
        // One of each stands in the legend.
        assert_eq!((red.matches(VERMILLION).count(), red.matches(SKY_BLUE).count()), (2, 1));
        assert_eq!((blue.matches(VERMILLION).count(), blue.matches(SKY_BLUE).count()), (1, 2));
    }

    #[test]
    fn names_are_escaped_and_values_that_are_not_there_leave_no_mark() {
        let text = render_accuracy_chart(&chart(vec![mark(None, None)]));
        assert!(text.contains("pose &lt;1&gt;") && text.ends_with("</svg>\n"));
        // Two marks of the legend are all.
        assert_eq!((text.matches("<circle").count(), text.matches("<polygon").count()), (1, 1));
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }
}
