//! Files that our writer does not write: an older format, and one made by hand from the specification.

use std::io::Cursor;

use posebridge_recording::container::{
    INPUT_ENCODING, INPUT_TOPIC, RecordingEnd, RecordingReader, TruthSample, read_truth,
};
use posebridge_telemetry::{Heading, Input, LinkId, LinkState, Meters, Pose, Timestamp};

use crate::{Recorded, UTC_START_NANOS, read_all, record_of, sample, write};

/// A recording of format 2, which has no chunks and the host clock's own times.
fn unchunked(items: &[Recorded]) -> Vec<u8> {
    let chunked = write(items);
    let mut file = mcap::WriteOptions::new().use_chunks(false).create(Cursor::new(Vec::new())).unwrap();
    let metadata = [
        ("format", "2"),
        ("program_version", "0.1.0"),
        ("utc_start_micros", "1700000000123456"),
        ("config_toml", ""),
        ("links", "[]"),
    ];
    file.write_metadata(&mcap::records::Metadata {
        name: "posebridge.recording".to_owned(),
        metadata: metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into(),
    })
    .unwrap();
    let schema = file.add_schema(INPUT_ENCODING, INPUT_ENCODING, b"text").unwrap();
    let channel = file.add_channel(schema, INPUT_TOPIC, INPUT_ENCODING, &std::collections::BTreeMap::new()).unwrap();
    for message in mcap::MessageStream::new(&chunked).unwrap() {
        let message = message.unwrap();
        let time = message.log_time - UTC_START_NANOS;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: message.sequence,
            log_time: time,
            publish_time: time,
        };
        if message.channel.topic == INPUT_TOPIC {
            file.write_to_known_channel(&header, &message.data).unwrap();
        }
    }
    file.finish().unwrap();
    file.into_inner().into_inner()
}

#[test]
fn a_recording_without_chunks_is_still_read_whole_or_cut() {
    let items = sample();
    let bytes = unchunked(&items);
    let reader = RecordingReader::open(&bytes).unwrap();
    assert_eq!(reader.header().format, 2);
    assert_eq!(reader.recording_end(), RecordingEnd::Complete);
    assert_eq!(read_all(&bytes), items);
    let cut = record_of(&bytes, 7) + 12;
    let found: Vec<_> = RecordingReader::open(&bytes[..cut]).unwrap().flatten().collect();
    assert_eq!(found, items[..7]);
    let ending = RecordingReader::open(&bytes[..cut]).unwrap().recording_end();
    let offset = record_of(&bytes, 7) as u64;
    assert!(matches!(ending, RecordingEnd::Truncated { offset: at, .. } if at == offset));
}

#[test]
fn a_file_that_was_put_together_by_hand_from_the_specification_is_read() {
    let bytes = &include_bytes!("../../../../fuzz/corpus/recording/chunks_and_truth")[1..];
    let reader = RecordingReader::open(bytes).unwrap();
    assert_eq!(reader.header().utc_start_micros, 1_700_000_000_000_000);
    assert_eq!((reader.part_header().part, reader.part_header().inputs_before), (2, 5));
    assert_eq!(reader.part_header().continues.as_deref(), Some("a.mcap"));
    assert_eq!(reader.recording_end(), RecordingEnd::Complete);
    let hello = Input::Bytes { link: LinkId(0), peer: posebridge_telemetry::PeerId(0), bytes: b"hello".to_vec() };
    let up = Input::Link { link: LinkId(0), state: LinkState::Up };
    let expected =
        [(Timestamp::from_micros(1), Input::Tick), (Timestamp::from_micros(2), hello), (Timestamp::from_micros(3), up)];
    assert_eq!(read_all(bytes), expected);
    let pose = Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5));
    let sample = TruthSample { robot: None, time: Timestamp::from_nanos(7), pose, odometry: None };
    assert_eq!(read_truth(bytes).unwrap(), [sample]);
}
