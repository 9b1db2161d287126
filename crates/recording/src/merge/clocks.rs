//! One clock for several recordings: by what their stations measured of each other, else by the dates at which they began.

use posebridge_telemetry::TimeDelta;

/// A measurement of one station's host clock by another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeasuredOffset {
    /// Index of the recording of the station that measured.
    pub by: usize,
    /// Index of the recording of the other station.
    pub of: usize,
    /// Host clock of `of` minus that of `by`.
    pub offset: TimeDelta,
    /// The true offset is at most this far from it.
    pub uncertainty: TimeDelta,
}

/// How a recording was put on the merged clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlignmentSource {
    /// It is the first recording, by which the others are aligned.
    Reference,
    /// By offsets that stations measured. The sum of their uncertainties, where the way leads through other stations.
    Measured { uncertainty: TimeDelta },
    /// By the dates in the headers, of itself or of the recording on which it was aligned. Computers' dates differ by an unknown time.
    StartDate,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AlignedClock {
    /// Host clock of the recording minus the merged clock; never positive.
    pub ahead: TimeDelta,
    pub source: AlignmentSource,
}

/// The clock of a merged recording: that of the recording which began first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MergedClock {
    /// Of each recording.
    pub clocks: Vec<AlignedClock>,
    /// Unix time of the merged clock's zero, in microseconds.
    pub utc_start_micros: u64,
}

/// Aligns the clocks of recordings with these start dates (Unix time of the host clock's zero in microseconds). Between two stations the
/// offset with the smallest uncertainty is taken; clocks are assumed not to drift.
pub fn align_clocks(utc_starts_micros: &[u64], measured: &[MeasuredOffset]) -> MergedClock {
    let mut clocks: Vec<Option<AlignedClock>> = vec![None; utc_starts_micros.len()];
    let utc_start = utc_starts_micros.first().copied().unwrap_or(0);
    while let Some(index) = clocks.iter().position(Option::is_none) {
        let own_start = utc_starts_micros.get(index).copied().unwrap_or(utc_start);
        let ahead = TimeDelta::from_micros(utc_start as i64 - own_start as i64);
        let source = if index == 0 { AlignmentSource::Reference } else { AlignmentSource::StartDate };
        follow_measurements(index, AlignedClock { ahead, source }, measured, &mut clocks);
    }
    let mut clocks: Vec<AlignedClock> = clocks.into_iter().flatten().collect();
    // The first to begin: its clock shows most.
    let latest = clocks.iter().map(|clock| clock.ahead).max().unwrap_or_default();
    for clock in &mut clocks {
        clock.ahead = clock.ahead - latest;
    }
    MergedClock { clocks, utc_start_micros: utc_start.saturating_sub(latest.as_nanos().unsigned_abs() / 1_000) }
}

/// Aligns the recording `start`, and all that are connected to it by measurements, each by the least sum of uncertainties.
fn follow_measurements(
    start: usize,
    clock: AlignedClock,
    measured: &[MeasuredOffset],
    clocks: &mut [Option<AlignedClock>],
) {
    let mut reached: Vec<Option<(TimeDelta, TimeDelta)>> = vec![None; clocks.len()];
    if let Some(first) = reached.get_mut(start) {
        *first = Some((TimeDelta::ZERO, TimeDelta::ZERO));
    }
    // Bellman-Ford: a way has at most as many steps as there are recordings.
    for _ in 0..clocks.len() {
        for one in measured {
            for (from, to, offset) in [(one.by, one.of, one.offset), (one.of, one.by, -one.offset)] {
                let Some(Some((ahead, uncertainty))) = reached.get(from).copied() else {
                    continue;
                };
                let found = (ahead + offset, uncertainty + one.uncertainty);
                if let Some(known) = reached.get_mut(to)
                    && known.is_none_or(|(_, known)| found.1 < known)
                {
                    *known = Some(found);
                }
            }
        }
    }
    for (index, (slot, found)) in clocks.iter_mut().zip(reached).enumerate() {
        let Some((offset, uncertainty)) = found else {
            continue;
        };
        let source = match clock.source {
            AlignmentSource::Reference if index != start => AlignmentSource::Measured { uncertainty },
            source @ (AlignmentSource::Reference | AlignmentSource::Measured { .. } | AlignmentSource::StartDate) => {
                source
            }
        };
        *slot = slot.or(Some(AlignedClock { ahead: clock.ahead + offset, source }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn micros(micros: i64) -> TimeDelta {
        TimeDelta::from_micros(micros)
    }

    fn measured(by: usize, of: usize, offset: i64, uncertainty: i64) -> MeasuredOffset {
        MeasuredOffset { by, of, offset: micros(offset), uncertainty: micros(uncertainty) }
    }

    fn aheads(merged: &MergedClock) -> Vec<i64> {
        merged.clocks.iter().map(|clock| clock.ahead.as_nanos() / 1_000).collect()
    }

    #[test]
    fn the_best_measurement_counts_in_either_direction_and_through_other_stations() {
        let offsets =
            [measured(0, 1, 500, 90), measured(1, 0, -450, 40), measured(2, 1, -30, 20), measured(0, 2, 470, 80)];
        let merged = align_clocks(&[1_000_000, 0, 7], &offsets);
        // Seen from the first: 450 and 450 + 30 ahead. The third began first.
        assert_eq!(aheads(&merged), [-480, -30, 0]);
        assert_eq!(merged.utc_start_micros, 1_000_000 - 480);
        let sources: Vec<AlignmentSource> = merged.clocks.iter().map(|clock| clock.source).collect();
        let by = |uncertainty| AlignmentSource::Measured { uncertainty: micros(uncertainty) };
        assert_eq!(sources, [AlignmentSource::Reference, by(40), by(60)]);
    }

    #[test]
    fn without_measurements_the_dates_count_and_with_some_those_that_are_connected_stay_together() {
        // The second began 300 µs after the first; the third 10 µs after it by measurement, whatever its date says.
        let merged = align_clocks(&[1_000, 1_300, 9_000], &[measured(2, 1, 10, 5)]);
        assert_eq!(aheads(&merged), [0, -300, -310]);
        assert_eq!(merged.utc_start_micros, 1_000);
        assert_eq!(merged.clocks[2].source, AlignmentSource::StartDate);
        let earlier = align_clocks(&[1_000, 400], &[]);
        assert_eq!((aheads(&earlier), earlier.utc_start_micros), (vec![-600, 0], 400));
        assert_eq!(align_clocks(&[], &[]).clocks, []);
        // Of recordings that are not there.
        assert_eq!(aheads(&align_clocks(&[0, 0], &[measured(0, 7, 1, 1), measured(8, 1, 1, 1)])), [0, 0]);
    }
}
