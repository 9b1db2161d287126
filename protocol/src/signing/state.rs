//! The state of a link's signing that must survive a restart.
//!
//! The written state is always a little old when a program is killed. Nothing after the writing may be repeatable, so
//! [`SigningState::resume`] advances the state: by at most [`SigningState::MAX_WRITE_GAP`].

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, TimeDelta};

use super::signature::SigningTime;

/// How far a sender's timestamps may run ahead of its time: a burst of frames takes one timestamp each.
const BURST: TimeDelta = TimeDelta::from_millis(500);

/// One sender on one of its links, which has its own timestamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StreamId {
    pub source: Address,
    pub link_id: u8,
}

/// The last accepted timestamp of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignedStreamState {
    pub timestamp: SigningTime,
    /// Its arrival, by our computer's date.
    pub date: SigningTime,
}

/// How the session that wrote a [`SigningState`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShutdownKind {
    /// Closed: nothing was sent or received after the writing.
    Clean,
    /// Killed some time after the writing.
    Interrupted,
}

/// The timestamps of one link, at one instant.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SigningState {
    /// The computer's date at that instant.
    pub written_at: SigningTime,
    /// Signature time at that instant; ahead of the date if a peer was. [`LinkSigner`](super::LinkSigner) counts it on: our
    /// timestamps are never behind it, and a new stream is rejected if it is more than a minute behind.
    pub clock: SigningTime,
    pub last_sent: SigningTime,
    /// Unlisted streams with this timestamp or an earlier one are rejected: a stream that was dropped to make room had
    /// reached it.
    pub min_timestamp: Option<SigningTime>,
    pub streams: BTreeMap<StreamId, SignedStreamState>,
}

impl SigningState {
    /// How often a running station writes a changed state.
    pub const WRITE_PERIOD: TimeDelta = TimeDelta::from_millis(500);

    /// The longest time without a write: twenty periods, so that a disk that stalls for a while does no harm.
    pub const MAX_WRITE_GAP: TimeDelta = TimeDelta::from_millis(10_000);

    /// The state of a new session that starts from this one at the computer's date `utc`.
    ///
    /// After [`ShutdownKind::Interrupted`] our own timestamps begin so far ahead that none is used twice. The
    /// timestamps of the streams between the writing and the end are unknown; they cannot have advanced by much more
    /// than the time since the stream's last frame, so that much is rejected.
    pub fn resume(mut self, utc: SigningTime, ending: ShutdownKind) -> Self {
        if ending == ShutdownKind::Interrupted {
            let since_writing = if utc > self.written_at {
                utc.since(self.written_at).min(Self::MAX_WRITE_GAP)
            } else {
                // A date that fell says nothing about what has passed.
                Self::MAX_WRITE_GAP
            };
            let cut = self.written_at.saturating_add(since_writing);
            for stream in self.streams.values_mut() {
                let unseen = cut.since(stream.date) + BURST;
                stream.timestamp = stream.timestamp.saturating_add(unseen);
                // As if this had been received: a second cut must not count the same time again.
                stream.date = utc.saturating_add(BURST);
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

    const STATE: SignedStreamState = SignedStreamState {
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
            streams: [(STREAM, STATE)].into(),
        }
    }

    #[test]
    fn a_closed_session_resumes_unchanged() {
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
                STATE.timestamp.saturating_add(TimeDelta::from_millis(unseen_ms)),
                "utc {utc}"
            );
            assert_eq!(resumed.clock, at(utc.max(1_000)), "utc {utc}");
        }
    }
}
