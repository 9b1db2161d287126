//! The magnified detail beside the map: on a map of metres, ellipses of millimetres are dots.
//!
//! It looks at the place where the estimate is least sure of itself. It draws nothing itself; the map draws its layers
//! a second time through the detail's axes.

use posebridge_telemetry::{Arena, Estimate, Point2};

use super::layers::{ellipse_of, is_drawable};
use super::panel::{PlotPanel, ValueRange};
use super::svg::Rect;

/// The detail is this many times as wide as the longest half axis.
const HALF_AXES_ACROSS: f64 = 9.0;

/// The least width of the detail, in metres.
const MIN_WIDTH_M: f64 = 0.01;

/// A detail that would show more than this share of the map magnifies nothing and is left out.
const MAX_SHARE: f64 = 0.35;

/// Ellipses in the detail.
const MAX_ELLIPSES: usize = 14;

/// The axes of the detail, around the widest ellipse; `None` where there is nothing to magnify.
pub(super) fn detail_panel(area: Rect, map: &PlotPanel, estimates: &[Estimate]) -> Option<PlotPanel> {
    let (half_axis_m, center) = estimates
        .iter()
        .filter(|estimate| estimate.validity.position && is_drawable(estimate.pose.origin()))
        .filter_map(|estimate| Some((ellipse_of(estimate)?.semi_major_m, estimate.pose.origin())))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let width_m = (HALF_AXES_ACROSS * half_axis_m).max(MIN_WIDTH_M);
    let height_m = width_m / area.width * area.height;
    let is_magnified = height_m < MAX_SHARE * map.y.extent();
    is_magnified.then(|| PlotPanel {
        area,
        x: ValueRange::around(center.x.0, width_m),
        y: ValueRange::around(center.y.0, height_m),
    })
}

/// Ellipses whose centres lie inside the detail, evenly picked.
pub(super) fn ellipses(detail: &PlotPanel, estimates: &[Estimate]) -> Vec<Vec<Point2<Arena>>> {
    let inside: Vec<&Estimate> = estimates
        .iter()
        .filter(|estimate| {
            estimate.validity.position && detail.x.contains(estimate.pose.x.0) && detail.y.contains(estimate.pose.y.0)
        })
        .collect();
    inside
        .iter()
        .step_by(inside.len().div_ceil(MAX_ELLIPSES).max(1))
        .filter_map(|estimate| Some(ellipse_of(estimate)?.corners(estimate.pose.origin())))
        .collect()
}
