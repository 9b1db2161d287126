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
    pub(super) longest: usize,
    framing: TelegramFraming,
    prefixed: TelegramBuffer,
    bare: VecDeque<Vec<u8>>,
    pub(super) radio: Radio,
}

impl NxtWire {
    pub(super) fn new(longest: usize, turn_around: TimeDelta) -> Self {
        Self {
            longest,
            framing: TelegramFraming::Unknown,
            prefixed: TelegramBuffer::default(),
            bare: VecDeque::new(),
            radio: Radio::new(turn_around, BYTE_S, SEND_BUFFERS),
        }
    }

    pub(super) fn reopen(&mut self) {
        self.framing = TelegramFraming::Unknown;
        self.prefixed.clear();
        self.bare.clear();
        self.radio.reset();
    }

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

    /// Queues a telegram; drops it if no buffer is free.
    pub(super) fn send(&mut self, telegram: &[u8]) {
        let is_bare = self.framing == TelegramFraming::Bare;
        self.radio.send(if is_bare { telegram.to_vec() } else { with_length(telegram) });
    }
}
