//! The NXT's side of the link: telegrams out of bytes, and a radio that needs time to turn around.
//!
//! # Model
//! ```text
//! form        first byte 98: telegrams bare, one per write, as the socket server of nxt-python passes them on; else LE16 length + telegram
//! receive     one telegram is handled per pass of a millisecond; what comes faster waits, as flow control lets it wait on the way
//! send        one buffer on the air, one queued; a third answer is dropped without a word
//! time        turn-around if something was received since the last turn, then 10 bits per byte at 460 800 per second
//! ```
//! There is no checksum and no start byte. After a length that cannot be, everything is thrown away until the line was quiet for
//! 100 ms, and so is a telegram whose end does not come.
//!
//! # Sources
//! LEGO's NXT firmware: send buffers, one telegram per pass, the UART's speed. The turn-around is that of the Bluetooth chip
//! (LEGO's figure, 30 ms). The quiet time is ours: a station that lost its place waits a little longer than that.

use std::collections::VecDeque;

use posebridge_telemetry::TimeDelta;

use super::super::radio::{Radio, RadioSettings};
use super::telegram::request_length;

/// The first message of a client of nxt-python's socket server, the reply to it, and its last message.
const HELLO: u8 = 0x98;
const KIND_OF_LINK: &[u8] = b"bluetooth";
const GOODBYE: u8 = 0x99;
/// Shortest telegram: type and opcode.
const SHORTEST: usize = 2;
/// Bytes that wait to be handled, here and before the brick; a sender without any patience loses the rest.
const RECEIVE_BYTES: usize = 16 * 1024;
/// Answers under way: one on the air, one queued.
const SEND_BUFFERS: usize = 2;
/// After this much silence a new telegram begins.
const RESYNC_TIMEOUT: TimeDelta = TimeDelta::from_millis(100);
/// Time of a byte on the UART between the processor and the radio, in seconds.
const BYTE_S: f64 = 10.0 / 460_800.0;

/// How telegrams are separated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum TelegramFraming {
    /// Nothing has been heard on this connection.
    #[default]
    Unknown,
    /// Each has its length before it.
    Prefixed,
    /// Each comes in a write of its own.
    Bare,
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct NxtWire {
    longest: usize,
    framing: TelegramFraming,
    received: Vec<u8>,
    /// Bare telegrams that wait to be handled.
    telegrams: VecDeque<Vec<u8>>,
    last_received: TimeDelta,
    is_lost: bool,
    radio: Radio,
}

impl NxtWire {
    /// An unused link. Telegrams are `longest` bytes at most, either way.
    pub(super) fn new(longest: usize, turn_around: TimeDelta) -> Self {
        Self {
            longest,
            framing: TelegramFraming::Unknown,
            received: Vec::new(),
            telegrams: VecDeque::new(),
            last_received: TimeDelta::ZERO,
            is_lost: false,
            radio: Radio::new(RadioSettings { turn_around, byte_s: BYTE_S, buffers: SEND_BUFFERS }),
        }
    }

    /// Longest telegram, in bytes.
    pub(super) const fn longest(&self) -> usize {
        self.longest
    }

    /// The link has a new peer.
    pub(super) fn reopen(&mut self) {
        self.framing = TelegramFraming::Unknown;
        self.received.clear();
        self.telegrams.clear();
        self.is_lost = false;
        self.radio.reset();
    }

    /// Takes bytes that arrive at `now`, the time since the beginning of the world.
    pub(super) fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        let Some(first) = bytes.first() else {
            return;
        };
        let was_quiet = now - self.last_received >= RESYNC_TIMEOUT;
        self.last_received = now;
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
                if was_quiet {
                    self.received.clear();
                    self.is_lost = false;
                }
                let room = RECEIVE_BYTES - self.received.len().min(RECEIVE_BYTES);
                if !self.is_lost {
                    self.received.extend(bytes.iter().take(room));
                }
            }
        }
    }

    /// The system may join two writes into one; telegrams of a known length are parted again.
    fn receive_bare(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let length = request_length(bytes).unwrap_or(bytes.len());
            let (telegram, rest) = bytes.split_at(length.min(bytes.len()));
            if telegram.is_empty() || self.telegrams.len() >= RECEIVE_BYTES {
                return;
            }
            self.telegrams.push_back(telegram.to_vec());
            bytes = rest;
        }
    }

    /// The next whole telegram.
    pub(super) fn next_telegram(&mut self) -> Option<Vec<u8>> {
        if self.framing == TelegramFraming::Bare {
            return self.telegrams.pop_front();
        }
        let length = usize::from(u16::from_le_bytes(*self.received.first_chunk()?));
        if !(SHORTEST..=self.longest).contains(&length) {
            self.received.clear();
            self.is_lost = true;
            return None;
        }
        if self.received.len() < 2 + length {
            return None;
        }
        Some(self.received.drain(..2 + length).skip(2).collect())
    }

    /// Whether nothing waits to be sent.
    pub(super) fn is_idle(&self) -> bool {
        self.radio.is_idle()
    }

    /// Sends a telegram; one for which there is no buffer is dropped.
    pub(super) fn send(&mut self, telegram: &[u8]) {
        let prefix = (telegram.len() as u16).to_le_bytes();
        let prefix = if self.framing == TelegramFraming::Bare { &[][..] } else { &prefix[..] };
        self.radio.send([prefix, telegram].concat());
    }

    /// What has gone over the air at `now`.
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

    fn wire() -> NxtWire {
        NxtWire::new(128, ms(30))
    }

    /// When what is sent at once goes out, in milliseconds after 1000.
    fn sent_at(wire: &mut NxtWire) -> Vec<(i64, Vec<u8>)> {
        let pass = |at: i64| Some((at, wire.step(ms(1_000 + at))?));
        (0..200).filter_map(pass).collect()
    }

    const BATTERY: [u8; 4] = [2, 0, 0, 0x0B];

    #[test]
    fn a_telegram_comes_together_from_any_pieces() {
        for size in 1..=8 {
            let mut wire = wire();
            let bytes = [&BATTERY[..], &BATTERY[..]].concat();
            let mut found = Vec::new();
            for piece in bytes.chunks(size) {
                wire.receive(ms(1_000), piece);
                found.extend(std::iter::from_fn(|| wire.next_telegram()));
            }
            assert_eq!(found, [[0, 0x0B], [0, 0x0B]], "pieces of {size}");
        }
    }

    #[test]
    fn after_a_lost_byte_and_a_pause_it_is_well_again() {
        for lost in 0..BATTERY.len() {
            let mut wire = wire();
            let mut bytes = BATTERY.to_vec();
            bytes.remove(lost);
            wire.receive(ms(1_000), &bytes);
            while wire.next_telegram().is_some() {}
            wire.receive(ms(1_101), &BATTERY);
            assert_eq!(wire.next_telegram().unwrap(), [0, 0x0B], "byte {lost} lost");
        }
    }

    #[test]
    fn a_length_that_cannot_be_is_not_believed() {
        for length in [0, 1, 129, 0xFFFF_u16] {
            let mut wire = wire();
            wire.receive(ms(1_000), &length.to_le_bytes());
            wire.receive(ms(1_050), &BATTERY);
            assert_eq!(wire.next_telegram(), None, "{length}");
            wire.receive(ms(1_060), &BATTERY);
            assert_eq!(wire.next_telegram(), None, "{length}");
        }
    }

    #[test]
    fn the_first_answer_waits_for_the_turn_and_the_second_does_not() {
        let mut wire = wire();
        wire.receive(ms(1_000), &BATTERY);
        wire.send(&[1; 105]);
        wire.send(&[2; 105]);
        wire.send(&[3; 105]);
        let sent = sent_at(&mut wire);
        // 107 bytes take 2.3 ms.
        let at: Vec<i64> = sent.iter().map(|(at, _)| *at).collect();
        assert_eq!(at, [33, 37]);
        assert_eq!(sent[1].1[..3], [105, 0, 2]);
        // Nothing was received since: no turn.
        wire.send(&[4]);
        assert_eq!(sent_at(&mut wire), [(1, vec![1, 0, 4])]);
    }

    #[test]
    fn the_bare_form_greets_and_has_no_prefix() {
        let mut wire = wire();
        wire.receive(ms(1_000), &[0x98]);
        assert_eq!(sent_at(&mut wire)[0].1, b"bluetooth");
        wire.receive(ms(1_000), &[0, 0x0B]);
        assert_eq!(wire.next_telegram().unwrap(), [0, 0x0B]);
        wire.send(&[2, 0x0B, 0, 1, 2]);
        assert_eq!(sent_at(&mut wire)[0].1, [2, 0x0B, 0, 1, 2]);
        wire.receive(ms(1_000), &[0x99]);
        wire.receive(ms(1_000), &BATTERY);
        assert_eq!(wire.next_telegram().unwrap(), [0, 0x0B]);
    }

    #[test]
    fn two_bare_telegrams_in_one_write_are_parted() {
        let mut wire = wire();
        wire.receive(ms(1_000), &[0x98]);
        wire.receive(ms(1_000), &[0x80, 0x05, 0, 6, 0, 0, 0x07, 0]);
        assert_eq!(wire.next_telegram().unwrap(), [0x80, 0x05, 0, 6, 0]);
        assert_eq!(wire.next_telegram().unwrap(), [0, 0x07, 0]);
        assert_eq!(wire.next_telegram(), None);
    }

    #[test]
    fn a_burst_waits_for_its_turn_up_to_a_limit() {
        let mut wire = wire();
        wire.receive(ms(1_000), &BATTERY.repeat(5_000));
        let found = std::iter::from_fn(|| wire.next_telegram()).count();
        assert_eq!(found, 4_096);
    }
}
