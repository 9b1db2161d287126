//! One set of axes: from data to pixels, with grid, ticks and labels.
//!
//! It knows ranges and pixels, not what the data mean; a logarithmic axis is a linear one whose data are logarithms.

use super::palette::{BORDER, FAINT_INK, GRID, INK};
use super::svg::{Anchor, PixelPoint, Rect, Svg, TextStyle};

const TICK_TEXT_PX: f64 = 12.0;
const AXIS_TEXT_PX: f64 = 13.0;

/// Room around the data on an equal-scale panel, as a share of the data's extent.
const MARGIN: f64 = 0.06;

/// The least extent of an equal-scale panel, in metres: a robot at rest still gets a readable axis.
const MIN_EXTENT_M: f64 = 0.1;

/// What an axis spans, in data units; `low` is below `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ValueRange {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl ValueRange {
    /// The smallest range that holds all values; `None` of nothing.
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        values.fold(None, |range: Option<Self>, value| {
            Some(range.map_or(Self { low: value, high: value }, |range| Self {
                low: range.low.min(value),
                high: range.high.max(value),
            }))
        })
    }

    /// The range of this extent around a middle.
    pub(super) fn around(middle: f64, extent: f64) -> Self {
        Self { low: middle - extent / 2.0, high: middle + extent / 2.0 }
    }

    pub(super) const fn extent(self) -> f64 {
        self.high - self.low
    }

    pub(super) fn contains(self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }

    /// The range of this extent around the same middle.
    fn widened_to(self, extent: f64) -> Self {
        Self::around(f64::midpoint(self.low, self.high), extent)
    }
}

/// A mark on an axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    pub(super) at: f64,
    pub(super) label: String,
}

/// Ticks at multiples of 1, 2 or 5 times a power of ten, about `wanted` of them.
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

/// A rectangle of the picture with a range along each side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlotPanel {
    pub(super) area: Rect,
    pub(super) x: ValueRange,
    pub(super) y: ValueRange,
}

impl PlotPanel {
    /// A panel on which one metre is as long in x as in y, and which holds both ranges with a margin.
    pub(super) fn equal_scale(area: Rect, x: ValueRange, y: ValueRange) -> Self {
        let stretch = 1.0 + 2.0 * MARGIN;
        let least_m = MIN_EXTENT_M / area.width.min(area.height);
        let m_per_px = (x.extent() * stretch / area.width).max(y.extent() * stretch / area.height).max(least_m);
        Self { area, x: x.widened_to(m_per_px * area.width), y: y.widened_to(m_per_px * area.height) }
    }

    /// Where a data point stands in the picture.
    pub(super) fn to_pixels(self, x: f64, y: f64) -> PixelPoint {
        let along_x = (x - self.x.low) / self.x.extent();
        let along_y = (y - self.y.low) / self.y.extent();
        (self.area.left + along_x * self.area.width, self.area.bottom() - along_y * self.area.height)
    }

    /// Grid lines and tick labels; drawn before the data.
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

    /// The border; drawn after the data.
    pub(super) fn draw_border(&self, svg: &mut Svg) {
        svg.rect(&self.area, &BORDER);
    }

    /// The names of the axes, below and on the left.
    pub(super) fn draw_names(&self, svg: &mut Svg, x_name: &str, y_name: &str) {
        let style = TextStyle { size_px: AXIS_TEXT_PX, color: INK, anchor: Anchor::Middle, weight: 400 };
        let middle_x = self.area.left + self.area.width / 2.0;
        let middle_y = self.area.top + self.area.height / 2.0;
        svg.text((middle_x, self.area.bottom() + 34.0), &style, x_name);
        svg.upright_text((self.area.left - 48.0, middle_y), &style, y_name);
    }
}

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
}
