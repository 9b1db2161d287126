//! The HiTechnic gyro: the turn rate is the difference between a reading and the reading at rest.
//!
//! ```text
//! rate = sign (raw - rest) deg/s,  for |raw - rest| <= RANGE and a raw below the converter's stop; else an empty port
//! rest = mean of the first readings while both wheels are at rest, if close together; later ones follow slowly
//! rest = mean of a calm, if it is another:  readings over CALM_TIME at rest, all within CALM_SPREAD of each other
//! ```
//! Wheels are also at rest while the robot is turned in the hand, and a robot that drives off provides only few readings. So
//! the calm corrects them: no hand turns for so long at a rate that is steady within four degrees per second. On a turntable,
//! or in a car in a long bend, a calm is a turn: there the rest must be configured.
//!
//! # Sources
//! HiTechnic NGY1044, data sheet: one degree per second and count, +-360 degrees per second, rest around 600, 580 to 625
//! reported, different for each sensor and drifting with temperature; people average about 500 readings at rest. An open
//! input of the ten-bit converter reads 1023 (LEGO MINDSTORMS NXT Hardware Developer Kit).

use posebridge_telemetry::{HostClock, RadiansPerSecond, TimeDelta, Timestamp};

use super::settings::GyroSign;
use crate::bricks::counters::WheelState;

/// Readings for the first rest value: less than a second's, a mean within 0.3 degrees per second, which is small
/// against the bias that a filter expects of this sensor. Robots rarely rest for longer before they drive off.
const MIN_REST_READINGS: u32 = 10;
/// Number of readings of the running mean afterwards.
const MAX_REST_READINGS: u32 = 500;
/// Largest spread of readings at rest, in counts: the noise is about one.
const REST_SPREAD: f64 = 8.0;
/// Largest deviation of a reading at rest; beyond it the robot is turned by hand.
const MAX_REST_DEVIATION: f64 = 4.0;
/// Duration of a calm, and its least number of readings.
const CALM_TIME: TimeDelta = TimeDelta::from_millis(3_000);
const CALM_COUNT: u32 = 30;
/// Largest spread of readings of a calm, in counts: fifty readings with a noise of 0.6 to 1 count mostly stay within it.
const CALM_SPREAD: f64 = 4.0;
/// A calm whose mean is closer to the rest value changes nothing.
const MIN_CALM_CHANGE: f64 = 1.0;
/// Possible rest values, with a margin.
const REST_RANGE: std::ops::RangeInclusive<f64> = 500.0..=700.0;
/// Largest deviation of a reading from the rest: 360 degrees per second, and a margin for the error of the rest value.
const RANGE: f64 = 380.0;
/// The converter's limit: an open input.
const OPEN_INPUT: u16 = 1023;
/// Time after the first reading at which an unknown rest value is reported.
const REST_TIMEOUT: TimeDelta = TimeDelta::from_millis(5_000);

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum GyroReadout {
    /// The turn rate, counter-clockwise positive, bias included.
    Rate(RadiansPerSecond),
    /// No rate yet: the rest value is unknown.
    Unknown,
    /// No rate for five seconds: the rest value is still unknown.
    RestTimeout,
    /// No gyro has this reading: the port is empty.
    Disconnected,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum RestUpdate {
    Unchanged,
    /// The first rest value, in counts.
    First(f64),
    /// The rest value was wrong; the new one, in counts.
    Corrected(f64),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct AnalogGyro {
    sign: f64,
    configured_rest: Option<f64>,
    rest_mean: RestMean,
    calm_period: CalmPeriod,
    first_reading: Option<Timestamp<HostClock>>,
}

#[derive(Clone, Copy, Debug, Default)]
struct RunningMean {
    count: u32,
    value: f64,
    smallest: f64,
    largest: f64,
}

impl AnalogGyro {
    pub(super) fn new(rest: Option<f64>, sign: GyroSign) -> Self {
        Self {
            sign: match sign {
                GyroSign::CounterClockwise => 1.0,
                GyroSign::Clockwise => -1.0,
            },
            configured_rest: rest,
            rest_mean: RestMean::default(),
            calm_period: CalmPeriod::default(),
            first_reading: None,
        }
    }

    /// In counts, once known.
    fn rest_value(&self) -> Option<f64> {
        self.configured_rest.or(self.rest_mean.value())
    }

    /// Converts a reading at the instant `at`, and updates the rest value.
    pub(super) fn push(&mut self, at: Timestamp<HostClock>, raw: u16, wheels: WheelState) -> (GyroReadout, RestUpdate) {
        if raw >= OPEN_INPUT {
            self.calm_period = CalmPeriod::default();
            return (GyroReadout::Disconnected, RestUpdate::Unchanged);
        }
        let raw = f64::from(raw);
        let taught = self.learn(at, raw, wheels);
        let Some(rest) = self.rest_value() else {
            let since = *self.first_reading.get_or_insert(at);
            let is_overdue = at - since >= REST_TIMEOUT;
            let turning = if is_overdue { GyroReadout::RestTimeout } else { GyroReadout::Unknown };
            return (turning, taught);
        };
        if (raw - rest).abs() > RANGE {
            return (GyroReadout::Disconnected, taught);
        }
        let rate = RadiansPerSecond(self.sign * (raw - rest).to_radians());
        (GyroReadout::Rate(rate), taught)
    }

    fn learn(&mut self, at: Timestamp<HostClock>, raw: f64, wheels: WheelState) -> RestUpdate {
        if self.configured_rest.is_some() {
            return RestUpdate::Unchanged;
        }
        let before = self.rest_value();
        self.rest_mean.push(raw, wheels);
        let calm = self.calm_period.push(at, raw, wheels);
        match (before, self.rest_value()) {
            (None, Some(rest)) => RestUpdate::First(rest),
            (Some(_), Some(rest)) => match calm {
                Some(calm) if (calm.value - rest).abs() > MIN_CALM_CHANGE => {
                    self.rest_mean = RestMean(calm);
                    RestUpdate::Corrected(calm.value)
                }
                _ => RestUpdate::Unchanged,
            },
            (_, None) => RestUpdate::Unchanged,
        }
    }
}

impl RunningMean {
    fn push(&mut self, raw: f64) {
        if self.count == 0 {
            (self.smallest, self.largest) = (raw, raw);
        }
        self.smallest = self.smallest.min(raw);
        self.largest = self.largest.max(raw);
        self.count += 1;
        self.value += (raw - self.value) / f64::from(self.count);
    }

    fn spread(&self) -> f64 {
        self.largest - self.smallest
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct RestMean(RunningMean);

impl RestMean {
    fn value(&self) -> Option<f64> {
        (self.0.count >= MIN_REST_READINGS).then_some(self.0.value)
    }

    fn push(&mut self, raw: f64, wheels: WheelState) {
        if let Some(rest) = self.value() {
            if wheels == WheelState::Standing && (raw - rest).abs() <= MAX_REST_DEVIATION {
                self.0.count = self.0.count.min(MAX_REST_READINGS - 1);
                self.0.push(raw);
            }
            return;
        }
        if wheels == WheelState::Turning {
            // It may stop again: at the next corner.
            return;
        }
        if !REST_RANGE.contains(&raw) {
            self.0 = RunningMean::default();
            return;
        }
        self.0.push(raw);
        if self.0.spread() > REST_SPREAD {
            self.0 = RunningMean::default();
        }
    }
}

/// Readings with a small spread while both wheels are at rest.
#[derive(Clone, Copy, Debug, Default)]
struct CalmPeriod {
    since: Option<Timestamp<HostClock>>,
    mean: RunningMean,
}

impl CalmPeriod {
    /// The mean of a calm that this reading completes; the next one begins anew.
    fn push(&mut self, at: Timestamp<HostClock>, raw: f64, wheels: WheelState) -> Option<RunningMean> {
        if wheels == WheelState::Turning || !REST_RANGE.contains(&raw) {
            *self = Self::default();
            return None;
        }
        self.mean.push(raw);
        if self.mean.spread() > CALM_SPREAD {
            // This reading may be the first of a calm.
            *self = Self::default();
            self.mean.push(raw);
        }
        let since = *self.since.get_or_insert(at);
        if at - since < CALM_TIME || self.mean.count < CALM_COUNT {
            return None;
        }
        Some(std::mem::take(self).mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gyro that is read every 60 ms.
    struct Bench {
        gyro: AnalogGyro,
        at: Timestamp<HostClock>,
        taught: Vec<RestUpdate>,
    }

    impl Bench {
        fn new(rest: Option<f64>, sign: GyroSign) -> Self {
            Self { gyro: AnalogGyro::new(rest, sign), at: Timestamp::ZERO, taught: Vec::new() }
        }

        fn push(&mut self, raw: u16, wheels: WheelState) -> GyroReadout {
            self.at = self.at + TimeDelta::from_millis(60);
            let (turning, taught) = self.gyro.push(self.at, raw, wheels);
            if taught != RestUpdate::Unchanged {
                self.taught.push(taught);
            }
            turning
        }

        fn at_rest(&mut self, readings: impl IntoIterator<Item = u16>) {
            for raw in readings {
                self.push(raw, WheelState::Standing);
            }
        }

        fn rest(&self) -> Option<f64> {
            self.gyro.rest_value()
        }
    }

    fn deg_per_s(turning: GyroReadout) -> f64 {
        match turning {
            GyroReadout::Rate(rate) => rate.0.to_degrees(),
            GyroReadout::Unknown | GyroReadout::RestTimeout | GyroReadout::Disconnected => f64::NAN,
        }
    }

    #[test]
    fn a_configured_rest_is_used_at_once_and_kept() {
        let mut bench = Bench::new(Some(600.5), GyroSign::CounterClockwise);
        let turning = bench.push(690, WheelState::Turning);
        assert!((deg_per_s(turning) - 89.5).abs() < 1e-9);
        bench.at_rest([598; 100]);
        assert_eq!(bench.rest(), Some(600.5));
        assert_eq!(bench.taught, []);
    }

    #[test]
    fn the_rest_value_is_learnt_at_standstill_and_nothing_is_measured_before() {
        let mut bench = Bench::new(None, GyroSign::Clockwise);
        assert_eq!(bench.push(600, WheelState::Turning), GyroReadout::Unknown);
        bench.at_rest([597, 598, 597, 598, 597]);
        // What it reads while it drives is no rest, and what was learnt before is kept.
        assert_eq!(bench.push(640, WheelState::Turning), GyroReadout::Unknown);
        bench.at_rest([598, 597, 598, 597]);
        assert_eq!(bench.rest(), None);
        bench.at_rest([597]);
        assert!((bench.rest().unwrap() - 597.4).abs() < 1e-9);
        assert!(matches!(bench.taught[..], [RestUpdate::First(_)]));
        let turning = bench.push(607, WheelState::Turning);
        assert!((deg_per_s(turning) + 9.6).abs() < 1e-9);
    }

    #[test]
    fn a_turn_restarts_learning_and_a_turn_by_hand_is_ignored() {
        let mut bench = Bench::new(None, GyroSign::CounterClockwise);
        bench.at_rest([600; 9]);
        bench.at_rest([620, 600]);
        assert_eq!(bench.rest(), None);
        bench.at_rest([600; 10]);
        assert!(bench.rest().is_some());
        // Ten seconds of a turn that is as steady as a hand is.
        bench.at_rest((0..170).map(|step| 640 + step % 7));
        assert_eq!(bench.rest(), Some(600.0));
    }

    #[test]
    fn a_rest_value_learnt_in_the_hand_is_corrected_at_standstill() {
        let mut bench = Bench::new(None, GyroSign::CounterClockwise);
        // Nearly three seconds at ten degrees per second; it stops before a calm is over.
        bench.at_rest([610; 50]);
        assert_eq!(bench.rest(), Some(610.0));
        bench.at_rest([600; 50]);
        assert_eq!(bench.rest(), Some(610.0));
        bench.at_rest([601]);
        let rest = bench.rest().unwrap();
        assert!((rest - 600.0).abs() < 0.1, "{rest}");
        assert_eq!(bench.taught[1..], [RestUpdate::Corrected(rest)]);
        let turning = bench.push(590, WheelState::Turning);
        assert!((deg_per_s(turning) + 10.0).abs() < 0.1);
    }

    #[test]
    fn calm_needs_wheels_at_standstill_for_its_duration() {
        let mut bench = Bench::new(None, GyroSign::CounterClockwise);
        bench.at_rest([600; 10]);
        for _ in 0..10 {
            bench.at_rest([610; 45]);
            bench.push(610, WheelState::Turning);
        }
        assert_eq!(bench.rest(), Some(600.0));
        // A stall: two readings in five seconds are no calm.
        bench.at_rest([610]);
        bench.at = bench.at + TimeDelta::from_millis(5_000);
        bench.at_rest([610]);
        assert_eq!(bench.rest(), Some(600.0));
    }

    #[test]
    fn the_rest_value_follows_slowly_at_standstill() {
        let mut bench = Bench::new(None, GyroSign::CounterClockwise);
        bench.at_rest([600; 25]);
        bench.at_rest([602; 25]);
        let soon = bench.rest().unwrap();
        assert!((soon - 601.0).abs() < 1e-9, "{soon}");
        bench.at_rest([602; 2_000]);
        assert!((bench.rest().unwrap() - 602.0).abs() < 0.05);
    }

    #[test]
    fn an_empty_port_is_no_gyro() {
        for rest in [None, Some(600.0), Some(690.0)] {
            let mut bench = Bench::new(rest, GyroSign::CounterClockwise);
            for raw in [1023, 1024, 5_000] {
                assert_eq!(bench.push(raw, WheelState::Standing), GyroReadout::Disconnected);
            }
            assert_eq!(bench.rest(), rest);
        }
        // Plugged out in the middle, and a contact that gives anything.
        let mut bench = Bench::new(None, GyroSign::CounterClockwise);
        bench.at_rest([600; 20]);
        for raw in [1023, 1000, 200, 0] {
            assert_eq!(bench.push(raw, WheelState::Turning), GyroReadout::Disconnected, "{raw}");
        }
        for raw in [240, 960] {
            let fastest = deg_per_s(bench.push(raw, WheelState::Turning)).abs();
            assert!((fastest - 360.0).abs() < 1e-9);
        }
        assert_eq!(bench.rest(), Some(600.0));
    }

    #[test]
    fn a_robot_that_never_stops_is_reported_after_five_seconds() {
        let mut bench = Bench::new(None, GyroSign::CounterClockwise);
        let readouts: Vec<GyroReadout> = (0..100).map(|_| bench.push(640, WheelState::Turning)).collect();
        let overdue = readouts.iter().position(|turning| *turning == GyroReadout::RestTimeout);
        assert_eq!(overdue, Some(84));
        bench.at_rest([600; 10]);
        assert_eq!(deg_per_s(bench.push(600, WheelState::Standing)), 0.0);
    }
}
