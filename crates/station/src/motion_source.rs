//! What drives a robot's filter: one of the sources that measure the same motion.
//!
//! An autopilot sends one inertial unit in several messages, and several units: two of them together would count one turn twice. The
//! speed of a satellite receiver stands in for wheels, where there are none.

use posebridge_protocol::message::ImuMessage;
use posebridge_telemetry::{HostClock, ObservationKind, RadiansPerSecond, SensorId, TimeDelta, Timestamp};

use crate::observation_extractor::UnalignedObservation;

/// After this silence of a source another one takes its place.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(1_000);

#[derive(Debug, Default)]
pub(crate) struct MotionSource {
    /// The inertial message that is used, and when it was last heard.
    imu: Option<(ImuMessage, Timestamp<HostClock>)>,
    /// When wheels or an odometer were last heard.
    wheels: Option<Timestamp<HostClock>>,
    /// The last turn rate that was used.
    turn_rate: Option<(RadiansPerSecond, Timestamp<HostClock>)>,
}

impl MotionSource {
    /// The observation as it is used at `now`; `None` if another source measures the same.
    pub(crate) fn choose(
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
            self.wheels = Some(now);
            return Some(*observation);
        };
        if self.wheels.is_some_and(|last| now - last < MAX_SILENCE) {
            return None;
        }
        // A receiver does not know the turn; without a gyro the robot drives straight on for all it says.
        let turn = self.turn_rate.filter(|(_, at)| now - *at < MAX_SILENCE);
        let turn = turn.map_or(RadiansPerSecond(0.0), |(rate, _)| rate);
        Some(UnalignedObservation { observed: ObservationKind::BodyVelocity { forward, turn }, ..*observation })
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

    #[test]
    fn one_message_is_used_until_a_better_one_comes_or_it_falls_silent() {
        let mut source = MotionSource::default();
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
}
