//! What the filter learned of the robot over time, each number with two standard deviations.

use super::super::plot::Shape;
use super::super::strip::{Inked, Strip, StripPanel, draw};
use super::{INK_OF_CLAIM, INK_OF_ESTIMATE, LearnedSeries, shown_unit};

const HEIGHT_PX: f64 = 92.0;

/// Draws a panel for each; returns a whole SVG document.
#[must_use]
pub fn learning(title: &str, all: &[LearnedSeries<'_>]) -> String {
    draw(&Strip { title: title.to_owned(), x_name: "time [s]".to_owned(), panels: all.iter().map(panel).collect() })
}

fn panel(series: &LearnedSeries<'_>) -> StripPanel {
    let (unit, factor) = shown_unit(series.key);
    let value = series.samples.iter().map(|one| (one.t_s, one.value * factor));
    let band = series.samples.iter().map(|one| {
        let (value, reach) = (one.value * factor, 2.0 * one.sigma * factor);
        (one.t_s, value - reach, value + reach)
    });
    StripPanel {
        y_name: format!("[{unit}]"),
        height_px: HEIGHT_PX,
        curves: vec![
            Inked::new("2 sigma", Shape::Band(band.collect()), INK_OF_CLAIM),
            Inked::new(series.key, Shape::Line(value.collect()), INK_OF_ESTIMATE),
        ],
        ..StripPanel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::LearnedSample;
    use super::*;

    #[test]
    fn a_bias_is_shown_in_degrees_with_its_band() {
        let samples =
            [0.0, 10.0].map(|t_s| LearnedSample { t_s, value: 1f64.to_radians(), sigma: 0.5f64.to_radians() });
        let svg = learning("robot", &[LearnedSeries { key: "gyro_bias_rad_per_s", samples: &samples }]);
        assert!(svg.contains("[deg/s]") && svg.contains(">2.0</text>"), "{svg}");
    }
}
