//! Fixes drawn from a recorded truth: a recording of wheels alone has nothing that a prediction could be held against.

use posebridge_telemetry::{
    Arena, BrickClock, Fix, Meters, Observation, ObservationKind, Point2, SensorId, TimeDelta, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// How the truth is shown to the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SyntheticFixes {
    /// Time between two of them.
    pub every: TimeDelta,
    /// Noise of x and of y, one standard deviation, in metres.
    pub sigma_m: f64,
    /// Seed of that noise.
    pub seed: u64,
}

/// Positions out of the truth, with seeded normal noise, as a camera would have seen them.
pub fn fixes_from_truth(
    truth: &[(Timestamp<BrickClock>, Point2<Arena>)],
    glimpses: &SyntheticFixes,
) -> Vec<Observation> {
    let mut rng = Pcg64::seed_from_u64(glimpses.seed);
    let mut due: Option<Timestamp<BrickClock>> = None;
    let mut fixes = Vec::new();
    for (stamp, place) in truth {
        if due.is_some_and(|due| *stamp < due) {
            continue;
        }
        due = Some(*stamp + glimpses.every);
        let [dx, dy] = normal_pair(rng.random(), rng.random());
        let position =
            Point2::new(Meters(place.x.0 + glimpses.sigma_m * dx), Meters(place.y.0 + glimpses.sigma_m * dy));
        fixes.push(Observation {
            sensor: SensorId::CAMERA,
            stamp: *stamp,
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Fix(Fix {
                position,
                heading: None,
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            }),
        });
    }
    fixes
}

/// Two independent standard normal numbers from two uniform ones in [0, 1).
///
/// Source: G. E. P. Box, M. E. Muller, A note on the generation of random normal deviates, Ann. Math. Statist. 29(2), 1958.
fn normal_pair(u: f64, v: f64) -> [f64; 2] {
    let radius = (-2.0 * (1.0 - u).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
    [radius * cos, radius * sin]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fixes_have_the_noise_and_the_rate_that_were_asked_for() {
        let truth: Vec<_> =
            (0..20_000).map(|i| (Timestamp::from_millis(50 * i), Point2::new(Meters(1.0), Meters(-2.0)))).collect();
        let glimpses = SyntheticFixes { every: TimeDelta::from_millis(1_000), sigma_m: 0.02, seed: 3 };
        let fixes = fixes_from_truth(&truth, &glimpses);
        assert_eq!(fixes.len(), 1_000);
        let squares: f64 = fixes
            .iter()
            .map(|fix| {
                let ObservationKind::Fix(fix) = fix.measurement else {
                    return f64::NAN;
                };
                (fix.position.x.0 - 1.0).powi(2) + (fix.position.y.0 + 2.0).powi(2)
            })
            .sum();
        let sigma_m = (squares / 2_000.0).sqrt();
        // Standard deviation of it: 0.02 / sqrt(2 * 2000) = 0.0003.
        assert!((sigma_m - 0.02).abs() < 0.001, "{sigma_m}");
        assert_eq!(fixes, fixes_from_truth(&truth, &glimpses));
        assert_ne!(fixes, fixes_from_truth(&truth, &SyntheticFixes { seed: 4, ..glimpses }));
    }
}
