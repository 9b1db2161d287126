//! Questions that wait for their answers, and what happens when none comes.
//!
//! Replies carry no number, and two questions of one kind have replies of one kind. A reply that comes too late must not be taken for
//! the answer to a later question, or the station would live in the past from then on. The brick answers in order, so after every
//! disturbance one question of another kind is asked: the fence. Its reply proves that everything asked before it is answered or lost;
//! until then nothing else is asked.
//!
//! # Model
//! ```text
//! waiting      asked, and within the time-out
//! overdue      asked, given up, its reply may still come; forgotten when the fence is answered
//! a reply      belongs to the oldest overdue question that it can answer, else to the oldest waiting one, else to nobody
//! ```

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::question::Question;
use super::telegram::Reply;

/// Most given-up questions that are remembered; while a fence waits no others are asked, so there are a few and fences.
const MOST_OVERDUE: usize = 8;

/// A question on its way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Asked {
    pub(super) question: Question,
    pub(super) sent: Stamp<HostClock>,
}

/// Whose answer a reply is.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Matched {
    /// Of a question that waited.
    Answer(Asked),
    /// Of a question that was given up.
    TooLate,
    /// Of nobody's.
    Unasked,
}

/// Where the fence stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fence {
    Down,
    Wanted,
    Asked,
}

/// What was counted since the codec was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    /// Questions that were answered in time.
    pub(super) answered: u64,
    /// Questions, fences apart, that were given up.
    pub(super) lost: u64,
    /// Replies to questions that had been given up, and to none.
    pub(super) late: u64,
}

/// The state of one link.
#[derive(Debug)]
pub(super) struct Conversation {
    timeout: Span,
    waiting: VecDeque<Asked>,
    overdue: VecDeque<Question>,
    fence: Fence,
    tally: Tally,
}

impl Conversation {
    pub(super) const fn new(timeout: Span) -> Self {
        Self {
            timeout,
            waiting: VecDeque::new(),
            overdue: VecDeque::new(),
            fence: Fence::Wanted,
            tally: Tally { answered: 0, lost: 0, late: 0 },
        }
    }

    /// The link is a new one: no reply to what was asked before can come.
    pub(super) fn restart(&mut self) {
        self.waiting.clear();
        self.overdue.clear();
        self.fence = Fence::Wanted;
    }

    /// Whether the fence must be asked next.
    pub(super) fn wants_fence(&self) -> bool {
        self.fence == Fence::Wanted
    }

    /// Whether another question may leave when at most `most` wait.
    pub(super) fn has_room(&self, most: usize) -> bool {
        match self.fence {
            Fence::Down => self.waiting.len() < most,
            Fence::Wanted => self.waiting.is_empty(),
            Fence::Asked => false,
        }
    }

    /// Whether this very question waits. It must not be asked again before: of two equal ones nobody could tell which was answered.
    pub(super) fn waits_for(&self, question: &Question) -> bool {
        self.waiting.iter().any(|asked| asked.question == *question)
    }

    pub(super) const fn tally(&self) -> Tally {
        self.tally
    }

    pub(super) fn ask(&mut self, question: Question, sent: Stamp<HostClock>) {
        if question == Question::Fence {
            self.fence = Fence::Asked;
        }
        self.waiting.push_back(Asked { question, sent });
    }

    /// Whose answer this is.
    pub(super) fn take(&mut self, reply: &Reply<'_>) -> Matched {
        let fits = |question: &Question| question.is_answered_by(reply);
        if Question::Fence.is_answered_by(reply) {
            return self.take_fence();
        }
        if let Some(at) = self.overdue.iter().position(fits) {
            self.overdue.remove(at);
            self.tally.late += 1;
            return Matched::TooLate;
        }
        let found = self.waiting.iter().position(|asked| fits(&asked.question));
        let Some(asked) = found.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return Matched::Unasked;
        };
        self.tally.answered += 1;
        Matched::Answer(asked)
    }

    /// Any fence that comes back is one: all that stood before it is known to be over.
    fn take_fence(&mut self) -> Matched {
        let is_waited_for = self.fence == Fence::Asked;
        let waiting = self.waiting.iter().position(|asked| asked.question == Question::Fence);
        let Some(asked) = waiting.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return if is_waited_for { Matched::TooLate } else { Matched::Unasked };
        };
        self.overdue.clear();
        self.fence = Fence::Down;
        self.tally.answered += 1;
        Matched::Answer(asked)
    }

    /// Gives up the oldest question that waits for too long; a fence must come next.
    pub(super) fn expire(&mut self, now: Stamp<HostClock>) -> Option<Question> {
        if self.deadline().is_none_or(|due| due > now) {
            return None;
        }
        let asked = self.waiting.pop_front()?;
        self.give_up(asked.question.clone());
        Some(asked.question)
    }

    /// The stream is out of step: no answer to what waits will be understood. Returns the questions that are lost by it.
    pub(super) fn break_off(&mut self) -> Vec<Question> {
        let mut lost = Vec::new();
        while let Some(asked) = self.waiting.pop_front() {
            self.give_up(asked.question.clone());
            lost.push(asked.question);
        }
        self.fence = Fence::Wanted;
        lost
    }

    fn give_up(&mut self, question: Question) {
        self.fence = Fence::Wanted;
        if question == Question::Fence {
            return;
        }
        self.tally.lost += 1;
        if self.overdue.len() >= MOST_OVERDUE {
            self.overdue.pop_front();
        }
        self.overdue.push_back(question);
    }

    /// When [`Conversation::expire`] must be called.
    pub(super) fn deadline(&self) -> Option<Stamp<HostClock>> {
        self.waiting.front().map(|asked| asked.sent + self.timeout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bricks::nxt::io_maps::{ALL_INPUTS, ALL_MOTORS};

    const VERSION: [u8; 7] = [0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01];

    fn motors() -> Vec<u8> {
        let mut telegram = vec![0x02, 0x94, 0x00, 0x01, 0x00, 0x02, 0x00, 0x60, 0x00];
        telegram.resize(9 + 96, 0);
        telegram
    }

    fn begun() -> Conversation {
        let mut talk = Conversation::new(Span::from_millis(500));
        talk.ask(Question::Fence, Stamp::ZERO);
        talk.take(&Reply::of(&VERSION).unwrap());
        talk
    }

    #[test]
    fn a_late_reply_is_never_the_answer_to_a_later_question() {
        let mut talk = begun();
        talk.ask(Question::Map(ALL_MOTORS), Stamp::ZERO);
        assert_eq!(talk.deadline(), Some(Stamp::from_millis(500)));
        assert_eq!(talk.expire(Stamp::from_millis(499)), None);
        let given_up = talk.expire(Stamp::from_millis(500));
        assert_eq!(given_up, Some(Question::Map(ALL_MOTORS)));
        assert!(talk.wants_fence() && talk.has_room(1));

        // Nothing but the fence may be asked before it is known what became of the reply.
        talk.ask(Question::Fence, Stamp::from_millis(500));
        assert!(!talk.has_room(2));
        let motors = motors();
        assert_eq!(talk.take(&Reply::of(&motors).unwrap()), Matched::TooLate);
        assert!(matches!(talk.take(&Reply::of(&VERSION).unwrap()), Matched::Answer(_)));
        talk.ask(Question::Map(ALL_MOTORS), Stamp::from_millis(600));
        assert!(matches!(talk.take(&Reply::of(&motors).unwrap()), Matched::Answer(_)));
        let tally = talk.tally();
        assert_eq!((tally.answered, tally.lost, tally.late), (4 - 1, 1, 1));
    }

    #[test]
    fn a_reply_that_never_came_is_forgotten_behind_the_fence() {
        let mut talk = begun();
        talk.ask(Question::Map(ALL_MOTORS), Stamp::ZERO);
        talk.expire(Stamp::from_millis(500));
        talk.ask(Question::Fence, Stamp::from_millis(500));
        talk.take(&Reply::of(&VERSION).unwrap());
        talk.ask(Question::Map(ALL_MOTORS), Stamp::from_millis(530));
        let motors = motors();
        assert!(matches!(
            talk.take(&Reply::of(&motors).unwrap()),
            Matched::Answer(asked) if asked.sent == Stamp::from_millis(530)
        ));
    }

    #[test]
    fn replies_find_their_questions_out_of_two_and_no_other() {
        let mut talk = begun();
        talk.ask(Question::Map(ALL_INPUTS), Stamp::ZERO);
        talk.ask(Question::Map(ALL_MOTORS), Stamp::from_millis(1));
        assert!(!talk.has_room(2));
        let motors = motors();
        assert!(matches!(
            talk.take(&Reply::of(&motors).unwrap()),
            Matched::Answer(asked) if asked.question == Question::Map(ALL_MOTORS)
        ));
        assert_eq!(talk.take(&Reply::of(&motors).unwrap()), Matched::Unasked);
        assert_eq!(talk.break_off(), [Question::Map(ALL_INPUTS)]);
        assert!(talk.wants_fence());
    }

    #[test]
    fn stray_fences_after_a_stall_do_no_harm() {
        let mut talk = Conversation::new(Span::from_millis(500));
        for half_second in 0..3 {
            talk.ask(Question::Fence, Stamp::from_millis(500 * half_second));
            if half_second < 2 {
                talk.expire(Stamp::from_millis(500 * (half_second + 1)));
            }
        }
        let version = Reply::of(&VERSION).unwrap();
        assert!(matches!(talk.take(&version), Matched::Answer(_)));
        assert_eq!(talk.take(&version), Matched::Unasked);
        assert!(talk.has_room(1));
        assert_eq!(talk.tally().lost, 0);
    }
}
