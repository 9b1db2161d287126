//! How much noisier a source really is than it was said to be: learned from its innovations, refused ones included.
//!
//! # Model
//! ```text
//! R = s R_0            ln s <- ln s + g u (1[NIS > median of chi-square] - 1/2) 2
//! g = max(g_min, 1 / (2 + k))          k observations so far
//! u = mean of R_ii / S_ii              how much of the innovation is the sensor's own
//! ```
//! The median of the NIS is not moved by a few gross outliers, however gross, and a gate that was set too narrow opens by
//! itself, because what it refuses counts as well.
//!
//! # Source
//! docs/maths/pose.md section 6; Robbins and Monro (1951) for quantiles by stochastic approximation.

use posebridge_telemetry::SensorId;

/// As many sources are followed; further ones keep the noise that they were given.
const MOST_SOURCES: usize = 6;
/// Variances are scaled by no more than this, either way: ten times the standard deviation.
const LARGEST_LN_SCALE: f64 = 4.605_170_185_988_092;

/// One source: a sensor with one kind of observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// The sensor.
    pub sensor: SensorId,
    /// The number of its kind, see `history`.
    pub kind: u8,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Scale {
    source: Source,
    ln_scale: f64,
    count: u32,
}

/// An innovation, as the scales see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// Normalised innovation squared, with the scale so far.
    pub nis: f64,
    /// Median of chi-square with its degrees of freedom.
    pub median: f64,
    /// Mean of R_ii / S_ii.
    pub own_share: f64,
}

/// The scales of all sources.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scales {
    slots: [Option<Scale>; MOST_SOURCES],
}

impl Scales {
    /// By how much the variances of a source are to be multiplied.
    #[must_use]
    pub fn factor(&self, source: Source) -> f64 {
        self.slots
            .iter()
            .flatten()
            .find(|scale| scale.source == source)
            .map_or(1.0, |scale| scale.ln_scale.exp())
    }

    /// Learns from an innovation; `least_gain` of zero learns nothing.
    pub fn learn(&mut self, source: Source, judged: Judged, least_gain: f64) {
        if least_gain <= 0.0 || !judged.own_share.is_finite() {
            return;
        }
        let slot = self
            .slots
            .iter_mut()
            .find(|slot| slot.is_none_or(|scale| scale.source == source));
        let Some(slot) = slot else { return };
        let scale = slot.get_or_insert(Scale {
            source,
            ln_scale: 0.0,
            count: 0,
        });
        let gain = least_gain.max(1.0 / (2.0 + f64::from(scale.count)));
        let side = if judged.nis > judged.median {
            1.0
        } else {
            -1.0
        };
        scale.ln_scale = (scale.ln_scale + gain * judged.own_share * side)
            .clamp(-LARGEST_LN_SCALE, LARGEST_LN_SCALE);
        scale.count = scale.count.saturating_add(1);
    }
}
