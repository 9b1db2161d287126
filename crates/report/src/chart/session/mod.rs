//! The figures of a report: one session, or one run, over its time.
//!
//! Each is a pure function from samples to a narrow SVG document (`strip`). Times are seconds since the session began,
//! by the host's clock, so that all figures of a page and its list of events agree; units are SI and become millimetres and degrees
//! on the axes.

mod clock;
mod errors;
mod innovations;
mod link;
mod online_calibration;
mod path;

use posebridge_telemetry::{Estimate, FusionOutcome, FusionRecord, LinkHealth};

use super::panel::ValueRange;
use super::plot::CurveStyle;
use super::{palette, plot};
use crate::metrics::PoseError;
use crate::metrics::innovations::variance;
use crate::track::PoseTrack;

pub use clock::render_clock;
pub use errors::render_errors;
pub use innovations::render_innovations;
pub use link::render_link;
pub use online_calibration::learning;
pub use path::render_path;

/// How far off an estimate was, and how far it claimed to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorSample {
    /// When it was made, s.
    pub t_s: f64,
    /// Distance of the estimated from the true position, m.
    pub position_m: f64,
    /// Twice the distance root mean square that is claimed, m.
    pub position_claim_m: f64,
    /// Heading error, the short way, rad.
    pub heading_rad: f64,
    /// Twice the claimed standard deviation of the heading, rad.
    pub heading_claim_rad: f64,
}

impl ErrorSample {
    /// How far an estimate that was made at `t_s` is from the truth at its own stamp; `None` where there is no truth, or its position
    /// may not be used.
    pub fn from_estimate(t_s: f64, estimate: &Estimate, truth: &PoseTrack) -> Option<Self> {
        let error = PoseError::of_estimate(estimate, truth.at(estimate.stamp)?);
        let sample = Self {
            t_s,
            position_m: error.dx_m.hypot(error.dy_m),
            position_claim_m: 2.0 * estimate.x_sigma_m().hypot(estimate.y_sigma_m()),
            heading_rad: error.heading_rad.unwrap_or(f64::NAN),
            heading_claim_rad: 2.0 * estimate.heading_sigma_rad(),
        };
        (estimate.validity.position && sample.position_m.is_finite()).then_some(sample)
    }
}

/// One attempt to use an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InnovationSample {
    /// When it was made, s.
    pub t_s: f64,
    /// Observed minus predicted, SI units; unused components are zero.
    pub innovation: [f64; 3],
    /// What is claimed of it, one standard deviation, SI units.
    pub sigma: [f64; 3],
    /// Normalised innovation squared.
    pub nis: f64,
    /// Its degrees of freedom; 0 where nothing was predicted.
    pub degrees_of_freedom: u8,
    /// Whether it was used; else the gate turned it away.
    pub is_used: bool,
}

impl InnovationSample {
    /// What a filter's record says; `None` where the observation did not reach the gate, or nothing was predicted.
    pub fn from_record(t_s: f64, record: &FusionRecord) -> Option<Self> {
        let is_used = match record.outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip => true,
            FusionOutcome::Gated => false,
            FusionOutcome::TooOld
            | FusionOutcome::Malformed
            | FusionOutcome::Rebased
            | FusionOutcome::PoseReset
            | FusionOutcome::Unused => {
                return None;
            }
        };
        let sigma = [0, 1, 2].map(|component| variance(record, component).max(0.0).sqrt());
        (record.degrees_of_freedom > 0).then_some(Self {
            t_s,
            innovation: record.innovation,
            sigma,
            nis: record.nis,
            degrees_of_freedom: record.degrees_of_freedom,
            is_used,
        })
    }
}

/// All attempts of one sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct InnovationSeries<'a> {
    /// The sensor, for people.
    pub name: &'a str,
    /// The kind of its observations, as [`posebridge_telemetry::ObservationKind::kind`] names it.
    pub kind: &'a str,
    /// In the order of time.
    pub samples: &'a [InnovationSample],
}

/// The estimate of one systematic error at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSample {
    /// When, s.
    pub t_s: f64,
    /// In the unit that its key ends in; a ratio without one.
    pub value: f64,
    /// One standard deviation.
    pub sigma: f64,
}

/// The estimates of one systematic error over time.
#[derive(Clone, Copy, Debug, Default)]
pub struct CalibrationSeries<'a> {
    /// Its key in the configuration.
    pub key: &'a str,
    /// In the order of time.
    pub samples: &'a [CalibrationSample],
}

/// The health of a link at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkSample {
    /// When, s.
    pub t_s: f64,
    /// Its counters since the session began.
    pub health: LinkHealth,
}

/// An alignment of the brick's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockSample {
    /// When, s.
    pub t_s: f64,
    /// Brick time minus host time, s.
    pub offset_s: f64,
    /// Rate of the brick's clock against the host's, minus one, parts per million.
    pub skew_ppm: f64,
    /// How far the offset may be off, s.
    pub uncertainty_s: f64,
    /// Of the exchange that led to it, s.
    pub round_trip_s: Option<f64>,
}

/// The unit of a number by the end of its key, as people read it, and by what SI is multiplied.
///
/// `gyro_bias_rad_per_s` is shown in degrees per second, a length in millimetres, a time in milliseconds, a ratio in per cent.
pub fn display_unit(key: &str) -> (&'static str, f64) {
    if key.ends_with("_rad_per_s") {
        ("deg/s", 1f64.to_degrees())
    } else if key.ends_with("_rad") {
        ("deg", 1f64.to_degrees())
    } else if key.ends_with("_m") {
        ("mm", 1e3)
    } else if key.ends_with("_s") {
        ("ms", 1e3)
    } else {
        ("%", 100.0)
    }
}

const ESTIMATE_STYLE: CurveStyle = CurveStyle { stroke: &palette::ESTIMATE, color: palette::BLUE };
const CLAIM_STYLE: CurveStyle = CurveStyle { stroke: &palette::CLAIM, color: palette::SKY_BLUE };
const EXPECTED_STYLE: CurveStyle = CurveStyle { stroke: &palette::EXPECTED, color: palette::FAINT_INK };
const MEAN_STYLE: CurveStyle = CurveStyle { stroke: &palette::MEAN, color: palette::VERMILLION };
const REJECTED_STYLE: CurveStyle = CurveStyle { stroke: &palette::REJECTED, color: palette::REDDISH_PURPLE };

/// This share of the values fits the axis; the rest may leave it, so that a moment at the start does not hide all that follows.
const SHOWN_SHARE: f64 = 0.995;

/// What nearly all sizes stay below, with a margin; `None` without any that is finite and not zero.
fn high_quantile(sizes: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sizes: Vec<f64> = sizes.map(f64::abs).filter(|size| size.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let index = ((sizes.len() as f64 - 1.0) * SHOWN_SHARE).floor() as usize;
    let size = sizes.get(index).copied().filter(|size| *size > 0.0)?;
    Some(size * 1.15)
}

/// From zero up to what nearly all sizes stay below.
fn range_from_zero(sizes: impl Iterator<Item = f64>) -> Option<ValueRange> {
    high_quantile(sizes).map(|high| ValueRange { low: 0.0, high })
}

/// To both sides of zero.
fn symmetric_range(sizes: impl Iterator<Item = f64>) -> Option<ValueRange> {
    high_quantile(sizes).map(|high| ValueRange { low: -high, high })
}

/// The ink of the curve with this place in a list.
const fn curve_style(place: usize) -> CurveStyle {
    plot::curve_style(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_tells_the_unit_that_people_read() {
        let unit = |key| display_unit(key).0;
        assert_eq!(unit("gyro_bias_rad_per_s"), "deg/s");
        assert_eq!(unit("fix_delay_s"), "ms");
        assert_eq!(unit("tag_forward_m"), "mm");
        assert_eq!(unit("track_scale"), "%");
    }

    #[test]
    fn a_moment_at_the_start_leaves_the_axis() {
        let mut sizes = vec![1.0; 1_000];
        sizes[0] = 500.0;
        sizes[1] = f64::NAN;
        assert_eq!(range_from_zero(sizes.into_iter()).unwrap().high, 1.15);
        assert_eq!(range_from_zero([0.0, 0.0].into_iter()), None);
        assert_eq!(symmetric_range(std::iter::empty()), None);
    }
}
