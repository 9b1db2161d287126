//! What was found in a file.

use std::collections::BTreeMap;

use posebridge_protocol::statistics::TrafficStatistics;
use posebridge_recording::container::RecordingHeader;
use posebridge_recording::tlog::ByteOrder;
use posebridge_telemetry::{HostClock, LinkId, Timestamp};

use super::descriptor::RunFacts;

/// What was found in a file of frames.
#[derive(Debug, Default)]
pub(super) struct FramedFacts {
    /// Bytes of the file, or of its MAVLink links, unpacked.
    pub(super) bytes: u64,
    pub(super) census: TrafficStatistics,
    /// Frames of unknown messages.
    pub(super) unknown_frames: u64,
    /// Their bytes, with the times before them.
    pub(super) unknown_bytes: u64,
    /// Bytes in no verified frame; those of unknown ones are among them.
    pub(super) bytes_outside: u64,
    /// The zero of the census's times, in microseconds since 1970; `None` if the file has no times.
    pub(super) epoch_micros: Option<u64>,
    pub(super) tlog: Option<TlogFacts>,
    pub(super) own: Option<RecordingFacts>,
}

/// What only a telemetry log has.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TlogFacts {
    pub(super) order: ByteOrder,
    /// How many times end in each value of the two lowest bits.
    pub(super) link_bits: [u64; 4],
}

impl TlogFacts {
    /// The numbers of links that the times hold, if they do: the lowest bits of times that hold none are spread evenly.
    pub(super) fn links(&self) -> Vec<usize> {
        let all: u64 = self.link_bits.iter().sum();
        let used = |share: &u64| *share > 0;
        let is_even = self.link_bits.iter().all(|share| 8 * share > all);
        if all < 64 || is_even {
            return Vec::new();
        }
        let bits = self.link_bits.iter().enumerate();
        bits.filter(|(_, share)| used(share)).map(|(bits, _)| bits).collect()
    }
}

/// Everything that is reported of a file.
pub(super) enum InspectResult {
    Framed(Box<FramedFacts>),
    Runs(Vec<RunFacts>),
}

impl InspectResult {
    pub(super) fn from_framed(framed: FramedFacts) -> Self {
        Self::Framed(Box::new(framed))
    }
}

/// What only a recording of ours has.
#[derive(Debug)]
pub(super) struct RecordingFacts {
    /// Its own description.
    pub(super) header: RecordingHeader,
    /// How many inputs it holds.
    pub(super) inputs: u64,
    /// Observations that came without bytes, from a foreign recording.
    pub(super) observations: u64,
    /// Commands.
    pub(super) commands: u64,
    /// Links by number.
    pub(super) links: BTreeMap<LinkId, LinkFacts>,
    /// When the first input was given; a later part of a session begins late.
    pub(super) first: Option<Timestamp<HostClock>>,
    /// Which part of its session this is; the first is 1.
    pub(super) part: u32,
    /// What it lacks of its session's beginning, in words.
    pub(super) missing_start: Option<String>,
    /// The names of the parts that continue it; they are not counted.
    pub(super) continued_by: Vec<String>,
    /// When the last input was given.
    pub(super) last: Timestamp<HostClock>,
    /// Where and why it ends early.
    pub(super) truncation: Option<String>,
    /// What is damaged within it.
    pub(super) damages: Vec<String>,
}

impl RecordingFacts {
    /// From its first input to its last, s.
    pub(super) fn duration_s(&self) -> f64 {
        let first = self.first.unwrap_or(self.last);
        (self.last - first).as_secs_f64()
    }
}

/// One link.
#[derive(Debug, Default)]
pub(super) struct LinkFacts {
    /// Its URL.
    pub(super) url: String,
    /// The protocol of its brick, if that is not MAVLink.
    pub(super) brick: Option<String>,
    /// Chunks that came.
    pub(super) chunks: u64,
    /// Their bytes.
    pub(super) bytes: u64,
    /// How often it came up.
    pub(super) ups: u64,
    /// How often it went down.
    pub(super) downs: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_bits_are_links_only_where_they_are_not_spread() {
        let links = |link_bits| TlogFacts { link_bits, ..TlogFacts::default() }.links();
        assert_eq!(links([251, 240, 260, 249]), [0_usize; 0]);
        assert_eq!(links([900, 0, 0, 100]), [0, 3]);
        assert_eq!(links([5, 0, 0, 0]), [0_usize; 0], "too few to tell");
    }
}
