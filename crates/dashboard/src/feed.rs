//! The channel from the station loop to the dashboard.

use std::sync::Arc;

use posebridge_telemetry::{Arena, BrickClock, DriveGeometry, Event, HostClock, Pose, RobotId, TimeDelta, Timestamp};
use tokio::sync::Notify;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::mpsc::{self, Receiver, Sender};

use crate::counters::{ServerCounter, ServerCounters};
use crate::model::{CalibrationRow, ParameterValue, SetupRow, SimulatorNow};

/// Most batches that wait before further ones are dropped and counted: half a minute of a brick that sends 200 times a
/// second. The reader polls fifty times a second.
const MAX_WAITING_BATCHES: usize = 6_000;
/// The backlog at which the reader is woken: after a stall many batches come within a few milliseconds and should not
/// fill the memory.
const BACKLOG_THRESHOLD: usize = 64;

/// The results of one input.
#[derive(Clone, Debug, PartialEq)]
pub struct EventBatch {
    pub now: Timestamp<HostClock>,
    /// From its arrival until all its outputs were sent to the links.
    pub latency: TimeDelta,
    /// Shared by all viewers and the recorder.
    pub events: Arc<[Event]>,
    /// Present once a second and after commands.
    pub status: Option<StationStatus>,
}

/// Sent once a second and after commands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StationStatus {
    pub robots: Vec<RobotStatus>,
    pub parameters: Vec<ParameterValue>,
    pub recording: Option<String>,
    /// Ids of sensors of the first robot.
    pub switched_off: Vec<u8>,
    /// Whether filters run beside the one that sends.
    pub is_comparing: bool,
    /// `None` without a simulated brick.
    pub simulator: Option<SimulatorNow>,
    /// The steps of each robot, or of the robot that has not been heard yet.
    pub setup: Vec<SetupRow>,
    /// How often the station loop stood still for longer than a second.
    pub loop_stalls: u64,
}

/// Geometry, calibration and disabled sensors of a robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotStatus {
    pub robot: RobotId,
    /// `None` if only its other parts are known.
    pub geometry: Option<DriveGeometry>,
    pub calibration: Vec<CalibrationRow>,
    pub switched_off: Vec<u8>,
}

/// The true pose of a simulated robot at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedTruth {
    /// `None` where the station has one simulated brick.
    pub robot: Option<RobotId>,
    /// By the host's clock.
    pub now: Timestamp<HostClock>,
    /// By the brick's clock, as in estimates.
    pub time: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// Of the brick's own dead reckoning.
    pub odometry: Option<Pose<Arena>>,
}

/// Sends events to the dashboard and never waits: a batch that does not fit is dropped and counted.
#[derive(Debug)]
pub struct EventFeed {
    sender: Sender<EventBatch>,
    counts: Arc<ServerCounters>,
    backlog: Arc<Notify>,
}

#[derive(Debug)]
pub(crate) struct EventBatches {
    receiver: Receiver<EventBatch>,
    backlog_notify: Arc<Notify>,
}

impl EventBatches {
    pub(crate) fn try_recv(&mut self) -> Result<EventBatch, TryRecvError> {
        self.receiver.try_recv()
    }

    /// Returns when the backlog is long.
    pub(crate) async fn backlog(&self) {
        self.backlog_notify.notified().await;
    }
}

impl EventFeed {
    /// Both ends. Tokio's channel allocates for waiting batches only; the standard library's would allocate all
    /// [`MAX_WAITING_BATCHES`].
    pub(crate) fn pair(counts: Arc<ServerCounters>) -> (Self, EventBatches) {
        let (sender, receiver) = mpsc::channel(MAX_WAITING_BATCHES);
        let backlog_notify = Arc::new(Notify::new());
        let batches = EventBatches { receiver, backlog_notify: Arc::clone(&backlog_notify) };
        let feed = Self { sender, counts, backlog: backlog_notify };
        (feed, batches)
    }

    /// Sends the results of an input. The reader polls, so this wakes it only if the backlog is long.
    pub fn publish(&self, batch: EventBatch) {
        let is_for_viewers = |event: &&Event| event.is_for_viewers();
        let lost = batch.events.iter().filter(is_for_viewers).count() as u64;
        if lost > 0 || batch.status.is_some() {
            let is_sent = self.sender.try_send(batch).is_ok();
            if !is_sent {
                self.counts.add(ServerCounter::EventsDropped, lost.max(1));
            }
            if self.sender.capacity() == MAX_WAITING_BATCHES - BACKLOG_THRESHOLD {
                self.backlog.notify_one();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::pin::pin;
    use std::task::{Context, Waker};

    use super::*;
    use posebridge_telemetry::Address;

    fn batch_of_two() -> EventBatch {
        let event = Event::Text { source: Address::new(1, 1), severity: 6, text: String::new() };
        EventBatch {
            now: Timestamp::ZERO,
            latency: TimeDelta::ZERO,
            events: Arc::from([event.clone(), event]),
            status: None,
        }
    }

    #[test]
    fn a_crowd_wakes_the_reader_and_fewer_do_not() {
        let (feed, receiver) = EventFeed::pair(Arc::default());
        let mut backlog = pin!(receiver.backlog());
        let mut context = Context::from_waker(Waker::noop());
        for _ in 1..BACKLOG_THRESHOLD {
            feed.publish(batch_of_two());
            assert!(backlog.as_mut().poll(&mut context).is_pending());
        }
        feed.publish(batch_of_two());
        assert!(backlog.as_mut().poll(&mut context).is_ready());
    }

    #[test]
    fn a_reader_that_hangs_costs_events_and_they_are_counted() {
        let counts = Arc::new(ServerCounters::default());
        let (feed, mut receiver) = EventFeed::pair(Arc::clone(&counts));
        for _ in 0..MAX_WAITING_BATCHES + 7 {
            feed.publish(batch_of_two());
        }
        assert_eq!(counts.value(ServerCounter::EventsDropped), 14);
        let batches = std::iter::from_fn(|| receiver.try_recv().ok());
        assert_eq!(batches.count(), MAX_WAITING_BATCHES);
    }
}
