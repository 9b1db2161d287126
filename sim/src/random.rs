//! Seeded random streams, one per sensor.
//!
//! Each stream derives from the scenario's seed and the sensor's name, so that switching one sensor off does not change the noise of
//! the others. Nothing here reads the operating system's randomness.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

#[derive(Clone, Debug)]
pub(crate) struct RandomStream(Pcg64);

impl RandomStream {
    /// The stream `name` of the scenario's `seed`.
    pub(crate) fn new(seed: u64, name: &str) -> Self {
        Self(Pcg64::new(u128::from(seed), fnv1a(name)))
    }

    pub(crate) fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// On [`low`, `high`).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// A period with a uniform relative spread, either way.
    pub(crate) fn period(&mut self, mean_s: f64, spread: f64) -> f64 {
        mean_s * (1.0 + spread * self.uniform(-1.0, 1.0))
    }

    /// Either -1 or 1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.0.random::<bool>() { 1.0 } else { -1.0 }
    }

    /// Always takes one draw, so that a changed probability shifts nothing else.
    pub(crate) fn bernoulli(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }
}

/// FNV-1a, 128 bits: offset basis and prime from the specification (draft-eastlake-fnv, section 5).
fn fnv1a(name: &str) -> u128 {
    const BASIS: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
    const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013b;
    name.bytes().fold(BASIS, |hash, byte| (hash ^ u128::from(byte)).wrapping_mul(PRIME))
}

#[cfg(test)]
pub(crate) fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_name_and_by_seed() {
        let draw = |seed, name| RandomStream::new(seed, name).uniform(0.0, 1.0);
        assert_ne!(draw(7, "gyro"), draw(7, "camera"));
        assert_ne!(draw(7, "gyro"), draw(8, "gyro"));
    }

    #[test]
    fn the_hash_matches_the_published_vectors() {
        assert_eq!(fnv1a(""), 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d);
        assert_eq!(fnv1a("a"), 0xd228_cb69_6f1a_8caf_7891_2b70_4e4a_8964);
    }
}
