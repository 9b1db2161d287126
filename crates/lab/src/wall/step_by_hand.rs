//! A step test as it is done by hand: differences of readings, lines through overlapping pieces, and the time to 90 %.

use posebridge_estimator::models::wall_approach::WallApproachModel;

use super::log::WallLog;

/// A speed towards the wall and the instant that it is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSample {
    /// When, in s.
    pub at_s: f64,
    /// The speed, m/s; positive towards the wall.
    pub towards_m_per_s: f64,
}

/// Why a step test has no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WallStepError {
    /// There are too few readings since the drive began.
    #[error("{found} readings since the drive began, {needed} are needed; drive longer or read faster")]
    TooFewReadings {
        /// Readings there are.
        found: usize,
        /// Readings that it takes.
        needed: usize,
    },
    /// No input but zero.
    #[error("the log holds no motor input, so the start of the step is unknown")]
    NoInput,
    /// The readings do not get smaller under the drive, or not as a first-order drive makes them.
    #[error("the readings do not show a car that speeds up towards the wall")]
    NoMotion,
}

/// What is found by hand.
#[derive(Clone, Debug, PartialEq)]
pub struct ManualStepFit {
    /// Speed at which it settles, from the steepest line, m/s.
    pub steady_m_per_s: f64,
    /// The same by the difference of the first and the last reading of that piece, m/s.
    pub steady_by_difference_m_per_s: f64,
    /// When the drive began, s.
    pub start_s: f64,
    /// Time from there to 90 % of the steady speed, s; between two lines it is interpolated.
    pub rise_90_s: f64,
    /// d and m from the two.
    pub model: WallApproachModel,
}

/// Speeds between neighbouring readings.
pub fn differences(log: &WallLog) -> Vec<SpeedSample> {
    let readings: Vec<(f64, f64)> = log.readings().collect();
    let pairs = readings.windows(2).filter(|pair| pair[1].0 > pair[0].0);
    pairs
        .map(|pair| SpeedSample {
            at_s: f64::midpoint(pair[0].0, pair[1].0),
            towards_m_per_s: (pair[0].1 - pair[1].1) / (pair[1].0 - pair[0].0),
        })
        .collect()
}

/// Slopes of lines by least squares through pieces of this number of readings, each overlapping half of the one before.
pub fn overlapping_lines(log: &WallLog, piece: usize) -> Vec<SpeedSample> {
    let readings: Vec<(f64, f64)> = log.readings().collect();
    segments(&readings, piece).filter_map(slope).collect()
}

/// Pieces of this number of readings that overlap by half; the last ends with the last reading.
fn segments(readings: &[(f64, f64)], piece: usize) -> impl Iterator<Item = &[(f64, f64)]> {
    let piece = piece.max(2);
    let last = readings.len().checked_sub(piece);
    let starts = last.into_iter().flat_map(move |last| {
        let step = piece.div_ceil(2);
        (0..last).step_by(step).chain([last])
    });
    starts.filter_map(move |start| readings.get(start..start + piece))
}

fn slope(piece: &[(f64, f64)]) -> Option<SpeedSample> {
    let count = piece.len() as f64;
    let at_s = piece.iter().map(|(at_s, _)| at_s).sum::<f64>() / count;
    let mean_m = piece.iter().map(|(_, range_m)| range_m).sum::<f64>() / count;
    let (mut across, mut along) = (0.0, 0.0);
    for (time_s, range_m) in piece {
        across += (time_s - at_s) * (range_m - mean_m);
        along += (time_s - at_s).powi(2);
    }
    (along > 0.0).then_some(SpeedSample { at_s, towards_m_per_s: -across / along })
}

/// Evaluates a step by hand: lines through pieces of this number of readings.
///
/// A line's slope is the mean speed of its piece, below that at its end while the car speeds up, and the steepest of several noisy
/// lines is too steep: figures of this kind are good to some per cent. [`fit_steps`](super::fit_steps) is better and says how good.
///
/// # Errors
/// [`WallStepError`] as it says.
pub fn fit_by_hand(log: &WallLog, piece: usize) -> Result<ManualStepFit, WallStepError> {
    let start_s = log.drives_from_s().ok_or(WallStepError::NoInput)?;
    let readings: Vec<(f64, f64)> = log.readings().filter(|(at_s, _)| *at_s >= start_s).collect();
    let needed = piece.max(2) + 1;
    if readings.len() < needed {
        return Err(WallStepError::TooFewReadings { found: readings.len(), needed });
    }
    let lines = segments(&readings, piece).filter_map(|piece| Some((slope(piece)?, piece)));
    let lines: Vec<(SpeedSample, &[(f64, f64)])> = lines.collect();
    let steepest = lines.iter().max_by(|a, b| a.0.towards_m_per_s.total_cmp(&b.0.towards_m_per_s));
    let (steady, of) = steepest.ok_or(WallStepError::NoMotion)?;
    let steady_m_per_s = steady.towards_m_per_s;
    let [first, .., last] = of else {
        return Err(WallStepError::NoMotion);
    };
    let reached_s = crossing(&lines, start_s, 0.9 * steady_m_per_s);
    let rise_90_s = reached_s.map_or(0.0, |at_s| at_s - start_s);
    if steady_m_per_s <= 0.0 || rise_90_s <= 0.0 {
        return Err(WallStepError::NoMotion);
    }
    Ok(ManualStepFit {
        steady_m_per_s,
        steady_by_difference_m_per_s: (first.1 - last.1) / (last.0 - first.0),
        start_s,
        rise_90_s,
        model: WallApproachModel::from_step_test(steady_m_per_s, rise_90_s),
    })
}

/// The mean over several steps; `None` of none.
pub fn mean_manual_fit(steps: &[ManualStepFit]) -> Option<ManualStepFit> {
    let count = steps.len() as f64;
    let mean = |of: fn(&ManualStepFit) -> f64| steps.iter().map(of).sum::<f64>() / count;
    let steady_m_per_s = mean(|step| step.steady_m_per_s);
    let rise_90_s = mean(|step| step.rise_90_s);
    (!steps.is_empty()).then(|| ManualStepFit {
        steady_m_per_s,
        steady_by_difference_m_per_s: mean(|step| step.steady_by_difference_m_per_s),
        start_s: mean(|step| step.start_s),
        rise_90_s,
        model: WallApproachModel::from_step_test(steady_m_per_s, rise_90_s),
    })
}

/// When the speed first reaches this, from rest at the start.
fn crossing(lines: &[(SpeedSample, &[(f64, f64)])], start_s: f64, level: f64) -> Option<f64> {
    let mut before = (start_s, 0.0);
    for (line, _) in lines {
        let speed = line.towards_m_per_s;
        if speed >= level {
            let share = (level - before.1) / (speed - before.1);
            return Some(before.0 + share * (line.at_s - before.0));
        }
        before = (line.at_s.max(start_s), speed);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::log::{WallEntry, WallReading};
    use super::*;

    /// Noise-free readings of the text's car, 18 on the way.
    fn noise_free(period_s: f64, count: u32) -> WallLog {
        let tau_s = 0.997 / std::f64::consts::LN_10;
        let readings = (0..count).map(|index| {
            let t = f64::from(index) * period_s;
            let way = 1.225 * (t - tau_s * (1.0 - (-t / tau_s).exp()));
            WallEntry { at_s: 0.241 + t, reading: WallReading::Range(4.0 - way) }
        });
        let drive = WallEntry { at_s: 0.241, reading: WallReading::Input(1.0) };
        WallLog::new([drive].into_iter().chain(readings).collect())
    }

    #[test]
    fn lines_and_differences_come_to_the_texts_car_when_readings_are_dense() {
        let log = noise_free(0.01, 280);
        let found = fit_by_hand(&log, 6).unwrap();
        assert!((found.steady_m_per_s / 1.225 - 1.0).abs() < 0.003, "{found:?}");
        assert!((found.steady_by_difference_m_per_s / found.steady_m_per_s - 1.0).abs() < 0.003);
        assert!((found.rise_90_s / 0.997 - 1.0).abs() < 0.02, "{found:?}");
        assert!((found.start_s - 0.241).abs() < 1e-12);
        let last = *differences(&log).last().unwrap();
        assert!((last.towards_m_per_s - 1.223).abs() < 0.003, "{last:?}");
    }

    #[test]
    fn the_mean_of_steps_has_the_model_of_the_mean_figures() {
        let one = fit_by_hand(&noise_free(0.01, 280), 6).unwrap();
        let mut other = one.clone();
        other.steady_m_per_s += 0.2;
        other.rise_90_s -= 0.1;
        let mean = mean_manual_fit(&[one.clone(), other]).unwrap();
        let expected = WallApproachModel::from_step_test(one.steady_m_per_s + 0.1, one.rise_90_s - 0.05);
        assert!((mean.model.mass_s2_per_m - expected.mass_s2_per_m).abs() < 1e-12);
        assert_eq!(mean_manual_fit(&[]), None);
    }

    #[test]
    fn pieces_overlap_by_half_and_reach_the_end() {
        let log = noise_free(0.1, 10);
        let lines = overlapping_lines(&log, 4);
        let middles: Vec<f64> = lines.iter().map(|line| line.at_s - 0.241).collect();
        for (found, expected) in middles.iter().zip([0.15, 0.35, 0.55, 0.75]) {
            assert!((found - expected).abs() < 1e-12, "{middles:?}");
        }
        assert_eq!(middles.len(), 4);
        assert!(overlapping_lines(&log, 11).is_empty());
    }

    #[test]
    fn what_is_no_step_is_refused_with_the_reason() {
        let full = noise_free(0.1, 4);
        let few = WallStepError::TooFewReadings { found: 4, needed: 5 };
        assert_eq!(fit_by_hand(&full, 4), Err(few));
        let undriven: Vec<WallEntry> = full.entries()[1..].to_vec();
        assert_eq!(fit_by_hand(&WallLog::new(undriven), 3), Err(WallStepError::NoInput));
        let standing = (0..9).map(|index| WallEntry { at_s: f64::from(index), reading: WallReading::Range(1.0) });
        let drive = WallEntry { at_s: 0.0, reading: WallReading::Input(1.0) };
        let standing = WallLog::new([drive].into_iter().chain(standing).collect());
        assert_eq!(fit_by_hand(&standing, 3), Err(WallStepError::NoMotion));
    }
}
