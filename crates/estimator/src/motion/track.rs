//! The wheels' travel over time, from whichever source is best.

use posebridge_telemetry::{BrickClock, DriveGeometry, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use super::backlash::{BacklashCrossing, GearPosition};
use super::reading::{InsertOutcome, MotionReading, MotionSource};
use super::{TimeSeries, count_before};
use crate::models::differential_drive::{WheelTravel, body_step};

/// Over a longer interval the path is not taken for an arc. Five lost frames in a row at 20 Hz are below it.
const MAX_ARC_INTERVAL: TimeDelta = TimeDelta::from_millis(300);

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct MotionSample {
    reading: MotionReading,
    /// Since the first sample; an unknown step counts as zero.
    cumulative_travel: WheelTravel,
    /// From the previous sample to this one; `None` when unknown, as for the first.
    step: Option<WheelTravel>,
    /// Of the left and the right gear over that step, and their positions after it.
    crossings: [BacklashCrossing; 2],
    gears: [GearPosition; 2],
}

/// A part of the time between two instants, with what is known of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TravelSegment {
    Known {
        until: Timestamp<BrickClock>,
        travel: WheelTravel,
        /// Of the left and the right gear.
        crossings: [BacklashCrossing; 2],
        /// Variance of each coordinate of the end, where the order of distance and turn is unknown; zero over short
        /// intervals.
        path_var_m2: f64,
    },
    /// The readings around it do not determine the motion.
    Gap { until: Timestamp<BrickClock> },
    /// There are no readings after its start.
    BeyondData { until: Timestamp<BrickClock> },
}

/// What a track has heard, without its configuration.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SavedTrack {
    source: Option<MotionSource>,
    samples: TimeSeries<MotionSample>,
}

#[derive(Clone, Debug)]
pub struct MotionTrack {
    geometry: DriveGeometry,
    max_wheel_rad_per_s: f64,
    /// The configured play, but no less than a count.
    backlash_rad: f64,
    source: Option<MotionSource>,
    samples: TimeSeries<MotionSample>,
}

impl MotionTrack {
    /// An empty track for a robot of this geometry whose wheels cannot turn faster than the limit.
    pub fn new(geometry: DriveGeometry, max_wheel_rad_per_s: f64) -> Self {
        let backlash_rad = geometry.tick.0;
        Self { geometry, max_wheel_rad_per_s, backlash_rad, source: None, samples: TimeSeries::default() }
    }

    /// With this play between encoders and wheels, rad.
    #[must_use]
    pub fn with_backlash(self, backlash_rad: f64) -> Self {
        Self { backlash_rad: backlash_rad.max(self.geometry.tick.0), ..self }
    }

    /// A larger jump than this re-bases the counters from now on.
    pub const fn set_max_wheel_rad_per_s(&mut self, max_wheel_rad_per_s: f64) {
        self.max_wheel_rad_per_s = max_wheel_rad_per_s;
    }

    pub(crate) fn save(&self) -> SavedTrack {
        let Self { geometry: _, max_wheel_rad_per_s: _, backlash_rad: _, source, samples } = self;
        SavedTrack { source: *source, samples: samples.clone() }
    }

    /// This track with what another one of the same configuration has heard.
    #[must_use]
    pub(crate) fn with_saved(self, saved: SavedTrack) -> Self {
        let SavedTrack { source, samples } = saved;
        Self { source, samples, ..self }
    }

    pub fn insert(&mut self, stamp: Timestamp<BrickClock>, reading: &MotionReading) -> InsertOutcome {
        let source = reading.source();
        if self.source.is_some_and(|current| source < current) {
            return InsertOutcome::Superseded;
        }
        let (index, before) = match self.samples.vacancy(stamp) {
            Ok(vacancy) => vacancy,
            Err(refused) => return refused,
        };
        let samples = &mut self.samples.entries;
        if self.source.is_some_and(|current| source > current) && index < samples.len() {
            return InsertOutcome::TooOld;
        }
        self.source = Some(source);
        let sample = MotionSample {
            reading: *reading,
            cumulative_travel: WheelTravel::default(),
            step: None,
            crossings: Default::default(),
            gears: Default::default(),
        };
        samples.insert(index, (stamp, sample));
        self.sum_from(index);
        match before {
            Some(before) if self.samples.entries[index].1.step.is_none() => InsertOutcome::Rebased(before),
            _ => InsertOutcome::Inserted(before),
        }
    }

    /// Recomputes the steps to the sample at `index` and to the next one, and all later sums.
    fn sum_from(&mut self, index: usize) {
        for i in index.max(1)..self.samples.entries.len() {
            let (from, before) = self.samples.entries[i - 1];
            let (to, mut sample) = self.samples.entries[i];
            if i <= index + 1 {
                sample.step = self.step(&before.reading, &sample.reading, (to - from).as_secs_f64());
            }
            sample.cumulative_travel = sum(before.cumulative_travel, sample.step.unwrap_or_default());
            (sample.gears, sample.crossings) = self.turn_gears(&before, &sample);
            self.samples.entries[i].1 = sample;
        }
    }

    fn step(&self, from: &MotionReading, to: &MotionReading, dt_s: f64) -> Option<WheelTravel> {
        let step = from.travel_to(to, dt_s, &self.geometry)?;
        let is_held = matches!(from, MotionReading::Velocity { .. });
        (is_held || self.is_possible(step, dt_s)).then_some(step)
    }

    /// The gears' positions after a step, and how they got there; unknown again where the step is.
    fn turn_gears(&self, before: &MotionSample, after: &MotionSample) -> ([GearPosition; 2], [BacklashCrossing; 2]) {
        let (MotionReading::Wheels { left_rad: left, right_rad: right }, MotionReading::Wheels { left_rad, right_rad }) =
            (before.reading, after.reading)
        else {
            return Default::default();
        };
        if after.step.is_none() {
            return Default::default();
        }
        let mut gears = before.gears;
        let crossings =
            [gears[0].turn(left_rad - left, self.backlash_rad), gears[1].turn(right_rad - right, self.backlash_rad)];
        (gears, crossings)
    }

    fn is_possible(&self, step: WheelTravel, dt_s: f64) -> bool {
        // Two counts of slack: quantisation alone must never look like a jump.
        let limit_rad = self.max_wheel_rad_per_s * dt_s + 2.0 * self.geometry.tick.0;
        let left_rad = step.left_m / self.geometry.left_wheel_radius.0;
        let right_rad = step.right_m / self.geometry.right_wheel_radius.0;
        left_rad.abs() <= limit_rad && right_rad.abs() <= limit_rad
    }

    pub fn segment(&self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) -> TravelSegment {
        let index = self.samples.count_until(from);
        let Some((after_stamp, after)) = self.samples.entries.get(index) else {
            return TravelSegment::BeyondData { until: to };
        };
        let until = to.min(*after_stamp);
        let before = index.checked_sub(1).and_then(|i| self.samples.entries.get(i));
        let (Some((before_stamp, _)), Some(step)) = (before, after.step) else {
            return TravelSegment::Gap { until };
        };
        let length = *after_stamp - *before_stamp;
        let share = (until - from).as_nanos() as f64 / length.as_nanos() as f64;
        let is_counted = matches!(after.reading, MotionReading::Wheels { .. });
        let path_var_m2 = if is_counted && length > MAX_ARC_INTERVAL { share * self.path_variance(step) } else { 0.0 };
        let is_complete = from == *before_stamp && until == *after_stamp;
        TravelSegment::Known {
            until,
            travel: if is_complete { step } else { self.travel_between(from, until) },
            crossings: if is_complete { after.crossings } else { after.crossings.map(|crossing| crossing.part(share)) },
            path_var_m2,
        }
    }

    /// A robot that has driven d and turned by dth in unknown order moved in a direction that is uniform within dth.
    fn path_variance(&self, step: WheelTravel) -> f64 {
        let step = body_step(step, &self.geometry);
        (step.forward_m * step.turn_rad).powi(2) / 12.0
    }

    /// The reading before the one at `stamp` and the travel since, where the interval is short enough to give a speed.
    pub fn step_to(&self, stamp: Timestamp<BrickClock>) -> Option<(Timestamp<BrickClock>, WheelTravel)> {
        let index = self.samples.count_until(stamp).checked_sub(1)?;
        let (_, sample) = self.samples.entries.get(index).filter(|(at, _)| *at == stamp)?;
        let before = self.samples.entries.get(index.checked_sub(1)?)?.0;
        let step = sample.step.filter(|_| stamp - before <= MAX_ARC_INTERVAL)?;
        Some((before, step))
    }

    /// The stamp of the last reading up to and including an instant.
    pub fn last_at_or_before(&self, stamp: Timestamp<BrickClock>) -> Option<Timestamp<BrickClock>> {
        self.samples.last_at_or_before(stamp).map(|sample| sample.0)
    }

    /// Travel between two instants, linear inside each interval; unknown motion counts as rest.
    pub fn travel_between(&self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) -> WheelTravel {
        difference(self.travel_at(to), self.travel_at(from))
    }

    fn travel_at(&self, stamp: Timestamp<BrickClock>) -> WheelTravel {
        let samples = &self.samples.entries;
        let index = count_before(samples, |(at, _)| *at < stamp);
        let before = index.checked_sub(1).and_then(|i| samples.get(i));
        match (before, samples.get(index)) {
            (Some((before_stamp, before)), Some((after_stamp, after))) => {
                let interval_nanos = (*after_stamp - *before_stamp).as_nanos() as f64;
                let part = (stamp - *before_stamp).as_nanos() as f64 / interval_nanos;
                let step = difference(after.cumulative_travel, before.cumulative_travel);
                WheelTravel {
                    left_m: before.cumulative_travel.left_m + part * step.left_m,
                    right_m: before.cumulative_travel.right_m + part * step.right_m,
                }
            }
            (Some((_, only)), None) | (None, Some((_, only))) => only.cumulative_travel,
            (None, None) => WheelTravel::default(),
        }
    }

    /// Discards readings that instants from `horizon` on do not need; the one before it stays, for interpolation.
    pub fn discard_before(&mut self, horizon: Timestamp<BrickClock>) {
        self.samples.discard_before(horizon);
    }
}

fn sum(a: WheelTravel, b: WheelTravel) -> WheelTravel {
    WheelTravel { left_m: a.left_m + b.left_m, right_m: a.right_m + b.right_m }
}

fn difference(a: WheelTravel, b: WheelTravel) -> WheelTravel {
    WheelTravel { left_m: a.left_m - b.left_m, right_m: a.right_m - b.right_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Meters, Radians};

    const GEOMETRY: DriveGeometry = DriveGeometry {
        left_wheel_radius: Meters(0.03),
        right_wheel_radius: Meters(0.03),
        track_width: Meters(0.1),
        tick: Radians(0.017_453_3),
    };

    fn ms(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    fn wheels(left_rad: f64, right_rad: f64) -> MotionReading {
        MotionReading::Wheels { left_rad, right_rad }
    }

    fn track(readings: &[(i64, MotionReading)]) -> MotionTrack {
        let mut track = MotionTrack::new(GEOMETRY, 100.0);
        for (stamp, reading) in readings {
            track.insert(ms(*stamp), reading);
        }
        track
    }

    #[test]
    fn travel_is_linear_inside_an_interval() {
        let track = track(&[(0, wheels(0.0, 0.0)), (100, wheels(1.0, 2.0))]);
        let half = track.travel_between(ms(0), ms(50));
        assert!((half.left_m - 0.015).abs() < 1e-12 && (half.right_m - 0.03).abs() < 1e-12);
    }

    #[test]
    fn one_wheel_alone_beyond_its_largest_speed_is_a_new_base() {
        // 100 rad/s for 0.1 s, and two counts.
        for (left_rad, right_rad) in [(10.1, 0.0), (-10.1, 0.0), (0.0, 10.1), (0.0, -10.1)] {
            let mut track = track(&[(0, wheels(0.0, 0.0))]);
            assert_eq!(track.insert(ms(100), &wheels(left_rad, right_rad)), InsertOutcome::Rebased(ms(0)));
        }
        let mut track = track(&[(0, wheels(0.0, 0.0))]);
        assert_eq!(track.insert(ms(100), &wheels(10.0, -10.0)), InsertOutcome::Inserted(Some(ms(0))));
    }

    #[test]
    fn wheels_take_over_from_held_speeds_without_a_jump() {
        let slow = MotionReading::Velocity { forward_m_per_s: 0.1, turn_rad_per_s: 0.0 };
        let mut track = track(&[(0, slow), (1000, slow)]);
        assert_eq!(
            track.insert(ms(900), &wheels(70.0, 70.0)),
            InsertOutcome::TooOld,
            "a take-over does not rewrite the past"
        );
        assert_eq!(track.insert(ms(1100), &wheels(77.0, 77.0)), InsertOutcome::Rebased(ms(1000)));
        assert_eq!(track.insert(ms(1150), &slow), InsertOutcome::Superseded);
        track.insert(ms(1200), &wheels(78.0, 78.0));
        assert!((track.travel_between(ms(0), ms(1200)).left_m - 0.13).abs() < 1e-12);
    }

    #[test]
    fn what_was_forgotten_is_not_read_again() {
        let mut track = track(&[(0, wheels(0.0, 0.0)), (100, wheels(1.0, 1.0))]);
        track.insert(ms(200), &wheels(2.0, 2.0));
        track.discard_before(ms(150));
        assert_eq!(track.insert(ms(50), &wheels(0.5, 0.5)), InsertOutcome::TooOld);
        assert_eq!(track.insert(ms(150), &wheels(1.5, 1.5)), InsertOutcome::Inserted(Some(ms(100))));
        assert_eq!(track.insert(ms(150), &wheels(1.5, 1.5)), InsertOutcome::Duplicate);
    }

    #[test]
    fn before_the_first_reading_and_after_the_last_nothing_is_known() {
        let track = track(&[(100, wheels(0.0, 0.0)), (150, wheels(1.0, 1.0))]);
        assert_eq!(track.segment(ms(0), ms(150)), TravelSegment::Gap { until: ms(100) });
        assert_eq!(track.segment(ms(150), ms(170)), TravelSegment::BeyondData { until: ms(170) });
        assert!(track.step_to(ms(100)).is_none() && track.step_to(ms(150)).is_some());
    }

    #[test]
    fn the_parts_of_a_long_interval_share_its_path_variance() {
        let track = track(&[(0, wheels(0.0, 0.0)), (4_000, wheels(20.0, 30.0))]);
        let path_variance = |from, to| {
            let TravelSegment::Known { path_var_m2, .. } = track.segment(ms(from), ms(to)) else {
                panic!("the wheels were read on both sides");
            };
            path_var_m2
        };
        // 0.75 m and 3 rad in unknown order.
        assert!((path_variance(0, 4_000) - (0.75_f64 * 3.0).powi(2) / 12.0).abs() < 1e-12);
        assert!((path_variance(0, 1_000) + path_variance(1_000, 4_000) - path_variance(0, 4_000)).abs() < 1e-12);
        assert!(track.step_to(ms(4_000)).is_none(), "a mean is no speed");
    }
}
