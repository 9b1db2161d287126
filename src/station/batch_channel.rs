//! A channel that is received in batches, so that the sender need not wake the receiver.
//!
//! To wake a thread that waits on a channel costs the sender a call of the system, and the woken thread takes a core just when the
//! next telemetry may come. A thread that may be a little late therefore naps before it looks again, and waits on the channel only
//! when nothing has come in the meantime: under steady telemetry the station loop's sends then only store.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SendError, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;
use std::time::Duration;

/// A nap: below what an eye sees, and the queues of recorder and observer hold far more than comes in it.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// When so many wait the reader is woken from its nap: what a stall has held back comes within a few milliseconds, and all of it would
/// be in memory at once.
const WAKE_BACKLOG: usize = 64;

/// What both ends know.
#[derive(Debug, Default)]
struct BatchChannelState {
    backlog: AtomicUsize,
    /// Whoever reads, from its first look on.
    reader: OnceLock<Thread>,
}

/// The sending end of such a channel.
#[derive(Debug)]
pub(super) struct BatchSender<T> {
    sender: SyncSender<T>,
    shared: Arc<BatchChannelState>,
}

/// The receiving end of a channel, emptied in batches.
pub(super) struct BatchReceiver<T> {
    receiver: Receiver<T>,
    shared: Arc<BatchChannelState>,
    poll_interval: Duration,
    /// It was empty a nap ago.
    has_polled_empty: bool,
}

/// A channel in which at most so many items wait.
pub(super) fn channel<T>(places: usize) -> (BatchSender<T>, BatchReceiver<T>) {
    let (sender, receiver) = sync_channel(places);
    let shared = Arc::new(BatchChannelState::default());
    let receiver =
        BatchReceiver { receiver, shared: Arc::clone(&shared), poll_interval: POLL_INTERVAL, has_polled_empty: false };
    (BatchSender { sender, shared }, receiver)
}

impl<T> BatchSender<T> {
    /// Sends without waiting.
    ///
    /// # Errors
    /// There is no room, or nobody who reads.
    pub(super) fn try_send(&self, item: T) -> Result<(), TrySendError<T>> {
        self.send_counted(|| self.sender.try_send(item))
    }

    /// Sends when there is room.
    ///
    /// # Errors
    /// Nobody reads any more.
    pub(super) fn send(&self, item: T) -> Result<(), SendError<T>> {
        self.send_counted(|| self.sender.send(item))
    }

    /// How many wait.
    pub(super) fn backlog(&self) -> usize {
        self.shared.backlog.load(Ordering::Relaxed)
    }

    /// Counted before it is sent: the reader may count it out at once.
    fn send_counted<E>(&self, send: impl FnOnce() -> Result<(), E>) -> Result<(), E> {
        let waiting = self.shared.backlog.fetch_add(1, Ordering::Relaxed);
        if waiting + 1 == WAKE_BACKLOG
            && let Some(reader) = self.shared.reader.get()
        {
            reader.unpark();
        }
        let sent = send();
        if sent.is_err() {
            self.shared.backlog.fetch_sub(1, Ordering::Relaxed);
        }
        sent
    }
}

impl<T> BatchReceiver<T> {
    /// The next item, oldest first; waits for it no longer than `patience` after a nap.
    ///
    /// # Errors
    /// Nothing came for so long, or all senders are gone and everything has been received.
    pub(super) fn recv(&mut self, patience: Duration) -> Result<T, RecvTimeoutError> {
        self.shared.reader.get_or_init(std::thread::current);
        loop {
            match self.receiver.try_recv() {
                Ok(item) => {
                    self.has_polled_empty = false;
                    return Ok(self.receive_counted(item));
                }
                Err(TryRecvError::Disconnected) => return Err(RecvTimeoutError::Disconnected),
                Err(TryRecvError::Empty) if !self.has_polled_empty => {
                    self.has_polled_empty = true;
                    std::thread::park_timeout(self.poll_interval);
                }
                Err(TryRecvError::Empty) => {
                    let received = self.receiver.recv_timeout(patience);
                    self.has_polled_empty = received.is_err();
                    return received.map(|item| self.receive_counted(item));
                }
            }
        }
    }

    fn receive_counted(&self, item: T) -> T {
        self.shared.backlog.fetch_sub(1, Ordering::Relaxed);
        item
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_comes_in_order_and_the_end_after_it() {
        let (sender, mut receiver) = channel(100);
        let sending = std::thread::spawn(move || (0..1_000).try_for_each(|i| sender.send(i)));
        let patience = Duration::from_secs(60);
        let received: Vec<i32> = std::iter::from_fn(|| receiver.recv(patience).ok()).collect();
        assert_eq!(received, (0..1_000).collect::<Vec<_>>());
        assert_eq!(receiver.recv(patience), Err(RecvTimeoutError::Disconnected));
        assert!(sending.join().unwrap().is_ok());
    }

    #[test]
    fn patience_ends_while_somebody_could_still_send() {
        let (_sender, mut receiver) = channel::<i32>(1);
        for _ in 0..3 {
            assert_eq!(receiver.recv(Duration::from_millis(1)), Err(RecvTimeoutError::Timeout));
        }
    }

    #[test]
    fn what_waits_is_counted() {
        let (sender, mut receiver) = channel(2 * WAKE_BACKLOG);
        for item in 0..2 * WAKE_BACKLOG {
            assert_eq!(sender.backlog(), item);
            sender.try_send(item).unwrap();
        }
        assert!(sender.try_send(0).is_err());
        assert_eq!(sender.backlog(), 2 * WAKE_BACKLOG);
        let received = std::iter::from_fn(|| receiver.recv(Duration::ZERO).ok());
        assert_eq!(received.count(), 2 * WAKE_BACKLOG);
        assert_eq!(sender.backlog(), 0);
        drop(receiver);
        assert!(sender.send(0).is_err());
        assert_eq!(sender.backlog(), 0);
    }

    #[test]
    fn a_crowd_ends_a_nap() {
        let (signal, awake) = sync_channel(1);
        // Who is woken before the nap begins does not nap at all: so the order of two threads does not matter.
        let reading = std::thread::spawn(move || {
            let (sender, mut receiver) = channel(WAKE_BACKLOG);
            let nothing = Err(RecvTimeoutError::Timeout);
            assert_eq!(receiver.recv(Duration::ZERO), nothing, "known from now on");
            for item in 0..WAKE_BACKLOG {
                sender.try_send(item).unwrap();
            }
            for item in 0..WAKE_BACKLOG {
                assert_eq!(receiver.recv(Duration::ZERO), Ok(item));
            }
            receiver.poll_interval = Duration::from_secs(3_600);
            assert_eq!(receiver.recv(Duration::ZERO), nothing);
            signal.send(()).unwrap();
        });
        let is_awake = awake.recv_timeout(Duration::from_secs(60));
        assert!(is_awake.is_ok(), "{:?}", reading.is_finished());
        reading.join().unwrap();
    }
}
