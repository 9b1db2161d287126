//! Means, quantiles and intervals of shares.

pub use posebridge_telemetry::estimate::NORMAL_95;

/// The mean; `None` of nothing.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.into_iter().fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The root of the mean square; `None` of nothing. Scaled by the largest value, so that squares do not overflow.
pub fn root_mean_square(values: &[f64]) -> Option<f64> {
    let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    if values.is_empty() || largest == 0.0 {
        return values.first().map(|_| 0.0);
    }
    let mean_square = mean(values.iter().map(|value| (value / largest).powi(2)))?;
    Some(largest * mean_square.sqrt())
}

/// The smallest value that this share of the values does not exceed (nearest rank); `None` of nothing.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

/// The 95 % interval of a share that was counted, which holds near 0 and 1 too; all of [0, 1] without a case.
///
/// Source: E. B. Wilson, Probable inference, J. Amer. Statist. Assoc. 22, 1927.
pub fn wilson_interval_95(hits: u64, cases: u64) -> [f64; 2] {
    if cases == 0 {
        return [0.0, 1.0];
    }
    let (n, z2) = (cases as f64, NORMAL_95 * NORMAL_95);
    let share = hits as f64 / n;
    let centre = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = NORMAL_95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    [(centre - half).max(0.0), (centre + half).min(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilsons_interval_is_the_published_one() {
        // R. G. Newcombe, Statistics in Medicine 17, 1998, table I, method 3.
        let published = [
            ((81, 263), [0.2553, 0.3662]),
            ((15, 148), [0.0624, 0.1605]),
            ((0, 20), [0.0, 0.1611]),
            ((1, 29), [0.0061, 0.1718]),
        ];
        for ((hits, cases), expected) in published {
            let found = wilson_interval_95(hits, cases);
            assert!((0..2).all(|bound| (found[bound] - expected[bound]).abs() < 5.1e-5), "{hits} {cases}: {found:?}");
        }
        assert_eq!((wilson_interval_95(100, 100)[1], wilson_interval_95(0, 0)), (1.0, [0.0, 1.0]));
    }

    #[test]
    fn the_root_mean_square_of_3_and_4_is_the_root_of_12_and_a_half() {
        assert!((root_mean_square(&[3.0, -4.0]).unwrap() - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(root_mean_square(&[0.0, 0.0]), Some(0.0));
        assert_eq!((root_mean_square(&[]), mean([])), (None, None));
        assert!((root_mean_square(&[1e300, 1e300]).unwrap() / 1e300 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_quantile_is_one_of_the_values() {
        let values = [4.0, 1.0, 3.0, 2.0];
        let found = [0.0, 0.25, 0.26, 0.5, 0.95, 1.0].map(|share| quantile(&values, share).unwrap());
        assert_eq!(found, [1.0, 1.0, 2.0, 2.0, 4.0, 4.0]);
        assert_eq!(quantile(&[], 0.5), None);
    }
}
