//! The map of a run: truth, odometry, the estimate with its 95 % ellipses, and fixes by fusion outcome.

use posebridge_telemetry::{Arena, Ellipse, Estimate, Point2};

use crate::chart::axes::{
    BLUISH_GREEN, ELLIPSE, ESTIMATE, INK, LATE, ODOMETRY, REJECTED, SMOOTHED, TRUTH, compared_stroke,
};
use crate::chart::layers::{DrawableLayers, Polylines, RunLayers, is_drawable, on_map};
use crate::chart::plot::{Axes, Curve, CurveShape};
use crate::chart::strip::render_strip;
use crate::chart::svg::Stroke;

/// Half axes of the 95 % ellipse of a planar normal distribution, in standard deviations: sqrt(-2 ln 0.05).
const SIGMAS_95: f64 = 2.447_746_830_680_816;
/// More ellipses overlap into a ribbon that hides the lines.
const MAX_ELLIPSES: usize = 24;
const HEIGHT_PX: f64 = 430.0;

const START: Stroke = Stroke::solid(INK, 2.2);
const USED_FIX: Stroke = Stroke::solid(BLUISH_GREEN, 1.5);

/// Returns a whole SVG document. Any layer may be missing; rejected fixes do not stretch the map.
pub fn render_path(layers: &RunLayers<'_>) -> String {
    let drawable = DrawableLayers::from_layers(layers);
    let mut curves = Vec::new();
    let ellipses = CurveShape::Outlines(ellipses(layers.estimates));
    let add_lines = |curves: &mut Vec<Curve>, name: &str, lines: &Polylines, stroke| {
        for (index, line) in lines.iter().enumerate() {
            let name = if index == 0 { name } else { "" };
            curves.push(Curve::line(name, pairs(line)).with_stroke(stroke));
        }
    };
    if !layers.estimates.is_empty() {
        curves.push(Curve::new("its 95 % ellipses", ellipses).with_stroke(&ELLIPSE));
    }
    add_lines(&mut curves, "truth", &drawable.truth, &TRUTH);
    add_lines(&mut curves, "odometry", &drawable.odometry, &ODOMETRY);
    add_fixes(&mut curves, &drawable);
    for (index, (filter, lines)) in drawable.compared.iter().enumerate() {
        add_lines(&mut curves, &format!("filter {filter}"), lines, compared_stroke(index));
    }
    add_lines(&mut curves, "estimate", &drawable.estimate, &ESTIMATE);
    add_lines(&mut curves, "smoothed", &drawable.smoothed, &SMOOTHED);
    if let Some(start) = drawable.start() {
        let marker = CurveShape::Rings(vec![(start.x.0, start.y.0)]);
        curves.push(Curve::new("start", marker).with_stroke(&START));
    }
    render_strip(layers.title, &[Axes::new("x [m]", "y [m]", HEIGHT_PX, curves).with_equal_scales()])
}

fn add_fixes(curves: &mut Vec<Curve>, drawable: &DrawableLayers) {
    type Make = fn(Vec<(f64, f64)>) -> CurveShape;
    let rows: [(&str, &[Point2<Arena>], Make, &'static Stroke); 3] = [
        ("fix, used", &drawable.used_fixes, CurveShape::Specks, &USED_FIX),
        ("fix, gated", &drawable.rejected_fixes, CurveShape::Crosses, &REJECTED),
        ("fix, too late", &drawable.late_fixes, CurveShape::Rings, &LATE),
    ];
    for (name, fixes, shape, stroke) in rows {
        if !fixes.is_empty() {
            let name = format!("{name} ({})", fixes.len());
            curves.push(Curve::new(name, shape(pairs(fixes))).with_stroke(stroke));
        }
    }
}

fn pairs(points: &[Point2<Arena>]) -> Vec<(f64, f64)> {
    points.iter().map(|point| (point.x.0, point.y.0)).collect()
}

fn ellipses(estimates: &[Estimate]) -> Vec<Vec<(f64, f64)>> {
    let is_shown = on_map(estimates);
    let evenly = estimates.iter().step_by(estimates.len().div_ceil(MAX_ELLIPSES).max(1));
    let drawn = evenly.filter_map(|estimate| {
        let [[xx_m2, xy_m2, ..], [_, yy_m2, ..], ..] = estimate.covariance;
        let ellipse = Ellipse::from_covariance(xx_m2, xy_m2, yy_m2, SIGMAS_95)?;
        let corners = ellipse.corners(estimate.pose.origin());
        let is_drawn = is_shown(estimate) && corners.iter().all(|corner| is_drawable(*corner));
        is_drawn.then(|| pairs(&corners))
    });
    drawn.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::FixMark;
    use crate::track::TimedPose;
    use posebridge_telemetry::{FusionOutcome, Heading, Meters, Pose, Timestamp};

    fn estimate(x_m: f64) -> Estimate {
        let mut covariance = [[0.0; 5]; 5];
        covariance[0][0] = 0.01_f64.powi(2);
        covariance[1][1] = 0.01_f64.powi(2);
        let pose = Pose::new(Meters(x_m), Meters(0.0), Heading::default());
        TimedPose { time: Timestamp::ZERO, pose }.with_covariance(covariance)
    }

    #[test]
    fn fixes_are_drawn_apart_by_what_became_of_them() {
        let verdicts = [FusionOutcome::Accepted, FusionOutcome::Gated, FusionOutcome::TooOld, FusionOutcome::PoseReset];
        let fixes = verdicts.map(|verdict| FixMark {
            time: Timestamp::ZERO,
            position: Point2::new(Meters(0.5), Meters(0.1)),
            verdict,
        });
        let estimates: Vec<Estimate> = (0..10).map(|step| estimate(f64::from(step) * 0.1)).collect();
        let svg = render_path(&RunLayers {
            title: "</title><script>",
            estimates: &estimates,
            fixes: &fixes,
            ..RunLayers::default()
        });
        for name in ["fix, used (2)", "fix, gated (1)", "fix, too late (1)", "estimate", "start"] {
            assert!(svg.contains(name), "{name}");
        }
        assert!(!svg.contains("<script"), "{svg}");
        assert!(render_path(&RunLayers::default()).contains("nothing to show"));
    }

    #[test]
    fn an_ellipse_holds_95_per_cent() {
        let outline = ellipses(&[estimate(0.0)]);
        let half_width = outline[0].iter().map(|(x, _)| x.abs()).fold(0.0, f64::max);
        // Of a round normal distribution exp(-r^2 / 2) lies outside r standard deviations.
        let outside = (-(half_width / 0.01).powi(2) / 2.0).exp();
        assert!((outside - 0.05).abs() < 1e-6, "{outside}");
    }
}
