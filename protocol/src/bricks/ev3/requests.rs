//! Which questions wait for their answers.
//!
//! Each question has a counter of its own, and its answer bears it. So an answer that comes after its question was given up is still
//! known for what it is.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::sensors::CycleSensors;

/// Most abandoned requests whose late replies are still recognized. Ten seconds of silence, with the time to wait growing,
/// give up five.
const MAX_ABANDONED: usize = 8;

/// What was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ev3Request {
    /// To set up the sensor with this index and to read it once.
    SetUp(usize),
    /// Clock, counts and these sensors.
    Cycle(CycleSensors),
}

/// A question that has left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct OutstandingRequest {
    pub(super) request: Ev3Request,
    counter: u16,
    /// Bytes of values in its answer.
    values: usize,
    /// When it left.
    pub(super) sent: Timestamp<HostClock>,
    /// When it is given up.
    due: Timestamp<HostClock>,
}

/// Whether an answer came while its question was waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReplyTiming {
    OnTime,
    Late,
}

/// All questions of one link.
#[derive(Debug, Default)]
pub(super) struct OutstandingRequests {
    last_counter: u16,
    waiting: VecDeque<OutstandingRequest>,
    abandoned: VecDeque<OutstandingRequest>,
}

impl OutstandingRequests {
    /// Forgets all questions; their counters are not used again soon.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
        self.abandoned.clear();
    }

    /// The counter of the next question.
    pub(super) const fn next_counter(&self) -> u16 {
        self.last_counter.wrapping_add(1)
    }

    /// The question with [`Self::next_counter`] left.
    pub(super) fn record_sent(
        &mut self,
        question: Ev3Request,
        values: usize,
        now: Timestamp<HostClock>,
        patience: TimeDelta,
    ) {
        self.last_counter = self.next_counter();
        self.waiting.push_back(OutstandingRequest {
            request: question,
            counter: self.last_counter,
            values,
            sent: now,
            due: now + patience,
        });
    }

    /// A counter for a telegram that is not answered.
    pub(super) fn allocate_counter(&mut self) -> u16 {
        self.last_counter = self.next_counter();
        self.last_counter
    }

    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// How many bytes of values the answer to a question has; `None` if there was no request.
    pub(super) fn values_of(&self, counter: u16) -> Option<usize> {
        let all = self.waiting.iter().chain(&self.abandoned);
        let asked = all.into_iter().find(|asked| asked.counter == counter);
        asked.map(|asked| asked.values)
    }

    /// The question that is answered.
    pub(super) fn match_reply(&mut self, counter: u16) -> Option<(OutstandingRequest, ReplyTiming)> {
        let take = |asked: &mut VecDeque<OutstandingRequest>| {
            let index = asked.iter().position(|asked| asked.counter == counter)?;
            asked.remove(index)
        };
        if let Some(asked) = take(&mut self.waiting) {
            return Some((asked, ReplyTiming::OnTime));
        }
        take(&mut self.abandoned).map(|asked| (asked, ReplyTiming::Late))
    }

    /// When the next question is given up.
    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.waiting.iter().map(|asked| asked.due).min()
    }

    /// The next question that has waited for too long.
    pub(super) fn expired(&mut self, now: Timestamp<HostClock>) -> Option<Ev3Request> {
        let index = self.waiting.iter().position(|asked| asked.due <= now)?;
        self.abandon_at(index)
    }

    /// The next question that left before this one and still waits: answers come in the order of their questions.
    pub(super) fn pop_overtaken(&mut self, by: &OutstandingRequest) -> Option<Ev3Request> {
        let is_older = |asked: &OutstandingRequest| by.counter.wrapping_sub(asked.counter) < u16::MAX / 2;
        let index = self.waiting.iter().position(is_older)?;
        self.abandon_at(index)
    }

    /// The next question, whose answer will not come.
    pub(super) fn abandon_all(&mut self) -> Option<Ev3Request> {
        self.abandon_at(0)
    }

    fn abandon_at(&mut self, index: usize) -> Option<Ev3Request> {
        let asked = self.waiting.remove(index)?;
        if self.abandoned.len() >= MAX_ABANDONED {
            self.abandoned.pop_front();
        }
        self.abandoned.push_back(asked);
        Some(asked.request)
    }
}
