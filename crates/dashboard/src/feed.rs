//! The shard's end of the channel to the dashboard.

use std::sync::Arc;

use posebridge_telemetry::{Arena, BrickClock, Event, HostClock, Pose, Span, Stamp};
use tokio::sync::Notify;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::mpsc::{self, Receiver, Sender};

use crate::counts::{Count, Counts};
use crate::model::{CalibrationRow, ParameterValue, SimulatorNow};

/// So many batches wait before they are dropped and counted: half a minute of a brick that sends 200 times a second. The reader
/// looks fifty times a second.
const WAITING: usize = 6_000;
/// When so many wait the reader is woken: what a stall has held back comes within a few milliseconds, and all of it would be in memory
/// at once.
const CROWDED: usize = 64;

/// What one input has led to.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// When the input was given to the pipeline.
    pub now: Stamp<HostClock>,
    /// From its arrival until everything that it led to was handed to the links.
    pub took: Span,
    /// What happened, as everybody is told who watches or records.
    pub events: Arc<[Event]>,
    /// What stands, now and then.
    pub standing: Option<Standing>,
}

/// What holds until something else is said; told once a second and after commands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Standing {
    /// What was learned about it.
    pub calibration: Vec<CalibrationRow>,
    /// All tunables.
    pub parameters: Vec<ParameterValue>,
    /// The file that is being recorded into.
    pub recording: Option<String>,
    /// The numbers of the sources that are left out.
    pub switched_off: Vec<u8>,
    /// How the simulated brick was set last, if there is one.
    pub simulator: Option<SimulatorNow>,
}

/// Where the simulated robot was at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// When, by the host's clock.
    pub now: Stamp<HostClock>,
    /// When, by the brick's clock, as estimates are stamped.
    pub stamp: Stamp<BrickClock>,
    /// Where it was.
    pub pose: Pose<Arena>,
    /// Where the brick's own dead reckoning believed it to be.
    pub odometry: Option<Pose<Arena>>,
}

/// Tells the dashboard what happens, and never waits for it: what finds no room is dropped and counted.
#[derive(Debug)]
pub struct Feed {
    sender: Sender<Batch>,
    counts: Arc<Counts>,
    crowd: Arc<Notify>,
}

/// The reader's end of it.
#[derive(Debug)]
pub(crate) struct Batches {
    receiver: Receiver<Batch>,
    crowd: Arc<Notify>,
}

impl Batches {
    /// The next one, if there is one.
    pub(crate) fn try_recv(&mut self) -> Result<Batch, TryRecvError> {
        self.receiver.try_recv()
    }

    /// Until more wait than should.
    pub(crate) async fn crowd(&self) {
        self.crowd.notified().await;
    }
}

impl Feed {
    /// The two ends. Tokio's channel has memory for what waits; the standard library's would come to use room for all [`WAITING`].
    pub(crate) fn pair(counts: Arc<Counts>) -> (Self, Batches) {
        let (sender, receiver) = mpsc::channel(WAITING);
        let crowd = Arc::new(Notify::new());
        let batches = Batches { receiver, crowd: Arc::clone(&crowd) };
        let feed = Self { sender, counts, crowd };
        (feed, batches)
    }

    /// Tells what an input has led to. Whoever reads looks by itself: this only stores, and wakes nobody unless there is a crowd.
    pub fn tell(&self, batch: Batch) {
        let wanted = |event: &&Event| event.is_for_viewers();
        let lost = batch.events.iter().filter(wanted).count() as u64;
        if lost > 0 || batch.standing.is_some() {
            let is_told = self.sender.try_send(batch).is_ok();
            if !is_told {
                self.counts.add(Count::EventsDropped, lost.max(1));
            }
            if self.sender.capacity() == WAITING - CROWDED {
                self.crowd.notify_one();
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

    fn batch_of_two() -> Batch {
        let event = Event::Text { source: Address::new(1, 1), severity: 6, text: String::new() };
        Batch { now: Stamp::ZERO, took: Span::ZERO, events: Arc::from([event.clone(), event]), standing: None }
    }

    #[test]
    fn a_crowd_wakes_the_reader_and_fewer_do_not() {
        let (feed, receiver) = Feed::pair(Arc::default());
        let mut crowd = pin!(receiver.crowd());
        let mut context = Context::from_waker(Waker::noop());
        for _ in 1..CROWDED {
            feed.tell(batch_of_two());
            assert!(crowd.as_mut().poll(&mut context).is_pending());
        }
        feed.tell(batch_of_two());
        assert!(crowd.as_mut().poll(&mut context).is_ready());
    }

    #[test]
    fn a_reader_that_hangs_costs_events_and_they_are_counted() {
        let counts = Arc::new(Counts::default());
        let (feed, mut receiver) = Feed::pair(Arc::clone(&counts));
        for _ in 0..WAITING + 7 {
            feed.tell(batch_of_two());
        }
        assert_eq!(counts.of(Count::EventsDropped), 14);
        let told = std::iter::from_fn(|| receiver.try_recv().ok());
        assert_eq!(told.count(), WAITING);
    }
}
