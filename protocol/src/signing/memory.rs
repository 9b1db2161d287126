//! What a link's signing must still know after a restart, and how a session begins from it.
//!
//! What is written down is always a little old when a program is killed. Nothing that happened after the writing may be
//! possible a second time, so [`Memory::resumed`] goes ahead of what was written: by at most [`Memory::LARGEST_LOSS`].

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, Span};

use super::clock::Timestamp;

/// How far a sender's stamps may run ahead of the time that passes: a burst of frames takes one stamp each.
const BURST: Span = Span::from_millis(500);

/// One sender on one of its links: what has timestamps of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StreamId {
    /// Who sends.
    pub source: Address,
    /// What the sender calls the link.
    pub link_id: u8,
}

/// The last that was believed of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heard {
    /// Its timestamp, by the sender's clock.
    pub timestamp: Timestamp,
    /// When it came, by our computer's date.
    pub date: Timestamp,
}

/// How the session that wrote a [`Memory`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It closed: nothing was sent or heard after the writing.
    Closed,
    /// It was still running when it wrote, and never wrote again.
    Cut,
}

/// The timestamps of one link, at one instant.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// What the computer's date said at that instant.
    pub written: Timestamp,
    /// The time of signatures at that instant; ahead of the date if a peer was.
    pub clock: Timestamp,
    /// The last timestamp that we have signed with.
    pub own: Timestamp,
    /// Streams that are not listed and speak of this time or an earlier one are refused: a stream that made room for others
    /// was that far.
    pub floor: Option<Timestamp>,
    /// The last that was believed of every stream.
    pub streams: BTreeMap<StreamId, Heard>,
}

impl Memory {
    /// How often a running station writes its memory down, while there is anything new.
    pub const WRITTEN_EVERY: Span = Span::from_millis(500);

    /// The longest that it may go without: twenty times as long, so that a disk that hangs for a while costs nothing.
    pub const LARGEST_LOSS: Span = Span::from_millis(10_000);

    /// What a session begins with that finds this memory when its computer's date is `utc`.
    ///
    /// After [`Ending::Cut`] our own timestamps begin so far ahead that none is used twice. What a stream has said between the
    /// writing and the cut cannot be known; its stamps cannot have gone on by much more than the time since it was last
    /// heard, so that much is refused.
    #[must_use]
    pub fn resumed(mut self, utc: Timestamp, ending: Ending) -> Self {
        if ending == Ending::Cut {
            let since_writing = if utc > self.written {
                utc.since(self.written).min(Self::LARGEST_LOSS)
            } else {
                // A date that fell says nothing about what has passed.
                Self::LARGEST_LOSS
            };
            let cut = self.written.later(since_writing);
            for heard in self.streams.values_mut() {
                let unseen = cut.since(heard.date) + BURST;
                heard.timestamp = heard.timestamp.later(unseen);
                // As if this had been heard: a second cut must not count the same time again.
                heard.date = utc.later(BURST);
            }
            self.own = self.own.max(self.clock).later(Self::LARGEST_LOSS);
        }
        self.written = utc;
        self.clock = self.clock.max(utc);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STREAM: StreamId = StreamId { source: Address::new(1, 1), link_id: 0 };

    const HEARD: Heard =
        Heard { timestamp: Timestamp::from_units(200 * 100_000), date: Timestamp::from_units(997 * 100_000) };

    fn at(secs: u64) -> Timestamp {
        Timestamp::from_units(secs * 100_000)
    }

    fn memory() -> Memory {
        Memory {
            written: at(999),
            clock: at(1_000),
            own: at(990),
            floor: Some(at(5)),
            streams: [(STREAM, HEARD)].into(),
        }
    }

    #[test]
    fn a_closed_session_is_gone_on_with_as_it_stood() {
        let resumed = memory().resumed(at(1_500), Ending::Closed);
        let expected = Memory { written: at(1_500), clock: at(1_500), ..memory() };
        assert_eq!(resumed, expected);
    }

    #[test]
    fn many_cuts_do_not_shut_a_sender_out() {
        let mut memory = memory();
        for utc in 1_000..1_100 {
            memory = memory.resumed(at(utc), Ending::Cut);
        }
        // The sender was at 200 s when it was 997 s, so at 302 s when it was 1099 s.
        assert_eq!(memory.streams[&STREAM].timestamp, at(302).later(Span::from_millis(500)));
    }

    #[test]
    fn after_a_cut_nothing_that_may_have_been_used_can_come_again() {
        for (utc, unseen_ms) in [(1_002, 5_500), (90_000, 12_500), (999, 12_500), (2, 12_500)] {
            let resumed = memory().resumed(at(utc), Ending::Cut);
            assert_eq!(resumed.own, at(1_010), "utc {utc}");
            assert_eq!(
                resumed.streams[&STREAM].timestamp,
                HEARD.timestamp.later(Span::from_millis(unseen_ms)),
                "utc {utc}"
            );
            assert_eq!(resumed.clock, at(utc.max(1_000)), "utc {utc}");
        }
    }
}
