//! Frames that the operating system did not take yet, the worthiest first.
//!
//! ```text
//! taken out:   rest of a begun frame > Command > Conversation > Forwarded > Estimate
//! when full:   stalest Estimate < oldest Forwarded < oldest Conversation; never a Command
//! ```
//!
//! Within a [`Priority`] frames keep their order. A new estimate of the same stream for the same destination takes the
//! place of the one that waits, which counts as a drop: an old estimate is worth nothing. A frame of which a part has
//! been written is always finished: the rest of it would look like damage to the peer.
//!
//! Commands have a reserve of their own, so no flood of telemetry can push one out. When the reserve is full the *newest*
//! command is refused: whoever sent it learns from the missing acknowledgement, while a command taken from the middle
//! of a sequence that has been accepted would change what the others mean. It writes nothing itself.

use std::collections::VecDeque;

use posebridge_telemetry::Priority;

use crate::capacity::Backlog;

#[cfg(test)]
mod tests;

/// Bytes of commands that may wait: a hundred of the longest commands (MAVLink 2 COMMAND_LONG is 45 bytes, signed 58),
/// twice over, or fifty of the longest frames of any kind (280 bytes).
pub(crate) const COMMAND_RESERVE_BYTES: usize = 16 * 1024;

/// How many kinds of worth there are.
const RANKS: usize = 4;

/// The place of a priority among the others; 0 goes first.
const fn rank(priority: Priority) -> usize {
    match priority {
        Priority::Command => 0,
        Priority::Conversation => 1,
        Priority::Forwarded => 2,
        Priority::Estimate { .. } => 3,
    }
}

/// One frame that waits.
#[derive(Debug)]
struct Waiting<D> {
    to: D,
    priority: Priority,
    frame: Vec<u8>,
    /// How many frames had been offered before it; tells the stalest estimate.
    age_mark: u64,
}

/// The unwritten end of the frame that is being written.
#[derive(Debug)]
struct Begun<D> {
    to: D,
    frame: Vec<u8>,
    sent: usize,
}

impl<D> Begun<D> {
    fn rest(&self) -> &[u8] {
        self.frame.get(self.sent..).unwrap_or_default()
    }
}

/// Frames waiting to be written, each with its destination `D`.
#[derive(Debug)]
pub(crate) struct SendQueue<D> {
    begun: Option<Begun<D>>,
    /// By rank, each in the order in which it leaves.
    ranks: [VecDeque<Waiting<D>>; RANKS],
    /// Bytes of everything that waits except commands and the begun frame.
    shared_bytes: usize,
    command_bytes: usize,
    limit_bytes: usize,
    reserve_bytes: usize,
    offered: u64,
}

impl<D: PartialEq> SendQueue<D> {
    /// An empty queue that holds at most `limit_bytes`, and [`COMMAND_RESERVE_BYTES`] of commands beside them.
    pub(crate) const fn new(limit_bytes: usize) -> Self {
        Self::with_reserve(limit_bytes, COMMAND_RESERVE_BYTES)
    }

    /// As [`SendQueue::new`] with another reserve for commands.
    const fn with_reserve(limit_bytes: usize, reserve_bytes: usize) -> Self {
        Self {
            begun: None,
            ranks: [const { VecDeque::new() }; RANKS],
            shared_bytes: 0,
            command_bytes: 0,
            limit_bytes,
            reserve_bytes,
            offered: 0,
        }
    }

    /// True if nothing waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many frames wait, a begun one included.
    pub(crate) fn len(&self) -> usize {
        let waiting: usize = self.ranks.iter().map(VecDeque::len).sum();
        waiting + usize::from(self.begun.is_some())
    }

    /// Whether anything waits, as the meter of a link's capacity wants to know it.
    pub(crate) fn backlog(&self) -> Backlog {
        if self.is_empty() { Backlog::Empty } else { Backlog::Waiting }
    }

    /// How many bytes wait.
    pub(crate) fn bytes(&self) -> usize {
        self.begun_bytes() + self.shared_bytes + self.command_bytes
    }

    fn begun_bytes(&self) -> usize {
        self.begun.as_ref().map_or(0, |begun| begun.rest().len())
    }

    /// Adds a frame of which nothing has been written and returns how many frames had to go for it; the frame itself
    /// goes if there is no room that it may take.
    pub(crate) fn push(&mut self, to: D, priority: Priority, frame: &[u8]) -> u64 {
        self.offered += 1;
        if priority == Priority::Command {
            return self.push_command(to, frame);
        }
        let mut dropped = 0;
        let mut place = None;
        if let Some(older) = self.position_of_older(&to, priority) {
            self.remove(rank(priority), older);
            dropped += 1;
            place = Some(older);
        }
        let Some(evicted) = self.make_room(frame.len(), rank(priority)) else {
            return dropped + 1;
        };
        self.shared_bytes += frame.len();
        let waiting = self.waiting(to, priority, frame);
        if let Some(queue) = self.ranks.get_mut(rank(priority)) {
            // Those before it may have been dropped for it in the meantime.
            let place = place.unwrap_or(queue.len()).min(queue.len());
            queue.insert(place, waiting);
        }
        dropped + evicted
    }

    fn push_command(&mut self, to: D, frame: &[u8]) -> u64 {
        if self.command_bytes + frame.len() > self.reserve_bytes {
            return 1;
        }
        self.command_bytes += frame.len();
        let waiting = self.waiting(to, Priority::Command, frame);
        let [commands, ..] = &mut self.ranks;
        commands.push_back(waiting);
        0
    }

    fn waiting(&self, to: D, priority: Priority, frame: &[u8]) -> Waiting<D> {
        Waiting { to, priority, frame: frame.to_vec(), age_mark: self.offered }
    }

    /// Where an estimate of the same stream for the same destination waits.
    fn position_of_older(&self, to: &D, priority: Priority) -> Option<usize> {
        let Priority::Estimate { .. } = priority else {
            return None;
        };
        self.ranks.get(rank(priority))?.iter().position(|waiting| waiting.priority == priority && waiting.to == *to)
    }

    /// Drops frames that are worth no more than `rank` until `bytes` fit, and returns how many; `None`, with nothing
    /// dropped, if they cannot fit.
    fn make_room(&mut self, bytes: usize, rank: usize) -> Option<u64> {
        let spared: usize = self.ranks.iter().take(rank).skip(1).flatten().map(|waiting| waiting.frame.len()).sum();
        if self.begun_bytes() + spared + bytes > self.limit_bytes {
            return None;
        }
        let mut dropped = 0;
        while self.begun_bytes() + self.shared_bytes + bytes > self.limit_bytes {
            let (rank, place) = self.least_worthy()?;
            self.remove(rank, place);
            dropped += 1;
        }
        Some(dropped)
    }

    /// The frame that goes first when room is needed.
    fn least_worthy(&self) -> Option<(usize, usize)> {
        let (rank, queue) = self.ranks.iter().enumerate().skip(1).rfind(|(_, queue)| !queue.is_empty())?;
        // Only estimates are out of order: each holds the place of the one that it replaced.
        let (place, _) = queue.iter().enumerate().min_by_key(|(_, waiting)| waiting.age_mark)?;
        Some((rank, place))
    }

    /// Takes one frame other than a command out of the queue.
    fn remove(&mut self, rank: usize, place: usize) {
        if let Some(old) = self.ranks.get_mut(rank).and_then(|queue| queue.remove(place)) {
            self.shared_bytes -= old.frame.len();
        }
    }

    /// Adds the unwritten end of a frame, to an empty queue. It is never dropped.
    pub(crate) fn push_rest(&mut self, to: D, rest: &[u8]) {
        debug_assert!(self.is_empty(), "a frame is begun only when none waits");
        self.begun = Some(Begun { to, frame: rest.to_vec(), sent: 0 });
    }

    /// The frame to write next: its destination and its unwritten bytes.
    pub(crate) fn head(&self) -> Option<(&D, &[u8])> {
        if let Some(begun) = &self.begun {
            return Some((&begun.to, begun.rest()));
        }
        let first = self.ranks.iter().find_map(VecDeque::front)?;
        Some((&first.to, &first.frame))
    }

    /// The frame to write next, if nothing has been written of it: its destination, its worth and its bytes.
    pub(crate) fn first(&self) -> Option<(&D, Priority, &[u8])> {
        if self.begun.is_some() {
            return None;
        }
        let first = self.ranks.iter().find_map(VecDeque::front)?;
        Some((&first.to, first.priority, &first.frame))
    }

    /// Notes that `count` bytes of the head frame have been written.
    pub(crate) fn advance(&mut self, count: usize) {
        if count == 0 {
            return;
        }
        if self.begun.is_none() {
            self.begun = self.take_first();
        }
        if let Some(begun) = &mut self.begun {
            begun.sent = begun.sent.saturating_add(count).min(begun.frame.len());
            if begun.rest().is_empty() {
                self.begun = None;
            }
        }
    }

    fn take_first(&mut self) -> Option<Begun<D>> {
        let queue = self.ranks.iter_mut().find(|queue| !queue.is_empty())?;
        let first = queue.pop_front()?;
        if first.priority == Priority::Command {
            self.command_bytes -= first.frame.len();
        } else {
            self.shared_bytes -= first.frame.len();
        }
        Some(Begun { to: first.to, frame: first.frame, sent: 0 })
    }

    /// Drops the head frame, begun or not.
    pub(crate) fn drop_head(&mut self) {
        if self.begun.take().is_none() {
            drop(self.take_first());
        }
    }

    /// Drops everything and returns how many frames that were.
    pub(crate) fn clear(&mut self) -> u64 {
        let count = self.len() as u64;
        self.begun = None;
        for queue in &mut self.ranks {
            queue.clear();
        }
        self.shared_bytes = 0;
        self.command_bytes = 0;
        count
    }
}
