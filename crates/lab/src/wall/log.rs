//! The log of a drive before a wall: readings and motor inputs in time order.

use posebridge_telemetry::UncertainValue;

use crate::statistics::{median, uncertain_mean};

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WallReading {
    Range(f64),
    /// The motor input from here on; 1 is the input of the step test, or full drive.
    Input(f64),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallEntry {
    pub at_s: f64,
    pub reading: WallReading,
}

/// Whether the log holds the command that started the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepCommand {
    Recorded,
    /// Full drive from an instant to be found.
    Unknown,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct WallLog {
    entries: Vec<WallEntry>,
}

impl WallLog {
    /// Sorts entries by time; at one instant, an input comes first. Omits non-finite entries and negative ranges.
    pub fn new(mut entries: Vec<WallEntry>) -> Self {
        entries.retain(|entry| {
            let is_sound = match entry.reading {
                WallReading::Range(range_m) => range_m.is_finite() && range_m >= 0.0,
                WallReading::Input(input) => input.is_finite(),
            };
            is_sound && entry.at_s.is_finite()
        });
        let kind = |entry: &WallEntry| matches!(entry.reading, WallReading::Range(_));
        entries.sort_by(|a, b| a.at_s.total_cmp(&b.at_s).then_with(|| kind(a).cmp(&kind(b))));
        Self { entries }
    }

    pub fn entries(&self) -> &[WallEntry] {
        &self.entries
    }

    /// Time and distance, in s and m.
    pub fn readings(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.entries.iter().filter_map(|entry| match entry.reading {
            WallReading::Range(range_m) => Some((entry.at_s, range_m)),
            WallReading::Input(_) => None,
        })
    }

    pub fn inputs(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.entries.iter().filter_map(|entry| match entry.reading {
            WallReading::Input(input) => Some((entry.at_s, input)),
            WallReading::Range(_) => None,
        })
    }

    /// The first instant with an input other than zero.
    pub fn drives_from_s(&self) -> Option<f64> {
        let mut inputs = self.inputs();
        inputs.find(|(_, input)| *input != 0.0).map(|(at_s, _)| at_s)
    }

    /// From the entry before the first drive to the drive: when in it the command came, a log of samples does not tell.
    ///
    /// For a log that begins with the drive the usual interval of its readings.
    pub(super) fn command_gap_s(&self) -> f64 {
        let drives_from_s = self.drives_from_s().unwrap_or_default();
        let before = self.entries.iter().map(|entry| entry.at_s).take_while(|at_s| *at_s < drives_from_s).last();
        let times: Vec<f64> = self.readings().map(|(at_s, _)| at_s).collect();
        let usual_s = || median(times.windows(2).map(|pair| pair[1] - pair[0])).unwrap_or_default();
        before.map_or_else(usual_s, |before_s| drives_from_s - before_s)
    }

    /// The log with its inputs later by `delay_s`: the dead time of the drive.
    pub(super) fn with_delayed_inputs(&self, delay_s: f64) -> Self {
        let mut entries = self.entries.clone();
        for entry in &mut entries {
            if matches!(entry.reading, WallReading::Input(_)) {
                entry.at_s += delay_s;
            }
        }
        Self::new(entries)
    }

    /// If the log has no input other than zero, adds full drive from its first instant on: for cars whose log has no inputs.
    pub fn with_assumed_drive(self) -> Self {
        let Some(first) = self.entries.first().copied() else {
            return self;
        };
        if self.drives_from_s().is_some() {
            return self;
        }
        let driven = WallEntry { at_s: first.at_s, reading: WallReading::Input(1.0) };
        let readings = self.entries.into_iter().filter(|entry| matches!(entry.reading, WallReading::Range(_)));
        Self::new(std::iter::once(driven).chain(readings).collect())
    }

    /// Intervals between the inputs, which a control program sends once per cycle: mean, shortest and longest.
    pub fn loop_intervals_s(&self) -> Option<(f64, f64, f64)> {
        let times: Vec<f64> = self.inputs().map(|(at_s, _)| at_s).collect();
        let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
        let (low, high) = gaps.fold((f64::INFINITY, 0.0_f64), |(low, high), gap| (low.min(gap), high.max(gap)));
        let (first, last) = (times.first()?, times.last()?);
        let count = times.len().checked_sub(1).filter(|count| *count > 0)?;
        Some(((last - first) / count as f64, low, high))
    }
}

/// The mean interval between the inputs of logs, in seconds; its sigma assumes independent intervals.
///
/// `None` for fewer than three intervals, as in a log without inputs.
pub fn loop_period(logs: &[WallLog]) -> Option<UncertainValue> {
    mean_interval(logs.iter().map(|log| log.inputs().map(|(at_s, _)| at_s).collect()))
}

/// The same between the readings: a missed reading doubles an interval.
pub fn reading_period(logs: &[WallLog]) -> Option<UncertainValue> {
    mean_interval(logs.iter().map(|log| log.readings().map(|(at_s, _)| at_s).collect()))
}

fn mean_interval(times: impl Iterator<Item = Vec<f64>>) -> Option<UncertainValue> {
    let intervals = |times: Vec<f64>| times.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<f64>>();
    let intervals: Vec<f64> = times.flat_map(intervals).collect();
    if intervals.len() < 3 { None } else { uncertain_mean(&intervals) }
}

/// A reading with the travel by then at a steady speed of 1 m/s per unit of input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ResponseSample {
    pub(super) at_s: f64,
    pub(super) range_m: f64,
    pub(super) distance_m: f64,
}

/// The readings of a log with their travel; exact, because the input is held between entries. At rest at the first entry.
pub(super) fn responses(log: &WallLog, rate_per_s: f64) -> Vec<ResponseSample> {
    let mut readings = Vec::new();
    let Some(first) = log.entries().first() else {
        return readings;
    };
    let (mut at_s, mut distance_m, mut speed, mut input) = (first.at_s, 0.0, 0.0, 0.0);
    for entry in log.entries() {
        let dt_s = entry.at_s - at_s;
        let decayed = -(-rate_per_s * dt_s).exp_m1();
        distance_m += input * dt_s + (speed - input) * decayed / rate_per_s;
        speed += (input - speed) * decayed;
        at_s = entry.at_s;
        match entry.reading {
            WallReading::Input(next) => input = next,
            WallReading::Range(range_m) => readings.push(ResponseSample { at_s, range_m, distance_m }),
        }
    }
    readings
}

#[cfg(test)]
pub(super) mod test_logs {
    use super::{WallEntry, WallLog, WallReading};

    /// The log of these inputs and ranges, each after its instant.
    pub(crate) fn log_of(
        inputs: impl IntoIterator<Item = (f64, f64)>,
        ranges: impl IntoIterator<Item = (f64, f64)>,
    ) -> WallLog {
        let inputs = inputs.into_iter().map(|(at_s, input)| WallEntry { at_s, reading: WallReading::Input(input) });
        let ranges = ranges.into_iter().map(|(at_s, range_m)| WallEntry { at_s, reading: WallReading::Range(range_m) });
        WallLog::new(inputs.chain(ranges).collect())
    }

    /// How far the text's car has come, m, so long after it began to drive.
    pub(crate) fn driven_m(since_s: f64) -> f64 {
        let tau_s = 0.997 / std::f64::consts::LN_10;
        1.225 * (since_s - tau_s * (1.0 - (-since_s / tau_s).exp()))
    }
}

#[cfg(test)]
mod tests {
    use super::test_logs::log_of;
    use super::*;

    fn entry(at_s: f64, reading: WallReading) -> WallEntry {
        WallEntry { at_s, reading }
    }

    #[test]
    fn entries_are_sorted_and_damage_is_left_out() {
        let log = WallLog::new(vec![
            entry(2.0, WallReading::Range(1.0)),
            entry(f64::NAN, WallReading::Range(1.0)),
            entry(1.0, WallReading::Range(3.0)),
            entry(1.0, WallReading::Input(0.5)),
            entry(1.5, WallReading::Range(-1.0)),
            entry(1.6, WallReading::Input(f64::INFINITY)),
        ]);
        assert_eq!(log.entries().len(), 3);
        assert_eq!(log.entries()[0].reading, WallReading::Input(0.5));
        assert_eq!(log.readings().collect::<Vec<_>>(), [(1.0, 3.0), (2.0, 1.0)]);
        assert_eq!(log.drives_from_s(), Some(1.0));
        assert_eq!(log.clone().with_assumed_drive(), log);
    }

    #[test]
    fn a_command_came_between_two_entries() {
        let sampled = log_of([(0.0, 0.0), (0.1, 0.0), (0.2, 1.0)], [(0.0, 2.0), (0.1, 2.0), (0.2, 2.0)]);
        assert!((sampled.command_gap_s() - 0.1).abs() < 1e-12);
        let begins_with_it = log_of([(0.0, 1.0)], [(0.0, 2.0), (0.07, 2.0), (0.14, 1.9)]);
        assert!((begins_with_it.command_gap_s() - 0.07).abs() < 1e-12);
    }

    #[test]
    fn a_log_without_inputs_is_taken_for_full_drive() {
        let assumed = log_of([(1.1, 0.0)], [(1.0, 3.0)]).with_assumed_drive();
        assert_eq!(assumed.inputs().collect::<Vec<_>>(), [(1.0, 1.0)]);
        assert_eq!(WallLog::default().with_assumed_drive(), WallLog::default());
    }

    #[test]
    fn the_loop_is_measured() {
        let found = log_of([0.0, 0.01, 0.04].map(|at_s| (at_s, 1.0)), []).loop_intervals_s().unwrap();
        assert!((found.0 - 0.02).abs() < 1e-12 && (found.2 - 0.03).abs() < 1e-12);
        assert!((found.1 - 0.01).abs() < 1e-12);
        assert_eq!(WallLog::default().loop_intervals_s(), None);
    }

    #[test]
    fn the_mean_is_over_all_logs_and_not_over_the_time_between_them() {
        let logs = [0.0, 100.0].map(|from_s| log_of([0.0, 0.01, 0.03].map(|at_s| (from_s + at_s, 1.0)), []));
        let found = loop_period(&logs).unwrap();
        assert!((found.value - 0.015).abs() < 1e-9);
        // Four intervals of 10, 20, 10, 20 ms: 5 ms off each, over 3, over 4.
        assert!((found.sigma - 0.005 / 3.0_f64.sqrt()).abs() < 1e-9);
        assert_eq!(reading_period(&logs), None);
    }

    #[test]
    fn a_log_without_inputs_has_no_loop() {
        let logs = [log_of([], [0.0, 0.1, 0.2, 0.3].map(|at_s| (at_s, 1.0)))];
        assert_eq!(loop_period(&logs), None);
        assert!((reading_period(&logs).unwrap().value - 0.1).abs() < 1e-9);
        assert_eq!(loop_period(&[]), None);
    }

    #[test]
    fn the_way_is_that_of_the_differential_equation() {
        let inputs = [(0.0, 1.0), (0.7, -0.4), (0.9, 0.2)];
        let found = responses(&log_of(inputs, [(1.4, 2.0)]), 2.3)[0].distance_m;
        let (mut distance, mut speed, parts) = (0.0, 0.0, 1_400_000);
        for part in 0..parts {
            let at_s = 1.4 * f64::from(part) / f64::from(parts);
            let input = inputs.iter().rfind(|(from, _)| *from <= at_s).unwrap().1;
            distance += speed * 1e-6;
            speed += 2.3 * (input - speed) * 1e-6;
        }
        assert!((found - distance).abs() < 1e-5, "{found} {distance}");
    }
}
