//! Files that our writer does not write: flipped bits, missing messages, destroyed framing, an older format, and one made by hand from
//! the specification.

use std::io::Cursor;

use posebridge_recording::container::{
    INPUT_ENCODING, INPUT_TOPIC, ReadError, RecordingEnd, RecordingGap, RecordingReader, RecordingWriter, TruthSample,
    read_truth,
};
use posebridge_telemetry::{Heading, Input, LinkId, LinkState, Meters, PeerId, Pose, Timestamp};

use crate::container::{Recorded, UTC_START_NANOS, header, read_all, record_of, sample, write};

#[test]
fn a_flipped_bit_never_becomes_another_input() {
    let items = sample();
    let bytes = write(&items);
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        let Ok(reader) = RecordingReader::open(&damaged) else {
            continue;
        };
        let mut rest = items.iter();
        for found in reader.flatten() {
            assert!(rest.any(|item| *item == found), "byte {at} gave {found:?}");
        }
    }
}

#[test]
fn a_damaged_message_is_named_by_its_offset_and_the_next_one_follows() {
    let items: Vec<Recorded> = (0..5).map(|n| (Timestamp::from_millis(n), Input::Tick)).collect();
    let mut damaged = write(&items);
    let at = record_of(&damaged, 2);
    damaged[at + 9 + 22 + 1] ^= 1;
    let found: Vec<_> = RecordingReader::open(&damaged).unwrap().collect();
    let [Err(ReadError::Chunk { .. }), found @ ..] = &found[..] else {
        panic!("the chunk's checksum said nothing: {found:?}");
    };
    assert_eq!(found.len(), 5);
    let Err(ReadError::Message { offset, .. }) = &found[2] else {
        panic!("{:?}", found[2]);
    };
    assert_eq!(*offset, at as u64);
    assert!(found.iter().filter(|item| item.is_ok()).count() == 4);
}

#[test]
fn a_missing_message_is_a_gap() {
    let items: Vec<Recorded> = (0..4).map(|n| (Timestamp::from_millis(n), Input::Tick)).collect();
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header()).unwrap();
    writer.record(items[0].0, &items[0].1).unwrap();
    let gap = RecordingGap { inputs: 1, from: items[0].0, to: items[2].0 };
    writer.record_gap(&gap).unwrap();
    for (now, input) in &items[2..] {
        writer.record(*now, input).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let found: Vec<_> = RecordingReader::open(&bytes).unwrap().collect();
    assert!(matches!(found[1], Err(ReadError::Gap { expected: 1, found: 2, .. })), "{:?}", found[1]);
    assert_eq!(found[2], Ok(items[2].clone()));
    assert_eq!(found.len(), 4);
}

#[test]
fn destroyed_framing_costs_the_rest_of_its_chunk_and_no_more() {
    let items = sample();
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header()).unwrap();
    for (now, input) in &items {
        writer.record(*now, input).unwrap();
        writer.flush().unwrap();
    }
    let mut bytes = writer.finish().unwrap().into_inner();
    let at = record_of(&bytes, 5);
    bytes[at] = 0;
    let found: Vec<_> = RecordingReader::open(&bytes).unwrap().collect();
    let good = found.iter().filter(|item| item.is_ok()).count();
    assert_eq!(good, items.len() - 1);
    let defects: Vec<_> = found.iter().filter_map(|item| item.as_ref().err()).collect();
    assert!(
        matches!(defects[..], [ReadError::Chunk { .. }, ReadError::Chunk { .. }, ReadError::Gap { .. }]),
        "{defects:?}"
    );
}

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
    let hello = Input::Bytes { link: LinkId(0), peer: PeerId(0), bytes: b"hello".to_vec() };
    let up = Input::Link { link: LinkId(0), state: LinkState::Up };
    let expected =
        [(Timestamp::from_micros(1), Input::Tick), (Timestamp::from_micros(2), hello), (Timestamp::from_micros(3), up)];
    assert_eq!(read_all(bytes), expected);
    let pose = Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5));
    let sample = TruthSample { robot: None, time: Timestamp::from_nanos(7), pose, odometry: None };
    assert_eq!(read_truth(bytes).unwrap(), [sample]);
}
