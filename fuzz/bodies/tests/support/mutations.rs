//! Seeded damage to inputs: what a fuzzer does without coverage to guide it.

use rand::RngExt;
use rand_pcg::Pcg64;

/// Values at which lengths and counters go wrong.
const EDGES: [u8; 8] = [0, 1, 0x7F, 0x80, 0xFE, 0xFF, b'\n', b'"'];
/// Longest mutated input, so that a repeated part cannot grow without end.
const MAX_BYTES: usize = 8_192;

/// An entry of the corpus with one to four changes. `corpus` holds at least one entry.
pub(crate) fn mutated(corpus: &[Vec<u8>], random: &mut Pcg64) -> Vec<u8> {
    let mut bytes = any_of(corpus, random).to_vec();
    for _ in 0..random.random_range(1..=4) {
        change(&mut bytes, corpus, random);
    }
    bytes.truncate(MAX_BYTES);
    bytes
}

fn change(bytes: &mut Vec<u8>, corpus: &[Vec<u8>], random: &mut Pcg64) {
    let at = random.random_range(0..=bytes.len());
    match random.random_range(0..7) {
        0 => set(bytes, at, |byte| byte ^ (1 << (at % 8))),
        1 => {
            let value = EDGES[random.random_range(0..EDGES.len())];
            set(bytes, at, |_| value);
        }
        2 => bytes.insert(at, random.random()),
        3 => drop(bytes.drain(part(at, bytes.len(), random))),
        4 => {
            let repeated = bytes[part(at, bytes.len(), random)].to_vec();
            bytes.splice(at..at, repeated);
        }
        5 => {
            let other = any_of(corpus, random);
            let begin = random.random_range(0..=other.len());
            let inserted = other[part(begin, other.len(), random)].to_vec();
            bytes.splice(at..at, inserted);
        }
        _ => bytes.truncate(at),
    }
}

fn set(bytes: &mut [u8], at: usize, new: impl Fn(u8) -> u8) {
    if let Some(byte) = bytes.get_mut(at) {
        *byte = new(*byte);
    }
}

/// A part that begins at `begin`, mostly a short one.
fn part(begin: usize, length: usize, random: &mut Pcg64) -> std::ops::Range<usize> {
    let longest = 1usize << random.random_range(0..10);
    begin..length.min(begin + random.random_range(0..=longest))
}

fn any_of<'a>(corpus: &'a [Vec<u8>], random: &mut Pcg64) -> &'a [u8] {
    &corpus[random.random_range(0..corpus.len())]
}
