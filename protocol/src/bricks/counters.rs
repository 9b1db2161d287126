//! Wheel totals from motor counters that may be reset while the station runs.
//!
//! A program that starts or stops on a LEGO brick sets the counters of the motors to zero. That is no motion. Nor is a
//! damaged byte in a telegram without a checksum.
//! ```text
//! dt           since the last sample that was accepted                        v: speed before, w: speed after
//! reached      |change| <= fastest dt + margin                                of both wheels
//! zeroed       both are nearer to zero than before, 0 reaches them in dt, and no third motor has kept its count
//! explained    change within hull(0, v dt), widened by a dt'^2 / 2 + 3 + |v| dt / 4,  dt' <= 0.1 s
//!
//! a sample that is reached, and not zeroed or else explained                  motion
//! any other                                                                   rejected for now; the next one decides:
//!    only the one before reaches it                                             the suspect was damaged; motion
//!    only the suspect reaches it                                                the counters restarted: at zero if zeroed, else
//!    where both reach it, and zeroed                                                            the less surprising of motion
//!    and a beginning at zero: distance of the change from hull(0, v dt, w dt)
//! ```
//! What the wheels have turned since the counters were set to zero is motion. Counters that are set to zero while they are
//! small look like motion: three to eight counts at 30 ms, 1 to 4 mm with wheels of 56 mm.
//!
//! # Sources
//! That a program's start resets all motors: documentation of nxt-python, "start_program". Sharpest change of speed: the
//! EV3's large motor has 175 rpm within its time constant of 105 ms (Pybricks' identified model); the NXT's is slower
//! (Philo's motor measurements).

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// Largest acceleration, counts per s^2.
const MAX_COUNTS_PER_S2: f64 = 10_000.0;
/// Over longer times the largest acceleration explains any change.
const MAX_ACCELERATION_TIME_S: f64 = 0.1;
/// Rounding of both samples, and backlash.
const STEPS: f64 = 3.0;
/// Share of the travel at the last speed by which the wheels may have turned further, or back.
const SPEED_TOLERANCE: f64 = 0.25;
/// A speed over a shorter interval is noise.
const MIN_INTERVAL_S: f64 = 0.001;

/// Counts of the left and the right wheel's motor, and of a third where it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MotorCounts {
    pub(super) wheels: [i32; 2],
    pub(super) third: Option<i32>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct MotorLimits {
    pub(super) max_counts_per_s: f64,
    /// Additional difference between two samples, in counts.
    pub(super) margin: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WheelState {
    Standing,
    Turning,
}

/// The last counts of both wheels, and since when they are unchanged.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Standstill(Option<([i32; 2], Timestamp<HostClock>)>);

impl Standstill {
    pub(super) fn record(&mut self, counts: [i32; 2], at: Timestamp<HostClock>) {
        if self.0.is_none_or(|(last, _)| last != counts) {
            self.0 = Some((counts, at));
        }
    }

    /// Wheels whose counts have not changed for `least` are at rest.
    pub(super) fn wheel_state(&self, now: Timestamp<HostClock>, least: TimeDelta) -> WheelState {
        match self.0 {
            Some((_, since)) if now - since >= least => WheelState::Standing,
            _ => WheelState::Turning,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CounterUpdate {
    /// Totals of the left and the right wheel.
    Total([i64; 2]),
    /// Totals; the counters were reset in between, to zero or to another value.
    Rebased([i64; 2]),
    /// The sample is damaged, or the counters were reset; the next one decides.
    Rejected,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct MotorCounters {
    limits: MotorLimits,
    now_s: f64,
    last: Option<CounterSample>,
    suspect: Option<CounterSample>,
    is_restarted: bool,
}

#[derive(Clone, Copy, Debug)]
struct CounterSample {
    at_s: f64,
    counts: MotorCounts,
    total: [i64; 2],
    /// Counts per second; `None` before there are two samples.
    speed: Option<[f64; 2]>,
}

/// The meaning of a sample that follows a rejected one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CounterInterpretation {
    Motion,
    FromZero,
    FromSuspect,
    Unexplained,
}

impl MotorCounters {
    pub(super) const fn new(limits: MotorLimits) -> Self {
        Self { limits, now_s: 0.0, last: None, suspect: None, is_restarted: false }
    }

    /// The brick was restarted: its counters began at zero, whatever they show at the next reading.
    pub(super) const fn brick_restarted(&mut self) {
        self.is_restarted = true;
    }

    /// Takes counts that were read at most `since` after the previous ones, rejected ones included.
    pub(super) fn push(&mut self, since: TimeDelta, counts: MotorCounts) -> CounterUpdate {
        self.now_s += since.as_secs_f64();
        let is_restarted = std::mem::take(&mut self.is_restarted);
        let Some(last) = self.last else {
            return CounterUpdate::Total(self.store(counts, counts.wheels.map(i64::from), None));
        };
        if is_restarted {
            return CounterUpdate::Rebased(self.store(counts, last.total_from([0; 2], counts), None));
        }
        let now = CounterSample { at_s: self.now_s, counts, ..last };
        let Some(suspect) = self.suspect else {
            if self.is_motion(&last, &now) {
                return CounterUpdate::Total(self.accept_motion(&last, &now));
            }
            self.suspect = Some(now);
            return CounterUpdate::Rejected;
        };
        match self.interpret(&last, &suspect, &now) {
            CounterInterpretation::Motion => CounterUpdate::Total(self.accept_motion(&last, &now)),
            CounterInterpretation::Unexplained => {
                self.suspect = Some(now);
                CounterUpdate::Rejected
            }
            meaning @ (CounterInterpretation::FromZero | CounterInterpretation::FromSuspect) => {
                let from = if meaning == CounterInterpretation::FromZero { [0; 2] } else { suspect.counts.wheels };
                let speed = suspect.speed_to(&now);
                CounterUpdate::Rebased(self.store(counts, last.total_from(from, counts), speed))
            }
        }
    }

    fn is_motion(&self, last: &CounterSample, now: &CounterSample) -> bool {
        last.is_reachable(now, self.limits) && (!last.may_have_been_zeroed(now, self.limits) || last.is_predicted(now))
    }

    fn interpret(&self, last: &CounterSample, suspect: &CounterSample, now: &CounterSample) -> CounterInterpretation {
        let runs_on = last.is_reachable(now, self.limits);
        if !suspect.is_reachable(now, self.limits) {
            return if runs_on { CounterInterpretation::Motion } else { CounterInterpretation::Unexplained };
        }
        let is_zeroed = last.may_have_been_zeroed(suspect, self.limits);
        match (runs_on, is_zeroed) {
            (true, true) => last.more_likely_meaning(suspect, now),
            (true, false) => CounterInterpretation::Motion,
            (false, true) => CounterInterpretation::FromZero,
            (false, false) => CounterInterpretation::FromSuspect,
        }
    }

    fn accept_motion(&mut self, last: &CounterSample, now: &CounterSample) -> [i64; 2] {
        let total = last.total_from(last.counts.wheels, now.counts);
        self.store(now.counts, total, last.speed_to(now))
    }

    fn store(&mut self, counts: MotorCounts, total: [i64; 2], speed: Option<[f64; 2]>) -> [i64; 2] {
        self.suspect = None;
        self.last = Some(CounterSample { at_s: self.now_s, counts, total, speed });
        total
    }
}

impl CounterSample {
    fn is_reachable(&self, now: &Self, limits: MotorLimits) -> bool {
        let most = limits.max_counts_per_s * (now.at_s - self.at_s) + limits.margin;
        let changes = count_changes(self.counts.wheels, now.counts.wheels);
        changes.iter().all(|change| (*change as f64).abs() <= most)
    }

    fn may_have_been_zeroed(&self, now: &Self, limits: MotorLimits) -> bool {
        let zeroed = Self { counts: MotorCounts { wheels: [0; 2], third: None }, ..*self };
        let pairs = self.counts.wheels.iter().zip(&now.counts.wheels);
        let is_nearer = pairs.into_iter().all(|(last, found)| found.unsigned_abs() <= last.unsigned_abs());
        let is_third_unchanged =
            now.counts.third.is_some_and(|third| third != 0) && now.counts.third == self.counts.third;
        is_nearer && !is_third_unchanged && zeroed.is_reachable(now, limits)
    }

    fn is_predicted(&self, now: &Self) -> bool {
        let Some(speed) = self.speed else {
            return true;
        };
        let dt_s = now.at_s - self.at_s;
        let sharp_s = dt_s.min(MAX_ACCELERATION_TIME_S);
        let sharp = 0.5 * MAX_COUNTS_PER_S2 * sharp_s * sharp_s + STEPS;
        let changes = count_changes(self.counts.wheels, now.counts.wheels);
        changes.iter().zip(speed).all(|(change, speed)| {
            let led = speed * dt_s;
            distance_to_range(*change as f64, [led, 0.0]) <= sharp + SPEED_TOLERANCE * led.abs()
        })
    }

    /// Whether the change to a rejected sample is motion, or motion since zero, by the speeds before and after.
    fn more_likely_meaning(&self, suspect: &Self, now: &Self) -> CounterInterpretation {
        let dt_s = suspect.at_s - self.at_s;
        let before = self.speed.unwrap_or_default();
        let after = suspect.speed_to(now).unwrap_or_default();
        let surprise = |from: [i32; 2]| {
            let changes = count_changes(from, suspect.counts.wheels);
            let led = before.iter().zip(after);
            changes
                .iter()
                .zip(led)
                .map(|(change, (before, after))| distance_to_range(*change as f64, [before * dt_s, after * dt_s]))
                .fold(0.0, f64::max)
        };
        if surprise([0; 2]) < surprise(self.counts.wheels) {
            CounterInterpretation::FromZero
        } else {
            CounterInterpretation::Motion
        }
    }

    fn speed_to(&self, now: &Self) -> Option<[f64; 2]> {
        let dt_s = now.at_s - self.at_s;
        if dt_s < MIN_INTERVAL_S {
            return self.speed;
        }
        let changes = count_changes(self.counts.wheels, now.counts.wheels);
        Some(changes.map(|change| change as f64 / dt_s))
    }

    fn total_from(&self, from: [i32; 2], to: MotorCounts) -> [i64; 2] {
        let [left, right] = count_changes(from, to.wheels);
        [self.total[0] + left, self.total[1] + right]
    }
}

fn count_changes(from: [i32; 2], to: [i32; 2]) -> [i64; 2] {
    let [left, right] = to;
    [i64::from(left.wrapping_sub(from[0])), i64::from(right.wrapping_sub(from[1]))]
}

/// Distance of a change from the range between zero and `led`.
fn distance_to_range(change: f64, led: [f64; 2]) -> f64 {
    let least = led.iter().copied().fold(0.0, f64::min);
    let most = led.iter().copied().fold(0.0, f64::max);
    (least - change).max(change - most).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: TimeDelta = TimeDelta::from_millis(30);
    const LIMITS: MotorLimits = MotorLimits { max_counts_per_s: 1_600.0, margin: 3.0 };

    #[derive(Debug)]
    struct Bench(MotorCounters);

    impl Bench {
        const fn new() -> Self {
            Self(MotorCounters::new(LIMITS))
        }

        fn after(&mut self, since: TimeDelta, wheels: [i32; 2]) -> CounterUpdate {
            let third = None;
            self.0.push(since, MotorCounts { wheels, third })
        }

        fn push(&mut self, wheels: [i32; 2]) -> CounterUpdate {
            self.after(CYCLE, wheels)
        }

        /// Two wheels that have this speed, counts per cycle, up to these counts.
        fn moving(per_cycle: i32, to: i32) -> Self {
            let mut bench = Self::new();
            for step in (0..10).rev() {
                bench.push([to - step * per_cycle; 2]);
            }
            bench
        }
    }

    fn updates_of(samples: &[[i32; 2]]) -> Vec<CounterUpdate> {
        let mut bench = Bench::new();
        samples.iter().map(|counts| bench.push(*counts)).collect()
    }

    #[test]
    fn a_program_that_sets_the_counters_to_zero_is_no_motion() {
        let taken = updates_of(&[[5_000, 4_000], [5_010, 4_010], [0, 0], [0, 0], [9, 8]]);
        let expected = [
            CounterUpdate::Total([5_000, 4_000]),
            CounterUpdate::Total([5_010, 4_010]),
            CounterUpdate::Rejected,
            CounterUpdate::Rebased([5_010, 4_010]),
            CounterUpdate::Total([5_019, 4_018]),
        ];
        assert_eq!(taken, expected);
    }

    #[test]
    fn a_few_counts_that_fall_to_zero_are_no_motion_either() {
        for before in [[20, 9], [17, 7]] {
            let taken = updates_of(&[before, [20, 9], [0, 0], [0, 0], [0, 0]]);
            assert_eq!(taken[2], CounterUpdate::Rejected);
            assert_eq!(taken[3..], [CounterUpdate::Rebased([20, 9]), CounterUpdate::Total([20, 9])]);
        }
    }

    #[test]
    fn wheels_that_roll_back_through_zero_at_once_are_motion() {
        let samples: Vec<_> = (-6..=6).map(|k: i32| [-k * 20, -k * 20]).collect();
        let expected: Vec<_> = samples.iter().map(|counts| CounterUpdate::Total(counts.map(i64::from))).collect();
        assert_eq!(updates_of(&samples), expected);
    }

    #[test]
    fn a_third_motor_that_keeps_its_count_excludes_a_reset() {
        for (third, expected) in [(90, CounterUpdate::Total([0, 0])), (0, CounterUpdate::Rejected)] {
            let mut counters = MotorCounters::new(LIMITS);
            let reading = |left, third| MotorCounts { wheels: [left, 0], third: Some(third) };
            counters.push(CYCLE, reading(30, 90));
            counters.push(CYCLE, reading(30, 90));
            assert_eq!(counters.push(CYCLE, reading(0, third)), expected);
        }
    }

    #[test]
    fn a_damaged_count_costs_one_sample_and_moves_nothing() {
        for bit in 6..32 {
            let taken = updates_of(&[[100, 90], [110, 100], [0x78 ^ (1 << bit), 110], [130, 120]]);
            assert_eq!(taken[2], CounterUpdate::Rejected, "bit {bit}");
            assert_eq!(taken[3], CounterUpdate::Total([130, 120]), "bit {bit}");
        }
    }

    #[test]
    fn a_leap_is_damage_once_and_a_new_base_twice() {
        let taken = updates_of(&[[0, 0], [70_000, 3], [5, 5], [9_000, 9_000], [9_010, 9_011]]);
        assert_eq!(taken[1..3], [CounterUpdate::Rejected, CounterUpdate::Total([5, 5])]);
        assert_eq!(taken[3..], [CounterUpdate::Rejected, CounterUpdate::Rebased([15, 16])]);
    }

    #[test]
    fn motion_since_the_zero_counts_and_the_wrap_of_the_counter_is_none() {
        let reset = updates_of(&[[9_000, 9_000], [30, 28], [45, 42]]);
        assert_eq!(reset[1..], [CounterUpdate::Rejected, CounterUpdate::Rebased([9_045, 9_042])]);
        let wrapped = updates_of(&[[i32::MAX - 4, -3], [i32::MIN + 5, 7]]);
        let expected = CounterUpdate::Total([i64::from(i32::MAX) + 6, 7]);
        assert_eq!(wrapped[1], expected);
    }

    #[test]
    fn after_a_restart_counters_count_from_zero_at_any_distance() {
        let mut bench = Bench::new();
        bench.push([30, 30]);
        bench.0.brick_restarted();
        let after = bench.after(TimeDelta::from_millis(9_000), [34, 35]);
        assert_eq!(after, CounterUpdate::Rebased([64, 65]));
    }

    #[test]
    fn counters_that_fall_in_a_silence_of_a_resting_robot_are_no_motion() {
        for silence_millis in [100, 1_000, 2_500, 30_000] {
            let silence = TimeDelta::from_millis(silence_millis);
            for left in [0, 30, -20] {
                let mut bench = Bench::moving(0, 1_750);
                assert_eq!(bench.after(silence, [left, left]), CounterUpdate::Rejected);
                let total = 1_750 + i64::from(left);
                assert_eq!(bench.push([left, left]), CounterUpdate::Rebased([total; 2]));
            }
        }
    }

    #[test]
    fn a_robot_that_drives_on_through_a_silence_has_moved() {
        // 500 counts per second: on, slower, faster, stopped, and back by a little.
        let silence = TimeDelta::from_millis(2_000);
        for after in [2_000, 1_700, 2_300, 1_100, 1_000, 900] {
            let mut bench = Bench::moving(15, 1_000);
            let total = i64::from(after);
            assert_eq!(bench.after(silence, [after; 2]), CounterUpdate::Total([total; 2]), "{after}");
        }
    }

    #[test]
    fn a_robot_that_drives_on_with_counters_that_fell_in_a_silence_has_moved_since() {
        let mut bench = Bench::moving(15, 1_000);
        let update = bench.after(TimeDelta::from_millis(2_000), [600; 2]);
        assert_eq!(update, CounterUpdate::Rejected);
        assert_eq!(bench.push([615; 2]), CounterUpdate::Rebased([1_615; 2]));
    }

    #[test]
    fn the_speed_after_a_silence_distinguishes_driving_back_from_a_reset() {
        let silence = TimeDelta::from_millis(2_500);
        for (next, expected) in [(380, CounterUpdate::Total([380; 2])), (420, CounterUpdate::Rebased([900 + 420; 2]))] {
            let mut bench = Bench::moving(0, 900);
            assert_eq!(bench.after(silence, [400; 2]), CounterUpdate::Rejected);
            assert_eq!(bench.push([next; 2]), expected);
        }
    }

    #[test]
    fn a_long_stall_at_full_speed_is_motion() {
        let mut bench = Bench::new();
        bench.push([0, 0]);
        let after = bench.after(TimeDelta::from_millis(2_000), [2_100, -2_100]);
        assert_eq!(after, CounterUpdate::Total([2_100, -2_100]));
    }
}
