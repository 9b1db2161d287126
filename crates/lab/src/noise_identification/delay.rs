//! A camera's delay from the correlation of its motion with the wheels': equation (5) of the parent module.
//!
//! ```text
//! d^       the delay of the largest correlation: a grid, then a golden section
//! e'       de/dd, less its projection on e, because g is unknown as well
//! var d^ = sum_|j|<=2 sum_k e'_k e'_k+j n_k n_k+j / (g sum e'_k^2)^2     whatever the noise is like (W. K. Newey, K. D. West, 1987)
//! ```

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{DriveGeometry, Observation, ObservationKind};

use crate::statistics::{correlated_variance, golden_section, running_sums};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DelaySearch {
    /// The smallest delay; negative for a camera whose timestamps are early.
    pub from_s: f64,
    pub to_s: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct FixDelay {
    pub delay_s: f64,
    pub sigma_s: f64,
    pub correlation: f64,
    pub fixes: usize,
    pub by_heading: bool,
    pub curve: Vec<(f64, f64)>,
}

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DelayError {
    #[error("only {0} fixes lie within the wheel readings at every delay; 30 are needed")]
    TooFew(usize),
    #[error("the robot hardly changes its motion (correlation {0:.2}): let it turn to and fro")]
    NoMotion(f64),
    #[error("the best delay, {0:.3} s, is at the end of the search: widen it with --most")]
    AtSearchLimit(f64),
    #[error("the search must go from a smaller to a larger number of seconds, both finite")]
    NoRange,
}

const MIN_FIXES: usize = 30;
/// Samples on either side for the moving mean: slower drift is removed.
const MEAN_HALF_WINDOW: usize = 10;
const GRID_S: f64 = 0.01;
/// Golden sections of the last two grid steps: 0.02 s / 1.618^30.
const SECTIONS: u32 = 30;
/// Half step of the derivative: about a sampling interval of the wheels, between which they are interpolated linearly.
const SLOPE_HALF_WIDTH_S: f64 = 0.02;
/// Lags at which the noise may be correlated: the moving mean and a camera that filters cause some.
const LAGS: usize = 2;
/// Below this correlation the best delay is chance.
const MIN_CORRELATION: f64 = 0.5;

pub fn find_delay(
    levels: &CumulativeMotion,
    sightings: &[CameraSample],
    search: &DelaySearch,
) -> Result<FixDelay, DelayError> {
    let is_range = search.from_s.is_finite() && search.to_s.is_finite() && search.from_s < search.to_s;
    if !is_range {
        return Err(DelayError::NoRange);
    }
    let motion = CameraMotion::of(levels, sightings, search)?;
    let points = ((search.to_s - search.from_s) / GRID_S).ceil() as u32;
    let grid = (0..=points).map(|i| search.from_s + (search.to_s - search.from_s) * f64::from(i) / f64::from(points));
    let curve: Vec<(f64, f64)> = grid.map(|delay_s| (delay_s, motion.correlation(delay_s))).collect();
    let best = curve.iter().max_by(|a, b| a.1.total_cmp(&b.1)).copied();
    let (coarse_s, correlation) = best.unwrap_or_default();
    if correlation < MIN_CORRELATION {
        return Err(DelayError::NoMotion(correlation));
    }
    if coarse_s <= search.from_s || coarse_s >= search.to_s {
        return Err(DelayError::AtSearchLimit(coarse_s));
    }
    let value = |delay_s| motion.correlation(delay_s);
    let delay_s = golden_section(coarse_s - GRID_S, coarse_s + GRID_S, SECTIONS, value);
    Ok(FixDelay {
        delay_s,
        sigma_s: motion.sigma_s(delay_s),
        correlation: motion.correlation(delay_s),
        fixes: motion.at_s.len(),
        by_heading: motion.axis == MotionAxis::Turn,
        curve,
    })
}

/// Camera motion less its moving mean, with the wheels' motion.
struct CameraMotion<'a> {
    levels: &'a CumulativeMotion,
    axis: MotionAxis,
    at_s: Vec<f64>,
    camera: Vec<f64>,
}

impl<'a> CameraMotion<'a> {
    fn of(levels: &'a CumulativeMotion, sightings: &[CameraSample], search: &DelaySearch) -> Result<Self, DelayError> {
        let (first_s, last_s) = levels.time_range_s().ok_or(DelayError::TooFew(0))?;
        let from_s = first_s + search.to_s.max(0.0) + SLOPE_HALF_WIDTH_S;
        let until_s = last_s + search.from_s.min(0.0) - SLOPE_HALF_WIDTH_S;
        let mut last_s = f64::NEG_INFINITY;
        let mut used: Vec<&CameraSample> = Vec::new();
        for sighting in sightings {
            let is_finite = sighting.position_m.iter().all(|value| value.is_finite());
            if is_finite && sighting.at_s > last_s && (from_s..=until_s).contains(&sighting.at_s) {
                last_s = sighting.at_s;
                used.push(sighting);
            }
        }
        if used.len() < MIN_FIXES {
            return Err(DelayError::TooFew(used.len()));
        }
        let headings: Option<Vec<f64>> =
            used.iter().map(|sighting| sighting.heading_rad.filter(|rad| rad.is_finite())).collect();
        let of = if headings.is_some() { MotionAxis::Turn } else { MotionAxis::Path };
        let steps: Vec<f64> = match headings {
            Some(headings) => headings
                .windows(2)
                .map(|pair| pair.iter().copied().reduce(|a, b| wrap_rad(b - a)).unwrap_or(0.0))
                .collect(),
            None => used
                .iter()
                .zip(used.iter().skip(1))
                .map(|(a, b)| (b.position_m[0] - a.position_m[0]).hypot(b.position_m[1] - a.position_m[1]))
                .collect(),
        };
        Ok(Self {
            levels,
            axis: of,
            at_s: used.iter().map(|sighting| sighting.at_s).collect(),
            camera: without_mean(&running_sums(steps)),
        })
    }

    /// Wheel motion `delay_s` earlier, less its moving mean.
    fn predicted(&self, delay_s: f64) -> Vec<f64> {
        let at = |at_s: &f64| self.levels.at(at_s - delay_s, self.axis).unwrap_or(0.0);
        without_mean(&self.at_s.iter().map(at).collect::<Vec<_>>())
    }

    fn correlation(&self, delay_s: f64) -> f64 {
        let e = self.predicted(delay_s);
        let both = dot(&e, &e) * dot(&self.camera, &self.camera);
        if both > 0.0 { dot(&e, &self.camera) / both.sqrt() } else { 0.0 }
    }

    fn sigma_s(&self, delay_s: f64) -> f64 {
        let e = self.predicted(delay_s);
        let slope: Vec<f64> = self
            .predicted(delay_s + SLOPE_HALF_WIDTH_S)
            .iter()
            .zip(self.predicted(delay_s - SLOPE_HALF_WIDTH_S))
            .map(|(later, earlier)| (later - earlier) / (2.0 * SLOPE_HALF_WIDTH_S))
            .collect();
        let g = dot(&e, &self.camera) / dot(&e, &e);
        let share = dot(&slope, &e) / dot(&e, &e);
        let scores: Vec<f64> =
            slope.iter().zip(&e).zip(&self.camera).map(|((slope, e), c)| (slope - share * e) * (c - g * e)).collect();
        let own = dot(&slope, &slope) - share * dot(&slope, &e);
        let variance = correlated_variance(&scores, LAGS);
        variance.max(0.0).sqrt() / (g.abs() * own)
    }
}

fn without_mean(values: &[f64]) -> Vec<f64> {
    let about = |i: usize| {
        let from = i.saturating_sub(MEAN_HALF_WINDOW);
        let until = (i + MEAN_HALF_WINDOW + 1).min(values.len());
        let window = values.get(from..until).unwrap_or(&[]);
        window.iter().sum::<f64>() / window.len() as f64
    };
    values.iter().enumerate().map(|(i, value)| value - about(i)).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct CumulativeMotion {
    /// Instant in seconds, turn in radians, path in metres.
    samples: Vec<[f64; 3]>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSample {
    /// By the clock whose delay is estimated.
    pub at_s: f64,
    pub position_m: [f64; 2],
    /// `None` if the camera does not measure it.
    pub heading_rad: Option<f64>,
}

/// From wheel counts, or a foreign odometer where there are none.
pub fn cumulative_motion_of(observations: &[Observation], geometry: &DriveGeometry) -> CumulativeMotion {
    let has_wheels =
        observations.iter().any(|observation| matches!(observation.measurement, ObservationKind::WheelAngles { .. }));
    let mut levels = CumulativeMotion::default();
    let mut last: Option<[f64; 3]> = None;
    for observation in observations {
        let at_s = observation.stamp.as_secs_f64();
        if let ObservationKind::WheelAngles { left, right } = observation.measurement {
            let (left_m, right_m) = (left.0 * geometry.left_wheel_radius.0, right.0 * geometry.right_wheel_radius.0);
            let turn_rad = (right_m - left_m) / geometry.track_width.0;
            levels.push([at_s, turn_rad, 0.5 * (left_m + right_m)]);
        } else if let ObservationKind::OdometerPose(pose) = observation.measurement
            && !has_wheels
        {
            let [x, y, heading] = [pose.x.0, pose.y.0, pose.heading.rad()];
            let (turn, path) =
                last.map_or((0.0, 0.0), |[x0, y0, heading0]| (wrap_rad(heading - heading0), (x - x0).hypot(y - y0)));
            let [_, turned, driven] = levels.samples.last().copied().unwrap_or_default();
            levels.push([at_s, turned + turn, driven + path]);
            last = Some([x, y, heading]);
        }
    }
    levels
}

impl CumulativeMotion {
    /// Adds a sample; ignores one that is not finite or not later than the last.
    fn push(&mut self, sample: [f64; 3]) {
        let is_later = self.samples.last().is_none_or(|last| last[0] < sample[0]);
        if is_later && sample.iter().all(|value| value.is_finite()) {
            self.samples.push(sample);
        }
    }

    pub fn time_range_s(&self) -> Option<(f64, f64)> {
        Some((self.samples.first()?[0], self.samples.last()?[0]))
    }

    /// Turn or path at an instant, interpolated linearly; `None` outside.
    pub(super) fn at(&self, at_s: f64, of: MotionAxis) -> Option<f64> {
        let after = self.samples.partition_point(|sample| sample[0] < at_s);
        let column = of as usize;
        let right = self.samples.get(after)?;
        if right[0] == at_s {
            return Some(right[column]);
        }
        let left = self.samples.get(after.checked_sub(1)?)?;
        let share = (at_s - left[0]) / (right[0] - left[0]);
        Some(left[column] + share * (right[column] - left[column]))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MotionAxis {
    Turn = 1,
    Path = 2,
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::SensorNoise;

    use super::*;
    use crate::test_support::{self, wheels};

    #[test]
    fn turn_and_path_lie_on_a_line_between_two_counts() {
        let geometry = test_support::config([0.05; 2], 0.2, 0.01, SensorNoise::EXACT).geometry;
        // Wheels of 50 mm on a track of 200 mm.
        let observations = [(0, 0.0, 0.0), (1_000, 1.0, 2.0), (500, 9.0, 9.0), (2_000, f64::NAN, 0.0)]
            .map(|(millis, left, right)| wheels(millis, left, right));
        let levels = cumulative_motion_of(&observations, &geometry);
        assert_eq!(levels.time_range_s(), Some((0.0, 1.0)));
        assert!((levels.at(0.5, MotionAxis::Turn).unwrap() - 0.125).abs() < 1e-12);
        assert!((levels.at(0.5, MotionAxis::Path).unwrap() - 0.0375).abs() < 1e-12);
        assert_eq!(levels.at(1.1, MotionAxis::Path), None);
        assert_eq!(levels.at(-0.1, MotionAxis::Path), None);
    }
}
