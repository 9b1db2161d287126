//! Telegrams out of a stream that has neither start byte nor checksum, and the requests that they answer.
//!
//! Only a reply to a pending request is accepted: its length, counter and type must be those that the request expects.
//! Anything else costs one byte, so that damage costs the reply that it hits and none after it. A telegram that stops in its
//! middle holds back what follows; [`ReplyFramer::skip_byte`] ends that.
//!
//! Sources: LEGO MINDSTORMS EV3 Communication Developer Kit, sections 3 and 4; `c_com.h` of the firmware lms2012.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::sensors::CycleSensors;

const LENGTH_BYTES: usize = 2;
const HEAD_BYTES: usize = 3;
/// Longest telegram that an EV3 sends: its buffer for replies.
const MAX_TELEGRAM_BYTES: usize = 1024;
const REPLY: u8 = 0x02;
const ERROR: u8 = 0x04;
/// System command without reply, as a program on the brick sends it.
const SYSTEM_COMMAND: u8 = 0x81;
const WRITE_MAILBOX: u8 = 0x9E;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ev3Telegram {
    Reply {
        counter: u16,
        answer: ReplyBody,
    },
    /// A program on the brick wrote to a mailbox; ignored.
    Mailbox,
    UnframedBytes(u32),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ReplyBody {
    Values(Vec<u8>),
    Rejected,
}

enum FrontMatch {
    Incomplete,
    NoTelegram,
    Telegram { bytes: usize },
}

/// Received bytes that are no telegram yet; at most one telegram more than the last chunk.
#[derive(Debug, Default)]
pub(super) struct ReplyFramer {
    buffer: Vec<u8>,
}

impl ReplyFramer {
    pub(super) fn clear(&mut self) {
        self.buffer.clear();
    }

    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    pub(super) const fn waiting_bytes(&self) -> usize {
        self.buffer.len()
    }

    /// The next telegram; `None` until more bytes come. `values_of` returns the number of value bytes that a request
    /// asked for.
    pub(super) fn next_telegram(&mut self, values_of: &dyn Fn(u16) -> Option<usize>) -> Option<Ev3Telegram> {
        let mut skipped = 0;
        loop {
            let rest = self.buffer.get(skipped..).unwrap_or_default();
            match match_front(rest, values_of) {
                FrontMatch::NoTelegram => skipped += 1,
                FrontMatch::Incomplete | FrontMatch::Telegram { .. } if skipped > 0 => {
                    self.buffer.drain(..skipped);
                    return Some(Ev3Telegram::UnframedBytes(skipped as u32));
                }
                FrontMatch::Incomplete => return None,
                FrontMatch::Telegram { bytes } => return self.pop_bytes(bytes),
            }
        }
    }

    pub(super) fn skip_byte(&mut self) {
        if !self.buffer.is_empty() {
            self.buffer.remove(0);
        }
    }

    fn pop_bytes(&mut self, bytes: usize) -> Option<Ev3Telegram> {
        let telegram: Vec<u8> = self.buffer.drain(..bytes.min(self.buffer.len())).collect();
        let (head, values) = telegram.get(LENGTH_BYTES..)?.split_first_chunk::<HEAD_BYTES>()?;
        let [low, high, kind] = *head;
        let counter = u16::from_le_bytes([low, high]);
        Some(match kind {
            REPLY => Ev3Telegram::Reply { counter, answer: ReplyBody::Values(values.to_vec()) },
            ERROR => Ev3Telegram::Reply { counter, answer: ReplyBody::Rejected },
            _ => Ev3Telegram::Mailbox,
        })
    }
}

fn match_front(rest: &[u8], values_of: &dyn Fn(u16) -> Option<usize>) -> FrontMatch {
    let Some((length, telegram)) = rest.split_first_chunk::<LENGTH_BYTES>() else {
        return FrontMatch::Incomplete;
    };
    let length = usize::from(u16::from_le_bytes(*length));
    if !(HEAD_BYTES..=MAX_TELEGRAM_BYTES).contains(&length) {
        return FrontMatch::NoTelegram;
    }
    let [low, high, kind, ..] = *telegram else {
        return FrontMatch::Incomplete;
    };
    let counter = u16::from_le_bytes([low, high]);
    let is_possible = match kind {
        REPLY => values_of(counter).is_some_and(|values| length == HEAD_BYTES + values),
        // The firmware sends the values, for what they are worth, or nothing.
        ERROR => values_of(counter).is_some_and(|values| length == HEAD_BYTES + values || length == HEAD_BYTES),
        SYSTEM_COMMAND => may_be_mailbox(telegram.get(HEAD_BYTES..).unwrap_or_default(), length),
        _ => false,
    };
    match (is_possible, telegram.len() >= length) {
        (false, _) => FrontMatch::NoTelegram,
        (true, false) => FrontMatch::Incomplete,
        (true, true) => FrontMatch::Telegram { bytes: LENGTH_BYTES + length },
    }
}

/// Whether the bytes after the type, as many as there are, may be 9E, length of the name, name, length of the payload,
/// payload.
fn may_be_mailbox(command: &[u8], length: usize) -> bool {
    let Some((command, rest)) = command.split_first() else {
        return true;
    };
    if *command != WRITE_MAILBOX {
        return false;
    }
    let Some((name_bytes, rest)) = rest.split_first() else {
        return true;
    };
    let name_bytes = usize::from(*name_bytes);
    // Command, two lengths and the name precede the payload.
    let Some(payload_bytes) = length.checked_sub(HEAD_BYTES + 4 + name_bytes) else {
        return false;
    };
    let length = rest.get(name_bytes..).and_then(|behind| behind.first_chunk::<LENGTH_BYTES>());
    length.is_none_or(|length| usize::from(u16::from_le_bytes(*length)) == payload_bytes)
}

/// Most abandoned requests whose late replies are still recognized. Ten seconds of silence, with the growing time-out,
/// abandon five.
const MAX_ABANDONED: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ev3Request {
    /// Sets up the sensor with this index and reads it once.
    SetUp(usize),
    Battery,
    /// Clock, counts and these sensors.
    Cycle(CycleSensors),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct OutstandingRequest {
    pub(super) request: Ev3Request,
    counter: u16,
    values: usize,
    pub(super) sent: Timestamp<HostClock>,
    due: Timestamp<HostClock>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReplyTiming {
    OnTime,
    Late,
}

#[derive(Debug, Default)]
pub(super) struct OutstandingRequests {
    last_counter: u16,
    waiting: VecDeque<OutstandingRequest>,
    abandoned: VecDeque<OutstandingRequest>,
}

impl OutstandingRequests {
    /// Forgets all requests; their counters are not used again soon.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
        self.abandoned.clear();
    }

    /// Returns the counter that the telegram must have.
    pub(super) fn record_sent(
        &mut self,
        request: Ev3Request,
        values: usize,
        now: Timestamp<HostClock>,
        patience: TimeDelta,
    ) -> u16 {
        let counter = self.allocate_counter();
        self.waiting.push_back(OutstandingRequest { request, counter, values, sent: now, due: now + patience });
        counter
    }

    pub(super) fn allocate_counter(&mut self) -> u16 {
        self.last_counter = self.last_counter.wrapping_add(1);
        self.last_counter
    }

    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Number of value bytes in the reply to a request; `None` if there was no such request.
    pub(super) fn values_of(&self, counter: u16) -> Option<usize> {
        let all = self.waiting.iter().chain(&self.abandoned);
        let request = all.into_iter().find(|request| request.counter == counter);
        request.map(|request| request.values)
    }

    pub(super) fn match_reply(&mut self, counter: u16) -> Option<(OutstandingRequest, ReplyTiming)> {
        let take = |queue: &mut VecDeque<OutstandingRequest>| {
            let index = queue.iter().position(|request| request.counter == counter)?;
            queue.remove(index)
        };
        if let Some(request) = take(&mut self.waiting) {
            return Some((request, ReplyTiming::OnTime));
        }
        take(&mut self.abandoned).map(|request| (request, ReplyTiming::Late))
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.waiting.iter().map(|request| request.due).min()
    }

    pub(super) fn expired(&mut self, now: Timestamp<HostClock>) -> Option<Ev3Request> {
        let index = self.waiting.iter().position(|request| request.due <= now)?;
        self.abandon_at(index)
    }

    /// The next outstanding request that was sent before this one: replies come in the order of their requests, so it
    /// is lost.
    pub(super) fn pop_overtaken(&mut self, by: &OutstandingRequest) -> Option<Ev3Request> {
        let is_older = |request: &OutstandingRequest| by.counter.wrapping_sub(request.counter) < u16::MAX / 2;
        let index = self.waiting.iter().position(is_older)?;
        self.abandon_at(index)
    }

    /// The next outstanding request, whose reply will not come.
    pub(super) fn abandon_all(&mut self) -> Option<Ev3Request> {
        self.abandon_at(0)
    }

    fn abandon_at(&mut self, index: usize) -> Option<Ev3Request> {
        let request = self.waiting.remove(index)?;
        if self.abandoned.len() >= MAX_ABANDONED {
            self.abandoned.pop_front();
        }
        self.abandoned.push_back(request);
        Some(request.request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything in the bytes, when request 7 expects four bytes of values.
    fn found(bytes: &[u8], chunk: usize) -> Vec<Ev3Telegram> {
        let mut inbox = ReplyFramer::default();
        let mut found = Vec::new();
        for part in bytes.chunks(chunk) {
            inbox.push(part);
            while let Some(item) = inbox.next_telegram(&|counter| (counter == 7).then_some(4)) {
                found.push(item);
            }
        }
        found
    }

    const MAILBOX: [u8; 20] = *include_bytes!("../../../tests/data/ev3_mailbox.bin");
    const ANSWER: [u8; 9] = [7, 0, 7, 0, 2, 1, 2, 3, 4];

    #[test]
    fn only_what_is_waited_for_is_an_answer() {
        let answer = |counter, answer| Ev3Telegram::Reply { counter, answer };
        let values = answer(7, ReplyBody::Values(vec![1, 2, 3, 4]));
        assert_eq!(found(&ANSWER, 9), [values]);
        let refused = answer(7, ReplyBody::Rejected);
        assert_eq!(found(&[3, 0, 7, 0, 4], 5), std::slice::from_ref(&refused));
        assert_eq!(found(&[7, 0, 7, 0, 4, 0, 0, 0, 0], 9), [refused]);
        // Another length, another counter, another type.
        for at in [0, 2, 4] {
            let mut other = ANSWER;
            other[at] += 1;
            let answers = found(&other, 9);
            assert!(answers.iter().all(|item| matches!(item, Ev3Telegram::UnframedBytes(_))), "{answers:?}");
        }
    }

    #[test]
    fn a_mailbox_of_a_program_is_a_telegram_in_any_chunks() {
        let bytes = [&MAILBOX[..], &ANSWER].concat();
        for chunk in 1..=bytes.len() {
            let found = found(&bytes, chunk);
            assert_eq!(found.len(), 2, "chunk {chunk}: {found:?}");
            assert_eq!(found[0], Ev3Telegram::Mailbox);
        }
        let mut truncated = MAILBOX;
        truncated[11] = 8;
        assert_eq!(found(&truncated, 20), [Ev3Telegram::UnframedBytes(18)]);
    }
}
