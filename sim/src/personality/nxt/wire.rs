//! The NXT's side of the link: splits bytes into telegrams, and simulates a radio with turn-around time.
//!
//! # Model
//! ```text
//! form        first byte 98: telegrams bare, one per write, as the socket server of nxt-python passes them on; else LE16 length + telegram
//! receive     one telegram is handled per pass of a millisecond; what comes faster waits, as flow control lets it wait on the way
//! send        one buffer on the air, one queued; a third answer is dropped
//! time        turn-around if something was received since the last turn, then 10 bits per byte at 460 800 per second
//! ```
//! # Sources
//! LEGO's NXT firmware: send buffers, one telegram per pass, the UART's speed. The turn-around is that of the Bluetooth chip
//! (LEGO's figure, 30 ms).

use std::collections::VecDeque;

use posebridge_telemetry::TimeDelta;

use super::super::lego::{RECEIVE_BYTES, Radio, TelegramBuffer, with_length};
use super::telegram::request_length;

/// First message of a client of nxt-python's socket server, the reply to it, and its last message.
const HELLO: u8 = 0x98;
const KIND_OF_LINK: &[u8] = b"bluetooth";
const GOODBYE: u8 = 0x99;
/// Type and opcode.
const SHORTEST: usize = 2;
/// Queued replies: one in transmission, one waiting.
const SEND_BUFFERS: usize = 2;
/// On the UART between the processor and the radio.
const BYTE_S: f64 = 10.0 / 460_800.0;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum TelegramFraming {
    #[default]
    Unknown,
    /// Each is prefixed with its length.
    Prefixed,
    /// Each is one write.
    Bare,
}

#[derive(Clone, Debug)]
pub(super) struct NxtWire {
    longest: usize,
    framing: TelegramFraming,
    prefixed: TelegramBuffer,
    bare: VecDeque<Vec<u8>>,
    radio: Radio,
}

impl NxtWire {
    /// A new link. Telegrams are `longest` bytes at most in both directions.
    pub(super) fn new(longest: usize, turn_around: TimeDelta) -> Self {
        Self {
            longest,
            framing: TelegramFraming::Unknown,
            prefixed: TelegramBuffer::default(),
            bare: VecDeque::new(),
            radio: Radio::new(turn_around, BYTE_S, SEND_BUFFERS),
        }
    }

    pub(super) const fn longest(&self) -> usize {
        self.longest
    }

    pub(super) fn reopen(&mut self) {
        self.framing = TelegramFraming::Unknown;
        self.prefixed.clear();
        self.bare.clear();
        self.radio.reset();
    }

    /// `now` is world time.
    pub(super) fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        let Some(first) = bytes.first() else {
            return;
        };
        self.radio.receive();
        match self.framing {
            TelegramFraming::Unknown if *first == HELLO => {
                self.framing = TelegramFraming::Bare;
                self.radio.send(KIND_OF_LINK.to_vec());
                self.receive_bare(bytes.get(1..).unwrap_or_default());
            }
            TelegramFraming::Bare if bytes == [GOODBYE] => self.reopen(),
            TelegramFraming::Bare => self.receive_bare(bytes),
            TelegramFraming::Unknown | TelegramFraming::Prefixed => {
                self.framing = TelegramFraming::Prefixed;
                self.prefixed.receive(now, bytes);
            }
        }
    }

    /// The operating system may join two writes into one; telegrams of a known length are split again.
    fn receive_bare(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let length = request_length(bytes).unwrap_or(bytes.len());
            let (telegram, rest) = bytes.split_at(length.min(bytes.len()));
            if telegram.is_empty() || self.bare.len() >= RECEIVE_BYTES {
                return;
            }
            self.bare.push_back(telegram.to_vec());
            bytes = rest;
        }
    }

    pub(super) fn next_telegram(&mut self) -> Option<Vec<u8>> {
        if self.framing == TelegramFraming::Bare {
            return self.bare.pop_front();
        }
        self.prefixed.next(SHORTEST..=self.longest)
    }

    pub(super) fn is_idle(&self) -> bool {
        self.radio.is_idle()
    }

    /// Queues a telegram; drops it if no buffer is free.
    pub(super) fn send(&mut self, telegram: &[u8]) {
        let is_bare = self.framing == TelegramFraming::Bare;
        self.radio.send(if is_bare { telegram.to_vec() } else { with_length(telegram) });
    }

    /// The telegram whose transmission is complete at `now`.
    pub(super) fn step(&mut self, now: TimeDelta) -> Option<Vec<u8>> {
        self.radio.step(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(count: i64) -> TimeDelta {
        TimeDelta::from_millis(count)
    }

    /// When what is sent at once goes out, in milliseconds after 1000.
    fn sent_at(wire: &mut NxtWire) -> Vec<(i64, Vec<u8>)> {
        (0..200).filter_map(|at: i64| Some((at, wire.step(ms(1_000 + at))?))).collect()
    }

    const BATTERY: [u8; 4] = [2, 0, 0, 0x0B];

    #[test]
    fn the_first_answer_waits_for_the_turn_and_the_second_does_not_and_the_third_is_lost() {
        let mut wire = NxtWire::new(128, ms(30));
        wire.receive(ms(1_000), &BATTERY);
        (1..=3).for_each(|answer| wire.send(&[answer; 105]));
        let sent = sent_at(&mut wire);
        // 107 bytes take 2.3 ms.
        assert_eq!(sent.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [33, 37]);
        assert_eq!(sent[1].1[..3], [105, 0, 2]);
        // Nothing was received since: no turn.
        wire.send(&[4]);
        assert_eq!(sent_at(&mut wire), [(1, vec![1, 0, 4])]);
    }

    #[test]
    fn the_bare_form_greets_has_no_prefix_and_parts_telegrams_of_one_write() {
        let mut wire = NxtWire::new(128, ms(30));
        wire.receive(ms(1_000), &[0x98]);
        assert_eq!(sent_at(&mut wire)[0].1, b"bluetooth");
        wire.receive(ms(1_000), &[0x80, 0x05, 0, 6, 0, 0, 0x07, 0]);
        assert_eq!(wire.next_telegram().unwrap(), [0x80, 0x05, 0, 6, 0]);
        assert_eq!(wire.next_telegram().unwrap(), [0, 0x07, 0]);
        assert_eq!(wire.next_telegram(), None);
        wire.send(&[2, 0x0B, 0, 1, 2]);
        assert_eq!(sent_at(&mut wire)[0].1, [2, 0x0B, 0, 1, 2]);
        wire.receive(ms(1_000), &[0x99]);
        wire.receive(ms(1_000), &BATTERY);
        assert_eq!(wire.next_telegram().unwrap(), BATTERY[2..]);
    }
}
