//! `posebridge inspect`: what a file carries, without estimating anything.
//!
//! Reads recordings of ours, telemetry logs, bare captures of a link's bytes and descriptors of foreign recordings; the first three
//! within a fixed memory, recordings of ours apart. Frames are verified with the checksum seeds of every known dialect.
//! docs/inspect.md describes the JSON object.

mod descriptor;
mod framed;
mod json;
mod own;
mod table;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use posebridge_protocol::census::Census;
use posebridge_recording::tlog::ByteOrder;

use super::{Failure, Stage};
use crate::cli::DataFlags;
use crate::input_file::{InputFile, Kind};
use crate::stdout;

/// Flags of `inspect`.
#[derive(Args, Clone, Debug)]
pub struct InspectArgs {
    /// A recording (*.mcap), a telemetry log (*.tlog, *.tlog.gz), bytes of a link (*.raw, *.bin) or a descriptor (*.toml).
    pub file: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Print one JSON object (docs/inspect.md) instead of tables.
    #[arg(long)]
    pub json: bool,
}

/// What was found in a file of frames.
#[derive(Debug, Default)]
struct Framed {
    /// Bytes of the file, or of its MAVLink links, unpacked.
    bytes: u64,
    census: Census,
    /// Frames of messages that nobody knows.
    unknown_frames: u64,
    /// Their bytes, with the times before them.
    unknown_bytes: u64,
    /// Bytes in no verified frame; those of unknown ones are among them.
    bytes_outside: u64,
    /// The zero of the census's times, in microseconds since 1970; `None` if the file has no times.
    epoch_micros: Option<u64>,
    tlog: Option<TlogFacts>,
    own: Option<own::OwnFacts>,
}

/// What only a telemetry log has.
#[derive(Clone, Copy, Debug, Default)]
struct TlogFacts {
    order: ByteOrder,
    /// How many times end in each value of the two lowest bits.
    link_bits: [u64; 4],
}

impl TlogFacts {
    /// The numbers of links that the times hold, if they do: the lowest bits of times that hold none are spread evenly.
    fn links(&self) -> Vec<usize> {
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

/// Everything that is told of a file.
enum Found {
    Framed(Box<Framed>),
    Runs(Vec<descriptor::RunFacts>),
}

/// Inspects.
///
/// # Errors
/// The file cannot be read or makes no sense.
pub fn execute(args: &InspectArgs) -> Result<(), Failure> {
    let file = InputFile::open(&args.file).at_start()?;
    let (name, kind, size) = (file.name.clone(), file.kind, file.size);
    let found = match kind {
        Kind::Tlog => framed::tlog(file).map(Found::framed).while_running()?,
        Kind::Bytes => framed::bytes(file).map(Found::framed).while_running()?,
        Kind::Own => own::inspect(file, &args.file).map(Found::framed).at_start()?,
        Kind::Descriptor => Found::Runs(descriptor::inspect(&args.file, &args.data).at_start()?),
    };
    let text = if args.json { json::text(&name, kind, size, &found) } else { table::text(&name, kind, &found) };
    stdout::print(&text).while_running()
}

impl Found {
    fn framed(framed: Framed) -> Self {
        Self::Framed(Box::new(framed))
    }
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
