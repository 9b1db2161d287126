//! Totals of motors whose counters jump to zero under a station that goes on.
//!
//! A program that starts or stops on the brick sets the counters of the motors to zero. That is no motion. Nor is a damaged byte in a
//! telegram without a checksum.
//!
//! # Model
//! ```text
//! possible       |change| <= fastest * dt + 3                            of both wheels
//! fell to zero   both counts are exactly 0, and for one wheel
//!                |0 - (last + v dt)| > 1/2 a dt'^2 + 3,  dt' <= 0.1 s    v: speed before
//! ```
//! A sample that is impossible or fell to zero is refused once. The next one tells: it follows either the last good one, and then the
//! refused one was damaged; or the refused one, and then the counters begin anew there. If it may follow both, they begin anew only near
//! zero, and only if the refused one, carried on with the speed before, lies nearer. What the wheels have turned since the counters were
//! set to zero is motion.
//!
//! # What cannot be known
//! Counters that are set to zero while few counts stand in them, or in a silence long enough for the fastest motor to turn back, look like
//! motion: three to eight counts at 30 ms, 1 to 4 mm with wheels of 56 mm.

use posebridge_telemetry::Span;

/// No motor of the set is faster, counts of 1 degree per second: 260 rpm of the EV3's medium motor at 9 V without load (Philohome,
/// Pybricks' identified model).
const FASTEST_PER_S: f64 = 1_600.0;
/// Sharpest change of speed, counts per s²: the large motor's 175 rpm within its time constant of 105 ms (Pybricks' identified model).
const SHARPEST_PER_S2: f64 = 10_000.0;
/// Over longer times the sharpest change explains anything.
const SHARP_FOR_S: f64 = 0.1;
/// Steps of both samples, and backlash.
const MARGIN: f64 = 3.0;
/// A speed over less time than this is noise.
const SHORTEST_S: f64 = 0.001;

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Counted {
    /// The wheels have turned so far, left and right.
    Total([i64; 2]),
    /// So far; the counters were set to zero in between, or began anew somewhere else.
    Rebased([i64; 2]),
    /// It may be damaged; the next one tells.
    Refused,
}

/// The totals of both wheels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counters {
    /// Time since the first sample, s.
    now_s: f64,
    last: Option<Sample>,
    suspect: Option<Sample>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    at_s: f64,
    counts: [i32; 2],
    total: [i64; 2],
    /// Counts per second.
    speed: [f64; 2],
}

impl Counters {
    /// Takes the counts that were read `since` the ones before, refused ones included.
    pub(super) fn take(&mut self, since: Span, counts: [i32; 2]) -> Counted {
        self.now_s += since.as_secs_f64();
        let Some(last) = self.last else {
            let total = counts.map(i64::from);
            self.keep(counts, total, [0.0; 2]);
            return Counted::Total(total);
        };
        let (suspect, now_s) = (self.suspect, self.now_s);
        let runs_on = last.is_possible(now_s, counts)
            && (suspect.is_some() || !last.fell_to_zero(now_s, counts));
        let begins_anew = suspect.filter(|suspect| suspect.is_possible(now_s, counts));
        match (runs_on, begins_anew) {
            (false, None) => {
                self.suspect = Some(Sample {
                    at_s: now_s,
                    counts,
                    ..last
                });
                Counted::Refused
            }
            (true, Some(suspect))
                if last.may_be_reset_to(&suspect)
                    && last.distance(now_s, counts) > suspect.distance(now_s, counts) =>
            {
                self.begin_anew(&last, &suspect, counts)
            }
            (false, Some(suspect)) => self.begin_anew(&last, &suspect, counts),
            (true, _) => {
                let total = added(last.total, changes(last.counts, counts));
                let speed = last.speed_to(now_s, counts);
                self.keep(counts, total, speed);
                Counted::Total(total)
            }
        }
    }

    /// The brick began anew: the wheels have not turned since the last sample, as far as anybody knows.
    pub(super) fn restart(&mut self, counts: [i32; 2]) -> Counted {
        let total = self.last.map_or(counts.map(i64::from), |last| last.total);
        self.keep(counts, total, [0.0; 2]);
        Counted::Rebased(total)
    }

    fn begin_anew(&mut self, last: &Sample, suspect: &Sample, counts: [i32; 2]) -> Counted {
        // From zero on, if that is where the counters were set to; else from where they were found.
        let from = if last.may_be_reset_to(suspect) {
            [0, 0]
        } else {
            suspect.counts
        };
        let total = added(last.total, changes(from, counts));
        let speed = suspect.speed_to(self.now_s, counts);
        self.keep(counts, total, speed);
        Counted::Rebased(total)
    }

    fn keep(&mut self, counts: [i32; 2], total: [i64; 2], speed: [f64; 2]) {
        self.suspect = None;
        self.last = Some(Sample {
            at_s: self.now_s,
            counts,
            total,
            speed,
        });
    }
}

impl Sample {
    /// Whether the fastest motor may have brought these counts.
    fn is_possible(&self, now_s: f64, counts: [i32; 2]) -> bool {
        let most = FASTEST_PER_S * (now_s - self.at_s) + MARGIN;
        let changes = changes(self.counts, counts);
        changes.iter().all(|change| (*change as f64).abs() <= most)
    }

    /// Whether the counters may have been set to zero in between: both stand nearer to it, and not further than the fastest motor turns.
    fn may_be_reset_to(&self, suspect: &Self) -> bool {
        let zeroed = Self {
            counts: [0, 0],
            ..*self
        };
        let pairs = self.counts.iter().zip(&suspect.counts);
        let is_nearer = pairs
            .into_iter()
            .all(|(last, found)| found.unsigned_abs() <= last.unsigned_abs());
        is_nearer && zeroed.is_possible(suspect.at_s, suspect.counts)
    }

    fn fell_to_zero(&self, now_s: f64, counts: [i32; 2]) -> bool {
        let dt_s = (now_s - self.at_s).min(SHARP_FOR_S);
        let most = 0.5 * SHARPEST_PER_S2 * dt_s * dt_s + MARGIN;
        counts == [0, 0] && self.distance(now_s, counts) > most
    }

    /// How far the counts are from where the speed leads, the worse of both wheels.
    fn distance(&self, now_s: f64, counts: [i32; 2]) -> f64 {
        let dt_s = now_s - self.at_s;
        let changes = changes(self.counts, counts);
        let off = |(change, speed): (&i64, &f64)| (*change as f64 - speed * dt_s).abs();
        changes.iter().zip(&self.speed).map(off).fold(0.0, f64::max)
    }

    fn speed_to(&self, now_s: f64, counts: [i32; 2]) -> [f64; 2] {
        let dt_s = now_s - self.at_s;
        if dt_s < SHORTEST_S {
            return self.speed;
        }
        changes(self.counts, counts).map(|change| change as f64 / dt_s)
    }
}

/// By how much the counters, which wrap, have changed.
fn changes(from: [i32; 2], to: [i32; 2]) -> [i64; 2] {
    let [left, right] = to;
    [
        i64::from(left.wrapping_sub(from[0])),
        i64::from(right.wrapping_sub(from[1])),
    ]
}

fn added(total: [i64; 2], changes: [i64; 2]) -> [i64; 2] {
    [total[0] + changes[0], total[1] + changes[1]]
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: Span = Span::from_millis(30);

    /// What becomes of counts that are read each cycle.
    fn taken(samples: &[[i32; 2]]) -> Vec<Counted> {
        let mut counters = Counters::default();
        let take = |counts: &[i32; 2]| counters.take(CYCLE, *counts);
        samples.iter().map(take).collect()
    }

    #[test]
    fn a_program_that_sets_the_counters_to_zero_is_no_motion() {
        let taken = taken(&[[5_000, 4_000], [5_010, 4_010], [0, 0], [0, 0], [9, 8]]);
        let expected = [
            Counted::Total([5_000, 4_000]),
            Counted::Total([5_010, 4_010]),
            Counted::Refused,
            Counted::Rebased([5_010, 4_010]),
            Counted::Total([5_019, 4_018]),
        ];
        assert_eq!(taken, expected);
    }

    #[test]
    fn a_few_counts_that_fall_to_zero_at_rest_are_no_motion_either() {
        let taken = taken(&[[20, 9], [20, 9], [0, 0], [0, 0], [0, 0]]);
        assert_eq!(taken[2], Counted::Refused);
        assert_eq!(
            taken[3..],
            [Counted::Rebased([20, 9]), Counted::Total([20, 9])]
        );
    }

    #[test]
    fn wheels_that_roll_back_through_zero_at_once_are_motion() {
        let samples: Vec<_> = (-6..=6).map(|k: i32| [-k * 20, -k * 20]).collect();
        let expected: Vec<_> = samples
            .iter()
            .map(|counts| Counted::Total(counts.map(i64::from)))
            .collect();
        assert_eq!(taken(&samples), expected);
    }

    #[test]
    fn a_damaged_count_costs_one_sample_and_moves_nothing() {
        for bit in 6..32 {
            let taken = taken(&[[100, 90], [110, 100], [0x78 ^ (1 << bit), 110], [130, 120]]);
            assert_eq!(taken[2], Counted::Refused, "bit {bit}");
            assert_eq!(taken[3], Counted::Total([130, 120]), "bit {bit}");
        }
    }

    #[test]
    fn motion_since_the_zero_counts_and_the_wrap_of_the_counter_is_none() {
        let reset = taken(&[[9_000, 9_000], [30, 28], [45, 42]]);
        assert_eq!(
            reset[1..],
            [Counted::Refused, Counted::Rebased([9_045, 9_042])]
        );
        let wrapped = taken(&[[i32::MAX - 4, -3], [i32::MIN + 5, 7]]);
        let expected = Counted::Total([i64::from(i32::MAX) + 6, 7]);
        assert_eq!(wrapped[1], expected);
    }

    #[test]
    fn a_long_stall_at_full_speed_is_motion() {
        let mut counters = Counters::default();
        counters.take(CYCLE, [0, 0]);
        let after = counters.take(Span::from_millis(2_000), [2_100, -2_100]);
        assert_eq!(after, Counted::Total([2_100, -2_100]));
    }
}
