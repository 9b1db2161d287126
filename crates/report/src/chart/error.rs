//! Position error over time, on a logarithmic axis, with what the estimate claims.
//!
//! ```text
//! error   distance between estimated and true position                     claim   2 sqrt(P_xx + P_yy)
//! ```
//! The claim is twice the distance root mean square; a consistent estimate stays below it 95 to 98 % of the time, depending on how
//! round its ellipse is. Errors below the panel's lowest decade are drawn on its edge.

use posebridge_telemetry::{Arena, BrickClock, Estimate, Pose, Timestamp};

use super::axes;
use super::axes::{
    CLAIM, ESTIMATE, FAINT_INK, FILL_OPACITY, LegendEntry, LegendMark, ODOMETRY, PlotPanel, SKY_BLUE, SMOOTHED, Tick,
    ValueRange, round_ticks,
};
use super::layers::{RunLayers, SIGMAS, downsample_series, is_drawable, open_figure};
use super::svg::{Anchor, PixelPoint, Rect, Svg, TextStyle};
use crate::track::{PoseTrack, TimedPose};

const HEIGHT_PX: f64 = 420.0;

const AREA: Rect = Rect { left: axes::LEFT_PX, top: 72.0, width: 590.0, height: 290.0 };

/// Limits of the axis as powers of ten of metres: 0.1 mm and 1000 km.
const DECADES: ValueRange = ValueRange { low: -4.0, high: 6.0 };

const MIN_DECADES: f64 = 2.0;
const MAX_DECADES: f64 = 6.0;

/// Share of the errors that may lie below the axis: an error that crosses zero has an unbounded logarithm.
const BELOW_AXIS_SHARE: f64 = 0.02;

/// Seconds and metres, in time order, split at gaps.
type Series = Vec<Vec<(f64, f64)>>;

pub(super) fn render(layers: &RunLayers<'_>) -> String {
    let mut svg = open_figure(layers, HEIGHT_PX);
    let dropped = draw(&mut svg, AREA, AREA.right() + 22.0, layers);
    svg.finish(dropped)
}

/// Draws the panel with its legend; returns the number of omitted values.
pub(super) fn draw(svg: &mut Svg, area: Rect, legend_left_px: f64, layers: &RunLayers<'_>) -> usize {
    let curves = ErrorCurves::from_layers(layers);
    let panel = PlotPanel { area, x: curves.time_range(), y: curves.decade_range() };
    panel.draw_grid(svg, &round_ticks(panel.x, 8.0), &decade_ticks(panel.y));
    svg.clip(&area, "errors", |svg| {
        for part in &curves.claim {
            draw_claim(svg, &panel, &to_pixels(&panel, part));
        }
        for (series, stroke) in
            [(&curves.odometry, &ODOMETRY), (&curves.estimate, &ESTIMATE), (&curves.smoothed, &SMOOTHED)]
        {
            for part in series {
                svg.polyline(&to_pixels(&panel, part), stroke);
            }
        }
    });
    panel.draw_border(svg);
    panel.draw_names(svg, "time [s]", "position error [mm]");
    if curves.is_empty() {
        draw_no_data(svg, &area);
    }
    axes::draw_legend(svg, (legend_left_px, area.top), &curves.entries());
    curves.dropped
}

struct ErrorCurves {
    odometry: Series,
    estimate: Series,
    smoothed: Series,
    claim: Series,
    dropped: usize,
}

impl ErrorCurves {
    fn from_layers(layers: &RunLayers<'_>) -> Self {
        let origin = first_stamp(layers);
        let secs = |stamp: Timestamp<BrickClock>| (stamp - origin).as_secs_f64();
        let of_track = |track: Option<&PoseTrack>| -> Series {
            let parts = track.into_iter().flat_map(PoseTrack::segments);
            let errors = parts.flat_map(|part| {
                connected(part.iter().map(|sample: &TimedPose| {
                    let error = error_m(sample.pose, sample.time, layers.truth);
                    (secs(sample.time), error)
                }))
            });
            errors.collect()
        };
        let valid = || layers.estimates.iter().filter(|estimate| estimate.validity.position);
        let estimate = connected(valid().map(|estimate| {
            let error = error_m(estimate.pose, estimate.stamp, layers.truth);
            (secs(estimate.stamp), error)
        }));
        let claims: Vec<(f64, Option<f64>)> =
            valid().map(|estimate| (secs(estimate.stamp), claim_m(estimate))).collect();
        Self {
            odometry: of_track(layers.odometry),
            estimate,
            smoothed: of_track(layers.smoothed),
            dropped: claims.iter().filter(|(_, claim)| claim.is_none()).count(),
            claim: connected(claims.into_iter()),
        }
    }

    fn is_empty(&self) -> bool {
        self.points().next().is_none()
    }

    fn points(&self) -> impl Iterator<Item = &(f64, f64)> {
        [&self.odometry, &self.estimate, &self.smoothed, &self.claim].into_iter().flatten().flatten()
    }

    fn time_range(&self) -> ValueRange {
        let last = self.points().map(|(secs, _)| *secs).fold(0.0, f64::max);
        ValueRange { low: 0.0, high: if last > 0.0 { last } else { 1.0 } }
    }

    /// Whole decades, as powers of ten of metres.
    fn decade_range(&self) -> ValueRange {
        let mut decades: Vec<f64> =
            self.points().map(|(_, metres)| metres.log10().clamp(DECADES.low, DECADES.high)).collect();
        decades.sort_by(f64::total_cmp);
        let lowest = (decades.len() as f64 * BELOW_AXIS_SHARE) as usize;
        let low = decades.get(lowest).map_or(-3.0, |decade| decade.floor());
        let high = decades.last().map_or(0.0, |decade| decade.ceil());
        let high = high.max(low + MIN_DECADES);
        ValueRange { low: low.max(high - MAX_DECADES), high }
    }

    fn entries(&self) -> Vec<LegendEntry> {
        [
            (&self.odometry, LegendMark::Line(&ODOMETRY), "odometry's error"),
            (&self.estimate, LegendMark::Line(&ESTIMATE), "estimate's error"),
            (&self.smoothed, LegendMark::Line(&SMOOTHED), "smoothed path's error"),
            (&self.claim, LegendMark::Area(&CLAIM), "its 2-sigma claim"),
        ]
        .into_iter()
        .filter(|(series, ..)| !series.is_empty())
        .map(|(_, mark, label)| LegendEntry::new(mark, label))
        .collect()
    }
}

fn first_stamp(layers: &RunLayers<'_>) -> Timestamp<BrickClock> {
    let tracks = [layers.truth, layers.odometry, layers.smoothed].into_iter().flatten();
    tracks
        .filter_map(|track| Some(track.samples().first()?.time))
        .chain(layers.estimates.iter().map(|estimate| estimate.stamp))
        .min()
        .unwrap_or(Timestamp::ZERO)
}

fn error_m(pose: Pose<Arena>, stamp: Timestamp<BrickClock>, truth: Option<&PoseTrack>) -> Option<f64> {
    let true_pose = truth?.at(stamp)?;
    let comparable = is_drawable(pose.origin()) && is_drawable(true_pose.origin());
    comparable.then(|| pose.origin().distance(true_pose.origin()).0)
}

fn claim_m(estimate: &Estimate) -> Option<f64> {
    let claim_m = SIGMAS * estimate.x_sigma_m().hypot(estimate.y_sigma_m());
    let variances_sum = estimate.covariance[0][0] + estimate.covariance[1][1];
    (variances_sum.is_finite() && claim_m.is_finite()).then_some(claim_m)
}

fn connected(values: impl Iterator<Item = (f64, Option<f64>)>) -> Series {
    let mut parts = vec![Vec::new()];
    for (secs, value) in values {
        match (value, parts.last_mut()) {
            (Some(value), Some(part)) => part.push((secs, value)),
            (Some(_) | None, _) => parts.push(Vec::new()),
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

fn to_pixels(panel: &PlotPanel, part: &[(f64, f64)]) -> Vec<PixelPoint> {
    let points: Vec<PixelPoint> = part
        .iter()
        .map(|(secs, metres)| {
            let decade = metres.log10().clamp(panel.y.low, panel.y.high);
            panel.to_pixels(*secs, decade)
        })
        .collect();
    downsample_series(&points)
}

/// The claim as an area from the lower edge up to the curve.
fn draw_claim(svg: &mut Svg, panel: &PlotPanel, curve: &[PixelPoint]) {
    if let (Some(first), Some(last)) = (curve.first(), curve.last()) {
        let mut corners = curve.to_vec();
        corners.push((last.0, panel.area.bottom()));
        corners.push((first.0, panel.area.bottom()));
        svg.polygon(&corners, SKY_BLUE, FILL_OPACITY, None);
        svg.polyline(curve, &CLAIM);
    }
}

fn decade_ticks(range: ValueRange) -> Vec<Tick> {
    let decades = range.low as i32..=range.high as i32;
    decades.map(|decade| Tick { at: f64::from(decade), label: millimetres(decade + 3) }).collect()
}

/// A power of ten as text: a plain number while it is short.
fn millimetres(power: i32) -> String {
    match power {
        ..0 => format!("{:.1}", 10_f64.powi(power)),
        0..5 => format!("{:.0}", 10_f64.powi(power)),
        _ => format!("1e{power}"),
    }
}

fn draw_no_data(svg: &mut Svg, area: &Rect) {
    let style = TextStyle { size_px: 14.0, color: FAINT_INK, anchor: Anchor::Middle, weight: 400 };
    let middle = (area.left + area.width / 2.0, area.top + area.height / 2.0);
    svg.text(middle, &style, "nothing to compare");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curves(errors_m: &[f64]) -> ErrorCurves {
        let points = errors_m.iter().enumerate();
        ErrorCurves {
            odometry: vec![points.map(|(secs, error_m)| (secs as f64, *error_m)).collect()],
            estimate: Series::new(),
            smoothed: Series::new(),
            claim: Series::new(),
            dropped: 0,
        }
    }

    #[test]
    fn the_axis_holds_the_errors_in_whole_decades_within_bounds() {
        let cases =
            [([0.004, 0.05, 0.3], (-3.0, 0.0)), ([0.0, 0.0, 2.0], (-4.0, 1.0)), ([0.0, 0.0, 1e300], (0.0, 6.0))];
        for (errors_m, decades) in cases {
            let range = curves(&errors_m).decade_range();
            assert_eq!((range.low, range.high), decades, "{errors_m:?}");
        }
    }

    #[test]
    fn a_missing_value_splits_a_series() {
        let values = [(0.0, Some(1.0)), (1.0, None), (2.0, Some(3.0)), (3.0, Some(4.0))];
        assert_eq!(connected(values.into_iter()), [vec![(0.0, 1.0)], vec![(2.0, 3.0), (3.0, 4.0)]]);
    }

    #[test]
    fn powers_of_ten_are_plain_while_they_are_short() {
        assert_eq!([-1, 0, 3, 6].map(millimetres), ["0.1", "1", "1000", "1e6"]);
    }
}
