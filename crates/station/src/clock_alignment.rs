//! A robot's clock: converts the timestamps of its messages to instants with their uncertainty.
//!
//! This is the only place that converts between the robot's clock and the host's.

use posebridge_estimator::RestoreError;
use posebridge_estimator::saved::Numbers;
use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{
    BrickClock, CameraClock, HostClock, ObservationKind, Radians, RadiansPerSecond, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::clock::align::{ClockAligner, ExchangeOutcome, SavedAligner};
use crate::clock::unwrap::UnwrapOutcome;
use crate::host_times::ShiftHostTimes;
use crate::observation_extractor::UnalignedObservation;
use crate::receive::{ReceiveInfo, TimeExchange};

/// Over a longer gap between two integrals of the gyro the mean rate is not used.
const MAX_GYRO_GAP: TimeDelta = TimeDelta::from_millis(1_000);
/// The integral on the wire has 32 bits of microradians.
const GYRO_TURN_PERIOD_RAD: f64 = 4_294.967_296;

#[derive(Clone, Debug, Default)]
pub(crate) struct ClockAlignment {
    pub(crate) aligner: ClockAligner<BrickClock>,
    last_gyro_turn: Option<(Timestamp<BrickClock>, Radians)>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct AlignedTime {
    /// The instant and its sigma; `None` if the timestamp is from before a restart, or belongs to a reply before the
    /// clock is aligned.
    pub(crate) time: Option<(Timestamp<BrickClock>, TimeDelta)>,
    pub(crate) has_restarted: bool,
    /// There is no instant, or the timestamp contradicts the alignment so much that it starts again.
    pub(crate) is_unaligned: bool,
}

/// A robot's clock as it is kept elsewhere.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SavedClocks {
    aligner: SavedAligner<BrickClock>,
    last_gyro_turn: Option<(Timestamp<BrickClock>, Radians)>,
}

impl ShiftHostTimes for SavedClocks {
    fn shift_host_times(&mut self, by: TimeDelta) {
        self.aligner.shift_host_times(by);
    }
}

impl ClockAlignment {
    pub(crate) fn save(&self) -> SavedClocks {
        let Self { aligner, last_gyro_turn } = self;
        SavedClocks { aligner: aligner.save(), last_gyro_turn: *last_gyro_turn }
    }

    pub(crate) fn restored(saved: SavedClocks) -> Result<Self, RestoreError> {
        let SavedClocks { aligner, last_gyro_turn } = saved;
        let is_finite = last_gyro_turn.is_none_or(|(_, turn)| turn.0.are_finite());
        is_finite.then_some(()).ok_or(RestoreError::Implausible("its gyro's turn is not finite"))?;
        Ok(Self { aligner: ClockAligner::restored(aligner)?, last_gyro_turn })
    }

    /// The clock of a sender that was followed as an observer before it proved to be a robot.
    pub(crate) fn from_observer(clock: ClockAligner<CameraClock>) -> Self {
        Self { aligner: clock.cast_clock(), last_gyro_turn: None }
    }

    pub(crate) fn align(&mut self, received: ReceiveInfo, stamp: WireStamp) -> AlignedTime {
        if let WireStamp::HostInterval { sent, answered } = stamp {
            let time = self.reply_time(sent, answered);
            return AlignedTime { time, has_restarted: false, is_unaligned: time.is_none() };
        }
        let outcome = self.aligner.observe_arrival(received.endpoint, stamp, received.host_time);
        let time = match outcome {
            UnwrapOutcome::Continued(time) | UnwrapOutcome::Restarted(time) => time,
            UnwrapOutcome::Stale => return AlignedTime { time: None, has_restarted: false, is_unaligned: true },
        };
        AlignedTime {
            time: Some((time, TimeDelta::ZERO)),
            has_restarted: matches!(outcome, UnwrapOutcome::Restarted(_)),
            is_unaligned: self.aligner.take_contradiction(),
        }
    }

    /// A duplicate from a redundant link adds only a bound of the clock.
    pub(crate) fn observe_copy(&mut self, received: ReceiveInfo, stamp: WireStamp) {
        self.aligner.observe_copy(received.endpoint, stamp, received.host_time);
    }

    pub(crate) fn observe_exchange(&mut self, exchange: &TimeExchange) -> ExchangeOutcome<BrickClock> {
        let ReceiveInfo { endpoint, host_time } = exchange.answer;
        self.aligner.observe_exchange(endpoint, exchange.sent, host_time, exchange.peer_nanos)
    }

    /// The mean turn rate since the sensor's last observation that arrived: from the integral, where the sender has
    /// one.
    pub(crate) fn mean_turn_rate(
        &mut self,
        time: Timestamp<BrickClock>,
        observation: &UnalignedObservation,
    ) -> ObservationKind {
        let Some(turn) = observation.gyro_turn else {
            return observation.observed;
        };
        let before = self.last_gyro_turn;
        // One that was overtaken on its way must not become the base of the next.
        if before.is_none_or(|(last, _)| time > last) {
            self.last_gyro_turn = Some((time, turn));
        }
        let Some((last_time, last_turn)) = before else {
            return observation.observed;
        };
        let gap = time - last_time;
        if gap <= TimeDelta::ZERO || gap > MAX_GYRO_GAP {
            return observation.observed;
        }
        let turned_rad = (turn.0 - last_turn.0 + 0.5 * GYRO_TURN_PERIOD_RAD).rem_euclid(GYRO_TURN_PERIOD_RAD)
            - 0.5 * GYRO_TURN_PERIOD_RAD;
        ObservationKind::TurnRate(RadiansPerSecond(turned_rad / gap.as_secs_f64()))
    }

    /// After a restart of the robot the gyro's integral starts again.
    pub(crate) fn forget_gyro_turn(&mut self) {
        self.last_gyro_turn = None;
    }

    /// The robot's instant at a host instant, and its sigma if the host instant may be off by `host_uncertainty` either
    /// way; `None` before the first alignment.
    pub(crate) fn at_host_time(
        &self,
        host: Timestamp<HostClock>,
        host_uncertainty: TimeDelta,
    ) -> Option<(Timestamp<BrickClock>, TimeDelta)> {
        let (time, uncertainty) = self.aligner.remote_at(host)?;
        Some((time, uniform_sigma(host_uncertainty + uncertainty)))
    }

    /// `None` before the first alignment.
    pub(crate) fn to_host(&self, time: Timestamp<BrickClock>) -> Option<Timestamp<HostClock>> {
        self.aligner.host_at(time).map(|(host, _)| host)
    }

    /// The instant of a reading between request and reply, and its sigma: it may lie anywhere between.
    fn reply_time(
        &self,
        sent: Timestamp<HostClock>,
        answered: Timestamp<HostClock>,
    ) -> Option<(Timestamp<BrickClock>, TimeDelta)> {
        let half = TimeDelta::from_nanos((answered - sent).as_nanos() / 2);
        self.at_host_time(sent + half, half)
    }
}

/// Standard deviation of a uniform distribution within plus or minus `bound`.
fn uniform_sigma(bound: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(bound.as_secs_f64() / 3.0_f64.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_protocol::routing::Endpoint;

    fn received(millis: i64) -> ReceiveInfo {
        ReceiveInfo { endpoint: Endpoint::default(), host_time: Timestamp::from_millis(millis) }
    }

    fn millis(value: u32) -> WireStamp {
        WireStamp::Millis32(value)
    }

    /// A clock that shows 5 s when the host's is at zero, requested and answered every 100 ms with 10 ms in each direction.
    fn aligned() -> ClockAlignment {
        let mut clocks = ClockAlignment::default();
        for n in 0..20 {
            let sent = 100 * n;
            clocks.align(received(sent + 10), millis(5_000 + sent as u32));
            clocks.observe_exchange(&TimeExchange {
                sent: Timestamp::from_millis(sent),
                answer: received(sent + 20),
                peer_nanos: (5_000 + sent + 10) * 1_000_000,
            });
        }
        clocks
    }

    #[test]
    fn a_host_instant_becomes_the_robots_with_an_honest_sigma() {
        let clocks = aligned();
        let (time, sigma) = clocks.at_host_time(Timestamp::from_millis(2_000), TimeDelta::ZERO).expect("it is aligned");
        let bound = clocks.aligner.uncertainty().expect("it is aligned");
        let off = time - Timestamp::from_millis(7_000);
        assert!(off.as_nanos().abs() <= bound.as_nanos(), "{off:?} {bound:?}");
        assert!(bound <= TimeDelta::from_millis(100), "{bound:?}");
        // Uniform within the bound, which grows away from the last exchange.
        assert!(sigma >= TimeDelta::from_secs_f64(bound.as_secs_f64() / 3.0_f64.sqrt()), "{sigma:?} {bound:?}");
        // What the host's instant may be off by adds up.
        let (_, wider) = clocks.at_host_time(Timestamp::from_millis(2_000), TimeDelta::from_millis(30)).unwrap();
        assert!(wider > sigma);
    }

    #[test]
    fn a_timestamp_that_falls_is_a_restart_and_a_reply_without_alignment_has_no_instant() {
        let mut clocks = aligned();
        let after = clocks.align(received(9_000), millis(3));
        assert!(after.has_restarted && after.time.is_some());
        let interval = WireStamp::HostInterval { sent: Timestamp::from_millis(1), answered: Timestamp::from_millis(5) };
        let unknown = ClockAlignment::default().align(received(5), interval);
        assert!(unknown.is_unaligned && unknown.time.is_none());
    }
}
