//! The queue of frames that the operating system has not accepted yet, by priority.
//!
//! ```text
//! sent first:    rest of a begun frame > Command > Session > Forwarded > Estimate
//! dropped first: oldest Estimate < oldest Forwarded < oldest Session; never a Command
//! ```
//!
//! Frames of one [`Priority`] keep their order. A new estimate replaces a waiting one of the same stream and
//! destination, which counts as a drop. A frame that is partly written is always finished: otherwise the peer would
//! receive a damaged frame.
//!
//! Commands have a reserve of their own, so that telemetry cannot displace them. When the reserve is full, the *newest*
//! command is refused: its sender notices the missing acknowledgement, while a command removed from the middle of an
//! accepted sequence would change the meaning of the others. The queue itself writes nothing.

use std::collections::VecDeque;

use posebridge_telemetry::Priority;

use crate::capacity::Backlog;

#[cfg(test)]
mod tests;

/// Bytes of commands that may wait: a hundred of the longest commands (MAVLink 2 COMMAND_LONG is 45 bytes, signed 58),
/// twice over, or fifty of the longest frames of any kind (280 bytes).
pub(crate) const COMMAND_RESERVE_BYTES: usize = 16 * 1024;

const PRIORITY_COUNT: usize = 4;

/// The rank of a priority; 0 goes first.
const fn priority_rank(priority: Priority) -> usize {
    match priority {
        Priority::Command => 0,
        Priority::Session => 1,
        Priority::Forwarded => 2,
        Priority::Estimate { .. } => 3,
    }
}

#[derive(Debug)]
struct QueuedFrame<D> {
    to: D,
    priority: Priority,
    frame: Vec<u8>,
    /// The number of frames pushed before it; identifies the oldest estimate.
    sequence: u64,
}

/// The unwritten end of the frame that is being written.
#[derive(Debug)]
struct PartialFrame<D> {
    to: D,
    frame: Vec<u8>,
    written: usize,
}

impl<D> PartialFrame<D> {
    fn unwritten(&self) -> &[u8] {
        self.frame.get(self.written..).unwrap_or_default()
    }
}

/// Frames waiting to be written, each with its destination `D`.
#[derive(Debug)]
pub(crate) struct SendQueue<D> {
    partial: Option<PartialFrame<D>>,
    /// By rank, each in the order of sending.
    queues: [VecDeque<QueuedFrame<D>>; PRIORITY_COUNT],
    /// Bytes of everything that waits except commands and the begun frame.
    telemetry_bytes: usize,
    command_bytes: usize,
    limit_bytes: usize,
    reserve_bytes: usize,
    offered_count: u64,
}

impl<D: PartialEq> SendQueue<D> {
    /// An empty queue that holds at most `limit_bytes`, and [`COMMAND_RESERVE_BYTES`] of commands beside them.
    pub(crate) const fn new(limit_bytes: usize) -> Self {
        Self::with_reserve(limit_bytes, COMMAND_RESERVE_BYTES)
    }

    const fn with_reserve(limit_bytes: usize, reserve_bytes: usize) -> Self {
        Self {
            partial: None,
            queues: [const { VecDeque::new() }; PRIORITY_COUNT],
            telemetry_bytes: 0,
            command_bytes: 0,
            limit_bytes,
            reserve_bytes,
            offered_count: 0,
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many frames wait, a begun one included.
    pub(crate) fn len(&self) -> usize {
        let waiting: usize = self.queues.iter().map(VecDeque::len).sum();
        waiting + usize::from(self.partial.is_some())
    }

    pub(crate) fn backlog(&self) -> Backlog {
        if self.is_empty() { Backlog::Empty } else { Backlog::Pending }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.partial_bytes() + self.telemetry_bytes + self.command_bytes
    }

    fn partial_bytes(&self) -> usize {
        self.partial.as_ref().map_or(0, |begun| begun.unwritten().len())
    }

    /// Adds an unstarted frame and returns the number of frames dropped for it, which includes the frame
    /// itself if there is no space for its priority.
    pub(crate) fn push(&mut self, to: D, priority: Priority, frame: &[u8]) -> u64 {
        self.offered_count += 1;
        if priority == Priority::Command {
            return self.push_command(to, frame);
        }
        let mut dropped = 0;
        let mut position = None;
        if let Some(older) = self.position_of_superseded(&to, priority) {
            self.remove(priority_rank(priority), older);
            dropped += 1;
            position = Some(older);
        }
        let Some(evicted) = self.evict_for(frame.len(), priority_rank(priority)) else {
            return dropped + 1;
        };
        self.telemetry_bytes += frame.len();
        let waiting = self.queued_frame(to, priority, frame);
        if let Some(queue) = self.queues.get_mut(priority_rank(priority)) {
            // Those before it may have been dropped for it in the meantime.
            let position = position.unwrap_or(queue.len()).min(queue.len());
            queue.insert(position, waiting);
        }
        dropped + evicted
    }

    fn push_command(&mut self, to: D, frame: &[u8]) -> u64 {
        if self.command_bytes + frame.len() > self.reserve_bytes {
            return 1;
        }
        self.command_bytes += frame.len();
        let waiting = self.queued_frame(to, Priority::Command, frame);
        let [commands, ..] = &mut self.queues;
        commands.push_back(waiting);
        0
    }

    fn queued_frame(&self, to: D, priority: Priority, frame: &[u8]) -> QueuedFrame<D> {
        QueuedFrame { to, priority, frame: frame.to_vec(), sequence: self.offered_count }
    }

    /// The index of a waiting estimate of the same stream and destination.
    fn position_of_superseded(&self, to: &D, priority: Priority) -> Option<usize> {
        let Priority::Estimate { .. } = priority else {
            return None;
        };
        self.queues
            .get(priority_rank(priority))?
            .iter()
            .position(|waiting| waiting.priority == priority && waiting.to == *to)
    }

    /// Drops frames of `rank` and lower priorities until `bytes` fit, and returns their number; `None`, with nothing dropped, if
    /// they cannot fit.
    fn evict_for(&mut self, bytes: usize, rank: usize) -> Option<u64> {
        let spared: usize = self.queues.iter().take(rank).skip(1).flatten().map(|waiting| waiting.frame.len()).sum();
        if self.partial_bytes() + spared + bytes > self.limit_bytes {
            return None;
        }
        let mut dropped = 0;
        while self.partial_bytes() + self.telemetry_bytes + bytes > self.limit_bytes {
            let (rank, position) = self.lowest_priority()?;
            self.remove(rank, position);
            dropped += 1;
        }
        Some(dropped)
    }

    /// The frame to drop first.
    fn lowest_priority(&self) -> Option<(usize, usize)> {
        let (rank, queue) = self.queues.iter().enumerate().skip(1).rfind(|(_, queue)| !queue.is_empty())?;
        // Only estimates are out of order: each has the position of the one that it replaced.
        let (position, _) = queue.iter().enumerate().min_by_key(|(_, waiting)| waiting.sequence)?;
        Some((rank, position))
    }

    /// Takes one frame other than a command out of the queue.
    fn remove(&mut self, rank: usize, position: usize) {
        if let Some(old) = self.queues.get_mut(rank).and_then(|queue| queue.remove(position)) {
            self.telemetry_bytes -= old.frame.len();
        }
    }

    /// Adds the unwritten end of a frame, to an empty queue. It is never dropped.
    pub(crate) fn push_partial(&mut self, to: D, rest: &[u8]) {
        debug_assert!(self.is_empty(), "a frame is begun only when none waits");
        self.partial = Some(PartialFrame { to, frame: rest.to_vec(), written: 0 });
    }

    /// The frame to write next: its destination and its unwritten bytes.
    pub(crate) fn head(&self) -> Option<(&D, &[u8])> {
        if let Some(begun) = &self.partial {
            return Some((&begun.to, begun.unwritten()));
        }
        let first = self.queues.iter().find_map(VecDeque::front)?;
        Some((&first.to, &first.frame))
    }

    /// The frame to write next, if nothing has been written of it: its destination, priority and bytes.
    pub(crate) fn head_unstarted(&self) -> Option<(&D, Priority, &[u8])> {
        if self.partial.is_some() {
            return None;
        }
        let first = self.queues.iter().find_map(VecDeque::front)?;
        Some((&first.to, first.priority, &first.frame))
    }

    /// Records that `count` bytes of the head frame have been written.
    pub(crate) fn advance(&mut self, count: usize) {
        if count == 0 {
            return;
        }
        if self.partial.is_none() {
            self.partial = self.pop_first();
        }
        if let Some(begun) = &mut self.partial {
            begun.written = begun.written.saturating_add(count).min(begun.frame.len());
            if begun.unwritten().is_empty() {
                self.partial = None;
            }
        }
    }

    fn pop_first(&mut self) -> Option<PartialFrame<D>> {
        let queue = self.queues.iter_mut().find(|queue| !queue.is_empty())?;
        let first = queue.pop_front()?;
        if first.priority == Priority::Command {
            self.command_bytes -= first.frame.len();
        } else {
            self.telemetry_bytes -= first.frame.len();
        }
        Some(PartialFrame { to: first.to, frame: first.frame, written: 0 })
    }

    /// Drops the head frame, begun or not.
    pub(crate) fn pop_head(&mut self) {
        if self.partial.take().is_none() {
            drop(self.pop_first());
        }
    }

    /// Drops all frames and returns their number.
    pub(crate) fn clear(&mut self) -> u64 {
        let count = self.len() as u64;
        self.partial = None;
        for queue in &mut self.queues {
            queue.clear();
        }
        self.telemetry_bytes = 0;
        self.command_bytes = 0;
        count
    }
}
