//! How far off the estimate was over time, and how far it claimed to be.

use super::super::plot::CurveShape;
use super::super::strip::{StripChart, StripPanel, StyledCurve, render_strip};
use super::{CLAIM_STYLE, ESTIMATE_STYLE, ErrorSample, range_from_zero, symmetric_range};

const HEIGHT_PX: f64 = 150.0;
const M_TO_MM: f64 = 1e3;

/// Draws position and heading error with the estimate's 2-sigma claims; returns a whole SVG document.
pub fn render_errors(title: &str, samples: &[ErrorSample]) -> String {
    render_strip(&StripChart {
        title: title.to_owned(),
        x_name: "time [s]".to_owned(),
        panels: vec![position(samples), heading(samples)],
    })
}

fn position(samples: &[ErrorSample]) -> StripPanel {
    let error = samples.iter().map(|sample| (sample.t_s, sample.position_m * M_TO_MM));
    let claim = samples.iter().map(|sample| (sample.t_s, 0.0, sample.position_claim_m * M_TO_MM));
    StripPanel {
        y_name: "position error [mm]".to_owned(),
        height_px: HEIGHT_PX,
        y: range_from_zero(
            samples.iter().flat_map(|sample| [sample.position_m, sample.position_claim_m]).map(|size| size * M_TO_MM),
        ),
        curves: curves(claim.collect(), error.collect()),
        ..StripPanel::default()
    }
}

/// A heading that may not be used has no error.
fn heading(samples: &[ErrorSample]) -> StripPanel {
    let known = || samples.iter().filter(|sample| sample.heading_rad.is_finite());
    let error = known().map(|sample| (sample.t_s, sample.heading_rad.to_degrees()));
    let claim = known().map(|sample| {
        let claim = sample.heading_claim_rad.to_degrees();
        (sample.t_s, -claim, claim)
    });
    StripPanel {
        y_name: "heading error [deg]".to_owned(),
        height_px: HEIGHT_PX,
        y: symmetric_range(
            known().flat_map(|sample| [sample.heading_rad, sample.heading_claim_rad]).map(f64::to_degrees),
        ),
        curves: curves(claim.collect(), error.collect()),
        ..StripPanel::default()
    }
}

/// A claim as a band, over it the error.
fn curves(claim: Vec<(f64, f64, f64)>, error: Vec<(f64, f64)>) -> Vec<StyledCurve> {
    vec![
        StyledCurve::new("its 2-sigma claim", CurveShape::Band(claim), CLAIM_STYLE),
        StyledCurve::new("error", CurveShape::Line(error), ESTIMATE_STYLE),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_in_millimetres_and_degrees() {
        let sample = |t_s: f64| ErrorSample {
            t_s,
            position_m: 0.004,
            position_claim_m: 0.008,
            heading_rad: 0.01,
            heading_claim_rad: 0.02,
        };
        let svg = render_errors("run", &[sample(0.0), sample(5.0)]);
        let unknown = ErrorSample { heading_rad: f64::NAN, ..sample(6.0) };
        assert!(!render_errors("run", &[sample(0.0), unknown]).contains("left out"));
        // The claims reach 8 mm and 1.1 degrees.
        assert!(svg.contains(">8</text>") && svg.contains(">1</text>"), "{svg}");
        assert_eq!(svg.matches("<polygon").count(), 4, "two bands, two legends");
        assert!(render_errors("none", &[]).contains("nothing to show"));
    }
}
