//! How often a loop turned, with how sure that is: the dt of a filter on the brick.

use posebridge_telemetry::UncertainValue;

use super::log::WallLog;

/// The mean interval between the inputs of logs, in seconds; its sigma is that of a mean of intervals that are independent of each other.
///
/// `None` where there are fewer than three intervals, as in a log without its inputs.
pub fn loop_period(logs: &[WallLog]) -> Option<UncertainValue> {
    let intervals: Vec<f64> = logs
        .iter()
        .flat_map(|log| {
            let times: Vec<f64> = log.inputs().map(|(at_s, _)| at_s).collect();
            gaps(&times)
        })
        .collect();
    mean(&intervals)
}

/// The same between the readings: a reading that is missed makes a gap twice as long.
pub fn reading_period(logs: &[WallLog]) -> Option<UncertainValue> {
    let intervals: Vec<f64> = logs
        .iter()
        .flat_map(|log| {
            let times: Vec<f64> = log.readings().map(|(at_s, _)| at_s).collect();
            gaps(&times)
        })
        .collect();
    mean(&intervals)
}

fn gaps(times: &[f64]) -> Vec<f64> {
    let pairs = times.iter().zip(times.iter().skip(1));
    pairs.map(|(from, to)| to - from).collect()
}

fn mean(intervals: &[f64]) -> Option<UncertainValue> {
    let count = intervals.len();
    if count < 3 {
        return None;
    }
    let value = intervals.iter().sum::<f64>() / count as f64;
    let squares: f64 = intervals.iter().map(|gap| (gap - value).powi(2)).sum();
    let variance = squares / (count - 1) as f64;
    Some(UncertainValue { value, sigma: (variance / count as f64).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::super::log::{WallEntry, WallReading};
    use super::*;

    fn log(times: &[f64], said: fn(f64) -> WallReading) -> WallLog {
        let entries = times.iter().map(|&at_s| WallEntry { at_s, reading: said(1.0) });
        WallLog::new(entries.collect())
    }

    #[test]
    fn the_mean_is_over_all_logs_and_not_over_the_time_between_them() {
        let logs = [log(&[0.0, 0.01, 0.03], WallReading::Input), log(&[100.0, 100.01, 100.03], WallReading::Input)];
        let found = loop_period(&logs).unwrap();
        assert!((found.value - 0.015).abs() < 1e-9);
        // Four intervals of 10, 20, 10, 20 ms: 5 ms off each, over 3, over 4.
        assert!((found.sigma - 0.005 / 3.0_f64.sqrt()).abs() < 1e-9);
        assert_eq!(reading_period(&logs), None);
    }

    #[test]
    fn a_log_without_inputs_has_no_loop() {
        let logs = [log(&[0.0, 0.1, 0.2, 0.3], WallReading::Range)];
        assert_eq!(loop_period(&logs), None);
        assert!((reading_period(&logs).unwrap().value - 0.1).abs() < 1e-9);
        assert_eq!(loop_period(&[]), None);
    }
}
