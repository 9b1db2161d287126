//! What is known of a drive before a wall: readings and motor inputs in the order of time.

/// What an entry says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WallReading {
    /// A reading of the distance, in metres.
    Range(f64),
    /// The motor input from here on; 1 is the input of the step test, or full drive.
    Input(f64),
}

/// One entry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallEntry {
    /// When, in the brick's seconds.
    pub at_s: f64,
    /// What.
    pub reading: WallReading,
}

/// A drive before a wall.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WallLog {
    entries: Vec<WallEntry>,
}

impl WallLog {
    /// Puts entries in the order of time; of one instant, an input comes first. Entries that are not finite, and ranges below
    /// zero, are left out.
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

    /// All entries, in order.
    pub fn entries(&self) -> &[WallEntry] {
        &self.entries
    }

    /// Time and distance of the readings, in s and m.
    pub fn readings(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.entries.iter().filter_map(|entry| match entry.reading {
            WallReading::Range(range_m) => Some((entry.at_s, range_m)),
            WallReading::Input(_) => None,
        })
    }

    /// Time and size of the inputs.
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

    /// The same log, with full drive from its first instant on if it holds no input other than zero: of a car that was driven and
    /// did not write it down.
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

    /// Intervals between the inputs, which a program of this kind gives once in a turn of its loop: mean, shortest and longest, s.
    pub fn loop_intervals_s(&self) -> Option<(f64, f64, f64)> {
        let times: Vec<f64> = self.inputs().map(|(at_s, _)| at_s).collect();
        let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
        let (low, high) = gaps.fold((f64::INFINITY, 0.0_f64), |(low, high), gap| (low.min(gap), high.max(gap)));
        let (first, last) = (times.first()?, times.last()?);
        let count = times.len().checked_sub(1).filter(|count| *count > 0)?;
        Some(((last - first) / count as f64, low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(at_s: f64, said: WallReading) -> WallEntry {
        WallEntry { at_s, reading: said }
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
    fn a_log_without_inputs_is_taken_for_full_drive() {
        let log = WallLog::new(vec![entry(1.0, WallReading::Range(3.0)), entry(1.1, WallReading::Input(0.0))]);
        let assumed = log.with_assumed_drive();
        assert_eq!(assumed.inputs().collect::<Vec<_>>(), [(1.0, 1.0)]);
        assert_eq!(WallLog::default().with_assumed_drive(), WallLog::default());
    }

    #[test]
    fn the_loop_is_measured() {
        let inputs = [0.0, 0.01, 0.04].map(|at_s| entry(at_s, WallReading::Input(1.0)));
        let found = WallLog::new(inputs.to_vec()).loop_intervals_s().unwrap();
        assert!((found.0 - 0.02).abs() < 1e-12 && (found.2 - 0.03).abs() < 1e-12);
        assert!((found.1 - 0.01).abs() < 1e-12);
        assert_eq!(WallLog::default().loop_intervals_s(), None);
    }
}
