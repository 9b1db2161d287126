//! When a series of values has settled: the figure by which a sensor and its prediction are compared.

/// How long after the onset a series stays within `limit` of `end` for good, in seconds; `None` if its last value is not within, if
/// it holds nothing, or if a number is not finite.
///
/// The series holds instants and values in the order of time. The instant is that of the first value after which none is outside.
pub fn settling_time_s(series: &[(f64, f64)], onset_s: f64, end: f64, limit: f64) -> Option<f64> {
    let is_inside = |value: f64| (value - end).abs() <= limit;
    let last_outside = series.iter().rposition(|(_, value)| !is_inside(*value));
    let first_inside = last_outside.map_or(0, |index| index + 1);
    let (at_s, _) = series.get(first_inside)?;
    let after_s = at_s - onset_s;
    after_s.is_finite().then_some(after_s.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_counts_from_the_last_excursion() {
        let series: Vec<(f64, f64)> =
            [9.0, 5.0, 3.2, 4.5, 3.1, 2.9].into_iter().enumerate().map(|(k, value)| (10.0 + k as f64, value)).collect();
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 0.5), Some(4.0));
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 2.0), Some(1.0));
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 9.0), Some(0.0));
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 0.01), None);
        assert_eq!(settling_time_s(&[], 0.0, 3.0, 1.0), None);
        assert_eq!(settling_time_s(&[(0.0, f64::NAN)], 0.0, 3.0, 1.0), None);
    }
}
