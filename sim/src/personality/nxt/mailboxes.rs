//! The message queues between a station and the program on the brick.
//!
//! 0 to 9 are the program's inboxes, 10 to 19 its outboxes. Each holds five messages; the sixth pushes the oldest out. A message ends with a
//! zero byte, which counts as a part of it; zeros before it are welcome.

use std::collections::VecDeque;

use super::status;

/// Number of queues.
const QUEUES: usize = 20;
/// Messages that a queue holds.
const DEPTH: usize = 5;
/// Longest message with its final zero, in bytes.
pub(super) const MAX_MESSAGE_BYTES: usize = 59;

/// All queues.
#[derive(Clone, Debug, Default)]
pub(super) struct Mailboxes {
    queues: [VecDeque<Vec<u8>>; QUEUES],
}

impl Mailboxes {
    /// Adds a message, `size` bytes long by its sender's word.
    pub(super) fn write(&mut self, queue: u8, size: u8, message: &[u8]) -> Result<(), u8> {
        let queue = self.queues.get_mut(usize::from(queue)).ok_or(status::ILLEGAL_MAILBOX)?;
        if message.len() != usize::from(size) || message.len() > MAX_MESSAGE_BYTES {
            return Err(status::ILLEGAL_SIZE);
        }
        if message.last() != Some(&0) {
            return Err(status::OUT_OF_RANGE);
        }
        if queue.len() >= DEPTH {
            queue.pop_front();
        }
        queue.push_back(message.to_vec());
        Ok(())
    }

    /// The oldest message, its final zero included.
    pub(super) fn oldest(&self, queue: u8) -> Result<&[u8], u8> {
        let queue = self.queues.get(usize::from(queue)).ok_or(status::ILLEGAL_MAILBOX)?;
        queue.front().map(Vec::as_slice).ok_or(status::MAILBOX_EMPTY)
    }

    /// Takes the oldest message out.
    pub(super) fn pop(&mut self, queue: u8) -> Option<Vec<u8>> {
        self.queues.get_mut(usize::from(queue))?.pop_front()
    }

    /// Empties all queues.
    pub(super) fn clear(&mut self) {
        self.queues.iter_mut().for_each(VecDeque::clear);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sixth_message_pushes_the_oldest_out() {
        let mut boxes = Mailboxes::default();
        for number in 1..=6 {
            boxes.write(3, 2, &[number, 0]).unwrap();
        }
        let taken: Vec<_> = std::iter::from_fn(|| boxes.pop(3)).collect();
        assert_eq!(taken, [2, 3, 4, 5, 6].map(|number| vec![number, 0]));
        assert_eq!(boxes.oldest(3), Err(status::MAILBOX_EMPTY));
    }

    #[test]
    fn what_is_no_message_is_refused() {
        let mut boxes = Mailboxes::default();
        assert_eq!(boxes.write(20, 1, &[0]), Err(status::ILLEGAL_MAILBOX));
        assert_eq!(boxes.write(0, 3, &[1, 0]), Err(status::ILLEGAL_SIZE));
        assert_eq!(boxes.write(0, 60, &[0; 60]), Err(status::ILLEGAL_SIZE));
        assert_eq!(boxes.write(0, 2, &[1, 2]), Err(status::OUT_OF_RANGE));
        assert_eq!(boxes.write(0, 59, &[0; 59]), Ok(()));
    }
}
