//! The map of a run: truth, odometry, the estimate with the ellipses that hold the robot in 95 of 100 cases, and fixes by what became
//! of them.

use posebridge_telemetry::{Arena, Ellipse, Estimate, Point2};

use super::super::layers::{DrawableLayers, Polylines, RunLayers, is_drawable};
use super::super::palette::{
    BLACK, BLUE, BLUISH_GREEN, ELLIPSE, ESTIMATE, INK, LATE, ODOMETRY, ORANGE, REDDISH_PURPLE, REJECTED, SKY_BLUE,
    SMOOTHED, TRUTH, VERMILLION,
};
use super::super::plot::{AxisScaling, CurveShape, CurveStyle};
use super::super::strip::{StripChart, StripPanel, StyledCurve, render_strip};
use super::super::svg::Stroke;

/// Half axes of the ellipse that holds 95 % of a planar normal distribution, in standard deviations: sqrt(-2 ln 0.05).
const SIGMAS_95: f64 = 2.447_746_830_680_816;
/// More ellipses overlap into a ribbon that hides the lines.
const MAX_ELLIPSES: usize = 24;
const HEIGHT_PX: f64 = 430.0;

const START: Stroke = Stroke::solid(INK, 2.2);

/// Draws it; returns a whole SVG document. Any layer may be missing; refused fixes do not stretch the map.
pub fn render_path(layers: &RunLayers<'_>) -> String {
    let drawable = DrawableLayers::from_layers(layers);
    let mut curves = Vec::new();
    let ellipses = CurveShape::Outlines(ellipses(layers.estimates));
    let add_lines = |curves: &mut Vec<StyledCurve>, name: &str, lines: &Polylines, ink: CurveStyle| {
        for (index, line) in lines.iter().enumerate() {
            let name = if index == 0 { name } else { "" };
            curves.push(StyledCurve::new(name, CurveShape::Line(pairs(line)), ink));
        }
    };
    let ink = |stroke, color| CurveStyle { stroke, color };
    if !layers.estimates.is_empty() {
        let name = "its 95 % ellipses";
        curves.push(StyledCurve::new(name, ellipses, ink(&ELLIPSE, SKY_BLUE)));
    }
    add_lines(&mut curves, "truth", &drawable.truth, ink(&TRUTH, BLACK));
    add_lines(&mut curves, "odometry", &drawable.odometry, ink(&ODOMETRY, VERMILLION));
    add_fixes(&mut curves, &drawable);
    add_lines(&mut curves, "estimate", &drawable.estimate, ink(&ESTIMATE, BLUE));
    add_lines(&mut curves, "smoothed", &drawable.smoothed, ink(&SMOOTHED, ORANGE));
    if let Some(start) = drawable.start() {
        let place = vec![(start.x.0, start.y.0)];
        curves.push(StyledCurve::new("start", CurveShape::Rings(place), ink(&START, INK)));
    }
    render_strip(&StripChart {
        title: layers.title.to_owned(),
        x_name: "x [m]".to_owned(),
        panels: vec![StripPanel {
            y_name: "y [m]".to_owned(),
            height_px: HEIGHT_PX,
            scales: AxisScaling::Equal,
            y: None,
            curves,
        }],
    })
}

fn add_fixes(curves: &mut Vec<StyledCurve>, drawable: &DrawableLayers) {
    type Make = fn(Vec<(f64, f64)>) -> CurveShape;
    let rows: [(&str, &[Point2<Arena>], Make, CurveStyle); 3] = [
        ("fix, used", &drawable.used_fixes, CurveShape::Specks, CurveStyle { stroke: &ESTIMATE, color: BLUISH_GREEN }),
        (
            "fix, gated",
            &drawable.rejected_fixes,
            CurveShape::Crosses,
            CurveStyle { stroke: &REJECTED, color: REDDISH_PURPLE },
        ),
        ("fix, too late", &drawable.late_fixes, CurveShape::Rings, CurveStyle { stroke: &LATE, color: ORANGE }),
    ];
    for (name, fixes, shape, ink) in rows {
        if !fixes.is_empty() {
            let name = format!("{name} ({})", fixes.len());
            curves.push(StyledCurve::new(name, shape(pairs(fixes)), ink));
        }
    }
}

fn pairs(points: &[Point2<Arena>]) -> Vec<(f64, f64)> {
    points.iter().map(|point| (point.x.0, point.y.0)).collect()
}

fn ellipses(estimates: &[Estimate]) -> Vec<Vec<(f64, f64)>> {
    let evenly = estimates.iter().step_by(estimates.len().div_ceil(MAX_ELLIPSES).max(1));
    let drawn = evenly.filter_map(|estimate| {
        let [[xx_m2, xy_m2, ..], [_, yy_m2, ..], ..] = estimate.covariance;
        let ellipse = Ellipse::from_covariance(xx_m2, xy_m2, yy_m2, SIGMAS_95)?;
        let corners = ellipse.corners(estimate.pose.origin());
        let is_drawn = estimate.validity.position && corners.iter().all(|corner| is_drawable(*corner));
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
        let reach = outline[0].iter().map(|(x, _)| x.abs()).fold(0.0, f64::max);
        // Of a round normal distribution exp(-r^2 / 2) lies outside r standard deviations.
        let outside = (-(reach / 0.01).powi(2) / 2.0).exp();
        assert!((outside - 0.05).abs() < 1e-6, "{outside}");
    }
}
