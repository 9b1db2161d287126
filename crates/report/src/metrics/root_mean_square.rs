//! Means that several metrics share.

/// The root of the mean square; `None` of nothing. Scaled by the largest value, so that squares do not overflow.
pub(super) fn root_mean_square(values: &[f64]) -> Option<f64> {
    let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    if values.is_empty() || largest == 0.0 {
        return values.first().map(|_| 0.0);
    }
    let sum: f64 = values.iter().map(|value| (value / largest).powi(2)).sum();
    Some(largest * (sum / values.len() as f64).sqrt())
}

/// The largest value; `None` of nothing.
pub(super) fn largest(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_mean_square_of_3_and_4_is_the_root_of_12_and_a_half() {
        assert!((root_mean_square(&[3.0, -4.0]).unwrap() - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(root_mean_square(&[0.0, 0.0]), Some(0.0));
        assert_eq!(root_mean_square(&[]), None);
    }

    #[test]
    fn huge_values_do_not_overflow() {
        assert!((root_mean_square(&[1e300, 1e300]).unwrap() / 1e300 - 1.0).abs() < 1e-12);
    }
}
