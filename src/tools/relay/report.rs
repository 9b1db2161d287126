//! The final report of a relay, for people and for machines.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use posebridge_sim::impairment::{Counters, FrameCounts, FrameLedger};
use serde::Serialize;

/// The end of a relay.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RelayReport {
    /// Name or file of the profile.
    pub(super) profile: String,
    /// Seed of the link's randomness.
    pub(super) seed: u64,
    /// How long it ran.
    pub(super) duration_s: f64,
    /// How often the model of the link went down.
    pub(super) outages: u64,
    /// What became of the brick's bytes.
    pub(super) to_station: DirectionReport,
    /// What became of the station's bytes.
    pub(super) to_brick: DirectionReport,
}

/// One direction.
#[derive(Clone, Debug, Serialize)]
pub(super) struct DirectionReport {
    /// What the model of the link did.
    #[serde(flatten)]
    pub(super) link: Counters,
    /// Bytes that were delivered and that the real end did not take: it was not there, or too slow.
    pub(super) bytes_untaken: u64,
    /// Chunks that the real end's port dropped.
    pub(super) chunks_dropped: u64,
    /// What became of the frames of each sender, `system/component`.
    pub(super) frames: BTreeMap<String, FrameCounts>,
}

/// The counts of a ledger under the names of the senders.
pub(super) fn by_sender(ledger: &FrameLedger) -> BTreeMap<String, FrameCounts> {
    let named = ledger.counts().map(|(source, counts)| (source.to_string(), counts));
    named.collect()
}

impl RelayReport {
    /// As a table.
    pub(super) fn table(&self) -> String {
        let mut text = format!(
            "link {}, seed {}, {:.1} s, {} outages\n\n{:<34}{:>14}{:>14}\n",
            self.profile, self.seed, self.duration_s, self.outages, "", "to station", "to brick"
        );
        let (station, brick) = (&self.to_station, &self.to_brick);
        for ((name, to_station), (_, to_brick)) in rows(station).into_iter().zip(rows(brick)) {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{name:<34}{to_station:>14}{to_brick:>14}");
        }
        for (end, direction) in [("station", station), ("brick", brick)] {
            for (source, frames) in &direction.frames {
                let FrameCounts { sent, whole, lost, .. } = frames;
                let _ =
                    writeln!(text, "frames of {source} to the {end}: {sent} sent, {whole} arrived whole, {lost} lost");
            }
        }
        text
    }
}

fn rows(direction: &DirectionReport) -> [(&'static str, u64); 16] {
    let link = direction.link;
    [
        ("units offered", link.units_offered),
        ("bytes offered", link.bytes_offered),
        ("bytes delivered", link.bytes_delivered),
        ("bytes on the way at the end", link.bytes_on_the_way),
        ("bytes lost to a full buffer", link.bytes_lost_to_full_buffer),
        ("bytes of units lost whole", link.bytes_lost_alone),
        ("bytes lost in bursts", link.bytes_lost_in_bursts),
        ("single bytes missing", link.bytes_missing),
        ("bytes lost to outages", link.bytes_lost_to_outages),
        ("bits turned over", link.bits_flipped),
        ("stalls", link.stalls),
        ("datagrams held back", link.held_back),
        ("datagrams repeated", link.repeated),
        ("chunks delivered", link.chunks_delivered),
        ("bytes that the end did not take", direction.bytes_untaken),
        ("chunks that its port dropped", direction.chunks_dropped),
    ]
}
