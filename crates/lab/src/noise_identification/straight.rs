//! Noise of a wheel speed differenced from counts, on a straight drive: equations (3) and (4) of the parent module.

use posebridge_telemetry::DriveGeometry;

use crate::statistics::{FittedLine, lagged_sum, longest_run, median};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StraightNoise {
    /// Speeds in the stretch at a steady speed.
    pub samples: usize,
    pub speed_m_per_s: f64,
    /// About a straight line through the speeds: the root of R.
    pub sigma_m_per_s: f64,
    pub sigma_sigma_m_per_s: f64,
    /// Correlation of successive deviations: -1/2 for rounding alone, whose errors alternate.
    pub rho_1: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StraightError {
    #[error(
        "only {0} intervals at a steady speed; 20 are the least: drive straight for longer, or choose the stretch with --from and --to"
    )]
    TooShort(usize),
    #[error("an interval is not finite or lasts no time")]
    NotFinite,
}

const MIN_INTERVALS: usize = 20;
/// The speed is steady where its mean over this number of intervals
const MEAN_OVER: usize = 10;
/// deviates from the median by at most this share.
const STEADY: f64 = 0.1;

/// `travel` holds intervals of time and travel of one wheel, in seconds and metres.
pub fn straight_noise(travel: &[(f64, f64)]) -> Result<StraightNoise, StraightError> {
    let is_usable = |(dt_s, by_m): &(f64, f64)| dt_s.is_finite() && *dt_s > 0.0 && by_m.is_finite();
    if !travel.iter().all(is_usable) {
        return Err(StraightError::NotFinite);
    }
    let speeds: Vec<f64> = travel.iter().map(|(dt_s, by_m)| by_m / dt_s).collect();
    let steady = steady_part(&speeds);
    if steady.len() < MIN_INTERVALS {
        return Err(StraightError::TooShort(steady.len()));
    }
    let points: Vec<(f64, f64)> = steady.iter().enumerate().map(|(index, speed)| (index as f64, *speed)).collect();
    let line = FittedLine::through(&points).ok_or(StraightError::TooShort(steady.len()))?;
    let deviations: Vec<f64> = points.iter().map(|point| line.residual(*point)).collect();
    let n = deviations.len() as f64;
    let squares = lagged_sum(&deviations, 0);
    let rho_1 = if squares > 0.0 { lagged_sum(&deviations, 1) / squares } else { 0.0 };
    let sigma = (squares / (n - 2.0)).sqrt();
    Ok(StraightNoise {
        samples: steady.len(),
        speed_m_per_s: line.centre.1,
        sigma_m_per_s: sigma,
        // Correlated squares are fewer samples: M. S. Bartlett, J. R. Stat. Soc. Suppl. 8(1), 1946.
        sigma_sigma_m_per_s: sigma * ((1.0 + 2.0 * rho_1 * rho_1) / (2.0 * n)).sqrt(),
        rho_1,
    })
}

/// Standard deviation of a differenced speed due to rounding, averaged over speeds: equation (4), with the mean interval and the mean
/// wheel radius.
pub fn rounding_speed_sigma(geometry: &DriveGeometry, travel: &[(f64, f64)]) -> f64 {
    let dt_s = travel.iter().map(|(dt_s, _)| dt_s).sum::<f64>() / travel.len() as f64;
    let radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
    radius_m * geometry.tick.0 / dt_s / 6.0_f64.sqrt()
}

fn steady_part(speeds: &[f64]) -> &[f64] {
    let means: Vec<f64> =
        speeds.windows(MEAN_OVER).map(|window| window.iter().sum::<f64>() / MEAN_OVER as f64).collect();
    // Rest does not count: a robot may stand for longer than it drives.
    let fastest = means.iter().fold(0.0_f64, |most, mean| most.max(mean.abs()));
    let moving = means.iter().copied().filter(|mean| mean.abs() > 0.5 * fastest);
    let Some(median) = median(moving).filter(|_| fastest > 0.0) else {
        return &[];
    };
    let is_steady = means.iter().map(|mean| (mean - median).abs() <= STEADY * median.abs());
    let (first, count) = longest_run(is_steady);
    if count == 0 {
        return &[];
    }
    speeds.get(first..first + count + MEAN_OVER - 1).unwrap_or(&[])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Rest, then 0.2 m/s that slowly rises, with white noise of 0.01 m/s.
    fn run(count: usize, seed: u64) -> Vec<(f64, f64)> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let interval = |i: usize| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            let speed = if i < 50 { 0.0 } else { 0.2 + 1e-5 * i as f64 + 0.01 * noise };
            (0.05, 0.05 * speed)
        };
        (0..count).map(interval).collect()
    }

    #[test]
    fn white_noise_about_a_rising_speed_is_found_behind_the_rest() {
        for seed in 0..5 {
            let found = straight_noise(&run(850, seed)).unwrap();
            let off = (found.sigma_m_per_s - 0.01) / found.sigma_sigma_m_per_s;
            assert!(off.abs() < 3.0, "{seed}: {found:?}");
            assert!(found.samples > 750 && found.rho_1.abs() < 0.12, "{found:?}");
        }
    }

    #[test]
    fn rounding_makes_successive_speeds_differ_the_opposite_way() {
        // 2.5 counts an interval: 2, 3, 2, 3 and so on.
        let counts = |i: usize| (2.5 * i as f64).floor();
        let travel: Vec<_> = (0..200).map(|i| (0.05, 0.001 * (counts(i + 1) - counts(i)))).collect();
        let found = straight_noise(&travel).unwrap();
        assert!((found.sigma_m_per_s - 0.5 * 0.001 / 0.05).abs() < 2e-4, "{found:?}");
        assert!(found.rho_1 < -0.95);
    }

    #[test]
    fn what_tells_nothing_says_why() {
        assert_eq!(straight_noise(&[(0.05, 0.0); 100]), Err(StraightError::TooShort(0)));
        assert_eq!(straight_noise(&[(0.05, 0.01); 15]), Err(StraightError::TooShort(15)));
        assert_eq!(straight_noise(&[(0.0, 0.01); 100]), Err(StraightError::NotFinite));
        assert_eq!(straight_noise(&[(0.05, f64::NAN); 100]), Err(StraightError::NotFinite));
    }
}
