//! Four kinds of damage to a stream of 100 000 frames: every frame that was left intact must be delivered, and none may be
//! invented. The `mavlink` crate's reader runs over the same bytes.

use mavlink::dialects::common::MavMessage;
use mavlink::error::MessageReadError;
use mavlink::{MavlinkReader, MavlinkVersion};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_telemetry::{TimeDelta, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::support::mix::four_message_mix;

const FRAMES: usize = 100_000;
/// What one read from a serial port or a socket may return.
const CHUNK: usize = 4_096;

/// A damaged stream and the frames in it that were left intact.
struct DamagedStream {
    bytes: Vec<u8>,
    intact: Vec<Vec<u8>>,
}

/// Damages one frame in place and returns whether it was left intact; may append noise to the stream before it.
type DamageFn = fn(&mut Pcg64, &mut Vec<u8>, &mut Vec<u8>) -> bool;

fn damaged(seed: u64, damage: DamageFn) -> DamagedStream {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut bytes = Vec::new();
    let mut intact = Vec::new();
    for mut frame in four_message_mix(FRAMES) {
        let is_intact = damage(&mut rng, &mut bytes, &mut frame);
        bytes.extend_from_slice(&frame);
        if is_intact {
            intact.push(frame);
        }
    }
    DamagedStream { bytes, intact }
}

fn one_byte_lost(rng: &mut Pcg64, _stream: &mut Vec<u8>, frame: &mut Vec<u8>) -> bool {
    let is_intact = !rng.random_bool(0.02);
    if !is_intact {
        frame.remove(rng.random_range(0..frame.len()));
    }
    is_intact
}

fn bits_flipped(rng: &mut Pcg64, _stream: &mut Vec<u8>, frame: &mut Vec<u8>) -> bool {
    let mut is_intact = true;
    for byte in frame {
        if rng.random_bool(2e-4) {
            *byte ^= 1 << rng.random_range(0..8);
            is_intact = false;
        }
    }
    is_intact
}

fn tail_lost(rng: &mut Pcg64, _stream: &mut Vec<u8>, frame: &mut Vec<u8>) -> bool {
    let is_intact = !rng.random_bool(0.02);
    if !is_intact {
        frame.truncate(rng.random_range(1..frame.len()));
    }
    is_intact
}

fn noise_before(rng: &mut Pcg64, stream: &mut Vec<u8>, _frame: &mut Vec<u8>) -> bool {
    if rng.random_bool(0.05) {
        let length = rng.random_range(1..40);
        stream.extend((0..length).map(|_| rng.random::<u8>()));
    }
    true
}

/// Scans the stream; returns how many intact frames came out and how many frames did that were none.
fn deliver(stream: &DamagedStream) -> (usize, usize) {
    let mut framer = Framer::new(FramerConfig::default());
    let mut intact = stream.intact.iter();
    let (mut delivered, mut invented) = (0, 0);
    let mut take = |found: FramerOutput<'_>| {
        let FramerOutput::Frame(frame) = found else {
            return;
        };
        if intact.any(|expected| expected == frame.raw) {
            delivered += 1;
        } else {
            invented += 1;
        }
    };
    for chunk in stream.bytes.chunks(CHUNK) {
        framer.push(Timestamp::ZERO, chunk, &mut take);
    }
    framer.tick(Timestamp::ZERO + TimeDelta::from_millis(50), &mut take);
    (delivered, invented)
}

fn deliver_by_crate(bytes: &[u8]) -> usize {
    let mut reader = MavlinkReader::new(bytes);
    let mut frames = 0;
    loop {
        match reader.read_raw_message::<MavMessage>(MavlinkVersion::V2) {
            Ok(_) => frames += 1,
            Err(MessageReadError::Io(_)) => return frames,
            Err(MessageReadError::Parse(_)) => {}
        }
    }
}

#[test]
fn every_intact_frame_survives_the_damage_around_it() {
    let kinds: [(&str, u64, DamageFn); 4] = [
        ("one byte lost in 2 % of frames", 1, one_byte_lost),
        ("bit flips, 2e-4 per byte", 2, bits_flipped),
        ("frame tail lost in 2 %", 3, tail_lost),
        ("1-39 noise bytes before 5 %", 4, noise_before),
    ];
    println!("damage                           intact   ours  crate");
    for (name, seed, damage) in kinds {
        let stream = damaged(seed, damage);
        let intact = stream.intact.len();
        let (ours, invented) = deliver(&stream);
        let crates = deliver_by_crate(&stream.bytes);
        println!("{name:31} {intact:7} {ours:6} {crates:6}");
        assert_eq!(ours, intact, "{name}: an intact frame was lost");
        assert_eq!(invented, 0, "{name}");
        assert!(ours >= crates, "{name}: the crate delivers {crates}");
    }
}
