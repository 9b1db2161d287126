//! The brick's clock against the host's over time.

use super::super::plot::Shape;
use super::super::strip::{Inked, Strip, StripPanel, draw};
use super::{ClockSample, INK_OF_CLAIM, INK_OF_ESTIMATE, ink, upward};

const HEIGHT_PX: f64 = 100.0;
const S_TO_MS: f64 = 1e3;

/// Draws how the offset changed, the skew and the uncertainty; returns a whole SVG document.
#[must_use]
pub fn clock(title: &str, samples: &[ClockSample]) -> String {
    draw(&Strip {
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
            Inked::new("its bounds", Shape::Band(band.collect()), INK_OF_CLAIM),
            Inked::new("change of the offset", Shape::Line(line.collect()), INK_OF_ESTIMATE),
        ],
        ..StripPanel::default()
    }
}

fn skew(samples: &[ClockSample]) -> StripPanel {
    let line = samples.iter().map(|one| (one.t_s, one.skew_ppm));
    StripPanel {
        y_name: "[ppm]".to_owned(),
        height_px: HEIGHT_PX,
        curves: vec![Inked::new("the brick's clock is fast by", Shape::Line(line.collect()), ink(3))],
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
        y: upward(sizes.into_iter()),
        curves: vec![
            Inked::new("round trip", Shape::Specks(round_trip), INK_OF_ESTIMATE),
            Inked::new("uncertainty", Shape::Line(bound.collect()), ink(1)),
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
        let svg = clock("clock", &samples);
        assert!(svg.contains(">20</text>") && svg.contains(">change of the offset</text>"), "{svg}");
        assert!(!svg.contains("5000"), "{svg}");
    }
}
