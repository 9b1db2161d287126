//! The inputs that every way of writing the filter gets: a drive with the noise that the filter is told.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::{INTERVAL_S, OBSERVED_VARIANCES, PROCESS_VARIANCES};

/// Enough that no branch predictor learns them by heart, few enough for the first cache.
pub(crate) const STEPS: usize = 4096;

/// What a step gets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Input {
    pub(crate) forward_m_per_s2: f64,
    pub(crate) turn_rad_per_s2: f64,
    /// v, heading by the encoders, heading by the gyro, w; headings unwrapped.
    pub(crate) observed: [f64; 4],
}

/// The inputs of a drive in loops and curves.
pub(crate) fn recorded() -> Vec<Input> {
    let mut normals = Pcg64::seed_from_u64(0x0b5e_c0de);
    let mut normal = move |variance: f64| {
        let unit: f64 = normals.sample(StandardNormal);
        variance.sqrt() * unit
    };
    let (mut heading, mut v, mut w) = (0.0, 0.0, 0.0);
    let mut inputs = Vec::with_capacity(STEPS);
    for step in 0..STEPS {
        let time_s = step as f64 * INTERVAL_S;
        // Towards 0.2 m/s, more or less, and a turn rate that swings to both sides: no robot runs away.
        let forward_m_per_s2 = 0.2 + 0.1 * (0.7 * time_s).sin() - v;
        let turn_rad_per_s2 = 1.5 * (0.31 * time_s).cos() - w;
        heading += INTERVAL_S * w + normal(PROCESS_VARIANCES[2]);
        v += INTERVAL_S * forward_m_per_s2 + normal(PROCESS_VARIANCES[3]);
        w += INTERVAL_S * turn_rad_per_s2 + normal(PROCESS_VARIANCES[4]);
        let true_values = [v, heading, heading, w];
        let observed = std::array::from_fn(|i| true_values[i] + normal(OBSERVED_VARIANCES[i]));
        inputs.push(Input { forward_m_per_s2, turn_rad_per_s2, observed });
    }
    inputs
}
