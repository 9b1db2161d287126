//! What the updates of a pose filter need besides its state.

use super::layout::StateLayout;
use super::recent_ranges::RecentRanges;
use crate::filter::FilterConfig;
use crate::motion::{GyroTrack, MotionTrack};
use crate::numerics::chi_square::{ChiSquareGates, chi_square_gates};
use crate::params::Params;

/// The configuration, and what was observed of the motion.
#[derive(Clone, Debug)]
pub struct UpdateContext {
    pub config: FilterConfig,
    pub layout: StateLayout,
    pub track: MotionTrack,
    pub gyro: GyroTrack,
    pub ranges: RecentRanges,
    gates: ChiSquareGates,
}

impl UpdateContext {
    /// `max_states` is the number of rows of the filter's state.
    pub fn new(config: &FilterConfig, max_states: usize) -> Self {
        Self {
            config: config.clone(),
            layout: StateLayout::new(config, max_states),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s)
                .with_backlash(config.calibration.backlash_rad.value),
            gyro: GyroTrack::default(),
            ranges: RecentRanges::default(),
            gates: chi_square_gates(config.params.gate_probability),
        }
    }

    /// For an innovation of `components`.
    pub(super) const fn gate(&self, components: usize) -> f64 {
        self.gates[components - 1]
    }

    /// Tunables are read where they are used, except two from which something was computed.
    pub(super) fn set_params(&mut self, params: &Params) {
        self.config.params = *params;
        self.gates = chi_square_gates(params.gate_probability);
        self.track.set_max_wheel_rad_per_s(params.max_wheel_rad_per_s);
    }
}
