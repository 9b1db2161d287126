//! The brick's clock against the host's over time.

use super::super::plot::CurveShape;
use super::super::strip::{StripChart, StripPanel, StyledCurve, render_strip};
use super::{CLAIM_STYLE, ClockSample, ESTIMATE_STYLE, curve_style, range_from_zero};

const HEIGHT_PX: f64 = 100.0;
const S_TO_MS: f64 = 1e3;

/// Draws how the offset changed, the skew and the uncertainty; returns a whole SVG document.
pub fn render_clock(title: &str, samples: &[ClockSample]) -> String {
    render_strip(&StripChart {
        title: title.to_owned(),
        x_name: "time [s]".to_owned(),
        panels: vec![offset(samples), skew(samples), uncertainty(samples)],
    })
}

/// The change, because the offset itself is as large as the brick has been running.
fn offset(samples: &[ClockSample]) -> StripPanel {
    let first_s = samples.first().map_or(0.0, |first| first.offset_s);
    let change_ms = |sample: &ClockSample| (sample.offset_s - first_s) * S_TO_MS;
    let line = samples.iter().map(|one| (one.t_s, change_ms(one)));
    let band = samples.iter().map(|one| {
        let (middle, reach) = (change_ms(one), one.uncertainty_s * S_TO_MS);
        (one.t_s, middle - reach, middle + reach)
    });
    StripPanel {
        y_name: "[ms]".to_owned(),
        height_px: HEIGHT_PX,
        curves: vec![
            StyledCurve::new("its bounds", CurveShape::Band(band.collect()), CLAIM_STYLE),
            StyledCurve::new("change of the offset", CurveShape::Line(line.collect()), ESTIMATE_STYLE),
        ],
        ..StripPanel::default()
    }
}

fn skew(samples: &[ClockSample]) -> StripPanel {
    let line = samples.iter().map(|one| (one.t_s, one.skew_ppm));
    StripPanel {
        y_name: "[ppm]".to_owned(),
        height_px: HEIGHT_PX,
        curves: vec![StyledCurve::new(
            "the brick's clock is fast by",
            CurveShape::Line(line.collect()),
            curve_style(3),
        )],
        ..StripPanel::default()
    }
}

fn uncertainty(samples: &[ClockSample]) -> StripPanel {
    let bound = samples.iter().map(|one| (one.t_s, one.uncertainty_s * S_TO_MS));
    let round_trip = samples.iter().filter_map(|one| Some((one.t_s, one.round_trip_s? * S_TO_MS)));
    let round_trip: Vec<(f64, f64)> = round_trip.collect();
    let sizes: Vec<f64> = bound.clone().chain(round_trip.iter().copied()).map(|one| one.1).collect();
    StripPanel {
        y_name: "[ms]".to_owned(),
        height_px: HEIGHT_PX,
        y: range_from_zero(sizes.into_iter()),
        curves: vec![
            StyledCurve::new("round trip", CurveShape::Specks(round_trip), ESTIMATE_STYLE),
            StyledCurve::new("uncertainty", CurveShape::Line(bound.collect()), curve_style(1)),
        ],
        ..StripPanel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_is_shown_as_its_change() {
        let samples = [(0.0, 5000.0), (10.0, 5000.02)].map(|(t_s, offset_s)| ClockSample {
            t_s,
            offset_s,
            skew_ppm: 2000.0,
            uncertainty_s: 0.000_5,
            round_trip_s: None,
        });
        let svg = render_clock("clock", &samples);
        assert!(svg.contains(">20</text>") && svg.contains(">change of the offset</text>"), "{svg}");
        assert!(!svg.contains("5000"), "{svg}");
    }
}
