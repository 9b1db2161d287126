//! What the framer hands out, whatever the chunks, the noise and the unknown messages around it.

#[path = "support/framer_output.rs"]
mod framer_output;
#[path = "support/mix.rs"]
mod mix;

use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind, WireVersion, checksum};
use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_telemetry::{Address, ReceiveError, TimeDelta, Timestamp};

use framer_output::{OwnedFramerOutput, frames, owned, scan};
use mix::four_message_mix;

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

const DATAGRAM: FramerConfig =
    FramerConfig { accept_v1: false, gap: TimeDelta::from_millis(50), transport: TransportKind::Datagram };

fn heartbeat() -> Vec<u8> {
    four_message_mix(1).concat()
}

/// A frame of a message that no dialect has; its checksum is right for some CRC_EXTRA that we do not know.
fn stranger(payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![0xFD, payload.len() as u8, 0, 0, 7, 9, 1, 0x39, 0x30, 0x00];
    frame.extend_from_slice(payload);
    let sum = checksum(&frame[1..], 0x5A);
    frame.extend_from_slice(&sum.to_le_bytes());
    frame
}

#[test]
fn chunking_does_not_change_the_frames() {
    let mut stream = b"noise \xFD\x09 and more".to_vec();
    for frame in four_message_mix(12) {
        stream.extend_from_slice(&frame);
    }
    stream.extend_from_slice(&heartbeat()[..15]);
    stream.extend_from_slice(&stranger(b"abc"));
    stream.extend_from_slice(&four_message_mix(4).concat());
    stream.extend_from_slice(&stranger(b"at the end"));
    let config = FramerConfig::default();
    let (whole, whole_counters) = scan(config, &stream, stream.len());
    assert_eq!(frames(&whole).len(), 12 + 1 + 4 + 1);
    for chunk in 1..stream.len() {
        let (found, counters) = scan(config, &stream, chunk);
        assert_eq!(frames(&found), frames(&whole), "chunk size {chunk}");
        assert_eq!(counters, whole_counters, "chunk size {chunk}");
    }
}

#[test]
fn every_byte_is_accounted_for() {
    let mut stream = Vec::new();
    for frame in four_message_mix(8) {
        stream.extend_from_slice(b"xx\xFDyy");
        stream.extend_from_slice(&frame);
    }
    let (found, counters) = scan(FramerConfig::default(), &stream, 64);
    assert_eq!(counters.frames, 8);
    assert_eq!(counters.garbage_bytes, 8 * 5);
    let reported: u32 = found
        .iter()
        .map(|item| if let OwnedFramerOutput::Error(ReceiveError::UnframedBytes { bytes }) = item { *bytes } else { 0 })
        .sum();
    assert_eq!(reported, 8 * 5);
}

#[test]
fn a_frame_inside_a_damaged_frame_is_not_lost() {
    // The torn odometry claims 233 bytes of payload; whole frames follow inside its claim and behind it.
    let mix = four_message_mix(8);
    let mut stream = mix[3][..40].to_vec();
    stream.extend_from_slice(&mix[4..8].concat());
    let (found, counters) = scan(FramerConfig::default(), &stream, stream.len());
    let expected: Vec<OwnedFramerOutput> = mix[4..8].iter().cloned().map(OwnedFramerOutput::Frame).collect();
    assert_eq!(frames(&found), expected);
    assert_eq!(counters.garbage_bytes, 40);
    assert_eq!(counters.checksum_errors, 1);
}

#[test]
fn a_torn_header_releases_the_next_heartbeat_after_one_gap() {
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    let torn = &four_message_mix(4)[3][..12];
    let at = |millis| Timestamp::ZERO + TimeDelta::from_millis(millis);
    framer.push(at(0), torn, &mut |item| found.push(owned(item)));
    assert_eq!(framer.deadline(), Some(at(50)));
    framer.push(at(10), &heartbeat(), &mut |item| found.push(owned(item)));
    assert!(found.is_empty(), "the odometry may still come");
    assert_eq!(framer.deadline(), Some(at(60)));
    framer.tick(at(59), &mut |item| found.push(owned(item)));
    assert!(found.is_empty(), "not yet due");
    framer.tick(at(60), &mut |item| found.push(owned(item)));
    let expected = [
        OwnedFramerOutput::Error(ReceiveError::Timeout { bytes: 33 }),
        OwnedFramerOutput::Error(ReceiveError::UnframedBytes { bytes: 12 }),
        OwnedFramerOutput::Frame(heartbeat()),
    ];
    assert_eq!(found, expected);
    assert_eq!(framer.deadline(), None);
    assert_eq!(framer.counters().stalls, 1);
}

#[test]
fn a_torn_header_is_given_up_when_bytes_come_after_the_gap() {
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    let torn = &four_message_mix(4)[3][..12];
    framer.push(Timestamp::ZERO, torn, &mut |item| found.push(owned(item)));
    framer.push(Timestamp::from_millis(1_000), &heartbeat(), &mut |item| {
        found.push(owned(item));
    });
    assert_eq!(frames(&found), [OwnedFramerOutput::Frame(heartbeat())]);
}

#[test]
fn a_late_continuation_still_completes_its_frame() {
    let frame = &four_message_mix(4)[3];
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, &frame[..100], &mut |item| {
        found.push(owned(item));
    });
    framer.push(Timestamp::from_millis(80), &frame[100..], &mut |item| {
        found.push(owned(item));
    });
    assert_eq!(found, [OwnedFramerOutput::Frame(frame.clone())]);
}

#[test]
fn a_frame_that_stops_for_seconds_is_completed_wherever_it_stopped() {
    let frame = &four_message_mix(4)[3];
    for split in 1..frame.len() {
        let mut framer = Framer::new(FramerConfig::default());
        let mut found = Vec::new();
        framer.push(Timestamp::ZERO, &frame[..split], &mut |item| {
            found.push(owned(item));
        });
        let deadline = framer.deadline().unwrap();
        framer.tick(deadline, &mut |item| found.push(owned(item)));
        assert_eq!(framer.deadline(), None, "it is told once");
        let rest = [&frame[split..], &heartbeat()].concat();
        framer.push(Timestamp::from_millis(9_000), &rest, &mut |item| {
            found.push(owned(item));
        });
        let expected = [
            OwnedFramerOutput::Error(ReceiveError::Timeout { bytes: split as u32 }),
            OwnedFramerOutput::Frame(frame.clone()),
            OwnedFramerOutput::Frame(heartbeat()),
        ];
        assert_eq!(found, expected, "split at {split}");
        assert_eq!(framer.counters().stalls, 1);
        assert_eq!(framer.counters().garbage_bytes, 0);
    }
}

#[test]
fn a_frame_that_goes_on_in_pieces_after_seconds_is_completed() {
    let frame = &four_message_mix(4)[3];
    for split in 1..frame.len() - 1 {
        for second in [split + 1, usize::midpoint(split, frame.len()), frame.len() - 1] {
            let mut framer = Framer::new(FramerConfig::default());
            let mut found = Vec::new();
            let pieces = [(0, &frame[..split]), (9_000, &frame[split..second]), (9_001, &frame[second..])];
            for (millis, piece) in pieces {
                framer.push(Timestamp::from_millis(millis), piece, &mut |item| {
                    found.push(owned(item));
                });
            }
            assert_eq!(frames(&found), [OwnedFramerOutput::Frame(frame.clone())], "split at {split} and {second}");
        }
    }
}

#[test]
fn a_frame_that_stops_behind_a_torn_one_and_a_whole_one_is_completed() {
    let mix = four_message_mix(4);
    let torn = &mix[3][..12];
    let frame = &mix[1];
    for split in 1..frame.len() {
        let mut framer = Framer::new(FramerConfig::default());
        let mut found = Vec::new();
        let first = [torn, &heartbeat(), &frame[..split]].concat();
        framer.push(Timestamp::ZERO, &first, &mut |item| found.push(owned(item)));
        let deadline = framer.deadline().unwrap();
        framer.tick(deadline, &mut |item| found.push(owned(item)));
        assert_eq!(frames(&found), [OwnedFramerOutput::Frame(heartbeat())]);
        assert_eq!(framer.deadline(), None, "it is told once");
        framer.push(deadline, &frame[split..], &mut |item| {
            found.push(owned(item));
        });
        let expected = [OwnedFramerOutput::Frame(heartbeat()), OwnedFramerOutput::Frame(frame.clone())];
        assert_eq!(frames(&found), expected, "split at {split}");
        assert_eq!(framer.counters().stalls, 1, "one silence, one stall");
        assert_eq!(framer.counters().garbage_bytes, 12);
    }
}

#[test]
fn a_frame_in_pieces_after_a_torn_one_and_seconds_does_not_wait_for_the_gap() {
    let torn = &four_message_mix(4)[3][..12];
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    let whole = heartbeat();
    let pieces = [(0, torn), (9_000, &whole[..9]), (9_001, &whole[9..])];
    for (millis, piece) in pieces {
        framer.push(Timestamp::from_millis(millis), piece, &mut |item| {
            found.push(owned(item));
        });
    }
    assert_eq!(frames(&found), [OwnedFramerOutput::Frame(whole.clone())]);
}

#[test]
fn an_unknown_frame_that_stops_for_seconds_is_completed_too() {
    let unknown = stranger(b"who am I");
    let (first, rest) = unknown.split_at(15);
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, first, &mut |item| found.push(owned(item)));
    let deadline = framer.deadline().unwrap();
    framer.tick(deadline, &mut |item| found.push(owned(item)));
    let rest = [rest, &heartbeat()].concat();
    framer.push(Timestamp::from_millis(9_000), &rest, &mut |item| {
        found.push(owned(item));
    });
    let expected = [OwnedFramerOutput::UnknownFrame(unknown.clone()), OwnedFramerOutput::Frame(heartbeat())];
    assert_eq!(found, expected);
}

#[test]
fn a_frame_whose_rest_never_comes_is_given_up_by_what_comes_next() {
    let torn = &four_message_mix(4)[3][..100];
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, torn, &mut |item| found.push(owned(item)));
    let deadline = framer.deadline().unwrap();
    framer.tick(deadline, &mut |item| found.push(owned(item)));
    framer.push(Timestamp::from_millis(9_000), &heartbeat(), &mut |item| {
        found.push(owned(item));
    });
    let expected = [
        OwnedFramerOutput::Error(ReceiveError::Timeout { bytes: 100 }),
        OwnedFramerOutput::Error(ReceiveError::UnframedBytes { bytes: 100 }),
        OwnedFramerOutput::Frame(heartbeat()),
    ];
    assert_eq!(found, expected);
    assert_eq!(framer.counters().stalls, 1, "one silence, one stall");
}

#[test]
fn impossible_headers_are_refused_before_their_bytes_come() {
    // A HEARTBEAT of 200 bytes, and flags that no version has: nothing waits for either.
    for (header, message_id, length) in
        [(&[0xFD, 200, 0, 0, 1, 1, 1, 0, 0, 0][..], 0, 200), (&[0xFD, 9, 0x80][..], 0, 9)]
    {
        let mut stream = header.to_vec();
        stream.extend_from_slice(&heartbeat());
        let mut framer = Framer::new(FramerConfig::default());
        let mut found = Vec::new();
        framer.push(Timestamp::ZERO, &stream, &mut |item| found.push(owned(item)));
        let refused = OwnedFramerOutput::Error(ReceiveError::ImpossibleHeader { message_id, length });
        assert_eq!(found.first(), Some(&refused));
        assert_eq!(found.last(), Some(&OwnedFramerOutput::Frame(heartbeat())));
        assert_eq!(framer.counters().impossible_headers, 1);
    }
}

#[test]
fn an_unknown_frame_is_handed_out_when_a_verified_one_follows() {
    let unknown = stranger(b"who am I");
    let stream = [heartbeat(), unknown.clone(), unknown.clone(), heartbeat()].concat();
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    let mut ids = Vec::new();
    framer.push(Timestamp::ZERO, &stream, &mut |item| {
        if let FramerOutput::UnknownFrame(frame) = item {
            ids.push((frame.message_id, frame.source, frame.sequence));
        }
        found.push(owned(item));
    });
    let expected = [
        OwnedFramerOutput::Frame(heartbeat()),
        OwnedFramerOutput::UnknownFrame(unknown.clone()),
        OwnedFramerOutput::UnknownFrame(unknown),
        OwnedFramerOutput::Frame(heartbeat()),
    ];
    assert_eq!(found, expected, "in the order of the bytes, untouched");
    assert_eq!(ids, [(12_345, Address::new(9, 1), 7); 2]);
    assert_eq!(framer.counters().unknown_ids, 2);
}

#[test]
fn an_unknown_frame_at_the_end_waits_for_the_gap() {
    let unknown = stranger(b"who am I");
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, &unknown, &mut |item| found.push(owned(item)));
    assert!(found.is_empty(), "{found:?}");
    let deadline = framer.deadline().unwrap();
    framer.tick(deadline, &mut |item| found.push(owned(item)));
    assert_eq!(found, [OwnedFramerOutput::UnknownFrame(unknown)]);
    assert_eq!(framer.counters().stalls, 0);
}

#[test]
fn an_unknown_claim_never_costs_a_known_frame() {
    // Its payload is a whole heartbeat, and its claim reaches beyond the heartbeat's end.
    let mut payload = b"ab".to_vec();
    payload.extend_from_slice(&heartbeat());
    payload.extend_from_slice(b"cd");
    let disguised = stranger(&payload);
    let stream = [disguised, heartbeat()].concat();
    for transport in [TransportKind::Stream, TransportKind::Datagram] {
        let config = FramerConfig { transport, ..FramerConfig::default() };
        let (found, counters) = scan(config, &stream, stream.len());
        assert_eq!(frames(&found), [OwnedFramerOutput::Frame(heartbeat()), OwnedFramerOutput::Frame(heartbeat())]);
        assert_eq!(counters.unknown_ids, 0);
    }
}

#[test]
fn an_unknown_frame_does_not_delay_known_ones() {
    // The claim is longer than everything that follows.
    let mut stream = vec![0xFD, 250, 0, 0, 7, 9, 1, 0x39, 0x30, 0x00];
    stream.extend_from_slice(&heartbeat());
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, &stream, &mut |item| found.push(owned(item)));
    assert_eq!(frames(&found), [OwnedFramerOutput::Frame(heartbeat())]);
}

#[test]
fn a_datagram_decides_at_its_end() {
    let unknown = stranger(b"forward me");
    let mut framer = Framer::new(DATAGRAM);
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, &unknown, &mut |item| found.push(owned(item)));
    let pair = [unknown.clone(), heartbeat()].concat();
    framer.push(Timestamp::ZERO, &pair, &mut |item| found.push(owned(item)));
    let expected = [
        OwnedFramerOutput::UnknownFrame(unknown.clone()),
        OwnedFramerOutput::UnknownFrame(unknown),
        OwnedFramerOutput::Frame(heartbeat()),
    ];
    assert_eq!(found, expected);
    found.clear();
    framer.push(Timestamp::ZERO, &heartbeat()[..15], &mut |item| {
        found.push(owned(item));
    });
    framer.push(Timestamp::ZERO, &heartbeat(), &mut |item| {
        found.push(owned(item));
    });
    assert_eq!(framer.deadline(), None, "a datagram has no continuation");
    assert_eq!(frames(&found), [OwnedFramerOutput::Frame(heartbeat())]);
    assert_eq!(framer.counters().stalls, 1);
}

#[test]
fn unknown_telemetry_between_heartbeats_of_one_second_is_kept() {
    let unknown = stranger(&[0x11; 60]);
    let mut framer = Framer::new(FramerConfig::default());
    let mut handed_out = 0;
    let mut count = |item: FramerOutput<'_>| {
        if let FramerOutput::UnknownFrame(_) = item {
            handed_out += 1;
        }
    };
    for frame in 0..50 {
        framer.push(Timestamp::from_millis(20 * frame), &unknown, &mut count);
    }
    framer.push(Timestamp::from_millis(1_000), &heartbeat(), &mut count);
    assert_eq!(handed_out, 50);
    assert_eq!(framer.counters().garbage_bytes, 0);
}

#[test]
fn version_1_is_heard_only_when_asked_for() {
    let mut encoder = Encoder::new(WireVersion::V1);
    let mut stream = b"\xFE\x01".to_vec();
    encoder.encode(Address::new(1, 1), &HEARTBEAT, &mut stream);
    encoder.encode(Address::new(1, 1), &HEARTBEAT, &mut stream);
    let (deaf, counters) = scan(FramerConfig::default(), &stream, stream.len());
    assert!(frames(&deaf).is_empty());
    assert_eq!(counters.garbage_bytes, stream.len() as u64);
    let config = FramerConfig { accept_v1: true, ..FramerConfig::default() };
    for chunk in 1..=stream.len() {
        let (found, counters) = scan(config, &stream, chunk);
        assert_eq!(frames(&found).len(), 2, "chunk size {chunk}");
        assert_eq!(counters.garbage_bytes, 2, "chunk size {chunk}");
    }
}

#[test]
fn sequences_count_per_address_and_version_1_cannot_say_everything() {
    let mut encoder = Encoder::new(WireVersion::V1);
    let mut out = Vec::new();
    let robot = Address::new(1, 1);
    let station = Address::new(1, 197);
    let sequences: Vec<u8> = [robot, station, robot, robot, station]
        .into_iter()
        .map(|from| {
            out.clear();
            assert_eq!(encoder.encode(from, &HEARTBEAT, &mut out), 17);
            out[2]
        })
        .collect();
    assert_eq!(sequences, [0, 0, 1, 2, 1]);
    let wide = Message::WheelDistance {
        stamp: posebridge_protocol::message::WireStamp::Micros64(0),
        left: posebridge_telemetry::Meters(0.0),
        right: posebridge_telemetry::Meters(0.0),
    };
    out.clear();
    assert_eq!(encoder.encode(robot, &wide, &mut out), 0);
    assert!(out.is_empty());
}
