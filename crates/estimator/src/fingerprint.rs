//! The fingerprint of a filter's configuration: two filters with the same one continue each other's saved states.

use std::fmt::Debug;

use serde::{Deserialize, Serialize};

use crate::filter::FilterConfig;

/// A hash of each part of a configuration that a saved state depends on. The start is none: it was used, or comes later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfigFingerprint {
    geometry: u64,
    noise: u64,
    params: u64,
    calibration: u64,
    arena_map: u64,
    slow_sensor: u64,
}

impl ConfigFingerprint {
    pub fn new(config: &FilterConfig) -> Self {
        let FilterConfig { geometry, noise, start: _, params, calibration, arena_map, slow_sensor } = config;
        Self {
            geometry: hash(geometry),
            noise: hash(noise),
            params: hash(params),
            calibration: hash(calibration),
            arena_map: hash(arena_map),
            slow_sensor: hash(slow_sensor),
        }
    }

    /// The names of the parts that differ.
    pub fn differences(&self, other: &Self) -> impl Iterator<Item = &'static str> {
        let parts = |of: &Self| [of.geometry, of.noise, of.params, of.calibration, of.arena_map, of.slow_sensor];
        let names = ["geometry", "noise", "parameters", "calibration", "map", "slow sensor"];
        let pairs = names.into_iter().zip(parts(self).into_iter().zip(parts(other)));
        pairs.filter(|(_, (one, other))| one != other).map(|(name, _)| name)
    }
}

/// FNV-1a over the value as `Debug` prints it, which prints floats so that they read as the same number. The same on every machine.
pub fn hash(value: &impl Debug) -> u64 {
    let bytes = format!("{value:?}").into_bytes();
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::tests::config;

    #[test]
    fn it_names_what_differs_and_the_start_does_not() {
        let one = config();
        let mut other = config();
        other.start = None;
        let differences = |other: &FilterConfig| {
            ConfigFingerprint::new(&one).differences(&ConfigFingerprint::new(other)).collect::<Vec<_>>()
        };
        assert_eq!(differences(&other), [""; 0]);
        other.noise.gyro_rad_per_s = other.noise.gyro_rad_per_s.next_up();
        other.geometry.track_width.0 += 0.01;
        assert_eq!(differences(&other), ["geometry", "noise"]);
    }
}
