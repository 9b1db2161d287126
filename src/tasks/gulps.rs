//! Receives in gulps, so that whoever sends need not wake anybody.
//!
//! To wake a thread that waits on a channel costs the sender a call of the system, and the woken thread takes a core just when the
//! next telemetry may come. A thread that may be a little late therefore naps before it looks again, and waits on the channel only
//! when nothing has come in the meantime: under steady telemetry the shard's sends then only store.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SendError, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;
use std::time::Duration;

/// A nap: below what an eye sees, and the queues of recorder and observer hold far more than comes in it.
const NAP: Duration = Duration::from_millis(10);

/// When so many wait the reader is woken from its nap: what a stall has held back comes within a few milliseconds, and all of it would
/// be in memory at once.
const CROWDED: usize = 64;

/// What both ends know.
#[derive(Debug, Default)]
struct Shared {
    waiting: AtomicUsize,
    /// Whoever reads, from its first look on.
    reader: OnceLock<Thread>,
}

/// The sending end of such a channel.
#[derive(Debug)]
pub(super) struct Sender<T> {
    sender: SyncSender<T>,
    shared: Arc<Shared>,
}

/// The receiving end of a channel, emptied in gulps.
pub(super) struct Gulps<T> {
    receiver: Receiver<T>,
    shared: Arc<Shared>,
    nap: Duration,
    /// It was empty a nap ago.
    has_napped: bool,
}

/// A channel in which at most so many items wait.
pub(super) fn channel<T>(places: usize) -> (Sender<T>, Gulps<T>) {
    let (sender, receiver) = sync_channel(places);
    let shared = Arc::new(Shared::default());
    let gulps = Gulps { receiver, shared: Arc::clone(&shared), nap: NAP, has_napped: false };
    (Sender { sender, shared }, gulps)
}

impl<T> Sender<T> {
    /// Sends without waiting.
    ///
    /// # Errors
    /// There is no room, or nobody who reads.
    pub(super) fn try_send(&self, item: T) -> Result<(), TrySendError<T>> {
        self.counted_in(|| self.sender.try_send(item))
    }

    /// Sends when there is room.
    ///
    /// # Errors
    /// Nobody reads any more.
    pub(super) fn send(&self, item: T) -> Result<(), SendError<T>> {
        self.counted_in(|| self.sender.send(item))
    }

    /// How many wait.
    pub(super) fn waiting(&self) -> usize {
        self.shared.waiting.load(Ordering::Relaxed)
    }

    /// Counted before it is sent: the reader may count it out at once.
    fn counted_in<E>(&self, send: impl FnOnce() -> Result<(), E>) -> Result<(), E> {
        let waiting = self.shared.waiting.fetch_add(1, Ordering::Relaxed);
        if waiting + 1 == CROWDED
            && let Some(reader) = self.shared.reader.get()
        {
            reader.unpark();
        }
        let sent = send();
        if sent.is_err() {
            self.shared.waiting.fetch_sub(1, Ordering::Relaxed);
        }
        sent
    }
}

impl<T> Gulps<T> {
    /// The next item, oldest first; waits for it no longer than `patience` after a nap.
    ///
    /// # Errors
    /// Nothing came for so long, or all senders are gone and everything has been received.
    pub(super) fn next(&mut self, patience: Duration) -> Result<T, RecvTimeoutError> {
        self.shared.reader.get_or_init(std::thread::current);
        loop {
            match self.receiver.try_recv() {
                Ok(item) => {
                    self.has_napped = false;
                    return Ok(self.counted_out(item));
                }
                Err(TryRecvError::Disconnected) => return Err(RecvTimeoutError::Disconnected),
                Err(TryRecvError::Empty) if !self.has_napped => {
                    self.has_napped = true;
                    std::thread::park_timeout(self.nap);
                }
                Err(TryRecvError::Empty) => {
                    let received = self.receiver.recv_timeout(patience);
                    self.has_napped = received.is_err();
                    return received.map(|item| self.counted_out(item));
                }
            }
        }
    }

    fn counted_out(&self, item: T) -> T {
        self.shared.waiting.fetch_sub(1, Ordering::Relaxed);
        item
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_comes_in_order_and_the_end_after_it() {
        let (sender, mut gulps) = channel(100);
        let sending = std::thread::spawn(move || (0..1_000).try_for_each(|i| sender.send(i)));
        let patience = Duration::from_secs(60);
        let received: Vec<i32> = std::iter::from_fn(|| gulps.next(patience).ok()).collect();
        assert_eq!(received, (0..1_000).collect::<Vec<_>>());
        assert_eq!(gulps.next(patience), Err(RecvTimeoutError::Disconnected));
        assert!(sending.join().unwrap().is_ok());
    }

    #[test]
    fn patience_ends_while_somebody_could_still_send() {
        let (_sender, mut gulps) = channel::<i32>(1);
        for _ in 0..3 {
            assert_eq!(gulps.next(Duration::from_millis(1)), Err(RecvTimeoutError::Timeout));
        }
    }

    #[test]
    fn what_waits_is_counted() {
        let (sender, mut gulps) = channel(2 * CROWDED);
        for item in 0..2 * CROWDED {
            assert_eq!(sender.waiting(), item);
            sender.try_send(item).unwrap();
        }
        assert!(sender.try_send(0).is_err());
        assert_eq!(sender.waiting(), 2 * CROWDED);
        let received = std::iter::from_fn(|| gulps.next(Duration::ZERO).ok());
        assert_eq!(received.count(), 2 * CROWDED);
        assert_eq!(sender.waiting(), 0);
        drop(gulps);
        assert!(sender.send(0).is_err());
        assert_eq!(sender.waiting(), 0);
    }

    #[test]
    fn a_crowd_ends_a_nap() {
        let (tell, told) = sync_channel(1);
        // Who is woken before the nap begins does not nap at all: so the order of two threads does not matter.
        let reading = std::thread::spawn(move || {
            let (sender, mut gulps) = channel(CROWDED);
            let nothing = Err(RecvTimeoutError::Timeout);
            assert_eq!(gulps.next(Duration::ZERO), nothing, "known from now on");
            for item in 0..CROWDED {
                sender.try_send(item).unwrap();
            }
            for item in 0..CROWDED {
                assert_eq!(gulps.next(Duration::ZERO), Ok(item));
            }
            gulps.nap = Duration::from_secs(3_600);
            assert_eq!(gulps.next(Duration::ZERO), nothing);
            tell.send(()).unwrap();
        });
        let is_awake = told.recv_timeout(Duration::from_secs(60));
        assert!(is_awake.is_ok(), "{:?}", reading.is_finished());
        reading.join().unwrap();
    }
}
