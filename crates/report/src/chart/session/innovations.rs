//! The innovations of one sensor with their claimed deviation, and their NIS with its expected band.
//!
//! # Model
//! ```text
//! nu +- 2 sqrt(S_ii)                                     per component
//! NIS / m    between chi2(0.025, m) / m and chi2(0.975, m) / m in 95 of 100 cases
//! mean of W  between chi2(0.025, W m) / (W m) and chi2(0.975, W m) / (W m) likewise
//! ```

use posebridge_estimator::numerics::chi_square::chi_square_quantile;

use super::{InnovationSample, InnovationSeries, panel, symmetric_range};
use crate::chart::axes::{CLAIM, ESTIMATE, EXPECTED, MEAN, REJECTED, ValueRange};
use crate::chart::plot::{Axes, Curve, CurveShape};
use crate::chart::strip::render_strip;
use crate::metrics::ConsistencyBand;

/// Number of NIS values in an average: with two degrees of freedom the band is ±20 % wide.
const WINDOW_SAMPLES: usize = 50;
/// The NIS axis ends slightly above this quantile.
const NIS_AXIS_QUANTILE: f64 = 0.999;
const ABOVE_AXIS_FACTOR: f64 = 1.12;
const HEIGHT_PX: f64 = 105.0;
const NIS_HEIGHT_PX: f64 = 130.0;

pub fn render_innovations(series: &InnovationSeries<'_>) -> String {
    let degrees = most_common_degrees(series.samples);
    let names = components(series.kind);
    let mut panels: Vec<Axes> = (0..usize::from(degrees).min(names.len()))
        .map(|component| {
            let (name, factor) = names[component];
            innovation_panel(series.samples, component, name, factor)
        })
        .collect();
    panels.push(nis_panel(series.samples, degrees));
    render_strip(series.name, &panels)
}

/// Names of a kind's components with display units, and the factors from SI.
fn components(kind: &str) -> [(&'static str, f64); 3] {
    let degrees = 1f64.to_degrees();
    match kind {
        "fix" | "odometer_pose" => [("x [mm]", 1e3), ("y [mm]", 1e3), ("heading [deg]", degrees)],
        "beacon_range" | "wall_range" => [("range [mm]", 1e3), ("-", 1.0), ("-", 1.0)],
        "landmark" => [("range [mm]", 1e3), ("bearing [deg]", degrees), ("-", 1.0)],
        "compass_heading" => [("heading [deg]", degrees), ("-", 1.0), ("-", 1.0)],
        // What these filters compare differs from one to the next: angles of wheels, speeds, turns within a window.
        _ => [("first [SI]", 1.0), ("second [SI]", 1.0), ("third [SI]", 1.0)],
    }
}

/// The most common degrees of freedom; 0 without samples.
fn most_common_degrees(samples: &[InnovationSample]) -> u8 {
    let count = |degrees: u8| {
        let has = |sample: &&InnovationSample| sample.degrees_of_freedom == degrees;
        samples.iter().filter(has).count()
    };
    let all = [1_u8, 2, 3].map(|degrees| (count(degrees), degrees));
    let most = all.into_iter().max_by_key(|(count, _)| *count);
    most.filter(|(count, _)| *count > 0).map_or(0, |(_, degrees)| degrees)
}

fn innovation_panel(samples: &[InnovationSample], component: usize, name: &str, factor: f64) -> Axes {
    let has = |sample: &&InnovationSample| usize::from(sample.degrees_of_freedom) > component;
    let value = |sample: &InnovationSample| sample.innovation[component] * factor;
    let claim = |sample: &InnovationSample| 2.0 * sample.sigma[component] * factor;
    let used = || samples.iter().filter(has).filter(|sample| sample.is_used);
    let gated = samples.iter().filter(has).filter(|sample| !sample.is_used);
    let gated: Vec<(f64, f64)> = gated.map(|sample| (sample.t_s, value(sample))).collect();
    let band = used().map(|sample| (sample.t_s, -claim(sample), claim(sample)));
    let points = used().map(|sample| (sample.t_s, value(sample)));
    let mut curves = vec![
        Curve::new("2 sigma", CurveShape::Band(band.collect())).with_stroke(&CLAIM),
        Curve::new("used", CurveShape::Specks(points.collect())).with_stroke(&ESTIMATE),
    ];
    if !gated.is_empty() {
        curves.push(Curve::new("gated", CurveShape::Crosses(gated)).with_stroke(&REJECTED));
    }
    panel(name, HEIGHT_PX, symmetric_range(used().flat_map(|sample| [value(sample), claim(sample)])), curves)
}

fn nis_panel(samples: &[InnovationSample], degrees: u8) -> Axes {
    let m = u64::from(degrees);
    let per_degree = |probability| if m > 0 { chi_square_quantile(m, probability) / m as f64 } else { 1.0 };
    let top = per_degree(NIS_AXIS_QUANTILE) * ABOVE_AXIS_FACTOR;
    let ratio = |sample: &InnovationSample| {
        // What lies above the panel is shown on its edge.
        (sample.nis / f64::from(sample.degrees_of_freedom)).min(top * 0.985)
    };
    let has = |sample: &&InnovationSample| sample.degrees_of_freedom > 0;
    let of = |is_used: bool| -> Vec<(f64, f64)> {
        let these = samples.iter().filter(has);
        let these = these.filter(|sample| sample.is_used == is_used);
        these.map(|sample| (sample.t_s, ratio(sample))).collect()
    };
    let (used, gated) = (of(true), of(false));
    let mean = windowed_mean(samples);
    let mut curves = Vec::new();
    if let (Some((from, _)), Some((to, _)), Some(band)) =
        (mean.first(), mean.last(), ConsistencyBand::of_mean(m * WINDOW_SAMPLES as u64))
    {
        let bounds = vec![(*from, band.low, band.high), (*to, band.low, band.high)];
        curves.push(Curve::new("due for the mean", CurveShape::Band(bounds)).with_stroke(&CLAIM));
    }
    curves.push(Curve::new("each", CurveShape::Specks(used)).with_stroke(&ESTIMATE));
    if !gated.is_empty() {
        curves.push(Curve::new("gated", CurveShape::Crosses(gated)).with_stroke(&REJECTED));
    }
    if !mean.is_empty() {
        let name = format!("mean of {WINDOW_SAMPLES}");
        curves.push(Curve::line(name, mean).with_stroke(&MEAN));
    }
    if m > 0 {
        let (low, high) = (per_degree(0.025), per_degree(0.975));
        curves.push(Curve::new("95 % of each", CurveShape::Level(high)).with_stroke(&EXPECTED));
        curves.push(Curve::new("", CurveShape::Level(low)).with_stroke(&EXPECTED));
    }
    panel("NIS / dof", NIS_HEIGHT_PX, Some(ValueRange { low: 0.0, high: top }), curves)
}

/// Mean NIS per degree of freedom of the used samples, over a window that ends at each.
fn windowed_mean(samples: &[InnovationSample]) -> Vec<(f64, f64)> {
    let is_part =
        |sample: &&InnovationSample| sample.is_used && sample.degrees_of_freedom > 0 && sample.nis.is_finite();
    let used: Vec<&InnovationSample> = samples.iter().filter(is_part).collect();
    let of_window = |window: &[&InnovationSample]| {
        let nis: f64 = window.iter().map(|sample| sample.nis).sum();
        let degrees: u64 = window.iter().map(|one| u64::from(one.degrees_of_freedom)).sum();
        let end = window.last()?;
        Some((end.t_s, nis / degrees as f64))
    };
    used.windows(WINDOW_SAMPLES).filter_map(of_window).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(t_s: f64, nis: f64) -> InnovationSample {
        InnovationSample {
            t_s,
            innovation: [0.003, -0.004, 0.0],
            sigma: [0.005, 0.005, 0.0],
            nis,
            degrees_of_freedom: 2,
            is_used: nis < 10.0,
        }
    }

    #[test]
    fn a_camera_has_a_panel_for_each_component_and_one_for_its_nis() {
        let samples: Vec<InnovationSample> =
            (0..200).map(|step| sample(f64::from(step), if step == 50 { 400.0 } else { 2.0 })).collect();
        let svg = render_innovations(&InnovationSeries { name: "camera <1>", kind: "fix", samples: &samples });
        for name in ["x [mm]", "y [mm]", "NIS / dof", "mean of 50", "gated", "camera &lt;1&gt;"] {
            assert!(svg.contains(name), "{name}");
        }
        assert!(!svg.contains("heading [deg]"), "it has two components");
    }

    #[test]
    fn the_mean_is_taken_over_the_used_ones_only() {
        let mut samples: Vec<InnovationSample> = (0..60).map(|step| sample(f64::from(step), 3.0)).collect();
        samples[10].nis = 1e6;
        samples[10].is_used = false;
        let means = windowed_mean(&samples);
        assert_eq!(means.len(), 10);
        assert!(means.iter().all(|(_, mean)| (*mean - 1.5).abs() < 1e-12));
        assert!(windowed_mean(&samples[..40]).is_empty());
    }
}
