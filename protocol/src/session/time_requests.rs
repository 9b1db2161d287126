//! Our time requests and the answers to them.
//!
//! Requests go to everybody; every peer answers once. An answer counts only if it echoes a stamp that we really sent a
//! short while ago: late, doubled and invented answers would bend the clock.

use std::collections::VecDeque;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, Span, Stamp};

use super::{SHORTEST_PERIOD, next_after};

/// Requests at the start, and again for each new peer, that come in quick succession: ten exchanges give the hulls of the
/// clock alignment their first bounds.
const QUICK_REQUESTS: u8 = 10;
/// Time between quick requests.
const QUICK_PERIOD: Span = Span::from_millis(100);
/// An answer that comes later than this says nothing useful about the clock.
const STALE: Span = Span::from_millis(5_000);
/// The most requests that are remembered: five seconds of quick ones.
const MOST_OPEN: usize = 50;

/// One request of ours.
#[derive(Debug)]
struct Request<C: Clock> {
    sent: Stamp<C>,
    answered_by: Vec<Address>,
}

/// The requests that may still be answered, and when the next one is due.
#[derive(Debug)]
pub(super) struct TimeRequests<C: Clock> {
    period: Option<Span>,
    next: Stamp<C>,
    quick_left: u8,
    open: VecDeque<Request<C>>,
}

impl<C: Clock> TimeRequests<C> {
    pub(super) fn new(period: Option<Span>, now: Stamp<C>) -> Self {
        Self {
            period: period.map(|period| period.max(SHORTEST_PERIOD)),
            next: now,
            quick_left: QUICK_REQUESTS,
            open: VecDeque::new(),
        }
    }

    /// Starts a new series of quick requests.
    pub(super) fn hurry(&mut self, now: Stamp<C>) {
        self.quick_left = QUICK_REQUESTS;
        self.next = self.next.min(now + QUICK_PERIOD);
    }

    /// The stamp to send in a request, if one is due.
    pub(super) fn due(&mut self, now: Stamp<C>) -> Option<i64> {
        let period = self.period?;
        if now < self.next {
            return None;
        }
        self.forget_stale(now);
        let is_quick = self.quick_left > 0;
        self.quick_left = self.quick_left.saturating_sub(1);
        let wait = if is_quick { QUICK_PERIOD.min(period) } else { period };
        self.next = next_after(self.next, wait, now);
        if self.open.len() == MOST_OPEN {
            self.open.pop_front();
        }
        self.open.push_back(Request { sent: now, answered_by: Vec::new() });
        Some(now.as_nanos())
    }

    /// When we asked, if this is the first answer of `peer` to a request that is still open.
    pub(super) fn answered(&mut self, now: Stamp<C>, peer: Address, echoed_nanos: i64) -> Option<Stamp<C>> {
        self.forget_stale(now);
        let request = self.open.iter_mut().find(|request| request.sent.as_nanos() == echoed_nanos)?;
        if request.answered_by.contains(&peer) {
            return None;
        }
        request.answered_by.push(peer);
        Some(request.sent)
    }

    pub(super) fn deadline(&self) -> Option<Stamp<C>> {
        self.period.map(|_| self.next)
    }

    /// The clock fell: what was stamped before cannot be compared any more.
    pub(super) fn set_back(&mut self, fall: Span) {
        self.next = self.next - fall;
        self.open.clear();
    }

    fn forget_stale(&mut self, now: Stamp<C>) {
        while self.open.front().is_some_and(|request| now - request.sent > STALE) {
            self.open.pop_front();
        }
    }
}
