//! Verifies the signatures of a link's frames.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{SignatureError, TimeDelta};

use super::key::Key;
use super::signature::{Signature, SigningTime};
use super::state::{SignedStreamState, StreamId};
use crate::framing::FrameRef;

/// Most remembered streams. Only holders of the key make streams; a class of robots has a few hundred.
const MAX_STREAMS: usize = 1_024;
/// A new stream may be this far behind: 6 million units, MAVLink guide, "Timestamp Handling".
const MAX_LAG: TimeDelta = TimeDelta::from_millis(60_000);

/// Whether frames without a signature are accepted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UnsignedPolicy {
    /// A signature, if there is one, must still be valid.
    Accept,
    /// Rejected, except these message ids.
    RejectExcept(BTreeSet<u32>),
}

/// The last timestamp of every stream of a link.
#[derive(Clone, Debug)]
pub(super) struct SignatureVerifier {
    unsigned: UnsignedPolicy,
    streams: BTreeMap<StreamId, SignedStreamState>,
    floor: Option<SigningTime>,
    met: u64,
}

impl SignatureVerifier {
    pub(super) const fn new(
        unsigned: UnsignedPolicy,
        streams: BTreeMap<StreamId, SignedStreamState>,
        floor: Option<SigningTime>,
    ) -> Self {
        Self { unsigned, streams, floor, met: 0 }
    }

    /// Verifies a frame and stores its timestamp, which is returned; `None` if an accepted frame has no signature.
    /// `clock` is signature time, `date` the computer's.
    pub(super) fn verify(
        &mut self,
        (clock, date): (SigningTime, SigningTime),
        key: &Key,
        frame: &FrameRef<'_>,
    ) -> Result<Option<SigningTime>, SignatureError> {
        let Some(signature) = Signature::parse(frame) else {
            return match &self.unsigned {
                UnsignedPolicy::Accept => Ok(None),
                UnsignedPolicy::RejectExcept(ids) if ids.contains(&frame.message_id) => Ok(None),
                UnsignedPolicy::RejectExcept(_) => Err(SignatureError::Unsigned),
            };
        };
        if !signature.is_valid(key) {
            return Err(SignatureError::Invalid);
        }
        let timestamp = signature.timestamp;
        let stream = StreamId { source: frame.source, link_id: signature.link_id };
        if let Some(last) = self.streams.get_mut(&stream) {
            if timestamp <= last.timestamp {
                return Err(SignatureError::Replayed);
            }
            *last = SignedStreamState { timestamp, date };
        } else {
            if self.may_be_replayed(timestamp) || timestamp.saturating_add(MAX_LAG) < clock {
                return Err(SignatureError::Stale);
            }
            self.add_stream(stream, SignedStreamState { timestamp, date });
        }
        Ok(Some(timestamp))
    }

    pub(super) fn accepts_unsigned(&self) -> bool {
        self.unsigned == UnsignedPolicy::Accept
    }

    fn add_stream(&mut self, stream: StreamId, state: SignedStreamState) {
        if self.streams.len() >= MAX_STREAMS {
            let oldest = self.streams.iter().min_by_key(|(_, last)| last.timestamp);
            if let Some((oldest, last)) = oldest.map(|(oldest, last)| (*oldest, last.timestamp)) {
                self.streams.remove(&oldest);
                // Its frames cannot be replayed: a stream that is not in the table must be later.
                self.floor = self.floor.max(Some(last));
            }
        }
        self.streams.insert(stream, state);
        self.met += 1;
    }

    /// Whether a stream that is not remembered may have used this timestamp.
    fn may_be_replayed(&self, timestamp: SigningTime) -> bool {
        self.floor.is_some_and(|floor| timestamp <= floor)
    }

    pub(super) const fn streams(&self) -> &BTreeMap<StreamId, SignedStreamState> {
        &self.streams
    }

    pub(super) const fn min_timestamp(&self) -> Option<SigningTime> {
        self.floor
    }

    /// Number of new streams.
    pub(super) const fn streams_seen(&self) -> u64 {
        self.met
    }
}
