//! What a link's signing must still know after a restart, and how a session begins from it.
//!
//! What is written down is always a little old when a program is killed. Nothing that happened after the writing may be
//! possible a second time, so [`SigningState::resumed`] goes ahead of what was written: by at most [`SigningState::LARGEST_LOSS`].

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, TimeDelta};

use super::signature::SigningTime;

/// How far a sender's stamps may run ahead of the time that passes: a burst of frames takes one stamp each.
const BURST: TimeDelta = TimeDelta::from_millis(500);

/// One sender on one of its links: what has timestamps of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StreamId {
    /// Who sends.
    pub source: Address,
    /// What the sender calls the link.
    pub link_id: u8,
}

/// The last accepted timestamp of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignedStreamState {
    /// Its timestamp, by the sender's clock.
    pub timestamp: SigningTime,
    /// When it came, by our computer's date.
    pub date: SigningTime,
}

/// How the session that wrote a [`SigningState`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShutdownKind {
    /// It closed: nothing was sent or heard after the writing.
    Clean,
    /// It was still running when it wrote, and never wrote again.
    Interrupted,
}

/// The timestamps of one link, at one instant.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SigningState {
    /// What the computer's date said at that instant.
    pub written_at: SigningTime,
    /// The time of signatures at that instant; ahead of the date if a peer was.
    pub clock: SigningTime,
    /// The last timestamp that we have signed with.
    pub last_sent: SigningTime,
    /// Streams that are not listed are refused if their timestamp is this or an earlier one: a stream that made room for others
    /// was that far.
    pub min_timestamp: Option<SigningTime>,
    /// The last accepted timestamp of every stream.
    pub streams: BTreeMap<StreamId, SignedStreamState>,
}

impl SigningState {
    /// How often a running station writes its memory down, while there is anything new.
    pub const WRITE_PERIOD: TimeDelta = TimeDelta::from_millis(500);

    /// The longest that it may go without: twenty times as long, so that a disk that hangs for a while costs nothing.
    pub const MAX_WRITE_GAP: TimeDelta = TimeDelta::from_millis(10_000);

    /// What a session begins with that finds this memory when its computer's date is `utc`.
    ///
    /// After [`ShutdownKind::Interrupted`] our own timestamps begin so far ahead that none is used twice. What a stream has said
    /// between the writing and the cut cannot be known; its stamps cannot have gone on by much more than the time since it was
    /// last heard, so that much is refused.
    pub fn resume(mut self, utc: SigningTime, ending: ShutdownKind) -> Self {
        if ending == ShutdownKind::Interrupted {
            let since_writing = if utc > self.written_at {
                utc.since(self.written_at).min(Self::MAX_WRITE_GAP)
            } else {
                // A date that fell says nothing about what has passed.
                Self::MAX_WRITE_GAP
            };
            let cut = self.written_at.saturating_add(since_writing);
            for heard in self.streams.values_mut() {
                let unseen = cut.since(heard.date) + BURST;
                heard.timestamp = heard.timestamp.saturating_add(unseen);
                // As if this had been heard: a second cut must not count the same time again.
                heard.date = utc.saturating_add(BURST);
            }
            self.last_sent = self.last_sent.max(self.clock).saturating_add(Self::MAX_WRITE_GAP);
        }
        self.written_at = utc;
        self.clock = self.clock.max(utc);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STREAM: StreamId = StreamId { source: Address::new(1, 1), link_id: 0 };

    const HEARD: SignedStreamState = SignedStreamState {
        timestamp: SigningTime::from_units(200 * 100_000),
        date: SigningTime::from_units(997 * 100_000),
    };

    fn at(secs: u64) -> SigningTime {
        SigningTime::from_units(secs * 100_000)
    }

    fn memory() -> SigningState {
        SigningState {
            written_at: at(999),
            clock: at(1_000),
            last_sent: at(990),
            min_timestamp: Some(at(5)),
            streams: [(STREAM, HEARD)].into(),
        }
    }

    #[test]
    fn a_closed_session_is_gone_on_with_as_it_stood() {
        let resumed = memory().resume(at(1_500), ShutdownKind::Clean);
        let expected = SigningState { written_at: at(1_500), clock: at(1_500), ..memory() };
        assert_eq!(resumed, expected);
    }

    #[test]
    fn many_cuts_do_not_shut_a_sender_out() {
        let mut memory = memory();
        for utc in 1_000..1_100 {
            memory = memory.resume(at(utc), ShutdownKind::Interrupted);
        }
        // The sender was at 200 s when it was 997 s, so at 302 s when it was 1099 s.
        assert_eq!(memory.streams[&STREAM].timestamp, at(302).saturating_add(TimeDelta::from_millis(500)));
    }

    #[test]
    fn after_a_cut_nothing_that_may_have_been_used_can_come_again() {
        for (utc, unseen_ms) in [(1_002, 5_500), (90_000, 12_500), (999, 12_500), (2, 12_500)] {
            let resumed = memory().resume(at(utc), ShutdownKind::Interrupted);
            assert_eq!(resumed.last_sent, at(1_010), "utc {utc}");
            assert_eq!(
                resumed.streams[&STREAM].timestamp,
                HEARD.timestamp.saturating_add(TimeDelta::from_millis(unseen_ms)),
                "utc {utc}"
            );
            assert_eq!(resumed.clock, at(utc.max(1_000)), "utc {utc}");
        }
    }
}
