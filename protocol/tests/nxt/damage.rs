//! Lost, inserted and flipped bytes at every place of every kind of reply: each costs at most one request, and it goes on.

use posebridge_protocol::bricks::nxt::{NxtSensor, NxtSettings};
use posebridge_protocol::message::Message;
use posebridge_telemetry::Timestamp;

use crate::bench::{Bench, request_and_reply_ms};
use crate::session::{assert_true, moving_brick};

const SECOND: i64 = 1_000_000;
/// Replies from the first, the fence, on: ticks, set-up, motors, inputs, and a tick among them.
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

#[test]
fn a_lost_byte_anywhere_costs_at_most_one_request_in_chunks_of_any_size() {
    let mut runs = 0;
    for (reply, length) in lengths().into_iter().enumerate() {
        for at in 0..length {
            for chunk in [1, 7, usize::MAX] {
                let lose = |mut bytes: Vec<u8>, at: usize| {
                    bytes.remove(at);
                    bytes
                };
                let bench = run(reply, chunk, lose, at);
                let what = format!("reply {reply} without byte {at}, chunks of {chunk}");
                assert_goes_on(&bench, &what);
                assert_true(&bench);
                runs += 1;
            }
        }
    }
    println!("{runs} runs, each with one byte lost");
    assert!(runs > 2_000, "{runs}");
}

#[test]
fn an_inserted_byte_anywhere_costs_at_most_one_request_and_tells_nothing_untrue() {
    for (reply, length) in lengths().into_iter().enumerate() {
        for at in 0..length {
            for insert in [
                |mut bytes: Vec<u8>, at: usize| {
                    bytes.insert(at, 0x00);
                    bytes
                },
                |mut bytes: Vec<u8>, at: usize| {
                    bytes.insert(at, 0xA5);
                    bytes
                },
            ] {
                let bench = run(reply, usize::MAX, insert, at);
                let what = format!("reply {reply} with a byte before byte {at}");
                assert_goes_on(&bench, &what);
                assert_true(&bench);
            }
        }
    }
}

#[test]
fn a_flipped_bit_anywhere_costs_at_most_one_request() {
    for (reply, length) in lengths().into_iter().enumerate() {
        for at in 0..length {
            for flip in [
                |mut bytes: Vec<u8>, at: usize| {
                    bytes[at] ^= 0x80;
                    bytes
                },
                |mut bytes: Vec<u8>, at: usize| {
                    bytes[at] ^= 0x01;
                    bytes
                },
            ] {
                let bench = run(reply, usize::MAX, flip, at);
                assert_goes_on(&bench, &format!("reply {reply}, bit of byte {at}"));
            }
        }
    }
}

/// Noise without a pattern, by a linear congruential generator (Knuth's MMIX constants).
fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut state = seed;
    (0..length)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        })
        .collect()
}

#[test]
fn after_noise_of_any_kind_the_brick_is_understood_again() {
    for seed in 0..200 {
        let mut bench = Bench::new(settings(), moving_brick());
        bench.begin();
        bench.run_to(SECOND);
        bench.push(&noise(seed, 1 + seed as usize * 7));
        bench.run_to(3 * SECOND);
        assert_true(&bench);
        assert_goes_on(&bench, &format!("noise {seed}"));
    }
}

/// What the fuzz target promises, for seeded inputs: it always has a deadline or nothing to wait for, stops asking, and sends no more
/// than one question without an answer.
#[test]
fn any_bytes_at_any_time_leave_the_codec_alive() {
    for seed in 0..300 {
        let mut bench = Bench::new(settings(), moving_brick());
        let program = noise(seed, 400);
        bench.codec.on_link_up(Timestamp::ZERO);
        let mut now = Timestamp::ZERO;
        for step in program.chunks_exact(4) {
            now = now + posebridge_telemetry::TimeDelta::from_millis(i64::from(step[0]));
            bench.codec.push(now, &step[1..], &mut |_| {});
            bench.codec.tick(now, &mut |_| {});
            let mut sent = 0;
            while bench.codec.poll().is_some() {
                sent += 1;
                assert!(sent <= 2, "seed {seed}");
            }
            assert!(bench.codec.deadline().is_some_and(|due| due > now), "seed {seed}");
        }
    }
}
