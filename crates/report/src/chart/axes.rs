//! Common parts of all figures: the sheet, axes from data to pixels with grid and ticks, legends, colours.
//!
//! A logarithmic axis is a linear one whose data are logarithms.

pub(super) use super::svg::FAINT_INK;
use super::svg::{Anchor, BACKGROUND, PixelPoint, Rect, Stroke, Svg, TextStyle};

const TICK_TEXT_PX: f64 = 12.0;
const AXIS_TEXT_PX: f64 = 13.0;

/// Margin around the data on an equal-scale panel, relative to the data's extent.
const MARGIN: f64 = 0.06;

/// Least extent of an equal-scale panel: a robot at rest still gets a readable axis.
const MIN_EXTENT_M: f64 = 0.1;

/// In data units; `low` is below `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ValueRange {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl ValueRange {
    /// The smallest range that contains all values; `None` without values.
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        values.fold(None, |range: Option<Self>, value| {
            Some(range.map_or(Self { low: value, high: value }, |range| Self {
                low: range.low.min(value),
                high: range.high.max(value),
            }))
        })
    }

    pub(super) fn around(middle: f64, extent: f64) -> Self {
        Self { low: middle - extent / 2.0, high: middle + extent / 2.0 }
    }

    pub(super) const fn extent(self) -> f64 {
        self.high - self.low
    }

    pub(super) fn contains(self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }

    fn widened_to(self, extent: f64) -> Self {
        Self::around(f64::midpoint(self.low, self.high), extent)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    pub(super) at: f64,
    pub(super) label: String,
}

/// Ticks at multiples of 1, 2 or 5 times a power of ten, about `target_count` of them.
pub(super) fn round_ticks(range: ValueRange, target_count: f64) -> Vec<Tick> {
    let raw = range.extent() / target_count;
    let power = raw.log10().floor();
    let decade = 10_f64.powf(power);
    let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| factor * decade >= raw);
    let step = factor.unwrap_or(10.0) * decade;
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (range.low / step).ceil();
    let last = (range.high / step).floor();
    if !(last - first).is_finite() {
        return Vec::new();
    }
    // A round step gives at most 2.5 times the wanted number; the cap guards against a range lost in rounding.
    let count = (last - first + 1.0).clamp(0.0, 4.0 * target_count) as u32;
    (0..count)
        .map(|index| {
            let at = (first + f64::from(index)) * step + 0.0; // + 0.0 turns -0 into 0
            Tick { at, label: format!("{at:.decimals$}") }
        })
        .collect()
}

/// A rectangle of the picture with a data range along each side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlotPanel {
    pub(super) area: Rect,
    pub(super) x: ValueRange,
    pub(super) y: ValueRange,
}

impl PlotPanel {
    /// A panel with equal scales in x and y that contains both ranges with a margin.
    pub(super) fn equal_scale(area: Rect, x: ValueRange, y: ValueRange) -> Self {
        let stretch = 1.0 + 2.0 * MARGIN;
        let least_m = MIN_EXTENT_M / area.width.min(area.height);
        let m_per_px = (x.extent() * stretch / area.width).max(y.extent() * stretch / area.height).max(least_m);
        Self { area, x: x.widened_to(m_per_px * area.width), y: y.widened_to(m_per_px * area.height) }
    }

    pub(super) fn to_pixels(self, x: f64, y: f64) -> PixelPoint {
        let along_x = (x - self.x.low) / self.x.extent();
        let along_y = (y - self.y.low) / self.y.extent();
        (self.area.left + along_x * self.area.width, self.area.bottom() - along_y * self.area.height)
    }

    pub(super) fn draw_grid(&self, svg: &mut Svg, x_ticks: &[Tick], y_ticks: &[Tick]) {
        let style = |anchor| TextStyle { size_px: TICK_TEXT_PX, color: FAINT_INK, anchor, weight: 400 };
        for tick in x_ticks {
            let (x, _) = self.to_pixels(tick.at, self.y.low);
            svg.line((x, self.area.top), (x, self.area.bottom()), &GRID);
            svg.text((x, self.area.bottom() + 16.0), &style(Anchor::Middle), &tick.label);
        }
        for tick in y_ticks {
            let (_, y) = self.to_pixels(self.x.low, tick.at);
            svg.line((self.area.left, y), (self.area.right(), y), &GRID);
            svg.text((self.area.left - 7.0, y + 4.0), &style(Anchor::End), &tick.label);
        }
    }

    pub(super) fn draw_border(&self, svg: &mut Svg) {
        svg.rect(&self.area, &BORDER);
    }

    pub(super) fn draw_names(&self, svg: &mut Svg, x_name: &str, y_name: &str) {
        let style = TextStyle { size_px: AXIS_TEXT_PX, color: INK, anchor: Anchor::Middle, weight: 400 };
        let middle_x = self.area.left + self.area.width / 2.0;
        let middle_y = self.area.top + self.area.height / 2.0;
        svg.text((middle_x, self.area.bottom() + 34.0), &style, x_name);
        svg.upright_text((self.area.left - 48.0, middle_y), &style, y_name);
    }
}

/// Width of every figure: what a page on a code host shows without shrinking.
pub(super) const WIDTH_PX: f64 = 900.0;

/// Left edge of every panel; leaves room for tick labels.
pub(super) const LEFT_PX: f64 = 72.0;

/// Longer titles are cut; more characters do not fit.
const TITLE_CHARACTERS: usize = 72;

/// An empty sheet with a title and a line of key figures below it.
pub(super) fn open_sheet(title: &str, figures: &str, height_px: f64) -> Svg {
    let mut svg = Svg::new(WIDTH_PX, height_px, title);
    let heading = TextStyle { size_px: 19.0, color: INK, anchor: Anchor::Start, weight: 700 };
    let line = TextStyle { size_px: 13.5, color: FAINT_INK, weight: 400, ..heading };
    svg.text((LEFT_PX, 32.0), &heading, &truncate(title, TITLE_CHARACTERS));
    svg.text((LEFT_PX, 54.0), &line, figures);
    svg
}

pub(super) fn truncate(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let start: String = text.chars().take(most.saturating_sub(1)).collect();
    start + "…"
}

const ROW_PX: f64 = 22.0;
const SAMPLE_PX: f64 = 30.0;
/// Between a sample and its text, and between two entries of a row.
const TEXT_GAP_PX: f64 = 7.0;
const ENTRY_GAP_PX: f64 = 18.0;
/// Mean width of a 13 pixel character of Latin text in the figures' fonts.
const CHARACTER_PX: f64 = 6.6;

#[derive(Clone, Copy, Debug)]
pub(super) enum LegendMark {
    Line(&'static Stroke),
    Area(&'static Stroke),
    Disc(&'static str),
    Cross(&'static Stroke),
    Ring(&'static Stroke),
    Start,
}

#[derive(Clone, Debug)]
pub(super) struct LegendEntry {
    pub(super) mark: LegendMark,
    pub(super) label: String,
}

impl LegendEntry {
    pub(super) fn new(mark: LegendMark, label: impl Into<String>) -> Self {
        Self { mark, label: label.into() }
    }
}

pub(super) fn draw_legend(svg: &mut Svg, top_left: PixelPoint, entries: &[LegendEntry]) {
    let mut y = top_left.1 + ROW_PX / 2.0;
    for entry in entries {
        draw_entry(svg, (top_left.0, y), 10.0, entry);
        y += ROW_PX;
    }
}

fn draw_entry(svg: &mut Svg, at: PixelPoint, gap_px: f64, entry: &LegendEntry) {
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Start, weight: 400 };
    draw_sample(svg, at, entry.mark);
    svg.text((at.0 + SAMPLE_PX + gap_px, at.1 + 4.5), &style, &entry.label);
}

fn draw_sample(svg: &mut Svg, at: PixelPoint, mark: LegendMark) {
    let (left, y) = at;
    let middle = (left + SAMPLE_PX / 2.0, y);
    match mark {
        LegendMark::Line(stroke) => svg.line((left, y), (left + SAMPLE_PX, y), stroke),
        LegendMark::Area(stroke) => {
            let corners: Vec<PixelPoint> = (0..32)
                .map(|corner| {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(corner) / 32.0).sin_cos();
                    (middle.0 + SAMPLE_PX / 2.0 * cos, y + 7.0 * sin)
                })
                .collect();
            svg.polygon(&corners, stroke.color, FILL_OPACITY, Some(stroke));
        }
        LegendMark::Disc(fill) => svg.disc(middle, 3.0, fill, None),
        LegendMark::Cross(stroke) => svg.cross(middle, 4.0, stroke),
        LegendMark::Ring(stroke) => svg.disc(middle, 3.5, "none", Some(stroke)),
        LegendMark::Start => draw_start(svg, middle),
    }
}

/// Draws the entries from left to right, with a line break where the next does not fit; returns the height of all rows.
pub(super) fn draw_legend_rows(svg: &mut Svg, top_left: PixelPoint, width_px: f64, entries: &[LegendEntry]) -> f64 {
    for (entry, (right, down)) in entries.iter().zip(entry_positions(width_px, entries)) {
        draw_entry(svg, (top_left.0 + right, top_left.1 + down), TEXT_GAP_PX, entry);
    }
    legend_height_px(width_px, entries)
}

/// Height of [`draw_legend_rows`].
pub(super) fn legend_height_px(width_px: f64, entries: &[LegendEntry]) -> f64 {
    let last = entry_positions(width_px, entries).last().copied();
    last.map_or(0.0, |(_, down)| down + ROW_PX / 2.0)
}

/// Positions of the entries, from the top left corner to the middle of their left edge.
fn entry_positions(width_px: f64, entries: &[LegendEntry]) -> Vec<PixelPoint> {
    let (mut right, mut down) = (0.0, ROW_PX / 2.0);
    let position = |entry: &LegendEntry| {
        let text_px = entry.label.chars().count() as f64 * CHARACTER_PX;
        let entry_px = SAMPLE_PX + TEXT_GAP_PX + text_px;
        if right > 0.0 && right + entry_px > width_px {
            (right, down) = (0.0, down + ROW_PX);
        }
        let position = (right, down);
        right += entry_px + ENTRY_GAP_PX;
        position
    };
    entries.iter().map(position).collect()
}

pub(super) fn draw_start(svg: &mut Svg, at: PixelPoint) {
    let outline = Stroke::solid(INK, 2.0);
    svg.disc(at, 6.5, BACKGROUND, Some(&outline));
    svg.disc(at, 2.2, INK, None);
}

// The colours and strokes of the figures.
//
// The colours are those of M. Okabe and K. Ito, Color Universal Design (2008), which stay apart for colour-blind
// readers. Each layer also differs in line style or mark, so that a grey print can be read.

pub(super) const BLACK: &str = "#000000";
pub(super) const ORANGE: &str = "#E69F00";
pub(super) const SKY_BLUE: &str = "#56B4E9";
pub(super) const BLUISH_GREEN: &str = "#009E73";
pub(super) const BLUE: &str = "#0072B2";
pub(super) const VERMILLION: &str = "#D55E00";
pub(super) const REDDISH_PURPLE: &str = "#CC79A7";

pub(super) const INK: &str = "#222222";

pub(super) const GRID: Stroke = Stroke::solid("#E6E6E6", 1.0);
pub(super) const BORDER: Stroke = Stroke::solid("#888888", 1.0);
pub(super) const DETAIL_FRAME: Stroke = Stroke::solid(INK, 1.0);
pub(super) const IDEAL: Stroke = Stroke::dashed("#8C8C8C", 1.3, "7 5");
pub(super) const TRUTH: Stroke = Stroke::solid(BLACK, 2.6);
pub(super) const ODOMETRY: Stroke = Stroke::dashed(VERMILLION, 1.8, "9 2.5");
pub(super) const ESTIMATE: Stroke = Stroke::solid(BLUE, 1.5);
pub(super) const SMOOTHED: Stroke = Stroke::dashed(ORANGE, 1.8, "3 2.5");
/// Of compared filters, in their order; the ninth is like the first.
const COMPARED: [Stroke; 8] = [
    Stroke::solid(ORANGE, 1.4),
    Stroke::solid(BLUISH_GREEN, 1.4),
    Stroke::solid(REDDISH_PURPLE, 1.4),
    Stroke::solid(SKY_BLUE, 1.4),
    Stroke::dashed(ORANGE, 1.4, "6 3"),
    Stroke::dashed(BLUISH_GREEN, 1.4, "6 3"),
    Stroke::dashed(REDDISH_PURPLE, 1.4, "6 3"),
    Stroke::dashed(SKY_BLUE, 1.4, "6 3"),
];

pub(super) const fn compared_stroke(index: usize) -> &'static Stroke {
    &COMPARED[index % COMPARED.len()]
}

pub(super) const ELLIPSE: Stroke = Stroke::solid(SKY_BLUE, 0.9);
pub(super) const CLAIM: Stroke = Stroke::solid(SKY_BLUE, 1.1);
pub(super) const REJECTED: Stroke = Stroke::solid(REDDISH_PURPLE, 1.6);
pub(super) const LATE: Stroke = Stroke::solid(ORANGE, 1.4);
/// The 95 % interval.
pub(super) const EXPECTED: Stroke = Stroke::dashed(FAINT_INK, 1.1, "5 3");
pub(super) const MEAN: Stroke = Stroke::solid(VERMILLION, 1.8);

pub(super) const FILL_OPACITY: f64 = 0.25;

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: Rect = Rect { left: 50.0, top: 20.0, width: 600.0, height: 300.0 };

    fn range(low: f64, high: f64) -> ValueRange {
        ValueRange { low, high }
    }

    #[test]
    fn a_metre_is_as_long_in_x_as_in_y() {
        for (x, y) in [
            (range(0.0, 12.0), range(0.0, 3.0)),
            (range(-1.0, 0.0), range(5.0, 25.0)),
            (range(2.0, 2.0), range(3.0, 3.0)),
        ] {
            let panel = PlotPanel::equal_scale(AREA, x, y);
            let origin = panel.to_pixels(x.low, y.low);
            let right = panel.to_pixels(x.low + 1.0, y.low).0 - origin.0;
            let up = origin.1 - panel.to_pixels(x.low, y.low + 1.0).1;
            assert!((right / up - 1.0).abs() < 1e-9, "{right} {up}");
            let far = panel.to_pixels(x.high, y.high);
            assert!(far.0 <= AREA.right() && far.1 >= AREA.top && far.0 >= AREA.left);
        }
    }

    #[test]
    fn ticks_stand_at_round_numbers_inside_the_range() {
        let labels = |low, high| -> Vec<String> {
            let ticks = round_ticks(range(low, high), 5.0);
            ticks.into_iter().map(|tick| tick.label).collect()
        };
        assert_eq!(labels(-0.1, 1.1), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(0.0, 9.0), ["0", "2", "4", "6", "8"]);
        assert_eq!(labels(-0.03, 0.02), ["-0.03", "-0.02", "-0.01", "0.00", "0.01", "0.02"]);
    }

    #[test]
    fn a_range_without_extent_or_beyond_all_bounds_makes_no_endless_ticks() {
        assert!(round_ticks(range(5.0, 5.0), 5.0).len() <= 20);
        assert!(round_ticks(range(1e15, 1e15 + 1.0), 5.0).len() <= 20);
        assert!(round_ticks(range(-f64::MAX, f64::MAX), 5.0).len() <= 20);
    }

    #[test]
    fn a_long_title_is_cut_between_characters() {
        assert_eq!(truncate(&"ä".repeat(200), 72).chars().count(), 72);
        assert_eq!(truncate("short", 72), "short");
    }
}
