//! Each reading held against what was foretold before it was seen.

use posebridge_estimator::Params;
use posebridge_telemetry::FusionOutcome;

use super::log::{WallLog, WallReading};
use super::plant::{Plant, PlantFilter, PlantSearch};
use super::replay_filter::{ApproachEstimator, LinearExtrapolation};
use super::validate::{GATE_SIGMAS, innovation_sigma};

/// A reading and what was foretold of it, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeForecast {
    /// When it was made, s.
    pub at_s: f64,
    /// Its prediction.
    pub range_m: f64,
    /// By the filter, with the drive and the noise as the readings before have shown them.
    pub kalman_m: f64,
    /// By the line through the last two; `None` before there are two.
    pub line_m: Option<f64>,
    /// The model of the car.
    pub plant: Plant,
    /// Half-width of the gate, max(GATE_MIN, 3 sqrt(S)): a reading that is further from what was foretold is refused, m. `None` where
    /// the filter held it against nothing.
    pub gate_m: Option<f64>,
    /// Whether the gate refused the reading.
    pub is_gated: bool,
}

/// The drive is identified anew when the number of readings has grown by this factor; early, at each. It keeps the work of long logs small.
const REFIT_GROWTH: f64 = 1.02;

/// Foretells every reading but the first from those before it.
pub fn forecast(log: &WallLog, search: PlantSearch) -> Vec<RangeForecast> {
    let least_gate_m = Params::default().wall_gate_m;
    let mut foreseen = Vec::new();
    let mut line = LinearExtrapolation::default();
    let mut known: Option<(Plant, PlantFilter)> = None;
    let (mut readings, mut identified_at) = (0_usize, 0_usize);
    for (index, entry) in log.entries().iter().enumerate() {
        let WallReading::Range(range_m) = entry.reading else {
            if let Some((_, runner)) = &mut known {
                runner.observe(entry.at_s, entry.reading);
            }
            continue;
        };
        let is_due = readings as f64 >= REFIT_GROWTH * identified_at as f64;
        if readings > 0 && (known.is_none() || (is_due && readings > identified_at)) {
            let past = log.entries().iter().take(index).copied().collect();
            known = Some(search.best(&WallLog::new(past)));
            identified_at = readings;
        }
        if let Some((plant, runner)) = &mut known {
            let foretold = runner.distance_m(entry.at_s);
            let record = runner.fuse(entry.at_s, range_m);
            foreseen.extend(foretold.map(|kalman_m| RangeForecast {
                at_s: entry.at_s,
                range_m,
                kalman_m,
                line_m: line.estimate(entry.at_s).map(|belief| belief.distance_m).filter(|_| readings >= 2),
                plant: *plant,
                gate_m: innovation_sigma(&record).map(|s_m2| least_gate_m.max(GATE_SIGMAS * s_m2.sqrt())),
                is_gated: record.outcome == FusionOutcome::Gated,
            }));
        }
        line.observe_range(entry.at_s, range_m);
        readings += 1;
    }
    foreseen
}

/// What the gate did with the readings of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GateStatistics {
    /// Readings that were held against a prediction.
    pub readings: usize,
    /// Of these, readings that were refused.
    pub gated: usize,
    /// The gate's mean half-width, m.
    pub mean_m: f64,
}

/// Sums up the gate; `None` if no reading was held against a prediction.
pub fn gate_statistics(foreseen: &[RangeForecast]) -> Option<GateStatistics> {
    let gates: Vec<f64> = foreseen.iter().filter_map(|one| one.gate_m).collect();
    if gates.is_empty() {
        return None;
    }
    Some(GateStatistics {
        readings: gates.len(),
        gated: foreseen.iter().filter(|one| one.is_gated).count(),
        mean_m: gates.iter().sum::<f64>() / gates.len() as f64,
    })
}

/// Root mean squares of readings minus what was foretold, in m, over the readings that both sides foretold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForecastScore {
    /// How many readings.
    pub readings: usize,
    /// Of the filter.
    pub kalman_rms_m: f64,
    /// Of the other.
    pub other_rms_m: f64,
}

/// Scores the filter against another one; `other` gives what that one foretold. `None` if there is no common reading.
pub fn score_forecasts(
    foreseen: &[RangeForecast],
    other: impl Fn(&RangeForecast) -> Option<f64>,
) -> Option<ForecastScore> {
    let common: Vec<(&RangeForecast, f64)> =
        foreseen.iter().filter_map(|foreseen| Some((foreseen, other(foreseen)?))).collect();
    if common.is_empty() {
        return None;
    }
    let rms = |error: &dyn Fn(&(&RangeForecast, f64)) -> f64| {
        let squares = common.iter().map(|pair| error(pair).powi(2));
        (squares.sum::<f64>() / common.len() as f64).sqrt()
    };
    Some(ForecastScore {
        readings: common.len(),
        kalman_rms_m: rms(&|(foreseen, _)| foreseen.range_m - foreseen.kalman_m),
        other_rms_m: rms(&|(foreseen, other_m)| foreseen.range_m - other_m),
    })
}

#[cfg(test)]
mod tests {
    use super::super::log::WallEntry;
    use super::*;

    fn log(ranges: &[f64]) -> WallLog {
        let ranges = ranges
            .iter()
            .enumerate()
            .map(|(index, range_m)| WallEntry { at_s: 0.1 * index as f64, reading: WallReading::Range(*range_m) });
        WallLog::new(ranges.collect()).with_assumed_drive()
    }

    const SEARCH: PlantSearch = PlantSearch { range_sigma_m: 0.01 };

    #[test]
    fn what_is_foretold_does_not_depend_on_what_comes_later() {
        let ranges = [3.0, 2.98, 2.93, 2.86, 2.77, 2.66, 2.52, 2.39, 2.21, 2.04];
        let mut changed = ranges;
        changed[8..].fill(9.0);
        let (before, after) = (forecast(&log(&ranges), SEARCH), forecast(&log(&changed), SEARCH));
        assert_eq!(before.len(), 9);
        for (before, after) in before.iter().zip(&after).take(7) {
            assert_eq!(before, after);
        }
        assert_eq!(before[7].kalman_m, after[7].kalman_m);
        assert_ne!(before[8].kalman_m, after[8].kalman_m);
        assert_eq!(before[0].line_m, None);
        assert!((before[1].line_m.unwrap() - 2.96).abs() < 1e-9);
    }

    #[test]
    fn a_reading_beyond_the_gate_is_refused_and_counted() {
        // 0.5 m/s; the reading at 1.6 s is a passer-by.
        let mut ranges: Vec<f64> = (0..24).map(|index| 3.0 - 0.05 * f64::from(index)).collect();
        ranges[16] = 0.1;
        let foreseen = forecast(&log(&ranges), SEARCH);
        let refused: Vec<usize> = (0..23).filter(|index| foreseen[*index].is_gated).collect();
        // There is no prediction of the first reading.
        assert_eq!(refused, [15]);
        let off_m = (foreseen[15].range_m - foreseen[15].kalman_m).abs();
        assert!(off_m > foreseen[15].gate_m.unwrap());
        let used = gate_statistics(&foreseen).unwrap();
        assert_eq!((used.readings, used.gated), (23, 1));
        assert!(used.mean_m > 0.03 && used.mean_m < off_m, "{used:?}");
        assert_eq!(gate_statistics(&[]), None);
    }

    #[test]
    fn scores_are_over_common_readings_alone() {
        let foreseen = forecast(&log(&[3.0, 2.9, 2.7]), SEARCH);
        let by_line = score_forecasts(&foreseen, |foreseen| foreseen.line_m).unwrap();
        assert_eq!(by_line.readings, 1);
        assert!((by_line.other_rms_m - 0.1).abs() < 1e-9);
        let expected = (foreseen[1].range_m - foreseen[1].kalman_m).abs();
        assert!((by_line.kalman_rms_m - expected).abs() < 1e-12);
        assert_eq!(score_forecasts(&foreseen, |_| None), None);
    }
}
