//! From the layers of a run to lines and dots that can be drawn: in metres, split at gaps, free of what is not finite.

use posebridge_telemetry::{Arena, BrickClock, Ellipse, Estimate, FusionOutcome, Point2, Timestamp};

use super::panel::ValueRange;
use crate::track::PoseTrack;

/// Coordinates beyond this are left out, in metres: no arena is wider, and a diverged filter must not hide the rest.
pub const MAX_COORDINATE_M: f64 = 1e6;

/// A fix as the figures show it: where it was, and what the filter made of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixMark {
    /// The instant that it spoke of.
    pub time: Timestamp<BrickClock>,
    /// The observed position.
    pub position: Point2<Arena>,
    /// What became of it.
    pub verdict: FusionOutcome,
}

/// What one run left behind, as layers for the figures; any of them may be empty or `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunLayers<'a> {
    /// The scenario or the recording, for people; any text.
    pub title: &'a str,
    /// The path that the robot should follow.
    pub ideal: &'a [Point2<Arena>],
    /// Where the robot really was.
    pub truth: Option<&'a PoseTrack>,
    /// The path by the brick's own odometry.
    pub odometry: Option<&'a PoseTrack>,
    /// The station's estimates, in the order of time.
    pub estimates: &'a [Estimate],
    /// Where it must have been, by everything that was observed, before and after.
    pub smoothed: Option<&'a PoseTrack>,
    /// The fixes that came from outside.
    pub fixes: &'a [FixMark],
}

/// Ellipses on one picture; more overlap into a ribbon that hides the lines.
const MAX_ELLIPSES: usize = 60;

/// Standard deviations to the edge of an ellipse.
pub(super) const SIGMAS: f64 = 2.0;

/// Lines in metres, without a connection across a gap.
pub(super) type Polylines = Vec<Vec<Point2<Arena>>>;

/// What can be drawn of a run.
#[derive(Clone, Debug, Default)]
pub(super) struct DrawableLayers {
    pub(super) ideal: Vec<Point2<Arena>>,
    pub(super) truth: Polylines,
    pub(super) odometry: Polylines,
    pub(super) estimate: Polylines,
    pub(super) smoothed: Polylines,
    pub(super) ellipses: Vec<Vec<Point2<Arena>>>,
    pub(super) used_fixes: Vec<Point2<Arena>>,
    pub(super) rejected_fixes: Vec<Point2<Arena>>,
    /// Those of the refused ones that came too late.
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
        drawable.ellipses = drawable.ellipses_of(layers.estimates);
        let (used, unused): (Vec<FixMark>, Vec<FixMark>) = layers.fixes.iter().partition(|fix| was_used(fix.verdict));
        let (late, refused): (Vec<FixMark>, Vec<FixMark>) =
            unused.iter().partition(|fix| fix.verdict == FusionOutcome::TooOld);
        drawable.used_fixes = drawable.points(used.iter().map(|fix| fix.position));
        drawable.rejected_fixes = drawable.points(refused.iter().map(|fix| fix.position));
        drawable.late_fixes = drawable.points(late.iter().map(|fix| fix.position));
        drawable
    }

    /// Where the robot started: by the truth, else by the estimates.
    pub(super) fn start(&self) -> Option<Point2<Arena>> {
        [&self.truth, &self.estimate, &self.odometry].into_iter().find_map(|lines| lines.first()?.first()).copied()
    }

    /// What the panel must hold, x and y. Refused fixes may be anywhere and do not stretch it.
    pub(super) fn bounds(&self) -> (ValueRange, ValueRange) {
        let lines = [&self.truth, &self.odometry, &self.estimate, &self.smoothed];
        let points: Vec<Point2<Arena>> =
            lines.into_iter().flatten().chain([&self.ideal, &self.used_fixes]).flatten().copied().collect();
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

    /// A jump that is not motion ends a line, so that no stroke suggests a path which was never driven.
    fn estimate_lines(&mut self, estimates: &[Estimate]) -> Polylines {
        estimates
            .chunk_by(|a, b| a.reset_counter == b.reset_counter && a.validity.position == b.validity.position)
            .filter(|part| part.iter().all(|estimate| estimate.validity.position))
            .map(|part| self.points(part.iter().map(|estimate| estimate.pose.origin())))
            .filter(|line| !line.is_empty())
            .collect()
    }

    fn ellipses_of(&mut self, estimates: &[Estimate]) -> Vec<Vec<Point2<Arena>>> {
        estimates
            .iter()
            .step_by(estimates.len().div_ceil(MAX_ELLIPSES).max(1))
            .filter(|estimate| estimate.validity.position && is_drawable(estimate.pose.origin()))
            .filter_map(|estimate| {
                let ellipse = ellipse_of(estimate);
                self.dropped += usize::from(ellipse.is_none());
                Some(ellipse?.corners(estimate.pose.origin()))
            })
            .filter(|corners| corners.iter().all(|corner| is_drawable(*corner)))
            .collect()
    }
}

/// The 2-sigma ellipse of an estimate's position; `None` if its covariance has none.
pub(super) fn ellipse_of(estimate: &Estimate) -> Option<Ellipse> {
    let [[xx_m2, xy_m2, ..], [_, yy_m2, ..], ..] = estimate.covariance;
    Ellipse::from_covariance(xx_m2, xy_m2, yy_m2, SIGMAS)
}

fn was_used(verdict: FusionOutcome) -> bool {
    matches!(verdict, FusionOutcome::Accepted | FusionOutcome::Slip | FusionOutcome::PoseReset)
}

/// Whether a point is finite and not out of reach.
pub(super) fn is_drawable(point: Point2<Arena>) -> bool {
    point.x.0.abs() <= MAX_COORDINATE_M && point.y.0.abs() <= MAX_COORDINATE_M
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::TimedPose;
    use posebridge_telemetry::{Heading, Meters, Pose, Timestamp};

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
}
