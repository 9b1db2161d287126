//! Senders with clocks of their own that are no robots: cameras, and bricks with nothing but thermometers.

use std::collections::BTreeMap;

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{Address, BrickClock, CameraClock, HostClock, LinkId, SensorId, TimeDelta, Timestamp};

use crate::clock::align::ClockAligner;
use crate::clock::unwrap::UnwrapOutcome;
use crate::clock_alignment::{self, ExchangeOutcome};
use crate::fix_requests::{FixRequests, MAX_CAMERAS};
use crate::receive::{ReceiveInfo, TimeExchange};

/// A sender on the first link of its group.
pub(crate) type ObserverId = (LinkId, Address);

/// The clocks of all observers, and which of them are cameras.
#[derive(Debug, Default)]
pub(crate) struct Observers {
    clocks: BTreeMap<ObserverId, ClockAligner<CameraClock>>,
    /// Senders of fixes with clocks of their own, in the order of their first: each is a sensor of its own.
    cameras: Vec<ObserverId>,
    pub(crate) fix_requests: FixRequests,
}

/// What became of an observer's timestamp.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObserverTime<T> {
    /// `None` while that clock is not aligned, or for a timestamp from before a restart.
    pub(crate) time: Option<T>,
    pub(crate) has_restarted: bool,
}

impl Observers {
    /// The clock of a sender that proves to be a robot.
    pub(crate) fn remove_clock(&mut self, id: ObserverId) -> Option<ClockAligner<CameraClock>> {
        self.clocks.remove(&id)
    }

    pub(crate) fn observe_copy(&mut self, id: ObserverId, received: ReceiveInfo, stamp: WireStamp) {
        if let Some(clock) = self.clocks.get_mut(&id) {
            clock.observe_copy(received.endpoint, stamp, received.host_time);
        }
    }

    pub(crate) fn observe_exchange(&mut self, id: ObserverId, exchange: &TimeExchange) -> ExchangeOutcome<CameraClock> {
        clock_alignment::observe_exchange(self.clocks.entry(id).or_default(), exchange)
    }

    /// The host's instant of an observer's timestamp, and how far it may be off either way.
    pub(crate) fn host_time(
        &mut self,
        id: ObserverId,
        received: ReceiveInfo,
        stamp: WireStamp,
    ) -> ObserverTime<(Timestamp<HostClock>, TimeDelta)> {
        if let WireStamp::HostInterval { sent, answered } = stamp {
            let half = TimeDelta::from_nanos((answered - sent).as_nanos() / 2);
            return ObserverTime { time: Some((sent + half, half)), has_restarted: false };
        }
        let clock = self.clocks.entry(id).or_default();
        let outcome = clock.observe_arrival(received.endpoint, stamp, received.host_time);
        let (UnwrapOutcome::Continued(time) | UnwrapOutcome::Restarted(time)) = outcome else {
            return ObserverTime { time: None, has_restarted: false };
        };
        let time = clock.host_at(time);
        // A contradicted clock has no conversion, so that the caller reports it anyway.
        clock.take_contradiction();
        ObserverTime { time, has_restarted: matches!(outcome, UnwrapOutcome::Restarted(_)) }
    }

    /// The instant of a timestamp by the clock of a brick that is no robot, or not yet. Nothing is converted by this clock.
    pub(crate) fn own_time(
        &mut self,
        id: ObserverId,
        received: ReceiveInfo,
        stamp: WireStamp,
    ) -> ObserverTime<Timestamp<BrickClock>> {
        if matches!(stamp, WireStamp::HostInterval { .. }) {
            // Without a clock of its own its replies have no instants; with one it is a robot.
            return ObserverTime { time: None, has_restarted: false };
        }
        let clock = self.clocks.entry(id).or_default();
        let outcome = clock.observe_arrival(received.endpoint, stamp, received.host_time);
        clock.take_contradiction();
        let (UnwrapOutcome::Continued(time) | UnwrapOutcome::Restarted(time)) = outcome else {
            return ObserverTime { time: None, has_restarted: false };
        };
        ObserverTime {
            time: Some(Timestamp::from_nanos(time.as_nanos())),
            has_restarted: matches!(outcome, UnwrapOutcome::Restarted(_)),
        }
    }

    /// The sensor of a camera with a clock of its own: each has its own noise, gate and verdicts.
    pub(crate) fn camera_sensor(&mut self, id: ObserverId) -> SensorId {
        let known = self.cameras.iter().position(|camera| *camera == id);
        let index = known.unwrap_or_else(|| {
            if self.cameras.len() < MAX_CAMERAS {
                self.cameras.push(id);
            }
            self.cameras.len() - 1
        });
        SensorId::camera(index)
    }
}
