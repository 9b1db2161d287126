//! Frames that the operating system did not take yet.
//!
//! Bounded, in whole frames: when it is full the oldest frame goes, because an old estimate is worth less than a new
//! one. A frame of which a part has been written is never dropped: the rest of it would look like damage to the peer.
//! It writes nothing itself.

use std::collections::VecDeque;

/// Frames waiting to be written, each with its destination `D`.
#[derive(Debug)]
pub(crate) struct SendQueue<D> {
    frames: VecDeque<(D, Vec<u8>)>,
    /// Bytes of the head frame that are already written.
    head_sent: usize,
    /// The head frame has to be finished, whatever happens.
    is_head_begun: bool,
    /// Unwritten bytes in all frames.
    bytes: usize,
    limit_bytes: usize,
}

impl<D> SendQueue<D> {
    /// An empty queue that holds at most `limit_bytes`, the rest of a begun frame aside.
    pub(crate) const fn new(limit_bytes: usize) -> Self {
        Self {
            frames: VecDeque::new(),
            head_sent: 0,
            is_head_begun: false,
            bytes: 0,
            limit_bytes,
        }
    }

    /// True if nothing waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// How many frames wait, a begun one included.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// Adds a frame of which nothing has been written and returns how many frames had to go for it; the frame itself
    /// goes if it cannot fit.
    pub(crate) fn push(&mut self, to: D, frame: &[u8]) -> u64 {
        let kept = usize::from(self.is_head_begun);
        let begun_bytes = if self.is_head_begun {
            self.head().map_or(0, |(_, rest)| rest.len())
        } else {
            0
        };
        if begun_bytes + frame.len() > self.limit_bytes {
            return 1;
        }
        let mut dropped = 0;
        while self.bytes + frame.len() > self.limit_bytes {
            match self.frames.remove(kept) {
                Some((_, old)) => self.bytes -= old.len(),
                None => break,
            }
            dropped += 1;
        }
        self.bytes += frame.len();
        self.frames.push_back((to, frame.to_vec()));
        dropped
    }

    /// Adds the unwritten end of a frame, to an empty queue. It is never dropped.
    pub(crate) fn push_rest(&mut self, to: D, rest: &[u8]) {
        debug_assert!(
            self.frames.is_empty(),
            "a frame is begun only when none waits"
        );
        self.bytes += rest.len();
        self.is_head_begun = true;
        self.frames.push_back((to, rest.to_vec()));
    }

    /// The frame to write next: its destination and its unwritten bytes.
    pub(crate) fn head(&self) -> Option<(&D, &[u8])> {
        self.frames
            .front()
            .map(|(to, frame)| (to, frame.get(self.head_sent..).unwrap_or_default()))
    }

    /// Notes that `count` bytes of the head frame have been written.
    pub(crate) fn advance(&mut self, count: usize) {
        let Some(rest) = self.head().map(|(_, rest)| rest.len()) else {
            return;
        };
        let count = count.min(rest);
        self.bytes -= count;
        if count == rest {
            self.frames.pop_front();
            self.head_sent = 0;
            self.is_head_begun = false;
        } else {
            self.head_sent += count;
            self.is_head_begun |= count > 0;
        }
    }

    /// Drops the head frame, begun or not.
    pub(crate) fn drop_head(&mut self) {
        self.advance(usize::MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waiting(queue: &SendQueue<()>) -> Vec<&[u8]> {
        queue.frames.iter().map(|((), frame)| &frame[..]).collect()
    }

    #[test]
    fn a_full_queue_drops_the_oldest_frames_and_counts_them() {
        let mut queue = SendQueue::new(10);
        assert_eq!(queue.push((), b"aaaa"), 0);
        assert_eq!(queue.push((), b"bbbb"), 0);
        assert_eq!(queue.push((), b"cccccc"), 1);
        assert_eq!(waiting(&queue), [&b"bbbb"[..], b"cccccc"]);
        assert_eq!(queue.push((), b"dddddddddd"), 2);
        assert_eq!(waiting(&queue), [b"dddddddddd"]);
    }

    #[test]
    fn a_begun_frame_is_finished_before_newer_ones() {
        let mut queue = SendQueue::new(10);
        queue.push_rest((), b"rest");
        assert_eq!(queue.push((), b"bbb"), 0);
        assert_eq!(queue.push((), b"ccc"), 0);
        assert_eq!(queue.push((), b"ddd"), 1);
        assert_eq!(waiting(&queue), [&b"rest"[..], b"ccc", b"ddd"]);
        queue.advance(3);
        assert_eq!(queue.head(), Some((&(), &b"t"[..])));
        queue.advance(1);
        assert_eq!(queue.head(), Some((&(), &b"ccc"[..])));
    }

    #[test]
    fn a_frame_that_was_begun_in_the_queue_is_kept_too() {
        let mut queue = SendQueue::new(8);
        assert_eq!(queue.push((), b"aaaa"), 0);
        queue.advance(1);
        assert_eq!(queue.push((), b"bbbbb"), 0);
        assert_eq!(queue.push((), b"ccccc"), 1);
        assert_eq!(queue.head(), Some((&(), &b"aaa"[..])));
        assert_eq!(queue.len(), 2);
    }

    #[test]
    fn a_frame_larger_than_the_queue_drops_only_itself() {
        let mut queue = SendQueue::new(4);
        assert_eq!(queue.push((), b"aa"), 0);
        assert_eq!(queue.push((), b"bbbbb"), 1);
        assert_eq!(waiting(&queue), [b"aa"]);
    }

    #[test]
    fn a_queue_without_room_keeps_only_the_rest_of_a_begun_frame() {
        let mut queue = SendQueue::new(0);
        assert_eq!(queue.push((), b"a"), 1);
        assert!(queue.is_empty());
        queue.push_rest((), b"st");
        assert_eq!(queue.push((), b"b"), 1);
        assert_eq!(queue.len(), 1);
        queue.drop_head();
        assert!(queue.is_empty());
    }
}
