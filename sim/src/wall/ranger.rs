//! The time-of-flight sensor: readings at its own rate, with noise and dropouts.

use super::scene::RangerSettings;
use crate::random::RandomStream;

/// One reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeReading {
    /// When it was made, in the brick's seconds.
    pub at_s: f64,
    /// Its reading, in metres, at least 0.
    pub range_m: f64,
}

/// An estimate of the distance to the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeEstimate {
    /// In metres.
    pub distance_m: f64,
    /// Speed towards it, in m/s.
    pub towards_m_per_s: f64,
}

#[derive(Clone, Debug)]
pub(super) struct Ranger {
    settings: RangerSettings,
    next_s: f64,
    pace: RandomStream,
    noise: RandomStream,
    misses: RandomStream,
}

impl Ranger {
    pub(super) fn new(settings: RangerSettings, seed: u64, run: u32) -> Self {
        let stream = |of: &str| RandomStream::new(seed, &format!("wall ranger {of} {run}"));
        let mut pace = stream("pace");
        Self {
            settings,
            next_s: pace.uniform(0.0, settings.period_s),
            pace,
            noise: stream("noise"),
            misses: stream("misses"),
        }
    }

    /// Its reading at a turn of the loop, if it is due: of the distance then.
    pub(super) fn read(&mut self, at_s: f64, distance_m: f64) -> Option<RangeReading> {
        if at_s < self.next_s {
            return None;
        }
        let spread = self.settings.period_spread * self.pace.uniform(-1.0, 1.0);
        self.next_s += self.settings.period_s * (1.0 + spread);
        let sigma_m = self.settings.sigma_m + self.settings.sigma_share * distance_m;
        let range_m = (distance_m + sigma_m * self.noise.normal()).max(0.0);
        let is_missed = self.misses.bernoulli(self.settings.miss_probability);
        (!is_missed).then_some(RangeReading { at_s, range_m })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pace_noise_and_misses_are_as_stated() {
        let settings = RangerSettings {
            period_s: 0.1,
            period_spread: 0.02,
            sigma_m: 0.005,
            sigma_share: 0.01,
            miss_probability: 0.25,
        };
        let mut ranger = Ranger::new(settings, 4, 0);
        let readings: Vec<RangeReading> =
            (0..100_000).filter_map(|turn| ranger.read(0.01 * f64::from(turn), 2.0)).collect();
        // 10 000 due; binomial with sigma 43.
        assert!((7_330..=7_670).contains(&readings.len()), "{}", readings.len());
        let squares = readings.iter().map(|reading| (reading.range_m - 2.0).powi(2));
        let sigma_m = (squares.sum::<f64>() / readings.len() as f64).sqrt();
        // 25 mm, known to 0.8 %.
        assert!((sigma_m / 0.025 - 1.0).abs() < 0.03, "{sigma_m}");
    }
}
