//! Encoder counts that go on when the brick's begin anew.
//!
//! The start and the end of a program on the brick zero its counters. To a filter that would be a leap backwards. Here the fall becomes
//! a new base, and what the wheels turned after it counts as motion.
//!
//! # Model
//! ```text
//! reach = FASTEST dt + MARGIN                       how far a motor can have turned since the last reading
//! fell  = all counts are 0, and some wheel's is not where its speed was leading it: |n + v dt| > SLACK + |v dt| / 2
//!      or some wheel leapt further than its reach, and all wheels are within their reach of 0
//! fell                              total += count now                 (from zero)
//! no leap                           total += count now - count before
//! a leap that does not end near 0   damage, unless the next reading is near it: then the base is there
//! ```
//! # Assumptions
//! Both wheels' counters fall together. A fall from within `SLACK` counts of zero is taken for motion: two millimetres.
//!
//! # Sources
//! FASTEST: 170 rpm without load at 9 V (Philo's motor measurements, philohome.com/nxtmotor), 1020 degrees per second, and a
//! half on top. MARGIN: the reading lies anywhere within the 30 ms of a transaction. That a program's start resets all motors:
//! documentation of nxt-python, "start_program".

use posebridge_telemetry::{EncoderTicks, HostClock, Stamp};

/// Counts per second that no motor exceeds.
const FASTEST_PER_S: f64 = 1_500.0;
/// Counts that the uncertain instants of two readings are worth.
const MARGIN: f64 = 60.0;
/// Counts that are too few to make a fall of.
const SLACK: f64 = 4.0;

/// Counts of the left and the right wheel's motor, and of the third where it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) wheels: [i32; 2],
    pub(super) third: Option<i32>,
}

/// What a reading was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Counted {
    /// Motion, or the first reading; total counts of left and right.
    Moved([EncoderTicks; 2]),
    /// The counters began anew. The totals hold what has moved since.
    Rebased([EncoderTicks; 2]),
    /// Further than any motor turns.
    Impossible,
}

/// The counters of one brick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counters {
    totals: [i64; 2],
    last: Option<Reading>,
    /// One that was impossible; a second like it proves that it was not.
    doubted: Option<Reading>,
    is_restarted: bool,
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    counts: Counts,
    at: Stamp<HostClock>,
    /// Counts per second up to here.
    speeds: [f64; 2],
}

impl Counters {
    /// The brick was switched off and on: its counters began at zero, wherever they stand when they are read next.
    pub(super) const fn brick_restarted(&mut self) {
        self.is_restarted = true;
    }

    /// Takes a reading of the instant `at`.
    pub(super) fn take(&mut self, counts: Counts, at: Stamp<HostClock>) -> Counted {
        let fresh = |speeds| Reading { counts, at, speeds };
        let Some(last) = self.last else {
            self.totals = counts.wheels.map(i64::from);
            self.last = Some(fresh([0.0; 2]));
            self.is_restarted = false;
            return Counted::Moved(self.ticks());
        };
        let dt_s = (at - last.at).as_secs_f64().max(1e-3);
        if self.is_restarted || last.fell_to(&counts, dt_s) {
            self.is_restarted = false;
            return Counted::Rebased(self.advance(counts.wheels, fresh([0.0; 2])));
        }
        let moved = differences(counts, last.counts);
        if is_within(moved, dt_s) {
            let speeds = moved.map(|count| f64::from(count) / dt_s);
            return Counted::Moved(self.advance(moved, fresh(speeds)));
        }
        if let Some(doubted) = self.doubted {
            let since = differences(counts, doubted.counts);
            if is_within(since, (at - doubted.at).as_secs_f64().max(1e-3)) {
                return Counted::Rebased(self.advance(since, fresh([0.0; 2])));
            }
        }
        self.doubted = Some(fresh([0.0; 2]));
        Counted::Impossible
    }

    fn advance(&mut self, moved: [i32; 2], reading: Reading) -> [EncoderTicks; 2] {
        for (total, moved) in self.totals.iter_mut().zip(moved) {
            *total += i64::from(moved);
        }
        self.last = Some(reading);
        self.doubted = None;
        self.ticks()
    }

    fn ticks(&self) -> [EncoderTicks; 2] {
        self.totals.map(EncoderTicks)
    }
}

impl Reading {
    fn fell_to(&self, now: &Counts, dt_s: f64) -> bool {
        let all_zero = now.wheels == [0; 2] && now.third.is_none_or(|count| count == 0);
        let is_led_elsewhere = self
            .counts
            .wheels
            .iter()
            .zip(self.speeds)
            .any(|(count, v)| {
                (f64::from(*count) + v * dt_s).abs() > SLACK + (v * dt_s).abs() / 2.0
            });
        let leapt = !is_within(differences(*now, self.counts), dt_s);
        (all_zero && is_led_elsewhere) || (leapt && is_within(now.wheels, dt_s))
    }
}

/// The counters are 32 bits wide and wrap.
fn differences(now: Counts, before: Counts) -> [i32; 2] {
    std::array::from_fn(|wheel| now.wheels[wheel].wrapping_sub(before.wheels[wheel]))
}

fn is_within(moved: [i32; 2], dt_s: f64) -> bool {
    let reach = FASTEST_PER_S * dt_s + MARGIN;
    moved.iter().all(|count| f64::from(*count).abs() <= reach)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(left: i32, right: i32) -> Counts {
        Counts {
            wheels: [left, right],
            third: Some(0),
        }
    }

    /// Readings every 60 ms, and what became of each.
    fn follow(readings: &[(i32, i32)]) -> Vec<Counted> {
        let mut counters = Counters::default();
        let mut at = Stamp::ZERO;
        readings
            .iter()
            .map(|(left, right)| {
                at = at + posebridge_telemetry::Span::from_millis(60);
                counters.take(counts(*left, *right), at)
            })
            .collect()
    }

    const fn moved(left: i64, right: i64) -> Counted {
        Counted::Moved([EncoderTicks(left), EncoderTicks(right)])
    }

    const fn rebased(left: i64, right: i64) -> Counted {
        Counted::Rebased([EncoderTicks(left), EncoderTicks(right)])
    }

    #[test]
    fn a_fall_to_zero_is_no_motion_and_what_moves_after_it_is() {
        let found = follow(&[(500, 480), (0, 0), (12, 10)]);
        assert_eq!(found, [moved(500, 480), rebased(500, 480), moved(512, 490)]);
    }

    #[test]
    fn what_moved_between_the_fall_and_the_first_reading_is_kept() {
        let found = follow(&[(500, 480), (520, 500), (25, 24)]);
        assert_eq!(found, [moved(500, 480), moved(520, 500), rebased(545, 524)]);
    }

    #[test]
    fn a_small_count_that_falls_to_zero_against_its_speed_is_a_fall() {
        let found = follow(&[(20, 20), (30, 30), (0, 0)]);
        assert_eq!(found[2], rebased(30, 30));
    }

    #[test]
    fn wheels_that_roll_back_to_where_they_began_have_moved() {
        let found = follow(&[(40, 40), (20, 20), (0, 0), (-20, -20)]);
        assert_eq!(
            found,
            [moved(40, 40), moved(20, 20), moved(0, 0), moved(-20, -20)]
        );
    }

    #[test]
    fn a_third_motor_that_keeps_its_count_says_that_nothing_fell() {
        let mut counters = Counters::default();
        let reading = |left, third| Counts {
            wheels: [left, 0],
            third: Some(third),
        };
        counters.take(reading(30, 90), Stamp::from_millis(0));
        let kept = counters.take(reading(0, 90), Stamp::from_millis(60));
        assert_eq!(kept, moved(0, 0));
    }

    #[test]
    fn a_leap_is_damage_once_and_a_new_base_twice() {
        let found = follow(&[(0, 0), (70_000, 3), (5, 5), (9_000, 9_000), (9_010, 9_011)]);
        let expected = [
            moved(0, 0),
            Counted::Impossible,
            moved(5, 5),
            Counted::Impossible,
            rebased(15, 16),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn counters_run_on_across_their_wrap() {
        let found = follow(&[(i32::MAX, 0), (i32::MIN + 9, 0)]);
        assert_eq!(found[1], moved(i64::from(i32::MAX) + 10, 0));
    }

    #[test]
    fn after_a_restart_the_counters_began_at_zero_however_far_they_are() {
        let mut counters = Counters::default();
        counters.take(counts(30, 30), Stamp::from_millis(0));
        counters.brick_restarted();
        let after = counters.take(counts(34, 35), Stamp::from_millis(9_000));
        assert_eq!(after, rebased(64, 65));
    }
}
