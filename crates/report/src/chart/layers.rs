//! Converts the layers of a run to lines and dots that can be drawn: in metres, split at gaps, finite. Also draws the head of the
//! sheet.

use posebridge_telemetry::{Arena, BrickClock, Ellipse, Estimate, FusionOutcome, Point2, Timestamp};

use super::axes::{ValueRange, open_sheet};
use super::svg::{PixelPoint, Svg};
use crate::metrics::{ErrorSummary, errors_of_estimates, errors_of_track, summarise};
use crate::track::PoseTrack;

/// Coordinates beyond this are omitted: no arena is wider, and a diverged filter must not hide the rest.
pub const MAX_COORDINATE_M: f64 = 1e6;

/// A fix with its fusion outcome, for figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixMark {
    pub time: Timestamp<BrickClock>,
    pub position: Point2<Arena>,
    pub verdict: FusionOutcome,
}

/// The path of a filter that ran beside the one whose estimates were sent.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparedTrack {
    pub filter: &'static str,
    pub track: PoseTrack,
}

/// The data of a run for figures; every layer may be empty or `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunLayers<'a> {
    /// Scenario or recording; any text.
    pub title: &'a str,
    pub ideal: &'a [Point2<Arena>],
    pub truth: Option<&'a PoseTrack>,
    pub odometry: Option<&'a PoseTrack>,
    /// In time order.
    pub estimates: &'a [Estimate],
    /// The smoothed path: estimated from all observations, earlier and later.
    pub smoothed: Option<&'a PoseTrack>,
    pub compared: &'a [ComparedTrack],
    pub fixes: &'a [FixMark],
}

pub(super) fn open_figure(layers: &RunLayers<'_>, height_px: f64) -> Svg {
    open_sheet(layers.title, &key_figures(layers), height_px)
}

fn key_figures(layers: &RunLayers<'_>) -> String {
    let Some(truth) = layers.truth else {
        let is_relative = !layers.estimates.is_empty() && layers.estimates.iter().all(Estimate::is_relative);
        let origin = if is_relative { "relative to where the robot started; " } else { "" };
        return format!("{origin}no truth known: errors cannot be told");
    };
    let odometry = layers.odometry.map(|track| summarise(&errors_of_track(track, truth))).unwrap_or_default();
    let estimate = summarise(&errors_of_estimates(layers.estimates, truth));
    let mut parts = Vec::new();
    parts.extend(error_text("odometry", &odometry));
    parts.extend(error_text("estimate", &estimate));
    parts.extend(gain_text(&odometry, &estimate));
    parts.extend(estimate.anees.map(|anees| format!("ANEES {anees:.2}")));
    parts.join("   ·   ")
}

fn error_text(name: &str, errors: &ErrorSummary) -> Option<String> {
    let (rms_m, end_m) = (errors.position_rms_m?, errors.position_end_m?);
    Some(format!("{name}: rms {}, end {}", length_text(rms_m), length_text(end_m)))
}

fn gain_text(odometry: &ErrorSummary, estimate: &ErrorSummary) -> Option<String> {
    let ratio = odometry.position_rms_m? / estimate.position_rms_m?;
    (ratio.is_finite() && ratio >= 1.0).then(|| format!("{ratio:.1} times better"))
}

/// Millimetres up to ten metres.
fn length_text(length_m: f64) -> String {
    if length_m < 0.010 {
        format!("{:.1} mm", length_m * 1e3)
    } else if length_m < 10.0 {
        format!("{:.0} mm", length_m * 1e3)
    } else {
        format!("{length_m:.3e} m")
    }
}

/// More ellipses overlap into a ribbon that hides the lines.
const MAX_ELLIPSES: usize = 60;

/// Standard deviations to the edge of an ellipse.
pub(super) const SIGMAS: f64 = 2.0;

/// In metres, split at gaps.
pub(super) type Polylines = Vec<Vec<Point2<Arena>>>;

#[derive(Clone, Debug, Default)]
pub(super) struct DrawableLayers {
    pub(super) ideal: Vec<Point2<Arena>>,
    pub(super) truth: Polylines,
    pub(super) odometry: Polylines,
    pub(super) estimate: Polylines,
    pub(super) smoothed: Polylines,
    /// By filter.
    pub(super) compared: Vec<(&'static str, Polylines)>,
    pub(super) ellipses: Vec<Vec<Point2<Arena>>>,
    pub(super) used_fixes: Vec<Point2<Arena>>,
    pub(super) rejected_fixes: Vec<Point2<Arena>>,
    /// Rejected because they were too late.
    pub(super) late_fixes: Vec<Point2<Arena>>,
    pub(super) dropped: usize,
}

impl DrawableLayers {
    pub(super) fn from_layers(layers: &RunLayers<'_>) -> Self {
        let mut drawable = Self::default();
        drawable.ideal = drawable.points(layers.ideal.iter().copied());
        drawable.truth = drawable.track(layers.truth);
        drawable.odometry = drawable.track(layers.odometry);
        drawable.estimate = drawable.estimate_lines(layers.estimates);
        drawable.smoothed = drawable.track(layers.smoothed);
        let compared = layers.compared.iter();
        drawable.compared = compared.map(|one| (one.filter, drawable.track(Some(&one.track)))).collect();
        drawable.ellipses = drawable.ellipses_of(layers.estimates);
        let (used, unused): (Vec<FixMark>, Vec<FixMark>) = layers.fixes.iter().partition(|fix| fix.verdict.is_used());
        let (late, refused): (Vec<FixMark>, Vec<FixMark>) =
            unused.iter().partition(|fix| fix.verdict == FusionOutcome::TooOld);
        drawable.used_fixes = drawable.points(used.iter().map(|fix| fix.position));
        drawable.rejected_fixes = drawable.points(refused.iter().map(|fix| fix.position));
        drawable.late_fixes = drawable.points(late.iter().map(|fix| fix.position));
        drawable
    }

    /// Start position: by the truth, else by the estimates.
    pub(super) fn start(&self) -> Option<Point2<Arena>> {
        [&self.truth, &self.estimate, &self.odometry].into_iter().find_map(|lines| lines.first()?.first()).copied()
    }

    /// The x and y ranges of the panel. Rejected fixes may be anywhere and are not included.
    pub(super) fn bounds(&self) -> (ValueRange, ValueRange) {
        let lines = [&self.truth, &self.odometry, &self.estimate, &self.smoothed];
        let compared = self.compared.iter().map(|(_, lines)| lines);
        let points: Vec<Point2<Arena>> = lines
            .into_iter()
            .chain(compared)
            .flatten()
            .chain([&self.ideal, &self.used_fixes])
            .flatten()
            .copied()
            .collect();
        let unit = ValueRange { low: 0.0, high: 1.0 };
        (
            ValueRange::of(points.iter().map(|point| point.x.0)).unwrap_or(unit),
            ValueRange::of(points.iter().map(|point| point.y.0)).unwrap_or(unit),
        )
    }

    fn points(&mut self, points: impl Iterator<Item = Point2<Arena>>) -> Vec<Point2<Arena>> {
        points
            .filter(|point| {
                let drawn = is_drawable(*point);
                self.dropped += usize::from(!drawn);
                drawn
            })
            .collect()
    }

    fn track(&mut self, track: Option<&PoseTrack>) -> Polylines {
        let Some(track) = track else {
            return Polylines::new();
        };
        self.dropped += track.dropped();
        track
            .segments()
            .map(|part| self.points(part.iter().map(|sample| sample.pose.origin())))
            .filter(|line| !line.is_empty())
            .collect()
    }

    /// A correction jump ends a line, so that no stroke suggests a path which was never driven.
    fn estimate_lines(&mut self, estimates: &[Estimate]) -> Polylines {
        let is_shown = on_map(estimates);
        estimates
            .chunk_by(|a, b| a.reset_counter == b.reset_counter && a.is_relative() == b.is_relative())
            .filter(|part| part.iter().all(is_shown))
            .map(|part| self.points(part.iter().map(|estimate| estimate.pose.origin())))
            .filter(|line| !line.is_empty())
            .collect()
    }

    fn ellipses_of(&mut self, estimates: &[Estimate]) -> Vec<Vec<Point2<Arena>>> {
        let is_shown = on_map(estimates);
        estimates
            .iter()
            .step_by(estimates.len().div_ceil(MAX_ELLIPSES).max(1))
            .filter(|estimate| is_shown(estimate) && is_drawable(estimate.pose.origin()))
            .filter_map(|estimate| {
                let ellipse = ellipse_of(estimate);
                self.dropped += usize::from(ellipse.is_none());
                Some(ellipse?.corners(estimate.pose.origin()))
            })
            .filter(|corners| corners.iter().all(|corner| is_drawable(*corner)))
            .collect()
    }
}

/// `None` if the covariance has no valid ellipse.
pub(super) fn ellipse_of(estimate: &Estimate) -> Option<Ellipse> {
    let [[xx_m2, xy_m2, ..], [_, yy_m2, ..], ..] = estimate.covariance;
    Ellipse::from_covariance(xx_m2, xy_m2, yy_m2, SIGMAS)
}

/// The estimates of a run that count from one origin: the arena's, or, where the robot was never found there, its start.
pub fn on_map(run: &[Estimate]) -> impl Fn(&Estimate) -> bool + Copy + use<> {
    let is_relative = run.iter().all(Estimate::is_relative);
    move |estimate| estimate.is_relative() == is_relative
}

pub(super) fn is_drawable(point: Point2<Arena>) -> bool {
    point.x.0.abs() <= MAX_COORDINATE_M && point.y.0.abs() <= MAX_COORDINATE_M
}

const NEAR_PX: f64 = 0.3;

/// Drops points closer than 0.3 pixels to the last kept one; the first and the last always stay.
pub(super) fn downsample_path(points: &[PixelPoint]) -> Vec<PixelPoint> {
    let mut kept: Vec<PixelPoint> = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let is_far = kept.last().is_none_or(|last| (point.0 - last.0).hypot(point.1 - last.1) >= NEAR_PX);
        if is_far || index + 1 == points.len() {
            kept.push(*point);
        }
    }
    kept
}

/// Keeps the first, lowest, highest and last point of each pixel column, in order: peaks of a time series survive. The points must be
/// sorted by x.
pub(super) fn downsample_series(points: &[PixelPoint]) -> Vec<PixelPoint> {
    points.chunk_by(|a, b| a.0.floor() == b.0.floor()).flat_map(downsample_column).collect()
}

fn downsample_column(column: &[PixelPoint]) -> Vec<PixelPoint> {
    let by_height = |a: &usize, b: &usize| column[*a].1.total_cmp(&column[*b].1);
    let indices = 0..column.len();
    let mut kept: Vec<usize> =
        [indices.clone().next(), indices.clone().min_by(by_height), indices.clone().max_by(by_height), indices.last()]
            .into_iter()
            .flatten()
            .collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| column[index]).collect()
}

/// Simplifies a line. No removed point lies further than `tolerance_px` from the rest: corners and peaks stay, straight stretches need
/// two points.
///
/// Chunks of `CHUNK_POINTS` points are simplified separately, because the run time grows with the square of their length.
///
/// Source: Douglas and Peucker (1973), "Algorithms for the reduction of the number of points required to represent a digitized line".
pub(super) fn downsample_by_deviation(points: &[PixelPoint], tolerance_px: f64) -> Vec<PixelPoint> {
    let mut kept: Vec<PixelPoint> = points.first().copied().into_iter().collect();
    let mut from = 0;
    while from + 1 < points.len() {
        let to = (from + CHUNK_POINTS).min(points.len() - 1);
        let segment = points.get(from..=to).unwrap_or_default();
        kept.extend(simplify(segment, tolerance_px).into_iter().skip(1));
        from = to;
    }
    kept
}

const CHUNK_POINTS: usize = 512;

fn simplify(points: &[PixelPoint], tolerance_px: f64) -> Vec<PixelPoint> {
    let last = points.len().saturating_sub(1);
    let mut needed = vec![false; points.len()];
    let mut open = vec![(0, last)];
    while let Some((from, to)) = open.pop() {
        for end in [from, to] {
            if let Some(flag) = needed.get_mut(end) {
                *flag = true;
            }
        }
        if let Some((farthest, distance_px)) = farthest_between(points, from, to)
            && distance_px > tolerance_px
        {
            open.extend([(from, farthest), (farthest, to)]);
        }
    }
    let kept = points.iter().zip(needed);
    kept.filter_map(|(point, is_needed)| is_needed.then_some(*point)).collect()
}

/// The point farthest from the segment between two others, and its distance; `None` if there is none between.
fn farthest_between(points: &[PixelPoint], from: usize, to: usize) -> Option<(usize, f64)> {
    let (start, end) = (*points.get(from)?, *points.get(to)?);
    let (along_x, along_y) = (end.0 - start.0, end.1 - start.1);
    let length_squared = along_x * along_x + along_y * along_y;
    let distance_px = |point: &PixelPoint| {
        let (x, y) = (point.0 - start.0, point.1 - start.1);
        let share =
            if length_squared > 0.0 { ((x * along_x + y * along_y) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
        (x - share * along_x).hypot(y - share * along_y)
    };
    let between = points.iter().enumerate().take(to).skip(from + 1);
    between.map(|(index, point)| (index, distance_px(point))).max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Heading, Meters, Pose};

    use super::*;
    use crate::track::TimedPose;

    fn estimate(step: i64, x_m: f64) -> Estimate {
        let mut covariance = [[0.0; 5]; 5];
        covariance[0][0] = 0.03_f64.powi(2);
        covariance[1][1] = 0.01_f64.powi(2);
        let pose = Pose::new(Meters(x_m), Meters(0.0), Heading::from_rad(0.0));
        let stamp = Timestamp::from_millis(step);
        TimedPose { time: stamp, pose }.with_covariance(covariance)
    }

    fn drawable(estimates: &[Estimate]) -> DrawableLayers {
        DrawableLayers::from_layers(&RunLayers { estimates, ..RunLayers::default() })
    }

    #[test]
    fn ellipses_reach_two_standard_deviations() {
        let ellipse = ellipse_of(&estimate(0, 0.0)).unwrap();
        assert!((ellipse.semi_major_m - 0.06).abs() < 1e-12);
        assert!((ellipse.semi_minor_m - 0.02).abs() < 1e-12);
    }

    #[test]
    fn only_so_many_ellipses_are_drawn() {
        let estimates: Vec<Estimate> = (0..1_000).map(|step| estimate(step, 0.0)).collect();
        assert_eq!(drawable(&estimates[..40]).ellipses.len(), 40);
        let picked = drawable(&estimates).ellipses.len();
        assert!((MAX_ELLIPSES / 2..=MAX_ELLIPSES).contains(&picked), "{picked}");
    }

    #[test]
    fn a_reset_and_an_invalid_stretch_end_a_line() {
        let mut estimates: Vec<Estimate> = (0..9).map(|step| estimate(step, 1.0)).collect();
        estimates[3].validity.position = false;
        for estimate in &mut estimates[6..] {
            estimate.reset_counter = 1;
        }
        let lengths: Vec<usize> = drawable(&estimates).estimate.iter().map(Vec::len).collect();
        assert_eq!(lengths, [3, 2, 3]);
    }

    #[test]
    fn what_cannot_be_drawn_is_counted() {
        let mut estimates = [estimate(0, f64::NAN), estimate(1, 1.0), estimate(2, 1e300)];
        estimates[1].covariance[0][0] = -1.0;
        let drawable = drawable(&estimates);
        // Two positions and one covariance.
        assert_eq!(drawable.dropped, 3);
        assert_eq!(drawable.estimate, [[Point2::new(Meters(1.0), Meters(0.0))]]);
    }

    #[test]
    fn lengths_read_well_at_every_size() {
        assert_eq!(length_text(0.001_33), "1.3 mm");
        assert_eq!(length_text(0.397), "397 mm");
        assert_eq!(length_text(1e300), "1.000e300 m");
    }

    #[test]
    fn a_robot_at_rest_leaves_two_points() {
        let rest = vec![(5.0, 5.0); 1000];
        assert_eq!(downsample_path(&rest).len(), 2);
        assert_eq!(downsample_path(&rest[..1]).len(), 1);
    }

    #[test]
    fn a_thinned_line_stays_within_the_tolerance_and_needs_few_points() {
        let circle: Vec<PixelPoint> = (0..5_000)
            .map(|step| {
                let (sin, cos) = (f64::from(step) / 400.0).sin_cos();
                (100.0 * cos, 100.0 * sin)
            })
            .collect();
        let simplified = downsample_by_deviation(&circle, 0.2);
        assert!((40..400).contains(&simplified.len()), "{}", simplified.len());
        assert_eq!((simplified.first(), simplified.last()), (circle.first(), circle.last()));
        for point in &circle {
            let nearest = simplified.windows(2).map(|ends| {
                let pair = [ends[0], *point, ends[1]];
                farthest_between(&pair, 0, 2).unwrap().1
            });
            assert!(nearest.fold(f64::MAX, f64::min) <= 0.2);
        }
        assert!(downsample_by_deviation(&[], 0.2).is_empty());
        assert_eq!(downsample_by_deviation(&circle[..1], 0.2).len(), 1);
    }

    #[test]
    fn a_straight_line_keeps_its_ends_and_a_spike_stays() {
        let mut line: Vec<PixelPoint> = (0..300).map(|x| (f64::from(x), 0.0)).collect();
        assert_eq!(downsample_by_deviation(&line, 0.1).len(), 2);
        line[150].1 = 5.0;
        assert_eq!(
            downsample_by_deviation(&line, 0.1),
            [(0.0, 0.0), (149.0, 0.0), (150.0, 5.0), (151.0, 0.0), (299.0, 0.0)]
        );
    }

    #[test]
    fn a_peak_survives_the_thinning_of_its_column() {
        let mut points: Vec<PixelPoint> = (0..100).map(|i| (f64::from(i) / 100.0, 1.0)).collect();
        points[37].1 = 9.0;
        points.push((1.5, 2.0));
        assert_eq!(downsample_series(&points), [(0.0, 1.0), (0.37, 9.0), (0.99, 1.0), (1.5, 2.0)]);
    }
}
