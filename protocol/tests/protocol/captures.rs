//! Frames of real vehicles, against counts that foreign decoders made.
//!
//! A part of one recording lies beside the tests; the whole collection is used when POSEBRIDGE_DATA names the folder that
//! holds `mavlink/`. Expected counts come from pymavlink with the ardupilotmega dialect.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use posebridge_protocol::dialect::{decode, message_id_named};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, SequenceTracker, TransportKind};
use posebridge_protocol::message::Message;
use posebridge_telemetry::Timestamp;

pub(crate) const RECORDED: &[u8] = include_bytes!("../data/copter_apm_v1_2013_first150.tlog");
/// The time before each frame of a .tlog file.
const TLOG_STAMP: usize = 8;

/// What a scan of a file gave.
#[derive(Debug, Default)]
struct ScanTotals {
    by_id: BTreeMap<u32, u64>,
    by_source: BTreeMap<String, u64>,
    missing: BTreeMap<String, u64>,
    foreign: u64,
    unknown: u64,
    garbage: u64,
    messages: Vec<Message>,
}

/// Scans pieces of bytes, each by itself when `transport` is datagrams.
fn census<'a>(transport: TransportKind, pieces: impl Iterator<Item = &'a [u8]>) -> ScanTotals {
    let mut framer = Framer::new(FramerConfig { accept_v1: true, transport, ..FramerConfig::default() });
    let mut sequences = SequenceTracker::new();
    let mut census = ScanTotals::default();
    let mut take = |found: FramerOutput<'_>| {
        let frame = match found {
            FramerOutput::Frame(frame) => {
                *census.by_id.entry(frame.message_id).or_default() += 1;
                if let Some(message) = decode(&frame).expect("real messages make sense") {
                    census.messages.push(message);
                }
                frame
            }
            FramerOutput::UnknownFrame(frame) => {
                census.unknown += 1;
                frame
            }
            FramerOutput::Error(_) => return,
        };
        let source = frame.source.to_string();
        let missing = sequences.record_number(frame.source, frame.sequence);
        *census.missing.entry(source.clone()).or_default() += u64::from(missing);
        *census.by_source.entry(source).or_default() += 1;
    };
    for piece in pieces {
        framer.push(Timestamp::ZERO, piece, &mut take);
    }
    if let Some(deadline) = framer.deadline() {
        framer.tick(deadline, &mut take);
    }
    framer.finish(&mut take);
    census.foreign = framer.counters().foreign_frames;
    census.garbage = framer.counters().garbage_bytes;
    census
}

/// The frames of a .tlog file, by the lengths in their headers.
pub(crate) fn records(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut records = Vec::new();
    while let Some((_, rest)) = bytes.split_at_checked(TLOG_STAMP) {
        let length = match *rest {
            [0xFE, payload, ..] => 8 + usize::from(payload),
            [0xFD, payload, flags, ..] => 12 + usize::from(payload) + 13 * usize::from(flags & 1),
            _ => rest.len(),
        };
        let (frame, rest) = rest.split_at(length.min(rest.len()));
        records.push(frame);
        bytes = rest;
    }
    records
}

#[test]
fn the_beginning_of_a_recorded_flight() {
    let records = records(RECORDED);
    assert_eq!(records.len(), 150);
    let totals = census(TransportKind::Datagram, records.into_iter());
    // HEARTBEAT, PARAM_REQUEST_LIST, PARAM_VALUE; RADIO belongs to ArduPilot's dialect.
    assert_eq!(totals.by_id, BTreeMap::from([(0, 14), (21, 1), (22, 128), (166, 7)]));
    assert_eq!((totals.foreign, totals.unknown, totals.garbage), (7, 0, 0));
    let Some(Message::Heartbeat(first)) = totals.messages.first() else {
        panic!("{:?}", totals.messages.first());
    };
    assert_eq!((first.vehicle_type, first.autopilot), (6, 8), "a ground station");
}

#[test]
fn times_between_the_frames_are_only_garbage() {
    let totals = census(TransportKind::Stream, std::iter::once(RECORDED));
    assert_eq!(totals.by_id, BTreeMap::from([(0, 14), (21, 1), (22, 128), (166, 7)]));
}

#[derive(Debug)]
struct ExpectedCounts {
    file: String,
    text: serde_json::Value,
}

impl ExpectedCounts {
    fn counts(&self, key: &str) -> BTreeMap<String, u64> {
        serde_json::from_value(self.text[key].clone()).expect("counts")
    }
}

fn collection(folder: &Path) -> Vec<ExpectedCounts> {
    let mut expected = Vec::new();
    for entry in std::fs::read_dir(folder).expect("the mavlink folder") {
        let path = entry.expect("an entry").path();
        if path.to_string_lossy().ends_with(".expected.json") {
            let text = std::fs::read_to_string(&path).expect("expected counts");
            let text: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            let file = text["file"].as_str().expect("a name").to_owned();
            expected.push(ExpectedCounts { file, text });
        }
    }
    expected
}

/// The bytes of a file of the collection, plain or packed.
fn bytes_of(folder: &Path, file: &str) -> Vec<u8> {
    let plain = folder.join(file);
    if plain.exists() {
        return std::fs::read(plain).expect("a capture");
    }
    let packed = File::open(folder.join(format!("{file}.gz"))).expect("a packed capture");
    let mut bytes = Vec::new();
    GzDecoder::new(packed).read_to_end(&mut bytes).expect("gzip");
    bytes
}

#[test]
fn the_collection_counts_as_foreign_decoders_count() {
    let Some(root) = std::env::var_os("POSEBRIDGE_DATA") else {
        println!("POSEBRIDGE_DATA is not set: only the recording beside the tests was read");
        return;
    };
    let folder = PathBuf::from(root).join("mavlink");
    let mut read = 0;
    for expected in collection(&folder) {
        compare(&expected, &bytes_of(&folder, &expected.file));
        read += 1;
    }
    assert!(read >= 6, "only {read} files of the collection were read");
}

fn compare(expected: &ExpectedCounts, bytes: &[u8]) {
    let file = &expected.file;
    let has_times = Path::new(file).extension() == Some(OsStr::new("tlog"));
    let totals = if has_times {
        census(TransportKind::Datagram, records(bytes).into_iter())
    } else {
        census(TransportKind::Stream, std::iter::once(bytes))
    };
    let by_message = expected.counts("by_message").into_iter();
    let by_id = by_message.map(|(name, count)| (message_id_named(&name).expect("a known message"), count));
    assert_eq!(totals.by_id, by_id.collect(), "{file}");
    assert_eq!(totals.unknown, 0, "{file}");
    assert_eq!(totals.by_source, expected.counts("by_source"), "{file}");
    if has_times {
        compare_losses(expected, &totals);
    } else {
        let outside = expected.text["bytes_outside_valid_frames"].as_u64();
        assert_eq!(Some(totals.garbage), outside, "{file}: bytes outside");
    }
}

/// Senders that do not count by one have absurd losses by plain summing; those are only required to be capped.
const ABSURD: u64 = 1_000;

fn compare_losses(expected: &ExpectedCounts, totals: &ScanTotals) {
    for (source, missing) in expected.counts("seq_missing_by_source") {
        let ours = totals.missing[&source];
        if missing < ABSURD {
            assert_eq!(ours, missing, "{}: lost frames of {source}", expected.file);
        } else {
            assert!(ours < missing, "{}: {source}", expected.file);
        }
    }
}
