//! The readings of a sensor at rest, split at gaps.

use crate::statistics::median;

/// A longer gap splits a stretch, unless the sensor's rate is that low: the state during it is unknown.
const MIN_SILENCE_S: f64 = 1.0;
/// Gap of a sensor with a low rate, in median intervals.
const SILENCE_INTERVALS: f64 = 3.0;
/// Fewer readings give no useful mean; 20 determine the noise to a sixth.
const MIN_READINGS: usize = 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RestError {
    #[error("only {0} samples; 20 are the least")]
    TooShort(usize),
    #[error("the samples hold a number that is not finite, or no time passes between them")]
    NotFinite,
    #[error("every sample is the same: the sensor's step hides its noise, which is below half a step")]
    Silent,
}

#[derive(Clone, Debug, PartialEq)]
pub struct RestRecord {
    /// Instant in seconds and reading, in time order; each stretch has at least one.
    stretches: Vec<Vec<(f64, f64)>>,
    interval_s: f64,
    silences: Vec<f64>,
}

impl RestRecord {
    /// Splits stretches of (instant in s, reading), each in time order, at gaps.
    pub fn from_stretches(stretches: &[Vec<(f64, f64)>]) -> Result<Self, RestError> {
        let readings = stretches.iter().map(Vec::len).sum();
        if readings < MIN_READINGS {
            return Err(RestError::TooShort(readings));
        }
        let mut all = stretches.iter().flatten();
        if !all.all(|(at_s, reading)| at_s.is_finite() && reading.is_finite()) {
            return Err(RestError::NotFinite);
        }
        let interval_s = median_interval_s(stretches).ok_or(RestError::NotFinite)?;
        let longest_s = MIN_SILENCE_S.max(SILENCE_INTERVALS * interval_s);
        let is_on = |before: &(f64, f64), after: &(f64, f64)| after.0 - before.0 <= longest_s;
        let mut record = Self { stretches: Vec::new(), interval_s, silences: Vec::new() };
        for stretch in stretches {
            let mut before_s = None;
            for part in stretch.chunk_by(is_on) {
                let (first, last) = (part.first(), part.last());
                let silence = first.zip(before_s).map(|(first, before_s)| first.0 - before_s);
                record.silences.extend(silence);
                before_s = last.map(|last| last.0);
                record.stretches.push(part.to_vec());
            }
        }
        Ok(record)
    }

    /// The stretches without a gap; none is empty.
    pub fn stretches(&self) -> &[Vec<(f64, f64)>] {
        &self.stretches
    }

    pub const fn interval_s(&self) -> f64 {
        self.interval_s
    }

    pub fn silences(&self) -> &[f64] {
        &self.silences
    }

    /// Total duration of the stretches, without gaps.
    pub fn rest_s(&self) -> f64 {
        self.stretches.iter().filter_map(|one| length_s(one)).sum()
    }

    pub fn longest(&self) -> &[(f64, f64)] {
        let longest = self.stretches.iter().max_by_key(|stretch| stretch.len());
        longest.map_or(&[], Vec::as_slice)
    }

    pub fn readings(&self) -> impl Iterator<Item = f64> {
        self.stretches.iter().flatten().map(|(_, reading)| *reading)
    }
}

fn length_s(stretch: &[(f64, f64)]) -> Option<f64> {
    Some(stretch.last()?.0 - stretch.first()?.0)
}

/// `None` unless it is positive.
fn median_interval_s(stretches: &[Vec<(f64, f64)>]) -> Option<f64> {
    let pairs = stretches.iter().flat_map(|stretch| stretch.windows(2));
    median(pairs.filter_map(length_s)).filter(|interval_s| *interval_s > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ten_a_second(from_s: f64, count: u32) -> Vec<(f64, f64)> {
        let readings = (0..count).map(|i| (from_s + 0.1 * f64::from(i), f64::from(i % 3)));
        readings.collect()
    }

    #[test]
    fn a_silence_ends_a_stretch_and_lengthens_no_interval() {
        let mut readings = ten_a_second(5.0, 100);
        // The last rows of a file in seconds since 1970.
        readings.extend(ten_a_second(1.7e9, 5));
        let record = RestRecord::from_stretches(&[readings, ten_a_second(0.0, 2)]).unwrap();
        assert!((record.interval_s() - 0.1).abs() < 1e-6);
        let counts: Vec<usize> = record.stretches().iter().map(Vec::len).collect();
        assert_eq!(counts, [100, 5, 2]);
        assert_eq!(record.longest().len(), 100);
        assert!((record.rest_s() - (9.9 + 0.4 + 0.1)).abs() < 1e-5);
        assert_eq!(record.silences().len(), 1);
        assert!((record.silences()[0] - (1.7e9 - 14.9)).abs() < 1e-3);
    }

    #[test]
    fn a_sensor_that_speaks_seldom_is_not_silent() {
        let readings: Vec<(f64, f64)> = (0..100).map(|i| (5.0 * f64::from(i), 0.0)).collect();
        let record = RestRecord::from_stretches(&[readings]).unwrap();
        assert_eq!(record.stretches().len(), 1);
        assert!(record.silences().is_empty());
    }

    #[test]
    fn what_is_no_record_is_refused() {
        let refused = |readings: Vec<(f64, f64)>| RestRecord::from_stretches(&[readings]).unwrap_err();
        assert_eq!(refused(ten_a_second(0.0, 19)), RestError::TooShort(19));
        assert_eq!(refused(vec![(1.0, 0.0); 200]), RestError::NotFinite);
        let mut broken = ten_a_second(0.0, 200);
        broken[7].1 = f64::NAN;
        assert_eq!(refused(broken.clone()), RestError::NotFinite);
        broken[7] = (f64::INFINITY, 0.0);
        assert_eq!(refused(broken), RestError::NotFinite);
        // A reading at a time has no interval.
        let alone: Vec<Vec<(f64, f64)>> = (0..200).map(|i| vec![(f64::from(i), 0.0)]).collect();
        assert_eq!(RestRecord::from_stretches(&alone), Err(RestError::NotFinite));
    }
}
