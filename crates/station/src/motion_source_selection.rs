//! What drives a robot's filter: one of the sources that measure the same motion.
//!
//! An autopilot sends one inertial unit in several messages, and several units: two of them together would count one turn twice. The
//! speed of a satellite receiver stands in for wheels, where there are none. Filters follow counts of wheels and a foreign odometer for
//! good once they had them, so no speed takes the place of these; it takes that of a wheel's speeds when they fall silent.

use posebridge_protocol::message::ImuMessage;
use posebridge_telemetry::{
    HostClock, MetersPerSecond, ObservationKind, RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::host_times::ShiftHostTimes;
use crate::observation_extractor::UnalignedObservation;

/// After this silence of a source another one takes its place.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(1_000);
/// A receiver that reports less may be at rest: three standard deviations of the 0.1 m/s that they typically have. A robot that drives
/// more slowly is at rest by this, and only its positions show that it moves.
const MIN_GROUND_SPEED_M_PER_S: f64 = 0.3;

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct MotionSourceSelector {
    /// The inertial message that is used, and when it was last heard.
    imu: Option<(ImuMessage, Timestamp<HostClock>)>,
    wheels: WheelSource,
    /// The last turn rate that was used.
    turn_rate: Option<(RadiansPerSecond, Timestamp<HostClock>)>,
}

/// What was heard of wheels or an odometer.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
enum WheelSource {
    #[default]
    Unheard,
    /// Speeds, for the last time at this instant.
    Speeds(Timestamp<HostClock>),
    /// Counts of wheels, or an odometer.
    Travel,
}

impl WheelSource {
    fn observe(&mut self, now: Timestamp<HostClock>, observed: &ObservationKind) {
        *self = match (*self, observed) {
            (Self::Unheard | Self::Speeds(_), ObservationKind::BodyVelocity { .. }) => Self::Speeds(now),
            _ => Self::Travel,
        };
    }

    fn is_present(self, now: Timestamp<HostClock>) -> bool {
        match self {
            Self::Unheard => false,
            Self::Speeds(last) => now - last < MAX_SILENCE,
            Self::Travel => true,
        }
    }
}

impl ShiftHostTimes for MotionSourceSelector {
    fn shift_host_times(&mut self, by: TimeDelta) {
        let Self { imu, wheels, turn_rate } = self;
        imu.shift_host_times(by);
        turn_rate.shift_host_times(by);
        match wheels {
            WheelSource::Speeds(last) => last.shift_host_times(by),
            WheelSource::Unheard | WheelSource::Travel => {}
        }
    }
}

impl MotionSourceSelector {
    /// The observation as it is used at `now`; `None` if another source measures the same.
    pub(crate) fn select(
        &mut self,
        now: Timestamp<HostClock>,
        observation: &UnalignedObservation,
    ) -> Option<UnalignedObservation> {
        if observation.imu.is_some_and(|message| !self.is_imu_used(now, message)) {
            return None;
        }
        if let ObservationKind::TurnRate(rate) = observation.observed {
            self.turn_rate = Some((rate, now));
        }
        if !observation.is_of_wheels() {
            return Some(*observation);
        }
        let (SensorId::GNSS, ObservationKind::BodyVelocity { forward, .. }) =
            (observation.sensor, observation.observed)
        else {
            self.wheels.observe(now, &observation.observed);
            return Some(*observation);
        };
        if self.wheels.is_present(now) {
            return None;
        }
        // A receiver does not know the turn: without a gyro there is nothing to say of the motion.
        let (turn, _) = self.turn_rate.filter(|(_, at)| now - *at < MAX_SILENCE)?;
        // Its speed is never negative, so that the noise of a robot at rest would be a motion forward.
        let forward = if forward.0 < MIN_GROUND_SPEED_M_PER_S { MetersPerSecond(0.0) } else { forward };
        Some(UnalignedObservation { observed: ObservationKind::BodyVelocity { forward, turn }, ..*observation })
    }

    /// The gyro is switched off.
    pub(crate) const fn forget_turn_rate(&mut self) {
        self.turn_rate = None;
    }

    /// The message that was chosen, or a better one, or any after its silence.
    fn is_imu_used(&mut self, now: Timestamp<HostClock>, message: ImuMessage) -> bool {
        let is_used = self.imu.is_none_or(|(chosen, last)| message <= chosen || now - last >= MAX_SILENCE);
        if is_used {
            self.imu = Some((message, now));
        }
        is_used
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation_extractor::ClockSource;
    use posebridge_protocol::message::WireStamp;
    use posebridge_telemetry::Radians;

    #[test]
    fn one_message_is_used_until_a_better_one_comes_or_it_falls_silent() {
        let mut source = MotionSourceSelector::default();
        let heard = [
            (0, ImuMessage::Scaled2, true),
            (10, ImuMessage::Scaled3, false),
            (20, ImuMessage::Raw, true),
            (30, ImuMessage::Scaled2, false),
            (1_019, ImuMessage::Scaled2, false),
            (1_020, ImuMessage::Scaled2, true),
            (1_030, ImuMessage::Raw, true),
        ];
        for (millis, message, is_used) in heard {
            assert_eq!(source.is_imu_used(Timestamp::from_millis(millis), message), is_used, "{millis} {message:?}");
        }
    }

    fn reading(sensor: SensorId, observed: ObservationKind) -> UnalignedObservation {
        let (stamp, clock_source) = (WireStamp::Micros64(1), ClockSource::Robot);
        UnalignedObservation { sensor, stamp, clock_source, observed, gyro_turn: None, tag: None, imu: None }
    }

    fn speed(sensor: SensorId, forward_m_per_s: f64) -> UnalignedObservation {
        let (forward, turn) = (MetersPerSecond(forward_m_per_s), RadiansPerSecond(0.0));
        reading(sensor, ObservationKind::BodyVelocity { forward, turn })
    }

    #[test]
    fn the_speed_of_satellites_stands_in_for_the_speeds_of_wheels_and_not_for_their_counts() {
        let at = Timestamp::from_millis;
        let mut source = MotionSourceSelector::default();
        let mut passes = |millis, observation: UnalignedObservation| {
            let selected = source.select(at(millis), &observation)?;
            let ObservationKind::BodyVelocity { forward, turn } = selected.observed else { return None };
            Some((forward.0, turn.0))
        };
        assert_eq!(passes(0, speed(SensorId::GNSS, 1.0)), None, "its turn is unknown");
        let turning = reading(SensorId::GYRO, ObservationKind::TurnRate(RadiansPerSecond(0.5)));
        passes(900, turning);
        assert_eq!(passes(1_000, speed(SensorId::GNSS, 1.0)), Some((1.0, 0.5)));
        assert_eq!(passes(1_100, speed(SensorId::GNSS, 0.29)), Some((0.0, 0.5)), "noise of a robot at rest");
        assert_eq!(passes(1_200, speed(SensorId::WHEELS, 0.2)), Some((0.2, 0.0)));
        passes(2_000, turning);
        assert_eq!(passes(2_199, speed(SensorId::GNSS, 1.0)), None);
        assert_eq!(passes(2_200, speed(SensorId::GNSS, 1.0)), Some((1.0, 0.5)), "the wheels fell silent");
        let counts = ObservationKind::WheelAngles { left: Radians(0.0), right: Radians(0.0) };
        passes(2_300, reading(SensorId::WHEELS, counts));
        passes(60_000, turning);
        assert_eq!(passes(60_000, speed(SensorId::GNSS, 1.0)), None, "the filter waits for counts");
    }
}
