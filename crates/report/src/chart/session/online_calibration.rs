//! What the filter learned of the robot over time, each number with two standard deviations.

use super::super::plot::CurveShape;
use super::super::strip::{StripChart, StripPanel, StyledCurve, render_strip};
use super::{CLAIM_STYLE, CalibrationSeries, ESTIMATE_STYLE, display_unit};

const HEIGHT_PX: f64 = 92.0;

/// Draws a panel for each; returns a whole SVG document.
pub fn learning(title: &str, all: &[CalibrationSeries<'_>]) -> String {
    render_strip(&StripChart {
        title: title.to_owned(),
        x_name: "time [s]".to_owned(),
        panels: all.iter().map(panel).collect(),
    })
}

fn panel(series: &CalibrationSeries<'_>) -> StripPanel {
    let (unit, factor) = display_unit(series.key);
    let value = series.samples.iter().map(|one| (one.t_s, one.value * factor));
    let band = series.samples.iter().map(|one| {
        let (value, reach) = (one.value * factor, 2.0 * one.sigma * factor);
        (one.t_s, value - reach, value + reach)
    });
    StripPanel {
        y_name: format!("[{unit}]"),
        height_px: HEIGHT_PX,
        curves: vec![
            StyledCurve::new("2 sigma", CurveShape::Band(band.collect()), CLAIM_STYLE),
            StyledCurve::new(series.key, CurveShape::Line(value.collect()), ESTIMATE_STYLE),
        ],
        ..StripPanel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::CalibrationSample;
    use super::*;

    #[test]
    fn a_bias_is_shown_in_degrees_with_its_band() {
        let samples =
            [0.0, 10.0].map(|t_s| CalibrationSample { t_s, value: 1f64.to_radians(), sigma: 0.5f64.to_radians() });
        let svg = learning("robot", &[CalibrationSeries { key: "gyro_bias_rad_per_s", samples: &samples }]);
        assert!(svg.contains("[deg/s]") && svg.contains(">2.0</text>"), "{svg}");
    }
}
