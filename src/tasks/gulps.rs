//! Receives in gulps, so that whoever sends need not wake anybody.
//!
//! To wake a thread that waits on a channel costs the sender a call of the system, and the woken thread takes a core just when the
//! next telemetry may come. A thread that may be a little late therefore naps before it looks again, and waits on the channel only
//! when nothing has come in the meantime: under steady telemetry the shard's sends then only store.

use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::Duration;

/// A nap: below what an eye sees, and the queues of recorder and observer hold far more than comes in it.
const NAP: Duration = Duration::from_millis(10);

/// The receiving end of a channel, emptied in gulps.
pub(super) struct Gulps<T> {
    receiver: Receiver<T>,
    /// It was empty a nap ago.
    has_napped: bool,
}

impl<T> Gulps<T> {
    /// Over the receiving end of a channel.
    pub(super) const fn new(receiver: Receiver<T>) -> Self {
        Self {
            receiver,
            has_napped: false,
        }
    }

    /// The next item, oldest first; waits for it no longer than `patience` after a nap.
    ///
    /// # Errors
    /// Nothing came for so long, or all senders are gone and everything has been received.
    pub(super) fn next(&mut self, patience: Duration) -> Result<T, RecvTimeoutError> {
        loop {
            match self.receiver.try_recv() {
                Ok(item) => {
                    self.has_napped = false;
                    return Ok(item);
                }
                Err(TryRecvError::Disconnected) => return Err(RecvTimeoutError::Disconnected),
                Err(TryRecvError::Empty) if !self.has_napped => {
                    self.has_napped = true;
                    std::thread::park_timeout(NAP);
                }
                Err(TryRecvError::Empty) => {
                    let received = self.receiver.recv_timeout(patience);
                    self.has_napped = received.is_err();
                    return received;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    #[test]
    fn everything_comes_in_order_and_the_end_after_it() {
        let (sender, receiver) = sync_channel(100);
        let sending = std::thread::spawn(move || (0..1_000).try_for_each(|i| sender.send(i)));
        let mut gulps = Gulps::new(receiver);
        let patience = Duration::from_secs(60);
        let received: Vec<i32> = std::iter::from_fn(|| gulps.next(patience).ok()).collect();
        assert_eq!(received, (0..1_000).collect::<Vec<_>>());
        assert_eq!(gulps.next(patience), Err(RecvTimeoutError::Disconnected));
        assert!(sending.join().unwrap().is_ok());
    }

    #[test]
    fn patience_ends_while_somebody_could_still_send() {
        let (_sender, receiver) = sync_channel::<i32>(1);
        let mut gulps = Gulps::new(receiver);
        for _ in 0..3 {
            assert_eq!(
                gulps.next(Duration::from_millis(1)),
                Err(RecvTimeoutError::Timeout)
            );
        }
    }
}
