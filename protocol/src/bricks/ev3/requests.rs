//! Which questions wait for their answers.
//!
//! Each question has a counter of its own, and its answer bears it. So an answer that comes after its question was given up is still
//! known for what it is.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::cycle::Included;

/// So many questions that were given up are still known when their answers come. Ten seconds of silence, with the time to wait growing,
/// give up five.
const MOST_GIVEN_UP: usize = 8;

/// What was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Question {
    /// To set up the sensor with this index and to read it once.
    SetUp(usize),
    /// Clock, counts and these sensors.
    Cycle(Included),
}

/// A question that has left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Asked {
    pub(super) question: Question,
    counter: u16,
    /// Bytes of values in its answer.
    values: usize,
    /// When it left.
    pub(super) sent: Stamp<HostClock>,
    /// When it is given up.
    due: Stamp<HostClock>,
}

/// Whether an answer came while its question was waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Promptness {
    InTime,
    Late,
}

/// All questions of one link.
#[derive(Debug, Default)]
pub(super) struct Requests {
    last_counter: u16,
    waiting: VecDeque<Asked>,
    given_up: VecDeque<Asked>,
}

impl Requests {
    /// Forgets all questions; their counters are not used again soon.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
        self.given_up.clear();
    }

    /// The counter of the next question.
    pub(super) const fn next_counter(&self) -> u16 {
        self.last_counter.wrapping_add(1)
    }

    /// The question with [`Self::next_counter`] left.
    pub(super) fn left(&mut self, question: Question, values: usize, now: Stamp<HostClock>, patience: Span) {
        self.last_counter = self.next_counter();
        self.waiting.push_back(Asked { question, counter: self.last_counter, values, sent: now, due: now + patience });
    }

    /// A counter for a telegram that is not answered.
    pub(super) fn take_counter(&mut self) -> u16 {
        self.last_counter = self.next_counter();
        self.last_counter
    }

    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// How many bytes of values the answer to a question has; `None` if nobody asked.
    pub(super) fn values_of(&self, counter: u16) -> Option<usize> {
        let all = self.waiting.iter().chain(&self.given_up);
        let asked = all.into_iter().find(|asked| asked.counter == counter);
        asked.map(|asked| asked.values)
    }

    /// The question that is answered.
    pub(super) fn answered(&mut self, counter: u16) -> Option<(Asked, Promptness)> {
        let take = |asked: &mut VecDeque<Asked>| {
            let index = asked.iter().position(|asked| asked.counter == counter)?;
            asked.remove(index)
        };
        if let Some(asked) = take(&mut self.waiting) {
            return Some((asked, Promptness::InTime));
        }
        take(&mut self.given_up).map(|asked| (asked, Promptness::Late))
    }

    /// When the next question is given up.
    pub(super) fn deadline(&self) -> Option<Stamp<HostClock>> {
        self.waiting.iter().map(|asked| asked.due).min()
    }

    /// The next question that has waited for too long.
    pub(super) fn expired(&mut self, now: Stamp<HostClock>) -> Option<Question> {
        let index = self.waiting.iter().position(|asked| asked.due <= now)?;
        self.set_aside(index)
    }

    /// The next question that left before this one and still waits: answers come in the order of their questions.
    pub(super) fn overtaken(&mut self, by: &Asked) -> Option<Question> {
        let is_older = |asked: &Asked| by.counter.wrapping_sub(asked.counter) < u16::MAX / 2;
        let index = self.waiting.iter().position(is_older)?;
        self.set_aside(index)
    }

    /// The next question, whose answer will not come.
    pub(super) fn give_up(&mut self) -> Option<Question> {
        self.set_aside(0)
    }

    fn set_aside(&mut self, index: usize) -> Option<Question> {
        let asked = self.waiting.remove(index)?;
        if self.given_up.len() >= MOST_GIVEN_UP {
            self.given_up.pop_front();
        }
        self.given_up.push_back(asked);
        Some(asked.question)
    }
}
