//! Readers in this process: the same messages as those of the page, as values.
//!
//! The hub makes one attempt to hand a message to each reader and never waits for it. What finds no room is dropped and counted: a
//! reader that hangs misses messages and slows nobody.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};

use crate::model::Frame;

/// The hub's ends of the channels to readers in this process.
#[derive(Debug, Default)]
pub struct Taps {
    senders: Vec<Sender>,
}

#[derive(Debug)]
struct Sender {
    frames: SyncSender<Arc<Frame>>,
    missed: Arc<AtomicU64>,
}

/// A reader's end.
#[derive(Debug)]
pub struct FrameTap {
    frames: Receiver<Arc<Frame>>,
    missed: Arc<AtomicU64>,
}

/// What a reader that does not wait has found.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// A message.
    Frame(Arc<Frame>),
    /// Nothing for now.
    Nothing,
    /// Nothing ever again: the station is ending.
    End,
}

impl Taps {
    /// A new reader, behind whom so many messages may wait; there are up to fifty a second.
    pub fn add(&mut self, waiting: usize) -> FrameTap {
        let (sender, receiver) = sync_channel(waiting);
        let missed = Arc::new(AtomicU64::new(0));
        self.senders.push(Sender { frames: sender, missed: Arc::clone(&missed) });
        FrameTap { frames: receiver, missed }
    }

    /// Whether nobody reads.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.senders.is_empty()
    }

    /// Hands a message to everybody who has room for it; gives how many had none.
    pub(crate) fn tell(&mut self, frame: &Arc<Frame>) -> u64 {
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
    /// The next message; waits for it. `None` when the station ends.
    #[must_use]
    pub fn wait(&self) -> Option<Arc<Frame>> {
        self.frames.recv().ok()
    }

    /// The next message, if there is one.
    #[must_use]
    pub fn look(&self) -> Found {
        match self.frames.try_recv() {
            Ok(frame) => Found::Frame(frame),
            Err(TryRecvError::Empty) => Found::Nothing,
            Err(TryRecvError::Disconnected) => Found::End,
        }
    }

    /// So many messages were missed because this reader was slow.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
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
        let mut taps = Taps::default();
        assert!(taps.is_empty());
        let hanging = taps.add(2);
        let quick = taps.add(2);
        let mut heard = 0;
        let mut missed = 0;
        for step in 0..10 {
            missed += taps.tell(&frame(f64::from(step)));
            while let Found::Frame(_) = quick.look() {
                heard += 1;
            }
        }
        assert_eq!((heard, quick.missed()), (10, 0));
        assert_eq!((missed, hanging.missed()), (8, 8));
        assert_eq!(hanging.wait().unwrap().now_s, 0.0);
        drop(quick);
        drop(taps);
        assert_eq!(hanging.look(), Found::Frame(frame(1.0)));
        assert_eq!(hanging.look(), Found::End);
    }

    #[test]
    fn a_reader_that_is_gone_is_forgotten_and_not_counted() {
        let mut taps = Taps::default();
        drop(taps.add(1));
        assert_eq!(taps.tell(&frame(0.0)), 0);
        assert!(taps.is_empty());
    }
}
