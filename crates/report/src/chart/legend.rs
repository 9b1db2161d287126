//! The legend: a sample of each layer's mark with its name, in a column outside of the data.

use super::palette::{FILL_OPACITY, INK};
use super::svg::{Anchor, BACKGROUND, PixelPoint, Stroke, Svg, TextStyle};

const ROW_PX: f64 = 22.0;
const SAMPLE_PX: f64 = 30.0;
/// Between a sample and its text, and between two entries of a row.
const TEXT_GAP_PX: f64 = 7.0;
const ENTRY_GAP_PX: f64 = 18.0;
/// Width of a character of 13 pixels, on average over Latin text in the figures' fonts.
const CHARACTER_PX: f64 = 6.6;

/// How a layer is marked.
#[derive(Clone, Copy, Debug)]
pub(super) enum LegendMark {
    Line(&'static Stroke),
    Area(&'static Stroke, &'static str),
    Disc(&'static str),
    Cross(&'static Stroke),
    Ring(&'static Stroke),
    Start,
}

/// One row of the legend.
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

/// Draws the rows downward from the top left corner.
pub(super) fn draw(svg: &mut Svg, top_left: PixelPoint, entries: &[LegendEntry]) {
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Start, weight: 400 };
    let (left, mut y) = (top_left.0, top_left.1 + ROW_PX / 2.0);
    for entry in entries {
        draw_sample(svg, (left, y), entry.mark);
        svg.text((left + SAMPLE_PX + 10.0, y + 4.5), &style, &entry.label);
        y += ROW_PX;
    }
}

fn draw_sample(svg: &mut Svg, at: PixelPoint, mark: LegendMark) {
    let (left, y) = at;
    let middle = (left + SAMPLE_PX / 2.0, y);
    match mark {
        LegendMark::Line(stroke) => svg.line((left, y), (left + SAMPLE_PX, y), stroke),
        LegendMark::Area(stroke, fill) => {
            let corners: Vec<PixelPoint> = (0..32)
                .map(|corner| {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(corner) / 32.0).sin_cos();
                    (middle.0 + SAMPLE_PX / 2.0 * cos, y + 7.0 * sin)
                })
                .collect();
            svg.polygon(&corners, fill, FILL_OPACITY, Some(stroke));
        }
        LegendMark::Disc(fill) => svg.disc(middle, 3.0, fill, None),
        LegendMark::Cross(stroke) => svg.cross(middle, 4.0, stroke),
        LegendMark::Ring(stroke) => svg.disc(middle, 3.5, "none", Some(stroke)),
        LegendMark::Start => draw_start(svg, middle),
    }
}

/// Draws the entries from left to right, and in a new row where the next one has no room; returns the height of all rows.
pub(super) fn draw_rows(svg: &mut Svg, top_left: PixelPoint, width_px: f64, entries: &[LegendEntry]) -> f64 {
    let style = TextStyle { size_px: 13.0, color: INK, anchor: Anchor::Start, weight: 400 };
    for (entry, (right, down)) in entries.iter().zip(entry_positions(width_px, entries)) {
        let (left, y) = (top_left.0 + right, top_left.1 + down);
        draw_sample(svg, (left, y), entry.mark);
        let text = (left + SAMPLE_PX + TEXT_GAP_PX, y + 4.5);
        svg.text(text, &style, &entry.label);
    }
    rows_height_px(width_px, entries)
}

/// The height that [`draw_rows`] takes.
pub(super) fn rows_height_px(width_px: f64, entries: &[LegendEntry]) -> f64 {
    let last = entry_positions(width_px, entries).last().copied();
    last.map_or(0.0, |(_, down)| down + ROW_PX / 2.0)
}

/// Where the entries stand, from the top left corner to the middle of their left edge.
fn entry_positions(width_px: f64, entries: &[LegendEntry]) -> Vec<PixelPoint> {
    let (mut right, mut down) = (0.0, ROW_PX / 2.0);
    let place = |entry: &LegendEntry| {
        let text_px = entry.label.chars().count() as f64 * CHARACTER_PX;
        let entry_px = SAMPLE_PX + TEXT_GAP_PX + text_px;
        if right > 0.0 && right + entry_px > width_px {
            (right, down) = (0.0, down + ROW_PX);
        }
        let place = (right, down);
        right += entry_px + ENTRY_GAP_PX;
        place
    };
    entries.iter().map(place).collect()
}

/// The mark of the start, in the legend as on the panel.
pub(super) fn draw_start(svg: &mut Svg, at: PixelPoint) {
    let outline = Stroke::solid(INK, 2.0);
    svg.disc(at, 6.5, BACKGROUND, Some(&outline));
    svg.disc(at, 2.2, INK, None);
}
