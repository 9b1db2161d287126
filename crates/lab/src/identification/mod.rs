//! How a sensor answers a step, found from its samples; and the prediction of its final value from the transient.
//!
//! Gets samples, gives models and predictions; reads no file and no clock. The filter for known dynamics is
//! [`posebridge_estimator::filters::dynamic`]; here stands what comes before it (which dynamics?), beside it (block least squares,
//! which it must equal) and after it (what if they are not quite known?).
//!
//! | step | module |
//! |---|---|
//! | where in a recording the step is | [`onset`] |
//! | the response as a sum of exponentials, when it has settled, a sensor whose truth is known | [`step_response`] |
//! | least squares for its parameters, and their prior; errors of the model that hold for a while | [`fit`], [`prior`] |
//! | gain, delay, lags, their sigmas and the order of one run | [`step`](mod@step) |
//! | what an observation stream says of one sensor, and its noise | [`channel`] |
//! | sigmas that hold where errors of neighbours are alike | [`parameter_uncertainty`] |
//! | several runs of one kind of sensor: what to expect of the next; steps up against steps down | [`sensor_kind`] |
//! | the final value with bounds, from sample to sample | [`prediction`] |
//! | known dynamics: block and recursive least squares | [`known_dynamics`] |
//! | the experiment of the lab, section by section | [`lesson`] |
//!
//! ```
//! use posebridge_lab::identification::{StepOptions, TimedSample, identify_step};
//! // 20 degrees, then from 10 s on towards 3 with a lag of 5 s.
//! let samples: Vec<TimedSample> = (0..400)
//!     .map(|k| {
//!         let at_s = 0.1 * f64::from(k);
//!         let gone = if at_s > 10.0 { 1.0 - ((10.0 - at_s) / 5.0).exp() } else { 0.0 };
//!         TimedSample { at_s, value: 20.0 - 17.0 * gone }
//!     })
//!     .collect();
//! let found = identify_step(&samples, &StepOptions::with_sigma(0.01)).unwrap();
//! assert_eq!(found.order(), 1);
//! assert!((found.lags()[0].time_constant_s - 5.0).abs() < 0.05);
//! ```
//!
//! # Sources
//! Paper 2 (Markovsky); docs/lab/thermometer.md, whose equations the modules cite.

pub mod channel;
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

use posebridge_estimator::numerics::statistics;

pub use self::channel::{SensorChannel, estimate_noise};
pub use self::onset::{StepSegment, find_step};
pub use self::parameter_uncertainty::{Sampling, StepParameters};
pub use self::prediction::EndPrediction;
pub use self::prior::{ExpectedDynamics, StepDirection};
pub use self::sensor_kind::{DirectionComparison, KindError, SensorKind, compare_directions, predict};
pub use self::step::{IdentificationError, IdentifiedLag, IdentifiedStep, ModelOrder, StepOptions, identify_step};
pub use self::step_response::{Lag, StepResponse, settling_time_s};

/// What a sensor showed at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedSample {
    /// When, in seconds of the sensor's own clock.
    pub at_s: f64,
    /// What, in the sensor's unit.
    pub value: f64,
}

impl TimedSample {
    pub const fn is_finite(&self) -> bool {
        self.at_s.is_finite() && self.value.is_finite()
    }
}

/// The samples that are usable: finite, and each later than the one before.
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

/// The samples that are usable, whatever the order in which they came: finite, by rising time, the first of those at one instant.
///
/// One stamp that is too late would otherwise take everything after it along.
pub fn sorted_by_time(samples: &[TimedSample]) -> Vec<TimedSample> {
    let mut samples = samples.to_vec();
    samples.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    sorted_finite(&samples)
}

pub(crate) fn mean_of(samples: &[TimedSample]) -> Option<f64> {
    statistics::mean(samples.iter().map(|sample| sample.value))
}
