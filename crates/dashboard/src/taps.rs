//! Readers in this process, such as the terminal view: the messages of the page as values, and commands back.
//!
//! The hub makes one attempt to send a message to each reader and never waits. A message that does not fit is dropped
//! and counted: a reader that hangs misses messages and delays nobody.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};

use posebridge_telemetry::{Command, Input, RobotId};
use tokio::sync::mpsc;

use crate::counters::{ServerCounter, ServerCounters};
use crate::model::Frame;

/// The sending ends, owned by the hub.
#[derive(Debug, Default)]
pub struct FrameTaps {
    senders: Vec<TapSender>,
}

#[derive(Debug)]
struct TapSender {
    frames: SyncSender<Arc<Frame>>,
    missed: Arc<AtomicU64>,
}

/// The receiving end of a reader.
#[derive(Debug)]
pub struct FrameTap {
    frames: Receiver<Arc<Frame>>,
    missed: Arc<AtomicU64>,
}

/// The result of polling a `FrameTap`.
#[derive(Clone, Debug, PartialEq)]
pub enum TapPoll {
    Frame(Arc<Frame>),
    Empty,
    /// The station is stopping.
    Closed,
}

impl FrameTaps {
    /// `capacity` is in messages; there are up to fifty a second.
    pub fn add(&mut self, capacity: usize) -> FrameTap {
        let (sender, receiver) = sync_channel(capacity);
        let missed = Arc::new(AtomicU64::new(0));
        self.senders.push(TapSender { frames: sender, missed: Arc::clone(&missed) });
        FrameTap { frames: receiver, missed }
    }

    pub const fn is_empty(&self) -> bool {
        self.senders.is_empty()
    }

    /// Returns how many readers had a full queue.
    pub(crate) fn send(&mut self, frame: &Arc<Frame>) -> u64 {
        let mut missed = 0;
        self.senders.retain(|sender| match sender.frames.try_send(Arc::clone(frame)) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                sender.missed.fetch_add(1, Ordering::Relaxed);
                missed += 1;
                true
            }
            Err(TrySendError::Disconnected(_)) => false,
        });
        missed
    }
}

impl FrameTap {
    /// Blocks; `None` when the station stops.
    pub fn recv(&self) -> Option<Arc<Frame>> {
        self.frames.recv().ok()
    }

    pub fn try_recv(&self) -> TapPoll {
        match self.frames.try_recv() {
            Ok(frame) => TapPoll::Frame(frame),
            Err(TryRecvError::Empty) => TapPoll::Empty,
            Err(TryRecvError::Disconnected) => TapPoll::Closed,
        }
    }

    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
}

/// Sends commands of this process to the station.
#[derive(Clone, Debug)]
pub struct CommandSubmitter {
    pub(crate) commands: mpsc::Sender<Input>,
    pub(crate) counts: Arc<ServerCounters>,
}

impl CommandSubmitter {
    /// `robot` is `None` for a command that names no robot. Never blocks; false if the queue is full or the station is stopping.
    pub fn send(&self, robot: Option<RobotId>, command: Command) -> bool {
        let input = robot.map_or(Input::Command(command), |robot| Input::RobotCommand { robot, command });
        self.submit(input).is_ok()
    }

    /// Never blocks.
    ///
    /// # Errors
    /// Why not, for people.
    pub(crate) fn submit(&self, input: Input) -> Result<(), &'static str> {
        match self.commands.try_send(input) {
            Ok(()) => {
                self.counts.increment(ServerCounter::Commands);
                Ok(())
            }
            Err(mpsc::error::TrySendError::Full(_)) => {
                self.counts.increment(ServerCounter::CommandsFull);
                Err("too many commands wait; try again")
            }
            Err(mpsc::error::TrySendError::Closed(_)) => Err("the station is ending"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(now_s: f64) -> Arc<Frame> {
        Arc::new(Frame { now_s, ..Frame::default() })
    }

    #[test]
    fn a_reader_that_hangs_misses_messages_and_the_others_do_not() {
        let mut taps = FrameTaps::default();
        assert!(taps.is_empty());
        let hanging = taps.add(2);
        let quick = taps.add(2);
        let mut received = 0;
        let mut missed = 0;
        for step in 0..10 {
            missed += taps.send(&frame(f64::from(step)));
            while let TapPoll::Frame(_) = quick.try_recv() {
                received += 1;
            }
        }
        assert_eq!((received, quick.missed()), (10, 0));
        assert_eq!((missed, hanging.missed()), (8, 8));
        assert_eq!(hanging.recv().unwrap().now_s, 0.0);
        drop(quick);
        drop(taps);
        assert_eq!(hanging.try_recv(), TapPoll::Frame(frame(1.0)));
        assert_eq!(hanging.try_recv(), TapPoll::Closed);
    }

    #[test]
    fn a_reader_that_is_gone_is_forgotten_and_not_counted() {
        let mut taps = FrameTaps::default();
        drop(taps.add(1));
        assert_eq!(taps.send(&frame(0.0)), 0);
        assert!(taps.is_empty());
    }
}
