//! Flipped bits, missing messages, destroyed framing.

use std::io::Cursor;

use posebridge_recording::container::{ReadError, RecordingGap, RecordingReader, RecordingWriter};
use posebridge_telemetry::{Input, Timestamp};

use crate::{Recorded, header, record_of, sample, write};

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
