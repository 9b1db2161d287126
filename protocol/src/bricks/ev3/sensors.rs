//! The sensors of the brick, their set-up, and the gyro's angle without wraps.
//!
//! Setting a mode makes the brick wait, so it is done once and in a telegram of its own: then an error names its port. A
//! firmware may wait for a missing sensor forever, so a set-up without a reply is repeated less and less often, and only
//! while the wheels are at rest.

use posebridge_telemetry::{HostClock, Meters, TimeDelta, Timestamp};

use super::settings::{DistanceKind, Ev3Settings, GyroReading, GyroSettings, SensorPort};
use super::telegrams::{DirectCommand, SensorMode};
use crate::bricks::counters::WheelState;

pub(super) const MAX_SENSORS: usize = 2;
/// Interval between set-ups of a missing sensor.
const RETRY_INTERVAL: TimeDelta = TimeDelta::from_millis(10_000);
/// Limit of the doublings of that interval, one for each consecutive set-up without a reply: five minutes.
const MAX_RETRY_DOUBLINGS: u32 = 5;
/// A sensor without a value for this long counts as unplugged.
const LOST_TIMEOUT: TimeDelta = TimeDelta::from_millis(2_000);
/// No echo: the value that the ultrasonic sensors show for it, and the least such value.
const NO_ECHO_CM: f64 = 255.0;
/// The infrared sensor's proximity of 100 (LEGO's manual: about 70 cm), cm per step.
const INFRARED_CM: f64 = 0.7;
/// The infrared sensor's value without a target.
const NO_TARGET: f64 = 100.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SensorRole {
    Gyro(GyroSettings),
    Distance(DistanceKind),
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct CycleSensors(pub(super) [Option<SensorRole>; MAX_SENSORS]);

#[derive(Clone, Copy, Debug)]
struct SensorSlot {
    role: SensorRole,
    port: SensorPort,
    state: SetUpState,
    is_absence_reported: bool,
    /// Consecutive set-ups without a reply.
    unanswered: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SetUpFailure {
    /// The brick replied at once that there is no sensor.
    Rejected,
    /// The brick did not reply.
    TimedOut,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SetUpState {
    Pending { from: Timestamp<HostClock> },
    Ready { silent_since: Option<Timestamp<HostClock>> },
}

/// The sensors of one brick, in the order of their values in a reply.
#[derive(Clone, Debug)]
pub(super) struct SensorBank(Vec<SensorSlot>);

impl SensorBank {
    pub(super) fn new(settings: &Ev3Settings, now: Timestamp<HostClock>) -> Self {
        let gyro = settings.gyro.map(|gyro| (SensorRole::Gyro(gyro), gyro.port));
        let distance = settings.distance.map(|distance| (SensorRole::Distance(distance.kind), distance.port));
        let plugged = [gyro, distance].into_iter().flatten();
        let sensors = plugged.map(|(role, port)| SensorSlot {
            role,
            port,
            state: SetUpState::Pending { from: now },
            is_absence_reported: false,
            unanswered: 0,
        });
        Self(sensors.collect())
    }

    pub(super) fn next_pending(&self, now: Timestamp<HostClock>, wheels: WheelState) -> Option<usize> {
        let is_due = |sensor: &SensorSlot| {
            matches!(sensor.state, SetUpState::Pending { from } if from <= now)
                && (sensor.unanswered == 0 || wheels == WheelState::Standing)
        };
        self.0.iter().position(is_due)
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let from = self.0.iter().filter_map(|sensor| match sensor.state {
            SetUpState::Pending { from } => Some(from),
            SetUpState::Ready { .. } => None,
        });
        from.min()
    }

    pub(super) fn write_set_up(&self, index: usize, command: &mut DirectCommand) {
        if let Some(sensor) = self.0.get(index) {
            let mode = sensor.role.sensor_mode();
            command.wait_for(sensor.port, Some(mode), sensor.role.value_count());
        }
    }

    /// Writes the reading of all sensors that are set up, and returns which they are.
    pub(super) fn write_reading(&self, command: &mut DirectCommand) -> CycleSensors {
        let mut included = CycleSensors::default();
        for (sensor, slot) in self.0.iter().zip(&mut included.0) {
            if !matches!(sensor.state, SetUpState::Ready { .. }) {
                continue;
            }
            *slot = Some(sensor.role);
            match sensor.role.value_count() {
                1 => command.read_value(sensor.port),
                values => command.wait_for(sensor.port, None, values),
            }
        }
        included
    }

    pub(super) fn is_ready(&mut self, index: usize) {
        if let Some(sensor) = self.0.get_mut(index) {
            sensor.state = SetUpState::Ready { silent_since: None };
            sensor.is_absence_reported = false;
            sensor.unanswered = 0;
        }
    }

    /// A sensor could not be set up, or is unplugged: returns the text for people, once.
    pub(super) fn is_absent(
        &mut self,
        index: usize,
        now: Timestamp<HostClock>,
        failed: SetUpFailure,
    ) -> Option<String> {
        let sensor = self.0.get_mut(index)?;
        sensor.unanswered = match failed {
            SetUpFailure::Rejected => 0,
            SetUpFailure::TimedOut => sensor.unanswered.saturating_add(1),
        };
        let doublings = sensor.unanswered.saturating_sub(1).min(MAX_RETRY_DOUBLINGS);
        let from = now + TimeDelta::from_nanos(RETRY_INTERVAL.as_nanos() << doublings);
        sensor.state = SetUpState::Pending { from };
        let is_unreported = !std::mem::replace(&mut sensor.is_absence_reported, true);
        is_unreported.then(|| {
            format!(
                "the EV3 finds no {} at port {}; the wheels are read without it",
                sensor.role.name(),
                sensor.port.label()
            )
        })
    }

    /// The brick refused to read all sensors together: sets each up again, which finds the missing one.
    pub(super) fn restart_set_up(&mut self, now: Timestamp<HostClock>) {
        for sensor in &mut self.0 {
            sensor.state = SetUpState::Pending { from: now };
        }
    }

    /// Records a value or its absence; returns the text for people if the sensor counts as unplugged.
    pub(super) fn record_reading(&mut self, index: usize, now: Timestamp<HostClock>, values: &[f64]) -> Option<String> {
        let sensor = self.0.get_mut(index)?;
        let SetUpState::Ready { silent_since } = &mut sensor.state else {
            return None;
        };
        if values.iter().all(|value| value.is_finite()) {
            *silent_since = None;
            return None;
        }
        let since = *silent_since.get_or_insert(now);
        if now - since < LOST_TIMEOUT {
            return None;
        }
        self.is_absent(index, now, SetUpFailure::Rejected)
    }
}

impl SensorRole {
    /// Type and mode (EV3 hardware developer kit; ev3dev's table of sensors).
    const fn sensor_mode(self) -> SensorMode {
        let (kind, mode) = match self {
            // GYRO-RATE, GYRO-G&A.
            Self::Gyro(GyroSettings { reading, .. }) => match reading {
                GyroReading::Rate => (32, 1),
                GyroReading::RateAndAngle => (32, 3),
            },
            // US-DIST-CM, NXT-US-CM, IR-PROX.
            Self::Distance(DistanceKind::Ultrasonic) => (30, 0),
            Self::Distance(DistanceKind::NxtUltrasonic) => (5, 0),
            Self::Distance(DistanceKind::Infrared) => (33, 0),
        };
        SensorMode { kind, mode }
    }

    pub(super) const fn value_count(self) -> u8 {
        match self {
            Self::Gyro(GyroSettings { reading: GyroReading::RateAndAngle, .. }) => 2,
            Self::Gyro(_) | Self::Distance(_) => 1,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Gyro(_) => "gyro",
            Self::Distance(DistanceKind::Ultrasonic) => "EV3 ultrasonic sensor",
            Self::Distance(DistanceKind::NxtUltrasonic) => "NXT ultrasonic sensor",
            Self::Distance(DistanceKind::Infrared) => "infrared sensor",
        }
    }
}

impl DistanceKind {
    /// The range of a value, with its sigma if that is known; `None` without a target.
    pub(super) fn range(self, value: f64) -> Option<(Meters, Option<Meters>)> {
        match self {
            Self::Ultrasonic | Self::NxtUltrasonic => {
                let is_echo = value > 0.0 && value < NO_ECHO_CM;
                is_echo.then_some((Meters(value / 100.0), None))
            }
            Self::Infrared => {
                let has_target = (0.0..NO_TARGET).contains(&value);
                // Half of the range at its end: the proximity depends on what is seen.
                let range_m = value * INFRARED_CM / 100.0;
                has_target.then_some((Meters(range_m), Some(Meters(0.02 + 0.25 * range_m))))
            }
        }
    }
}

/// The sensor's limit, degrees per second (LEGO's manual).
const MAX_DEG_PER_S: f64 = 440.0;
/// Rounding of both angles and of the rate.
const MARGIN_DEG: f64 = 5.0;
const PERIOD_DEG: f64 = 65_536.0;

/// The turn since the first sample, degrees, with the sensor's sign, without wraps or jumps.
///
/// The sensor counts degrees in 16 bits, and setting its mode, as a program on the brick may do, resets the angle. A
/// change that the rate does not explain is replaced by the integral of the rate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TurnAccumulator {
    total_deg: f64,
    last_deg: Option<f64>,
}

impl TurnAccumulator {
    /// Takes angle and rate; `since` is the time since the previous ones.
    pub(super) fn push(&mut self, since: TimeDelta, angle_deg: f64, rate_deg_per_s: f64) -> f64 {
        if let Some(last_deg) = self.last_deg {
            let half = 0.5 * PERIOD_DEG;
            let change_deg = (angle_deg - last_deg + half).rem_euclid(PERIOD_DEG) - half;
            let by_rate_deg = rate_deg_per_s * since.as_secs_f64();
            let most_deg = MAX_DEG_PER_S * since.as_secs_f64() + MARGIN_DEG;
            self.total_deg += if (change_deg - by_rate_deg).abs() <= most_deg { change_deg } else { by_rate_deg };
        }
        self.last_deg = Some(angle_deg);
        self.total_deg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_turn_runs_on_across_the_wrap_and_a_reset_of_the_angle() {
        let mut turn = TurnAccumulator::default();
        let cycle = TimeDelta::from_millis(100);
        let angles = [32_760.0, 32_766.0, -32_764.0, -32_758.0, 0.0, 6.0];
        let turns = angles.map(|angle_deg| turn.push(cycle, angle_deg, 60.0));
        assert_eq!(turns, [0.0, 6.0, 12.0, 18.0, 24.0, 30.0]);
    }
}
