//! Learns the true noise of each source relative to the configured one, from its innovations, rejected ones included.
//!
//! ```text
//! R_i = s_g R_0i           s_g the scale of the group of component i: position, heading, range, bearing
//! ln s_g <- ln s_g + gain * mean over the group of  u_i sign(nu_i^2 / S_ii - m)
//! gain = max(g_min, 2.33 / (6 + k))       k observations so far         m = 0.4549, the median of chi-square with one degree
//! u_i = sqrt(R_i / S_ii)                  how much of the innovation's spread is the sensor's own
//! ```
//! Gross outliers do not move the median, and a gate that was set too narrow opens by itself, because what it refuses
//! counts as well.
//!
//! Source: docs/maths/pose.md section 6; Robbins and Monro (1951) for quantiles by stochastic approximation.

use posebridge_telemetry::SensorId;
use serde::{Deserialize, Serialize};

use crate::saved::{finite, not_nan};

/// Most sources with a learned scale; further ones keep their configured noise.
const MAX_SOURCES: usize = 8;
/// Variances are scaled by no more than this, either way: ten times the standard deviation.
const LARGEST_LN_SCALE: f64 = 4.605_170_185_988_092;

/// Two looks within this path of a wheel are looks from one place: half a degree of turn of a small robot.
const SAME_PLACE_M: f64 = 0.001;

const CHI_SQUARE_MEDIAN: f64 = 0.454_936_423_119_573;

/// 1 over twice the density at the median, for ln chi-square with one degree of freedom: 1 / (2 * 0.2143).
const FIRST_GAIN: f64 = 2.33;

/// One source: a group of components of one kind of observation by one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NoiseSource {
    pub sensor: SensorId,
    /// The number of its kind, see `entry`.
    pub kind: u8,
    pub group: NoiseGroup,
}

/// Components of an observation with the same noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NoiseGroup {
    /// Both coordinates of a position.
    Position,
    Range,
    Heading,
    /// A direction from the body.
    Bearing,
}

impl NoiseGroup {
    /// All groups, in the order in which an observation's are learned.
    pub const ALL: [Self; 4] = [Self::Position, Self::Range, Self::Heading, Self::Bearing];
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct NoiseScale {
    source: NoiseSource,
    #[serde(deserialize_with = "finite")]
    ln_factor: f64,
    count: u32,
    /// The path of the wheels at the last look that counted.
    #[serde(deserialize_with = "not_nan")]
    counted_at_m: f64,
}

/// The scales of all sources.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseScales {
    slots: [Option<NoiseScale>; MAX_SOURCES],
}

impl NoiseScales {
    /// Factor on the variances of a source.
    pub fn factor(&self, source: NoiseSource) -> f64 {
        self.slots.iter().flatten().find(|scale| scale.source == source).map_or(1.0, |scale| scale.ln_factor.exp())
    }

    /// Learns from the mean of [`scale_vote`] over a group's components; `least_gain` of zero learns nothing. `path_m` is the path
    /// of the wheels: what a sensor says again from one place is wrong by the same amount, which is no proof of precision.
    pub fn learn(&mut self, source: NoiseSource, votes: f64, least_gain: f64, path_m: f64) {
        if least_gain <= 0.0 || !votes.is_finite() {
            return;
        }
        let slot = self.slots.iter_mut().find(|slot| slot.is_none_or(|scale| scale.source == source));
        let Some(slot) = slot else { return };
        let first = NoiseScale { source, ln_factor: 0.0, count: 0, counted_at_m: f64::NEG_INFINITY };
        let scale = slot.get_or_insert(first);
        if path_m - scale.counted_at_m < SAME_PLACE_M {
            return;
        }
        scale.counted_at_m = path_m;
        let gain = least_gain.max(FIRST_GAIN / (6.0 + f64::from(scale.count)));
        scale.ln_factor = (scale.ln_factor + gain * votes).clamp(-LARGEST_LN_SCALE, LARGEST_LN_SCALE);
        scale.count = scale.count.saturating_add(1);
    }
}

/// Direction and weight with which a component's noise should change, from its innovation, S_ii and R_i.
pub fn scale_vote(innovation: f64, s: f64, noise: f64) -> f64 {
    (noise / s).sqrt().copysign(innovation * innovation / s - CHI_SQUARE_MEDIAN)
}

// Jumps of the frame that an observer reports in: a tracker that relocalizes counts them.
//
// Its fixes after a jump cannot be compared with the earlier estimate: neither is the robot's motion. The estimate goes to the
// observer's new space with the first fix of it, as a counted reset. Only a fix that follows one of the same observer shows a jump.

/// Most observers whose jumps are detected; the gate tests the fixes of further ones like all others.
const MAX_OBSERVERS: usize = 8;

/// The reset counters of all observers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ObserverFrames {
    counters: [Option<(SensorId, u8)>; MAX_OBSERVERS],
}

impl ObserverFrames {
    /// Whether an observer's frame has jumped since its last fix; stores the counter.
    pub fn has_jumped(&mut self, sensor: SensorId, counter: u8) -> bool {
        let slot = self.counters.iter_mut().find(|slot| slot.is_none_or(|(known, _)| known == sensor));
        let Some(slot) = slot else { return false };
        let before = slot.replace((sensor, counter));
        before.is_some_and(|(_, before)| before != counter)
    }

    /// The number of an observer, in the order in which they were seen first.
    pub fn number_of(&self, sensor: SensorId) -> Option<usize> {
        self.counters.iter().flatten().position(|(known, _)| *known == sensor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_a_counter_that_changed_and_each_observer_has_its_own() {
        let mut spaces = ObserverFrames::default();
        let camera = SensorId::camera(0);
        let other = SensorId::camera(1);
        let counters = [(camera, 3), (camera, 3), (other, 7), (camera, 4), (camera, 4), (other, 7), (camera, 3)];
        let jumped = counters.map(|(sensor, counter)| spaces.has_jumped(sensor, counter));
        assert_eq!(jumped, [false, false, false, true, false, false, true]);
    }

    #[test]
    fn one_observer_too_many_is_not_followed() {
        let mut spaces = ObserverFrames::default();
        for id in 0..9 {
            assert!(!spaces.has_jumped(SensorId(id), 0));
        }
        assert!(!spaces.has_jumped(SensorId(8), 1));
        assert!(spaces.has_jumped(SensorId(7), 1));
    }
}
