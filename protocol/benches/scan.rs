//! How fast frames are found, ours against the `mavlink` crate's reader, on the same bytes in the same run.
//!
//! The stream is the four-message mix of the tests: HEARTBEAT (21 bytes), SCALED_IMU (36), WHEEL_DISTANCE (149), ODOMETRY
//! (245), round robin. Both sides take turns, so that a busy machine slows both; the best of all rounds counts. Run with
//! `cargo bench -p posebridge-protocol`; files with what came over a real link, after `--`, are measured as well, without the crate, which
//! ends at the first damage.

#![expect(clippy::print_stdout, reason = "a benchmark prints its figures")]

#[path = "../tests/support/mix.rs"]
mod mix;

use std::hint::black_box;
use std::time::{Duration, Instant};

use mavlink::dialects::common::MavMessage;
use mavlink::{MavlinkReader, MavlinkVersion};
use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_telemetry::Timestamp;

/// Frames per round: more bytes than the caches hold.
const FRAMES: usize = 200_000;
/// What one read from a socket returns.
const CHUNK: usize = 64 * 1024;
const ROUNDS: usize = 9;

/// One way to do the work: its name and a function that returns how many frames it saw.
type Contender = (&'static str, fn(&[u8]) -> usize);

const CONTENDERS: [Contender; 5] = [
    ("posebridge scan", scan_all),
    ("posebridge scan, 64 KiB chunks", scan_chunks),
    ("posebridge scan + decode", scan_and_decode),
    ("mavlink crate, raw", crate_raw),
    ("mavlink crate, typed", crate_typed),
];

fn main() {
    let stream: Vec<u8> = mix::four_message_mix(FRAMES).concat();
    let best = measure("four-message mix", &stream, &CONTENDERS);
    assert!(best.iter().all(|(_, frames)| *frames == FRAMES), "{best:?}");
    if let [scan, _, decoded, raw, typed] =
        best.iter().map(|(elapsed, _)| elapsed.as_secs_f64()).collect::<Vec<_>>()[..]
    {
        println!("typed ratio {:.1}", typed / decoded);
        println!("ratio {:.1}", raw / scan);
    }
    for path in std::env::args().skip(1).filter(|argument| !argument.starts_with("--")) {
        let recorded = std::fs::read(&path).unwrap_or_default();
        assert!(!recorded.is_empty(), "{path} cannot be read or is empty");
        measure(&path, &recorded.repeat(stream.len() / recorded.len()), &CONTENDERS[..3]);
    }
}

/// The best time of each contender, and how many frames it found.
fn measure(name: &str, stream: &[u8], contenders: &[Contender]) -> Vec<(Duration, usize)> {
    let mut best = vec![(Duration::MAX, 0); contenders.len()];
    for _ in 0..ROUNDS {
        for (best, (_, run)) in best.iter_mut().zip(contenders) {
            *best = time(|| run(black_box(stream))).min(*best);
        }
    }
    println!("{name}: {} frames, {} bytes, best of {ROUNDS}", best[0].1, stream.len());
    for ((elapsed, frames), (name, _)) in best.iter().zip(contenders) {
        let nanos = elapsed.as_nanos() as f64 / *frames as f64;
        println!("{name:32} {nanos:7.1} ns/frame {:6.2} Mframe/s", 1e3 / nanos);
    }
    best
}

#[expect(clippy::disallowed_methods, reason = "a benchmark reads a clock")]
fn time(run: impl FnOnce() -> usize) -> (Duration, usize) {
    let start = Instant::now();
    let scanned = run();
    (start.elapsed(), scanned)
}

fn scan_all(stream: &[u8]) -> usize {
    scan(stream, stream.len())
}

fn scan_chunks(stream: &[u8]) -> usize {
    scan(stream, CHUNK)
}

fn scan(stream: &[u8], chunk: usize) -> usize {
    let mut framer = Framer::new(FramerConfig::default());
    let mut frames = 0;
    for part in stream.chunks(chunk) {
        framer.push(Timestamp::ZERO, part, &mut |found| {
            if let FramerOutput::Frame(frame) = found {
                black_box(frame);
                frames += 1;
            }
        });
    }
    frames
}

fn scan_and_decode(stream: &[u8]) -> usize {
    let mut framer = Framer::new(FramerConfig::default());
    let mut messages = 0;
    framer.push(Timestamp::ZERO, stream, &mut |found| {
        if let FramerOutput::Frame(frame) = found
            && let Ok(Some(message)) = decode(&frame)
        {
            black_box(message);
            messages += 1;
        }
    });
    messages
}

fn crate_raw(stream: &[u8]) -> usize {
    let mut reader = MavlinkReader::new(stream);
    let mut frames = 0;
    while let Ok(raw) = reader.read_raw_message::<MavMessage>(MavlinkVersion::V2) {
        black_box(raw);
        frames += 1;
    }
    frames
}

fn crate_typed(stream: &[u8]) -> usize {
    let mut reader = MavlinkReader::new(stream);
    let mut frames = 0;
    while let Ok(message) = reader.read_message::<MavMessage>(MavlinkVersion::V2) {
        black_box(message);
        frames += 1;
    }
    frames
}
