//! Lost, inserted and flipped bytes at every place of every kind of reply: each costs at most one request, and it goes on.

use posebridge_protocol::bricks::nxt::{NxtSensor, NxtSettings};
use posebridge_protocol::message::Message;

use super::bench::{Bench, request_and_reply_ms};
use super::session::{SECOND, assert_true, moving_brick};
use crate::support::noise;

/// Replies from the first, the barrier, on: ticks, set-up, motors, inputs, and a tick among them.
const REPLIES: std::ops::Range<usize> = 0..18;

fn settings() -> NxtSettings {
    NxtSettings {
        sensors: [NxtSensor::HtGyro, NxtSensor::None, NxtSensor::None, NxtSensor::None],
        gyro_rest_counts: Some(600.0),
        ..NxtSettings::default()
    }
}

/// A run with one damaged reply; `None` if the reply has no such byte.
fn run(damaged: usize, chunk: usize, damage: fn(Vec<u8>, usize) -> Vec<u8>, at: usize) -> Bench {
    let mut brick = moving_brick();
    brick.ports[0].raw = 610;
    let mut bench = Bench::new(settings(), brick);
    bench.chunk = chunk;
    bench.damage =
        Box::new(move |reply, bytes| if reply == damaged && at < bytes.len() { damage(bytes, at) } else { bytes });
    bench.begin();
    bench.run_to(3 * SECOND);
    bench
}

fn assert_goes_on(bench: &Bench, what: &str) {
    assert!(bench.lost() <= 1, "{what}: {} requests lost", bench.lost());
    let last = bench.messages().filter_map(|message| match message {
        Message::WheelTicks(ticks) => Some(request_and_reply_ms(ticks.stamp).1),
        _ => None,
    });
    let last = last.last().unwrap_or_default();
    assert!(last > 2_850.0, "{what}: the last state is of {last} ms");
    assert!(bench.wheels().len() > 25, "{what}: {}", bench.wheels().len());
}

fn lengths() -> Vec<usize> {
    let mut bench = Bench::new(settings(), moving_brick());
    let (sender, receiver) = std::sync::mpsc::sync_channel(4_096);
    bench.damage = Box::new(move |_, reply| {
        sender.try_send(reply.len()).expect("there is room");
        reply
    });
    bench.begin();
    bench.run_to(3 * SECOND);
    receiver.try_iter().take(REPLIES.end).collect()
}

/// Runs `damage` at every byte of every reply and returns how many runs there were.
fn at_every_byte(chunks: &[usize], name: &str, damage: fn(Vec<u8>, usize) -> Vec<u8>, check: fn(&Bench)) -> usize {
    let mut runs = 0;
    for (reply, length) in lengths().into_iter().enumerate() {
        for at in 0..length {
            for chunk in chunks {
                let bench = run(reply, *chunk, damage, at);
                assert_goes_on(&bench, &format!("reply {reply}, {name} {at}, chunks of {chunk}"));
                check(&bench);
                runs += 1;
            }
        }
    }
    runs
}

fn inserted(mut bytes: Vec<u8>, at: usize, byte: u8) -> Vec<u8> {
    bytes.insert(at, byte);
    bytes
}

fn flipped(mut bytes: Vec<u8>, at: usize, bits: u8) -> Vec<u8> {
    bytes[at] ^= bits;
    bytes
}

#[test]
fn a_lost_byte_anywhere_costs_at_most_one_request_in_chunks_of_any_size() {
    let lose = |bytes: Vec<u8>, at: usize| [&bytes[..at], &bytes[at + 1..]].concat();
    let runs = at_every_byte(&[1, 7, usize::MAX], "without byte", lose, assert_true);
    println!("{runs} runs, each with one byte lost");
    assert!(runs > 2_000, "{runs}");
}

#[test]
fn an_inserted_byte_anywhere_costs_at_most_one_request_and_yields_no_wrong_value() {
    at_every_byte(&[usize::MAX], "00 before byte", |bytes, at| inserted(bytes, at, 0x00), assert_true);
    at_every_byte(&[usize::MAX], "A5 before byte", |bytes, at| inserted(bytes, at, 0xA5), assert_true);
}

/// Its values may be wrong: telegrams have no checksum.
#[test]
fn a_flipped_bit_anywhere_costs_at_most_one_request() {
    at_every_byte(&[usize::MAX], "bit 7 of byte", |bytes, at| flipped(bytes, at, 0x80), |_| ());
    at_every_byte(&[usize::MAX], "bit 0 of byte", |bytes, at| flipped(bytes, at, 0x01), |_| ());
}

#[test]
fn after_noise_of_any_kind_the_brick_is_understood_again() {
    for seed in 0..200 {
        let mut bench = Bench::run(settings(), moving_brick(), SECOND);
        bench.push(&noise(seed, 1 + seed as usize * 7));
        bench.run_to(3 * SECOND);
        assert_true(&bench);
        assert_goes_on(&bench, &format!("noise {seed}"));
    }
}
