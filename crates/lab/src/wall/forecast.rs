//! Compares each reading with its prediction from earlier readings: by the bank of filters, and by lines.

use posebridge_estimator::Params;
use posebridge_estimator::numerics::statistics::mean;

use super::drive_bank::DriveBank;
use super::log::{WallLog, WallReading};
use crate::statistics::{FittedLine, correlated_variance};

/// Readings per line: two as in the paper, and longer ones for noisy readings.
pub const LINES: [usize; 3] = [2, 3, 5];

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeForecast {
    pub at_s: f64,
    pub range_m: f64,
    /// By the bank, which learns drive and noise from the earlier readings.
    pub kalman_m: f64,
    pub towards_m_per_s: f64,
    /// Motor input at the reading.
    pub input: f64,
    /// By the line through the last readings, [`LINES`] of them; `None` before there are as many.
    pub lines_m: [Option<f64>; LINES.len()],
    /// Steady speed under the input 1, and time constant, s.
    pub drive: Option<(f64, f64)>,
    /// Half-width of the gate, max(GATE_MIN, 3 sqrt(S)): a reading further from its prediction is rejected.
    pub gate_m: f64,
    pub is_gated: bool,
}

/// Predicts every reading but the first from the earlier ones.
pub fn forecast(log: &WallLog, range_sigma_m: f64) -> Vec<RangeForecast> {
    let mut bank = DriveBank::new(range_sigma_m, Params::default().wall_gate_m);
    let mut input = 0.0;
    let mut past: Vec<(f64, f64)> = Vec::new();
    let mut forecasts = Vec::new();
    for entry in log.entries() {
        let range_m = match entry.reading {
            WallReading::Input(next) => {
                bank.observe_input(entry.at_s, next);
                input = next;
                continue;
            }
            WallReading::Range(range_m) => range_m,
        };
        let drive = bank.drive();
        if let Some(update) = bank.observe_range(entry.at_s, range_m) {
            forecasts.push(RangeForecast {
                at_s: entry.at_s,
                range_m,
                kalman_m: update.predicted.distance_m,
                towards_m_per_s: update.predicted.towards_m_per_s,
                input,
                lines_m: LINES.map(|count| extrapolated(&past, count, entry.at_s)),
                drive,
                gate_m: update.gate_m,
                is_gated: update.is_gated,
            });
        }
        if past.last().is_none_or(|(last_s, _)| entry.at_s > *last_s) {
            past.push((entry.at_s, range_m));
        }
    }
    forecasts
}

fn extrapolated(past: &[(f64, f64)], count: usize, at_s: f64) -> Option<f64> {
    let last = past.get(past.len().checked_sub(count)?..)?;
    let line = FittedLine::through(last)?;
    Some(line.centre.1 + line.slope * (at_s - line.centre.0))
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GateStatistics {
    pub readings: usize,
    pub gated: usize,
    pub mean_m: f64,
}

pub fn gate_statistics(foreseen: &[RangeForecast]) -> Option<GateStatistics> {
    let mean_m = mean(foreseen.iter().map(|one| one.gate_m))?;
    Some(GateStatistics { readings: foreseen.len(), gated: foreseen.iter().filter(|one| one.is_gated).count(), mean_m })
}

/// Root mean square prediction errors, over the readings that both methods predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForecastScore {
    pub readings: usize,
    pub kalman_rms_m: f64,
    pub other_rms_m: f64,
    pub verdict: ForecastVerdict,
}

/// Which of two methods predicts better, by the mean of the differences of their squared errors and its sigma.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForecastVerdict {
    FilterBetter,
    /// Within two sigmas: the other method is as good on these readings.
    AsGood,
    OtherBetter,
}

impl ForecastVerdict {
    pub const fn name(self) -> &'static str {
        match self {
            Self::FilterBetter => "filter better",
            Self::AsGood => "as good",
            Self::OtherBetter => "line better",
        }
    }
}

/// Neighbouring errors of a prediction are correlated over about so many readings.
const CORRELATED_READINGS: usize = 3;

/// Scores the filter against another method; `other` returns that method's prediction. `None` without a common reading.
pub fn score_forecasts(
    foreseen: &[RangeForecast],
    other: impl Fn(&RangeForecast) -> Option<f64>,
) -> Option<ForecastScore> {
    let common: Vec<[f64; 2]> = foreseen
        .iter()
        .filter_map(|one| Some([(one.range_m - one.kalman_m).powi(2), (one.range_m - other(one)?).powi(2)]))
        .collect();
    let [kalman, others] = [0, 1].map(|which| mean(common.iter().map(|pair| pair[which])));
    let gains: Vec<f64> = common.iter().map(|pair| pair[1] - pair[0]).collect();
    let gain = mean(gains.iter().copied())?;
    let centred: Vec<f64> = gains.iter().map(|one| one - gain).collect();
    let sigma = correlated_variance(&centred, CORRELATED_READINGS).max(0.0).sqrt() / gains.len() as f64;
    let verdict = if gain.abs() <= 2.0 * sigma || gains.len() < 2 {
        ForecastVerdict::AsGood
    } else if gain > 0.0 {
        ForecastVerdict::FilterBetter
    } else {
        ForecastVerdict::OtherBetter
    };
    Some(ForecastScore { readings: common.len(), kalman_rms_m: kalman?.sqrt(), other_rms_m: others?.sqrt(), verdict })
}

/// The score against the line that predicts best in hindsight, and its readings.
pub fn score_against_best_line(foreseen: &[RangeForecast]) -> Option<(usize, ForecastScore)> {
    let scores = LINES
        .iter()
        .enumerate()
        .filter_map(|(index, count)| Some((*count, score_forecasts(foreseen, |one| one.lines_m[index])?)));
    // Ratios, because lines of more readings predict fewer of them.
    let ratio = |score: &ForecastScore| score.kalman_rms_m / score.other_rms_m;
    scores.max_by(|a, b| ratio(&a.1).total_cmp(&ratio(&b.1)))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::wall::log::test_logs::log_of;

    fn log(ranges: &[f64]) -> WallLog {
        let ranges = ranges.iter().enumerate().map(|(index, range_m)| (0.1 * index as f64, *range_m));
        log_of([], ranges).with_assumed_drive()
    }

    const SIGMA_M: f64 = 0.01;

    #[test]
    fn what_is_foretold_does_not_depend_on_what_comes_later() {
        let ranges = [3.0, 2.98, 2.93, 2.86, 2.77, 2.66, 2.52, 2.39, 2.21, 2.04];
        let mut changed = ranges;
        changed[8..].fill(9.0);
        let (before, after) = (forecast(&log(&ranges), SIGMA_M), forecast(&log(&changed), SIGMA_M));
        assert_eq!(before.len(), 9);
        for (before, after) in before.iter().zip(&after).take(7) {
            assert_eq!(before, after);
        }
        assert_eq!(before[7].kalman_m, after[7].kalman_m);
        assert_ne!(before[8].kalman_m, after[8].kalman_m);
        assert_eq!(before[0].lines_m[0], None);
        assert!((before[1].lines_m[0].unwrap() - 2.96).abs() < 1e-9);
    }

    #[test]
    fn a_reading_beyond_the_gate_is_refused_and_counted() {
        // 0.5 m/s; the reading at 1.6 s is a passer-by.
        let mut ranges: Vec<f64> = (0..24).map(|index| 3.0 - 0.05 * f64::from(index)).collect();
        ranges[16] = 0.1;
        let foreseen = forecast(&log(&ranges), SIGMA_M);
        let refused: Vec<usize> = (0..23).filter(|index| foreseen[*index].is_gated).collect();
        // There is no prediction of the first reading.
        assert_eq!(refused, [15]);
        let off_m = (foreseen[15].range_m - foreseen[15].kalman_m).abs();
        assert!(off_m > foreseen[15].gate_m);
        let used = gate_statistics(&foreseen).unwrap();
        assert_eq!((used.readings, used.gated), (23, 1));
        assert!(used.mean_m > 0.03 && used.mean_m < off_m, "{used:?}");
        assert_eq!(gate_statistics(&[]), None);
    }

    #[test]
    fn scores_are_over_common_readings_alone() {
        let foreseen = forecast(&log(&[3.0, 2.9, 2.7]), SIGMA_M);
        let by_line = score_forecasts(&foreseen, |foreseen| foreseen.lines_m[0]).unwrap();
        assert_eq!(by_line.readings, 1);
        assert!((by_line.other_rms_m - 0.1).abs() < 1e-9);
        let expected = (foreseen[1].range_m - foreseen[1].kalman_m).abs();
        assert!((by_line.kalman_rms_m - expected).abs() < 1e-12);
        assert_eq!(score_forecasts(&foreseen, |_| None), None);
    }

    /// A car of 2 m/s and 0.9 s under full drive, read ten times a second with 10 mm of noise.
    fn driven(input: f64, readings: u32) -> WallLog {
        let mut normals = Pcg64::seed_from_u64(7);
        let ranges = (0..readings).map(|index| {
            let t = 0.1 * f64::from(index);
            let distance_m = 2.0 * (t - 0.9 * (1.0 - (-t / 0.9).exp()));
            let noise: f64 = normals.sample(StandardNormal);
            (t, 5.0 - distance_m + 0.01 * noise)
        });
        log_of([(0.0, input)], ranges)
    }

    #[test]
    fn a_car_is_recognised_by_what_it_has_done_whatever_the_sign_of_its_input() {
        for input in [1.0, -0.5] {
            let (steady, time_constant_s) = forecast(&driven(input, 25), SIGMA_M).last().unwrap().drive.unwrap();
            assert!((steady * input / 2.0 - 1.0).abs() < 0.2, "{steady}");
            assert!((0.6..1.4).contains(&time_constant_s), "{time_constant_s}");
        }
    }

    #[test]
    fn a_car_that_has_turned_away_is_followed_from_the_third_reading_on() {
        // A wall at 1 m is gone: the next one is 3.5 m away.
        let ranges: Vec<f64> = (0..30)
            .map(|index| if index < 15 { 2.4 - 0.1 * f64::from(index) } else { 3.5 - 0.05 * f64::from(index - 15) })
            .collect();
        let forecasts = forecast(&log(&ranges), SIGMA_M);
        let refused: Vec<usize> = (0..29).filter(|index| forecasts[*index].is_gated).collect();
        assert_eq!(refused, [14, 15]);
        assert!(forecasts[17..].iter().all(|one| (one.kalman_m - one.range_m).abs() < 0.06));
    }

    #[test]
    fn after_somebody_who_stood_in_the_way_the_old_distance_is_taken_up_at_once() {
        let mut ranges: Vec<f64> = (0..30).map(|index| 3.0 - 0.05 * f64::from(index)).collect();
        ranges[15..19].fill(0.6);
        let forecasts = forecast(&log(&ranges), SIGMA_M);
        // The 16th and 17th reading are refused, the next two are used, the 20th returns to what was known.
        let refused: Vec<usize> = (0..29).filter(|index| forecasts[*index].is_gated).collect();
        assert_eq!(refused, [14, 15, 18]);
        assert!((forecasts[19].kalman_m - forecasts[19].range_m).abs() < 0.03);
    }
}
