//! More frames than a link takes, each with its number and the instant at which it was sent, and what a reader makes of them.

use posebridge_telemetry::{HostClock, Priority, TimeDelta, Timestamp};

pub(crate) const FRAME_BYTES: usize = 48;
const COMMAND: u8 = 9;

/// What a reader makes of the bytes.
#[derive(Default)]
pub(crate) struct ReceivedFrames {
    bytes: Vec<u8>,
    pub(crate) commands: Vec<u32>,
    /// Numbers of the estimates of each of two streams.
    pub(crate) estimates: [Vec<u32>; 2],
    pub(crate) oldest_estimate: TimeDelta,
    pub(crate) oldest_command: TimeDelta,
}

impl ReceivedFrames {
    pub(crate) fn push(&mut self, bytes: &[u8], now: Timestamp<HostClock>) {
        self.bytes.extend_from_slice(bytes);
        while self.bytes.len() >= FRAME_BYTES {
            let rest = self.bytes.split_off(FRAME_BYTES);
            let frame = std::mem::replace(&mut self.bytes, rest);
            let kind = frame[0];
            assert!(frame[13..].iter().all(|byte| *byte == kind), "a torn frame: {frame:?}");
            let number = u32::from_be_bytes(frame[1..5].try_into().expect("four bytes"));
            let sent = i64::from_be_bytes(frame[5..13].try_into().expect("eight bytes"));
            let age = now - Timestamp::from_nanos(sent);
            if kind == COMMAND {
                self.commands.push(number);
                self.oldest_command = self.oldest_command.max(age);
            } else {
                self.estimates[usize::from(kind)].push(number);
                self.oldest_estimate = self.oldest_estimate.max(age);
            }
        }
    }
}

/// Offers two streams of estimates, ten times as much as the link takes, and five commands per second.
pub(crate) struct TrafficSource {
    pub(crate) estimates: u32,
    pub(crate) commands: u32,
    per_tick: u32,
    ticks: u32,
}

impl TrafficSource {
    pub(crate) fn new(capacity_bytes_per_s: u32) -> Self {
        let bytes_per_tick = 10 * capacity_bytes_per_s / 100;
        Self { estimates: 0, commands: 0, per_tick: bytes_per_tick / (2 * FRAME_BYTES as u32), ticks: 0 }
    }

    /// The frames of 10 ms.
    pub(crate) fn tick(&mut self, now: Timestamp<HostClock>, mut send: impl FnMut(Priority, &[u8])) {
        let frame = |kind: u8, number: u32| {
            let mut frame = [kind; FRAME_BYTES];
            frame[1..5].copy_from_slice(&number.to_be_bytes());
            frame[5..13].copy_from_slice(&now.as_nanos().to_be_bytes());
            frame
        };
        for _ in 0..self.per_tick {
            for (kind, stream) in [(0, 30), (1, 32)] {
                send(Priority::Estimate { stream }, &frame(kind, self.estimates));
            }
            self.estimates += 1;
        }
        if self.ticks.is_multiple_of(20) {
            send(Priority::Command, &frame(COMMAND, self.commands));
            self.commands += 1;
        }
        self.ticks += 1;
    }
}
