//! Outstanding requests, their replies and timeouts.
//!
//! Replies have no number, and two requests of one kind have replies of one kind. A late reply must not be matched to a
//! later request, or all following replies would be shifted. The brick answers in order, so after every disturbance one
//! request of another kind is sent: the barrier. Its reply proves that every earlier request is answered or lost; until
//! then nothing else is requested.
//!
//! # Model
//! ```text
//! waiting      sent, and within the timeout
//! overdue      sent, timed out, its reply may still come; dropped when the barrier is answered
//! a reply      matches the oldest overdue request that it can answer, else the oldest waiting one, else none
//! ```

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::nxt_request::NxtRequest;
use super::telegram::NxtReply;

/// Most given-up questions that are remembered; while a fence waits no others are asked, so there are a few and fences.
const MAX_OVERDUE: usize = 8;

/// A question on its way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PendingRequest {
    pub(super) request: NxtRequest,
    pub(super) sent: Timestamp<HostClock>,
}

/// Whose answer a reply is.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ReplyMatch {
    /// Of a question that waited.
    Reply(PendingRequest),
    /// Of a question that was given up.
    TooLate,
    /// Of no request.
    Unexpected,
}

/// Where the fence stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SyncBarrier {
    Clear,
    Wanted,
    Pending,
}

/// What was counted since the codec was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RequestCounts {
    /// Questions that were answered in time.
    pub(super) answered: u64,
    /// Questions, fences apart, that were given up.
    pub(super) lost: u64,
    /// Replies to questions that had been given up, and to none.
    pub(super) late: u64,
}

/// The state of one link.
#[derive(Debug)]
pub(super) struct RequestTracker {
    timeout: TimeDelta,
    waiting: VecDeque<PendingRequest>,
    overdue: VecDeque<NxtRequest>,
    barrier: SyncBarrier,
    tally: RequestCounts,
}

impl RequestTracker {
    pub(super) const fn new(timeout: TimeDelta) -> Self {
        Self {
            timeout,
            waiting: VecDeque::new(),
            overdue: VecDeque::new(),
            barrier: SyncBarrier::Wanted,
            tally: RequestCounts { answered: 0, lost: 0, late: 0 },
        }
    }

    /// The link is a new one: no reply to what was asked before can come.
    pub(super) fn restart(&mut self) {
        self.waiting.clear();
        self.overdue.clear();
        self.barrier = SyncBarrier::Wanted;
    }

    /// Whether the fence must be asked next.
    pub(super) fn needs_barrier(&self) -> bool {
        self.barrier == SyncBarrier::Wanted
    }

    /// Whether another question may leave when at most `most` wait.
    pub(super) fn has_capacity(&self, most: usize) -> bool {
        match self.barrier {
            SyncBarrier::Clear => self.waiting.len() < most,
            SyncBarrier::Wanted => self.waiting.is_empty(),
            SyncBarrier::Pending => false,
        }
    }

    /// Whether this very question waits. It must not be asked again before: with two equal ones the reply would be ambiguous.
    pub(super) fn is_waiting_for(&self, question: &NxtRequest) -> bool {
        self.waiting.iter().any(|asked| asked.request == *question)
    }

    pub(super) const fn counts(&self) -> RequestCounts {
        self.tally
    }

    pub(super) fn record_sent(&mut self, question: NxtRequest, sent: Timestamp<HostClock>) {
        if question == NxtRequest::SyncBarrier {
            self.barrier = SyncBarrier::Pending;
        }
        self.waiting.push_back(PendingRequest { request: question, sent });
    }

    /// Whose answer this is.
    pub(super) fn match_reply(&mut self, reply: &NxtReply<'_>) -> ReplyMatch {
        let fits = |question: &NxtRequest| question.matches_reply(reply);
        if NxtRequest::SyncBarrier.matches_reply(reply) {
            return self.match_barrier();
        }
        if let Some(at) = self.overdue.iter().position(fits) {
            self.overdue.remove(at);
            self.tally.late += 1;
            return ReplyMatch::TooLate;
        }
        let found = self.waiting.iter().position(|asked| fits(&asked.request));
        let Some(asked) = found.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return ReplyMatch::Unexpected;
        };
        self.tally.answered += 1;
        ReplyMatch::Reply(asked)
    }

    /// Any fence that comes back is one: all that stood before it is known to be over.
    fn match_barrier(&mut self) -> ReplyMatch {
        let is_waited_for = self.barrier == SyncBarrier::Pending;
        let waiting = self.waiting.iter().position(|asked| asked.request == NxtRequest::SyncBarrier);
        let Some(asked) = waiting.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return if is_waited_for { ReplyMatch::TooLate } else { ReplyMatch::Unexpected };
        };
        self.overdue.clear();
        self.barrier = SyncBarrier::Clear;
        self.tally.answered += 1;
        ReplyMatch::Reply(asked)
    }

    /// Gives up the oldest question that waits for too long; a fence must come next.
    pub(super) fn expire(&mut self, now: Timestamp<HostClock>) -> Option<NxtRequest> {
        if self.deadline().is_none_or(|due| due > now) {
            return None;
        }
        let asked = self.waiting.pop_front()?;
        self.abandon(asked.request.clone());
        Some(asked.request)
    }

    /// The stream is out of step: no answer to what waits will be understood. Returns the questions that are lost by it.
    pub(super) fn abort_all(&mut self) -> Vec<NxtRequest> {
        let mut lost = Vec::new();
        while let Some(asked) = self.waiting.pop_front() {
            self.abandon(asked.request.clone());
            lost.push(asked.request);
        }
        self.barrier = SyncBarrier::Wanted;
        lost
    }

    fn abandon(&mut self, question: NxtRequest) {
        self.barrier = SyncBarrier::Wanted;
        if question == NxtRequest::SyncBarrier {
            return;
        }
        self.tally.lost += 1;
        if self.overdue.len() >= MAX_OVERDUE {
            self.overdue.pop_front();
        }
        self.overdue.push_back(question);
    }

    /// When [`RequestTracker::expire`] must be called.
    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
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

    fn begun() -> RequestTracker {
        let mut talk = RequestTracker::new(TimeDelta::from_millis(500));
        talk.record_sent(NxtRequest::SyncBarrier, Timestamp::ZERO);
        talk.match_reply(&NxtReply::parse(&VERSION).unwrap());
        talk
    }

    #[test]
    fn a_late_reply_is_never_the_answer_to_a_later_question() {
        let mut talk = begun();
        talk.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::ZERO);
        assert_eq!(talk.deadline(), Some(Timestamp::from_millis(500)));
        assert_eq!(talk.expire(Timestamp::from_millis(499)), None);
        let given_up = talk.expire(Timestamp::from_millis(500));
        assert_eq!(given_up, Some(NxtRequest::IoMap(ALL_MOTORS)));
        assert!(talk.needs_barrier() && talk.has_capacity(1));

        // Nothing but the fence may be asked before it is known what became of the reply.
        talk.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500));
        assert!(!talk.has_capacity(2));
        let motors = motors();
        assert_eq!(talk.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::TooLate);
        assert!(matches!(talk.match_reply(&NxtReply::parse(&VERSION).unwrap()), ReplyMatch::Reply(_)));
        talk.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(600));
        assert!(matches!(talk.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::Reply(_)));
        let tally = talk.counts();
        assert_eq!((tally.answered, tally.lost, tally.late), (4 - 1, 1, 1));
    }

    #[test]
    fn a_reply_that_never_came_is_forgotten_behind_the_fence() {
        let mut talk = begun();
        talk.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::ZERO);
        talk.expire(Timestamp::from_millis(500));
        talk.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500));
        talk.match_reply(&NxtReply::parse(&VERSION).unwrap());
        talk.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(530));
        let motors = motors();
        assert!(matches!(
            talk.match_reply(&NxtReply::parse(&motors).unwrap()),
            ReplyMatch::Reply(asked) if asked.sent == Timestamp::from_millis(530)
        ));
    }

    #[test]
    fn replies_find_their_questions_out_of_two_and_no_other() {
        let mut talk = begun();
        talk.record_sent(NxtRequest::IoMap(ALL_INPUTS), Timestamp::ZERO);
        talk.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(1));
        assert!(!talk.has_capacity(2));
        let motors = motors();
        assert!(matches!(
            talk.match_reply(&NxtReply::parse(&motors).unwrap()),
            ReplyMatch::Reply(asked) if asked.request == NxtRequest::IoMap(ALL_MOTORS)
        ));
        assert_eq!(talk.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::Unexpected);
        assert_eq!(talk.abort_all(), [NxtRequest::IoMap(ALL_INPUTS)]);
        assert!(talk.needs_barrier());
    }

    #[test]
    fn stray_fences_after_a_stall_do_no_harm() {
        let mut talk = RequestTracker::new(TimeDelta::from_millis(500));
        for half_second in 0..3 {
            talk.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500 * half_second));
            if half_second < 2 {
                talk.expire(Timestamp::from_millis(500 * (half_second + 1)));
            }
        }
        let version = NxtReply::parse(&VERSION).unwrap();
        assert!(matches!(talk.match_reply(&version), ReplyMatch::Reply(_)));
        assert_eq!(talk.match_reply(&version), ReplyMatch::Unexpected);
        assert!(talk.has_capacity(1));
        assert_eq!(talk.counts().lost, 0);
    }
}
