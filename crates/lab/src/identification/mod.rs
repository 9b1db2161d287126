//! Identification of a sensor's step response from its samples, and prediction of its final value from the transient.
//!
//! # Sources
//! Paper 2 (Markovsky); docs/lab/thermometer.md, whose equations the modules cite, and docs/lab/calibration.md section 7, (I6) to (I10).

pub mod channel;
pub mod direction_comparison;
pub mod fit;
pub mod known_dynamics;
pub mod lesson;
pub mod onset;
pub mod parameter_uncertainty;
pub mod prediction;
pub mod prior;
pub mod sensor_kind;
pub mod step;
pub mod step_response;

pub use self::channel::{SensorChannel, estimate_noise};
pub use self::direction_comparison::{DirectionComparison, compare_directions};
pub use self::onset::{StepSegment, find_step};
pub use self::parameter_uncertainty::{Sampling, StepParameters};
pub use self::prediction::{EndPrediction, predict};
pub use self::prior::StepDirection;
pub use self::sensor_kind::{RunSimilarity, describe_sensor};
pub use self::step::{IdentificationError, IdentifiedLag, IdentifiedStep, StepOptions, identify_step};
pub use self::step_response::{Lag, StepResponse, settling_time_s};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedSample {
    /// By the sensor's own clock.
    pub at_s: f64,
    /// In the sensor's unit.
    pub value: f64,
}

impl TimedSample {
    pub const fn is_finite(&self) -> bool {
        self.at_s.is_finite() && self.value.is_finite()
    }
}

/// Drops samples that are not finite or not later than the previous one.
pub(crate) fn sorted_finite(samples: &[TimedSample]) -> Vec<TimedSample> {
    let mut last_s = f64::NEG_INFINITY;
    samples
        .iter()
        .filter(|sample| {
            let is_next = sample.is_finite() && sample.at_s > last_s;
            if is_next {
                last_s = sample.at_s;
            }
            is_next
        })
        .copied()
        .collect()
}

/// Sorts samples by time; drops those that are not finite, and all but the first at one instant.
///
/// Without sorting, one timestamp that is too late would drop everything after it.
pub fn sorted_by_time(samples: &[TimedSample]) -> Vec<TimedSample> {
    let mut samples = samples.to_vec();
    samples.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    sorted_finite(&samples)
}
