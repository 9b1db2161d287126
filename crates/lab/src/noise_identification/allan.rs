//! The overlapping Allan deviation of a rate: equation (2) of the module's head.

/// One point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllanPoint {
    /// The averaging time, in seconds.
    pub tau_s: f64,
    /// The deviation, in the unit of the rate.
    pub deviation: f64,
    /// Its standard deviation, from the number of averages that do not overlap.
    pub sigma: f64,
}

/// Points per factor of ten of the averaging time.
const POINTS_PER_DECADE: f64 = 8.0;
/// Least number of independent averages.
const MIN_AVERAGES: usize = 9;

/// The deviation of evenly sampled rates, over averaging times up to a ninth of the record.
pub fn allan_deviation(rates: &[f64], dt_s: f64) -> Vec<AllanPoint> {
    if !(dt_s.is_finite() && dt_s > 0.0) || rates.iter().any(|rate| !rate.is_finite()) {
        return Vec::new();
    }
    let mut angle = 0.0;
    let mut angles = vec![0.0];
    for rate in rates {
        angle += rate * dt_s;
        angles.push(angle);
    }
    let longest = rates.len() / MIN_AVERAGES;
    let mut points = Vec::new();
    let mut m = 1;
    while m <= longest {
        points.push(point(&angles, m, dt_s));
        let next = (m as f64 * 10.0_f64.powf(POINTS_PER_DECADE.recip())).round() as usize;
        m = next.max(m + 1);
    }
    points
}

fn point(angles: &[f64], m: usize, dt_s: f64) -> AllanPoint {
    let tau_s = m as f64 * dt_s;
    let later = angles.iter().skip(m).zip(angles.iter().skip(2 * m));
    let second = angles.iter().zip(later).map(|(a, (b, c))| c - 2.0 * b + a);
    let (sum, count) = second.fold((0.0, 0.0), |(sum, count), d| (sum + d * d, count + 1.0));
    let deviation = (sum / (2.0 * tau_s * tau_s * count)).sqrt();
    let averages = angles.len() as f64 / m as f64;
    AllanPoint { tau_s, deviation, sigma: deviation / (2.0 * (averages - 1.0)).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alternating_rates_have_the_deviation_that_the_definition_gives() {
        let rates: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let points = allan_deviation(&rates, 0.1);
        // Neighbours differ by 2: sqrt(4 / 2). Averages over two samples are all equal.
        assert!((points[0].deviation - 2.0_f64.sqrt()).abs() < 1e-9);
        assert!(points[1].deviation < 1e-9 && (points[1].tau_s - 0.2).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_number_gives_no_points() {
        assert!(allan_deviation(&[0.0, f64::NAN], 0.1).is_empty());
        assert!(allan_deviation(&[0.0; 100], 0.0).is_empty());
        assert!(allan_deviation(&[0.0; 5], 0.1).is_empty());
    }
}
