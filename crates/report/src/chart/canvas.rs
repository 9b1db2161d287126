//! The sheet of every figure: size, title, key figures, and the note about what was left out.

use super::layers::RunLayers;
use super::palette::{FAINT_INK, INK};
use super::svg::{Anchor, Svg, TextStyle};
use crate::metrics::{ErrorSummary, errors_of_estimates, errors_of_track, summarise};

/// Width of every figure, in pixels: what a page on a code host shows without shrinking.
pub(super) const WIDTH_PX: f64 = 900.0;

/// Left edge of everything, in pixels; leaves room for tick labels.
pub(super) const LEFT_PX: f64 = 72.0;

/// Longer titles are cut, in characters; more do not fit.
const TITLE_CHARACTERS: usize = 72;

/// An empty sheet with the title of a run and its key figures.
pub(super) fn open_figure(layers: &RunLayers<'_>, height_px: f64) -> Svg {
    open_sheet(layers.title, &key_figures(layers), height_px)
}

/// An empty sheet with a title and a line of figures below it.
pub(super) fn open_sheet(title: &str, figures: &str, height_px: f64) -> Svg {
    let mut svg = Svg::new(WIDTH_PX, height_px, title);
    let heading = TextStyle { size_px: 19.0, color: INK, anchor: Anchor::Start, weight: 700 };
    let line = TextStyle { size_px: 13.5, color: FAINT_INK, weight: 400, ..heading };
    svg.text((LEFT_PX, 32.0), &heading, &shorten_title(title));
    svg.text((LEFT_PX, 54.0), &line, figures);
    svg
}

/// Closes the sheet, with a note if values were left out.
pub(super) fn close_figure(svg: Svg, height_px: f64, dropped: usize) -> String {
    close_at(svg, WIDTH_PX, height_px, dropped)
}

/// The same for a sheet of another width.
pub(super) fn close_at(mut svg: Svg, width_px: f64, height_px: f64, dropped: usize) -> String {
    if dropped > 0 {
        let style = TextStyle { size_px: 12.0, color: FAINT_INK, anchor: Anchor::End, weight: 400 };
        let note = format!("left out: {dropped} values that are not finite or out of reach");
        svg.text((width_px - 20.0, height_px - 8.0), &style, &note);
    }
    svg.finish()
}

fn shorten_title(title: &str) -> String {
    truncate(title, TITLE_CHARACTERS)
}

/// A text of at most this number of characters; what is longer ends in an ellipsis.
pub(super) fn truncate(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let start: String = text.chars().take(most.saturating_sub(1)).collect();
    start + "…"
}

fn key_figures(layers: &RunLayers<'_>) -> String {
    let Some(truth) = layers.truth else {
        return "no truth known: errors cannot be told".to_owned();
    };
    let odometry = layers.odometry.map(|track| summarise(&errors_of_track(track, truth))).unwrap_or_default();
    let estimate = summarise(&errors_of_estimates(layers.estimates, truth));
    let mut parts = Vec::new();
    parts.extend(error_text("odometry", &odometry));
    parts.extend(error_text("estimate", &estimate));
    parts.extend(gain_text(&odometry, &estimate));
    parts.extend(estimate.anees.map(|anees| format!("ANEES {anees:.2}")));
    parts.join("   ·   ")
}

fn error_text(name: &str, errors: &ErrorSummary) -> Option<String> {
    let (rms_m, end_m) = (errors.position_rms_m?, errors.position_end_m?);
    Some(format!("{name}: rms {}, end {}", length_text(rms_m), length_text(end_m)))
}

fn gain_text(odometry: &ErrorSummary, estimate: &ErrorSummary) -> Option<String> {
    let ratio = odometry.position_rms_m? / estimate.position_rms_m?;
    (ratio.is_finite() && ratio >= 1.0).then(|| format!("{ratio:.1} times better"))
}

/// A length for people: millimetres up to ten metres.
fn length_text(length_m: f64) -> String {
    if length_m < 0.010 {
        format!("{:.1} mm", length_m * 1e3)
    } else if length_m < 10.0 {
        format!("{:.0} mm", length_m * 1e3)
    } else {
        format!("{length_m:.3e} m")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_read_well_at_every_size() {
        assert_eq!(length_text(0.001_33), "1.3 mm");
        assert_eq!(length_text(0.397), "397 mm");
        assert_eq!(length_text(1e300), "1.000e300 m");
    }

    #[test]
    fn a_long_title_is_cut_between_characters() {
        let title = "ä".repeat(200);
        assert_eq!(shorten_title(&title).chars().count(), TITLE_CHARACTERS);
        assert_eq!(shorten_title("short"), "short");
    }
}
