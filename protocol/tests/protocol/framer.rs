//! What the framer emits, whatever the chunks, the noise and the unknown messages around it.

use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind, WireVersion, checksum};
use posebridge_telemetry::{Address, ReceiveError, Timestamp};

use crate::support::mix::four_message_mix;
use crate::support::{HEARTBEAT, OwnedFramerOutput, ROBOT, at, frames, owned, scan};
use OwnedFramerOutput::{Error, Frame, UnknownFrame};

const STREAM: TransportKind = TransportKind::Stream;
const DATAGRAM: TransportKind = TransportKind::Datagram;

fn heartbeat() -> Vec<u8> {
    four_message_mix(1).concat()
}

/// The longest of the four messages, 245 bytes.
fn odometry() -> Vec<u8> {
    four_message_mix(4).swap_remove(3)
}

/// A frame of a message that no dialect has; its checksum is right for some CRC_EXTRA that we do not know.
fn stranger(payload: &[u8]) -> Vec<u8> {
    frame_of([0x39, 0x30, 0x00], payload, 0x5A)
}

fn frame_of(id: [u8; 3], payload: &[u8], crc_extra: u8) -> Vec<u8> {
    let mut frame = [&[0xFD, payload.len() as u8, 0, 0, 7, 9, 1], &id[..]].concat();
    frame.extend_from_slice(payload);
    let sum = checksum(&frame[1..], crc_extra);
    frame.extend_from_slice(&sum.to_le_bytes());
    frame
}

/// A framer and what it has emitted.
struct Bench {
    framer: Framer,
    found: Vec<OwnedFramerOutput>,
}

impl Bench {
    fn new(transport: TransportKind) -> Self {
        let config = FramerConfig { transport, ..FramerConfig::default() };
        Self { framer: Framer::new(config), found: Vec::new() }
    }

    fn push(&mut self, millis: i64, bytes: &[u8]) {
        self.framer.push(at(millis), bytes, &mut |item| self.found.push(owned(item)));
    }

    fn tick(&mut self, millis: i64) {
        self.framer.tick(at(millis), &mut |item| self.found.push(owned(item)));
    }

    /// Lets the gap pass after bytes at 0 ms.
    fn pass_gap(&mut self) {
        assert_eq!(self.framer.deadline(), Some(at(50)));
        self.tick(50);
        assert_eq!(self.framer.deadline(), None, "it is told once");
    }

    fn frames(&self) -> Vec<OwnedFramerOutput> {
        frames(&self.found)
    }
}

#[test]
fn chunking_does_not_change_the_frames() {
    let mut stream = b"noise \xFD\x09 and more".to_vec();
    stream.extend(four_message_mix(12).concat());
    stream.extend_from_slice(&heartbeat()[..15]);
    stream.extend(stranger(b"abc"));
    stream.extend(four_message_mix(4).concat());
    stream.extend(stranger(b"at the end"));
    let (complete, complete_counters) = scan(FramerConfig::default(), &stream, stream.len());
    assert_eq!(frames(&complete).len(), 12 + 1 + 4 + 1);
    for chunk in 1..stream.len() {
        let (found, counters) = scan(FramerConfig::default(), &stream, chunk);
        assert_eq!((frames(&found), counters), (frames(&complete), complete_counters), "chunk size {chunk}");
    }
}

#[test]
fn every_byte_is_accounted_for() {
    let stream: Vec<u8> = four_message_mix(8).iter().flat_map(|frame| [b"xx\xFDyy", &frame[..]].concat()).collect();
    let (found, counters) = scan(FramerConfig::default(), &stream, 64);
    assert_eq!((counters.frames, counters.garbage_bytes), (8, 8 * 5));
    let reported = found.iter().map(|item| match item {
        Error(ReceiveError::UnframedBytes { bytes }) => *bytes,
        _ => 0,
    });
    assert_eq!(reported.sum::<u32>(), 8 * 5);
}

#[test]
fn a_frame_inside_a_damaged_frame_is_not_lost() {
    // The truncated odometry claims 233 bytes of payload; complete frames follow inside its claim and behind it.
    let mix = four_message_mix(8);
    let stream = [&mix[3][..40], &mix[4..8].concat()].concat();
    let (found, counters) = scan(FramerConfig::default(), &stream, stream.len());
    let expected: Vec<_> = mix[4..8].iter().cloned().map(Frame).collect();
    assert_eq!(frames(&found), expected);
    assert_eq!((counters.garbage_bytes, counters.checksum_errors), (40, 1));
}

#[test]
fn a_truncated_header_releases_the_next_heartbeat_after_one_gap() {
    let mut bench = Bench::new(STREAM);
    bench.push(0, &odometry()[..12]);
    assert_eq!(bench.framer.deadline(), Some(at(50)));
    bench.push(10, &heartbeat());
    assert_eq!(bench.framer.deadline(), Some(at(60)));
    bench.tick(59);
    assert_eq!(bench.found, [], "the odometry may still come");
    bench.tick(60);
    let expected = [
        Error(ReceiveError::Timeout { bytes: 33 }),
        Error(ReceiveError::UnframedBytes { bytes: 12 }),
        Frame(heartbeat()),
    ];
    assert_eq!(bench.found, expected);
    assert_eq!((bench.framer.deadline(), bench.framer.counters().stalls), (None, 1));
}

#[test]
fn frames_in_pieces_with_silences_between_them_are_completed() {
    type Pieces<'a> = &'a [(i64, &'a [u8])];
    let (odometry, heartbeat) = (odometry(), heartbeat());
    let truncated = &odometry[..12];
    let late: [(Pieces<'_>, &[&Vec<u8>]); 4] = [
        // A truncated header, and more after the gap.
        (&[(0, truncated), (1_000, &heartbeat)], &[&heartbeat]),
        (&[(0, truncated), (9_000, &heartbeat[..9]), (9_001, &heartbeat[9..])], &[&heartbeat]),
        // The rest comes late, or in two pieces.
        (&[(0, &odometry[..100]), (80, &odometry[100..])], &[&odometry]),
        (&[(0, &odometry[..100]), (9_000, &odometry[100..]), (9_001, &heartbeat)], &[&odometry, &heartbeat]),
    ];
    for (case, (pieces, expected)) in late.into_iter().enumerate() {
        let mut bench = Bench::new(STREAM);
        for (millis, piece) in pieces {
            bench.push(*millis, piece);
        }
        let expected: Vec<_> = expected.iter().map(|frame| Frame((*frame).clone())).collect();
        assert_eq!(bench.frames(), expected, "case {case}");
    }
    for split in 1..odometry.len() - 1 {
        for second in [split + 1, usize::midpoint(split, odometry.len()), odometry.len() - 1] {
            let mut bench = Bench::new(STREAM);
            bench.push(0, &odometry[..split]);
            bench.push(9_000, &odometry[split..second]);
            bench.push(9_001, &odometry[second..]);
            assert_eq!(bench.frames(), [Frame(odometry.clone())], "split at {split} and {second}");
        }
    }
}

#[test]
fn a_frame_that_stops_for_seconds_is_completed_wherever_it_stopped() {
    let frame = odometry();
    for split in 1..frame.len() {
        let mut bench = Bench::new(STREAM);
        bench.push(0, &frame[..split]);
        bench.pass_gap();
        bench.push(9_000, &[&frame[split..], &heartbeat()].concat());
        let timeout = Error(ReceiveError::Timeout { bytes: split as u32 });
        assert_eq!(bench.found, [timeout, Frame(frame.clone()), Frame(heartbeat())], "split at {split}");
        let counters = bench.framer.counters();
        assert_eq!((counters.stalls, counters.garbage_bytes), (1, 0));
    }
}

#[test]
fn a_frame_that_stops_after_a_truncated_and_a_complete_one_is_completed() {
    let mix = four_message_mix(4);
    let frame = &mix[1];
    for split in 1..frame.len() {
        let mut bench = Bench::new(STREAM);
        bench.push(0, &[&mix[3][..12], &heartbeat(), &frame[..split]].concat());
        bench.pass_gap();
        assert_eq!(bench.frames(), [Frame(heartbeat())]);
        bench.push(50, &frame[split..]);
        assert_eq!(bench.frames(), [Frame(heartbeat()), Frame(frame.clone())], "split at {split}");
        let counters = bench.framer.counters();
        assert_eq!((counters.stalls, counters.garbage_bytes), (1, 12), "one silence, one stall");
    }
}

#[test]
fn a_frame_whose_rest_never_comes_is_dropped_by_the_next_bytes() {
    let mut bench = Bench::new(STREAM);
    bench.push(0, &odometry()[..100]);
    bench.pass_gap();
    bench.push(9_000, &heartbeat());
    let expected = [
        Error(ReceiveError::Timeout { bytes: 100 }),
        Error(ReceiveError::UnframedBytes { bytes: 100 }),
        Frame(heartbeat()),
    ];
    assert_eq!(bench.found, expected);
    assert_eq!(bench.framer.counters().stalls, 1, "one silence, one stall");
}

#[test]
fn impossible_headers_are_refused_before_their_bytes_come() {
    // A HEARTBEAT of 200 bytes, and flags that no version has: nothing waits for either.
    for (header, length) in [(&[0xFD, 200, 0, 0, 1, 1, 1, 0, 0, 0][..], 200), (&[0xFD, 9, 0x80][..], 9)] {
        let mut bench = Bench::new(STREAM);
        bench.push(0, &[header, &heartbeat()].concat());
        let refused = Error(ReceiveError::ImpossibleHeader { message_id: 0, length });
        assert_eq!(bench.found.first(), Some(&refused));
        assert_eq!(bench.found.last(), Some(&Frame(heartbeat())));
        assert_eq!(bench.framer.counters().impossible_headers, 1);
    }
}

#[test]
fn an_unknown_frame_is_emitted_when_a_verified_one_follows() {
    let unknown = stranger(b"who am I");
    let stream = [heartbeat(), unknown.clone(), unknown.clone(), heartbeat()].concat();
    let mut bench = Bench::new(STREAM);
    bench.push(0, &stream);
    let expected = [Frame(heartbeat()), UnknownFrame(unknown.clone()), UnknownFrame(unknown), Frame(heartbeat())];
    assert_eq!(bench.found, expected, "in the order of the bytes, untouched");
    assert_eq!(bench.framer.counters().unknown_ids, 2);
    let mut ids = Vec::new();
    Framer::new(FramerConfig::default()).push(Timestamp::ZERO, &stream, &mut |item| {
        if let FramerOutput::UnknownFrame(frame) = item {
            ids.push((frame.message_id, frame.source, frame.sequence));
        }
    });
    assert_eq!(ids, [(12_345, Address::new(9, 1), 7); 2]);
}

/// RPM of ardupilotmega.xml: CRC_EXTRA 207, eight bytes. A sender may have been built from another version of that file.
#[test]
fn a_frame_of_a_foreign_dialect_is_verified_and_one_of_another_version_of_it_is_unknown() {
    const RPM: [u8; 3] = [226, 0, 0];
    let same = frame_of(RPM, &[1; 8], 207);
    let other_fields = frame_of(RPM, &[1; 8], 0x5A);
    let longer = frame_of(RPM, &[1; 12], 207);
    let stream = [&same, &other_fields, &longer, &heartbeat()].map(Vec::as_slice).concat();
    let expected = [Frame(same), UnknownFrame(other_fields), UnknownFrame(longer), Frame(heartbeat())];
    for chunk in 1..=stream.len() {
        let (found, counters) = scan(FramerConfig::default(), &stream, chunk);
        assert_eq!(found, expected, "in pieces of {chunk} bytes");
        assert_eq!((counters.frames, counters.foreign_frames, counters.unknown_ids), (2, 1, 2));
        assert_eq!((counters.checksum_errors, counters.garbage_bytes), (0, 0));
    }
}

#[test]
fn an_unknown_frame_at_the_end_waits_for_the_gap_and_one_that_stops_for_its_rest() {
    let unknown = stranger(b"who am I");
    let mut bench = Bench::new(STREAM);
    bench.push(0, &unknown);
    assert_eq!(bench.found, []);
    bench.pass_gap();
    assert_eq!(bench.found, [UnknownFrame(unknown.clone())]);
    assert_eq!(bench.framer.counters().stalls, 0);

    let mut bench = Bench::new(STREAM);
    bench.push(0, &unknown[..15]);
    bench.pass_gap();
    bench.push(9_000, &[&unknown[15..], &heartbeat()].concat());
    assert_eq!(bench.found, [UnknownFrame(unknown), Frame(heartbeat())]);
}

#[test]
fn an_unknown_claim_never_costs_or_delays_a_known_frame() {
    // Its payload is a complete heartbeat, and its claim reaches beyond the heartbeat's end.
    let disguised = stranger(&[b"ab", &heartbeat()[..], b"cd"].concat());
    let stream = [disguised, heartbeat()].concat();
    for transport in [STREAM, DATAGRAM] {
        let config = FramerConfig { transport, ..FramerConfig::default() };
        let (found, counters) = scan(config, &stream, stream.len());
        assert_eq!(frames(&found), [Frame(heartbeat()), Frame(heartbeat())]);
        assert_eq!(counters.unknown_ids, 0);
    }
    // The claim is longer than everything that follows.
    let mut bench = Bench::new(STREAM);
    bench.push(0, &[&[0xFD, 250, 0, 0, 7, 9, 1, 0x39, 0x30, 0x00], &heartbeat()[..]].concat());
    assert_eq!(bench.frames(), [Frame(heartbeat())]);
}

#[test]
fn a_datagram_decides_at_its_end() {
    let unknown = stranger(b"forward me");
    let mut bench = Bench::new(DATAGRAM);
    bench.push(0, &unknown);
    bench.push(0, &[unknown.clone(), heartbeat()].concat());
    assert_eq!(bench.found, [UnknownFrame(unknown.clone()), UnknownFrame(unknown), Frame(heartbeat())]);
    bench.found.clear();
    bench.push(0, &heartbeat()[..15]);
    bench.push(0, &heartbeat());
    assert_eq!(bench.framer.deadline(), None, "a datagram has no continuation");
    assert_eq!(bench.frames(), [Frame(heartbeat())]);
    assert_eq!(bench.framer.counters().stalls, 1);
}

#[test]
fn unknown_telemetry_between_heartbeats_of_one_second_is_kept() {
    let unknown = stranger(&[0x11; 60]);
    let mut bench = Bench::new(STREAM);
    for frame in 0..50 {
        bench.push(20 * frame, &unknown);
    }
    bench.push(1_000, &heartbeat());
    assert_eq!(bench.frames().len(), 50 + 1);
    assert_eq!(bench.framer.counters().garbage_bytes, 0);
}

#[test]
fn version_1_is_received_only_when_configured() {
    let mut encoder = Encoder::new(WireVersion::V1);
    let mut stream = b"\xFE\x01".to_vec();
    encoder.encode(ROBOT, &HEARTBEAT, &mut stream);
    encoder.encode(ROBOT, &HEARTBEAT, &mut stream);
    let (deaf, counters) = scan(FramerConfig::default(), &stream, stream.len());
    assert_eq!((frames(&deaf).len(), counters.garbage_bytes), (0, stream.len() as u64));
    let config = FramerConfig { accept_v1: true, ..FramerConfig::default() };
    for chunk in 1..=stream.len() {
        let (found, counters) = scan(config, &stream, chunk);
        assert_eq!((frames(&found).len(), counters.garbage_bytes), (2, 2), "chunk size {chunk}");
    }
}
