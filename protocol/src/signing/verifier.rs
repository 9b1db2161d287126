//! Which frames of a link are believed.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{Refusal, Span};

use super::clock::Timestamp;
use super::key::Key;
use super::memory::{Heard, StreamId};
use super::signature::Signature;
use crate::framing::FrameRef;

/// Most streams that are remembered. Only holders of the key make streams; a class of robots has a few hundred.
const MOST_STREAMS: usize = 1_024;
/// A new stream may be this far behind: 6 million units, MAVLink guide, "Timestamp Handling".
const LARGEST_LAG: Span = Span::from_millis(60_000);

/// What becomes of frames without a signature.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unsigned {
    /// They are believed. Those that have a signature must still have a right one.
    Accept,
    /// They are refused, except these message ids.
    RefuseExcept(BTreeSet<u32>),
}

/// Remembers how far every stream of a link is.
#[derive(Clone, Debug)]
pub(super) struct Verifier {
    unsigned: Unsigned,
    streams: BTreeMap<StreamId, Heard>,
    floor: Option<Timestamp>,
    met: u64,
}

impl Verifier {
    pub(super) const fn new(unsigned: Unsigned, streams: BTreeMap<StreamId, Heard>, floor: Option<Timestamp>) -> Self {
        Self { unsigned, streams, floor, met: 0 }
    }

    /// The timestamp of a frame that is to be believed, `None` if it comes without; takes note of it. `clock` is the time of
    /// signatures, `date` the computer's.
    pub(super) fn judge(
        &mut self,
        (clock, date): (Timestamp, Timestamp),
        key: &Key,
        frame: &FrameRef<'_>,
    ) -> Result<Option<Timestamp>, Refusal> {
        let Some(signature) = Signature::of(frame) else {
            return match &self.unsigned {
                Unsigned::Accept => Ok(None),
                Unsigned::RefuseExcept(ids) if ids.contains(&frame.message_id) => Ok(None),
                Unsigned::RefuseExcept(_) => Err(Refusal::Unsigned),
            };
        };
        if !signature.holds(key) {
            return Err(Refusal::WrongSignature);
        }
        let timestamp = signature.timestamp;
        let stream = StreamId { source: frame.source, link_id: signature.link_id };
        if let Some(last) = self.streams.get_mut(&stream) {
            if timestamp <= last.timestamp {
                return Err(Refusal::Replayed);
            }
            *last = Heard { timestamp, date };
        } else {
            if self.has_gone(timestamp) || timestamp.later(LARGEST_LAG) < clock {
                return Err(Refusal::Stale);
            }
            self.begin(stream, Heard { timestamp, date });
        }
        Ok(Some(timestamp))
    }

    /// Whether a frame needs no signature, whatever its message.
    pub(super) fn believes_everybody(&self) -> bool {
        self.unsigned == Unsigned::Accept
    }

    fn begin(&mut self, stream: StreamId, heard: Heard) {
        if self.streams.len() >= MOST_STREAMS {
            let oldest = self.streams.iter().min_by_key(|(_, last)| last.timestamp);
            if let Some((oldest, last)) = oldest.map(|(oldest, last)| (*oldest, last.timestamp)) {
                self.streams.remove(&oldest);
                // Nothing of it can come again: whoever is not in the table must be later.
                self.floor = self.floor.max(Some(last));
            }
        }
        self.streams.insert(stream, heard);
        self.met += 1;
    }

    /// Whether a stream that is not remembered may have said this.
    fn has_gone(&self, timestamp: Timestamp) -> bool {
        self.floor.is_some_and(|floor| timestamp <= floor)
    }

    pub(super) const fn streams(&self) -> &BTreeMap<StreamId, Heard> {
        &self.streams
    }

    pub(super) const fn floor(&self) -> Option<Timestamp> {
        self.floor
    }

    /// How many streams have begun.
    pub(super) const fn met(&self) -> u64 {
        self.met
    }
}
