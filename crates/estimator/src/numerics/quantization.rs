//! The step of a sensor that rounds, from its readings.

/// Relative remainder of a division by the step that counts as rounding in the file.
const SAME_STEP: f64 = 0.05;

/// The common step of all distances between readings; `None` if there is none.
///
/// A link that sends a coarse sensor in a finer unit smears each step slightly: readings much closer than the whole span count as one
/// value, if at least three such values remain and their distances share a step.
pub fn find_quantization_step(readings: &[f64]) -> Option<f64> {
    let mut sorted = readings.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (first, last) = (sorted.first()?, sorted.last()?);
    let smeared = shared_distance(&sorted, SMEARED * (last - first));
    if let Some((step, values)) = smeared
        && values >= MIN_SMEARED
    {
        return Some(step);
    }
    // Decimal fractions differ in their last digits.
    let largest = first.abs().max(last.abs());
    shared_distance(&sorted, 1e-9 * largest).map(|(step, _)| step)
}

/// Readings within this share of the whole span may be one value.
const SMEARED: f64 = 0.01;
/// Fewer values may be two biases.
const MIN_SMEARED: usize = 3;

/// The step of which all distances between values are multiples, and the number of values; readings no further apart than `same` are
/// one value, which must be narrow relative to the step.
fn shared_distance(sorted: &[f64], same: f64) -> Option<(f64, usize)> {
    let values = sorted.chunk_by(|before, after| after - before <= same);
    let values: Vec<&[f64]> = values.collect();
    let ends = |value: &[f64]| Some((*value.first()?, *value.last()?));
    let ends: Vec<(f64, f64)> = values.iter().filter_map(|value| ends(value)).collect();
    let distances: Vec<f64> = ends.windows(2).filter_map(|pair| Some(pair.last()?.0 - pair.first()?.1)).collect();
    let smallest = distances.iter().copied().min_by(f64::total_cmp)?;
    let widest = ends.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
    let is_integer = |distance: &f64| {
        let steps = distance / smallest;
        (steps - steps.round()).abs() <= SAME_STEP * steps.max(1.0)
    };
    // Few different values among many readings: the sensor rounds. Many: it does not.
    let is_coarse = distances.len() * 4 < sorted.len() && widest <= SAME_STEP * smallest;
    if !is_coarse || !distances.iter().all(is_integer) {
        return None;
    }
    let mut sum = 0.0;
    let steps = distances.iter().map(|distance| {
        sum += (distance / smallest).round();
        sum
    });
    let counted: Vec<f64> = std::iter::once(0.0).chain(steps).collect();
    Some((slope_through(&counted, &values)?, values.len()))
}

/// Slope of the regression of all readings over the counts of their values.
fn slope_through(counts: &[f64], values: &[&[f64]]) -> Option<f64> {
    let all = || counts.iter().zip(values);
    let readings: f64 = values.iter().map(|value| value.len() as f64).sum();
    let mean = |of: &dyn Fn(f64, &[f64]) -> f64| all().map(|(count, value)| of(*count, value)).sum::<f64>() / readings;
    let count = mean(&|count, value| count * value.len() as f64);
    let reading = mean(&|_, value| value.iter().sum());
    let along = mean(&|at, value| (at - count).powi(2) * value.len() as f64);
    let across = mean(&|at, value| {
        let off = value.iter().map(|one| one - reading);
        (at - count) * off.sum::<f64>()
    });
    (along > 0.0).then(|| across / along)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn the_finer_units_of_a_link_do_not_hide_the_step_of_a_gyro() {
        let mut random = Pcg64::seed_from_u64(9);
        // A degree per second, in units of 0.02 mrad/s.
        let step = 873.0 * 2e-5;
        let readings: Vec<f64> = (0..1_000)
            .map(|_| {
                let counts = (random.random::<f64>() * 5.0).floor();
                let smear = (random.random::<f64>() * 3.0).floor() - 1.0;
                counts * step + smear * 2e-5
            })
            .collect();
        let found = find_quantization_step(&readings).unwrap();
        assert!((found / step - 1.0).abs() < 0.01, "{found}");
        // Two values alone may be two biases: then the unit of the link is all that is known.
        let two: Vec<f64> = readings.iter().copied().filter(|reading| *reading < 1.5 * step).collect();
        let found = find_quantization_step(&two).unwrap();
        assert!((found - 2e-5).abs() < 1e-9, "{found}");
        // What is fine all over has no step.
        let fine: Vec<f64> = (0..500).map(|_| random.random::<f64>()).collect();
        assert_eq!(find_quantization_step(&fine), None);
    }

    #[test]
    fn what_is_one_value_or_none_has_no_step() {
        assert_eq!(find_quantization_step(&[]), None);
        assert_eq!(find_quantization_step(&[2.0; 50]), None);
    }
}
