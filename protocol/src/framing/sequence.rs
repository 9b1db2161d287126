//! Counts missing frames by the senders' sequence numbers, each (system, component) separately.
//!
//! Missing is what the sender has sent between two received frames, less what was received between them, as RFC 3550
//! (section 6.4.1, appendix A.3) defines the cumulative loss of RTP. An 8-bit number gives a distance only modulo 256:
//! ```text
//! n = a + 256 k     a = advance of the number modulo 256     k such that n is nearest to pace x (time between the two frames)
//! ```
//! The time is the sender's own, from the stamps of its messages, because a link that stalls delivers everything at once. A
//! sender without stamps is followed by its number alone: an advance of up to half the circle is a loss, more is an old
//! frame. A restarted sender begins anew: its clock shows it, and losses around the restart are not counted.

mod missing;
mod send_rate;
mod sender;

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, HostClock, SourceHealth, Timestamp};

use self::sender::{SenderSequence, StampedArrival};
use super::FrameRef;
use crate::dialect;

/// Counts the frames of every sender on one link, received and missing.
#[derive(Clone, Debug, Default)]
pub struct SequenceTracker {
    senders: BTreeMap<Address, SenderSequence>,
}

impl SequenceTracker {
    pub fn new() -> Self {
        Self::default()
    }

    /// Records a frame that arrived at `arrival` and returns the increase in the number of its sender's missing frames.
    /// That can be more than those just before it: only a message with a stamp shows how long a silence was.
    pub fn record(&mut self, frame: &FrameRef<'_>, arrival: Timestamp<HostClock>) -> u32 {
        let sender = self.senders.entry(frame.source).or_default();
        match dialect::timestamp_of(frame) {
            Some(stamp) => {
                sender.record_stamped(frame.sequence, StampedArrival { message_id: frame.message_id, stamp, arrival });
            }
            None => sender.record(frame.sequence),
        }
        sender.take_new_losses()
    }

    /// Records a frame by its number alone and returns the number of its sender's frames that are missing before it: 0
    /// to 127.
    pub fn record_number(&mut self, source: Address, sequence: u8) -> u8 {
        let sender = self.senders.entry(source).or_default();
        sender.record(sequence);
        u8::try_from(sender.take_new_losses()).unwrap_or(u8::MAX)
    }

    /// The link was lost. A sender with stamps is followed across the loss; for the others it is unknown whether they
    /// are the same, and their next frame starts a new sequence.
    pub fn handle_link_loss(&mut self) {
        for sender in self.senders.values_mut() {
            sender.handle_link_loss();
        }
    }

    /// Counters per sender, in the order of addresses.
    pub fn source_health(&self) -> impl Iterator<Item = SourceHealth> {
        self.senders.iter().map(|(source, sender)| SourceHealth {
            source: *source,
            frames: sender.frames(),
            lost: sender.lost(),
        })
    }
}

/// Counts the frames of one sender by their numbers alone.
#[derive(Clone, Debug, Default)]
pub struct SequenceCounter(SenderSequence);

impl SequenceCounter {
    pub fn record_number(&mut self, sequence: u8) -> u8 {
        self.0.record(sequence);
        u8::try_from(self.0.take_new_losses()).unwrap_or(u8::MAX)
    }
}

#[cfg(test)]
mod tests;
