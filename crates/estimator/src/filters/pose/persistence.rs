//! Errors of sightings and ranges that persist: two looks at one point from nearby are wrong in the same way.
//!
//! ```text
//! R <- R (1 + k) / (1 - k)      k = exp(-d / L)      d the path since the last look that was used, L over which errors persist
//! ```
//! So many looks from a stretch of path say together what the first-order autoregressive error allows, and at rest a further one says
//! nothing.
//!
//! Source: the information on a constant in n samples of a first-order autoregression, (n - (n - 2) k) / (1 + k) (Box and Jenkins, 1970);
//! docs/maths/pose.md section 4.

use super::layout::{MAX_BEACONS, MAX_LANDMARKS};

/// A look from where the last one was says no more than this share of what it would alone.
const MAX_FACTOR: f64 = 1e6;

/// A point that is looked at, by its number among the landmarks or beacons of the arena.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LookedAt {
    Landmark(usize),
    Beacon(usize),
}

impl LookedAt {
    const fn slot(self) -> usize {
        match self {
            Self::Landmark(slot) if slot < MAX_LANDMARKS => slot,
            Self::Beacon(slot) if slot < MAX_BEACONS => MAX_LANDMARKS + slot,
            Self::Landmark(_) | Self::Beacon(_) => usize::MAX,
        }
    }
}

/// The path of the wheels at the last look at each point; further points than there is room for count as never looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastLooks {
    at_m: [f32; MAX_LANDMARKS + MAX_BEACONS],
}

impl Default for LastLooks {
    fn default() -> Self {
        Self { at_m: [f32::NEG_INFINITY; MAX_LANDMARKS + MAX_BEACONS] }
    }
}

impl LastLooks {
    /// Factor on the variances of a look after the wheels' path `path_m`, where errors persist over `persistence_m`.
    pub fn variance_factor(&self, point: LookedAt, path_m: f64, persistence_m: f64) -> f64 {
        let Some(&at_m) = self.at_m.get(point.slot()) else { return 1.0 };
        if persistence_m <= 0.0 || at_m == f32::NEG_INFINITY {
            return 1.0;
        }
        let keep = (-(path_m - f64::from(at_m)).max(0.0) / persistence_m).exp();
        ((1.0 + keep) / (1.0 - keep)).min(MAX_FACTOR)
    }

    pub fn record(&mut self, point: LookedAt, path_m: f64) {
        if let Some(at_m) = self.at_m.get_mut(point.slot()) {
            *at_m = path_m as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_looks_from_a_stretch_of_path_say_what_their_common_error_allows() {
        let (persistence_m, length_m) = (0.5, 2.0);
        let point = LookedAt::Beacon(3);
        for looks in [20, 2_000] {
            let mut last = LastLooks::default();
            let mut information = 0.0;
            for look in 0..looks {
                let path_m = length_m * f64::from(look) / f64::from(looks - 1);
                information += 1.0 / last.variance_factor(point, path_m, persistence_m);
                last.record(point, path_m);
            }
            // In the limit of many: 1 + length / (2 persistence).
            assert!((information - 3.0).abs() < 0.1, "{information} after {looks}");
        }
        let last = LastLooks::default();
        assert_eq!(last.variance_factor(LookedAt::Landmark(40), 0.0, persistence_m), 1.0);
    }
}
