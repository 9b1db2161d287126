//! Time requests of this participant, and the replies to them.
//!
//! Requests are broadcast; every peer replies once. A reply counts only if it echoes the timestamp of a recent
//! request: late, duplicate and forged replies would corrupt the clock alignment.

use std::collections::{BTreeSet, VecDeque};

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{PeerId, TimeDelta, Timestamp};

use super::output::{MIN_PERIOD, SessionSender, next_period};

/// Number of requests in quick succession, at the start and for each new peer: ten exchanges give the hulls of the
/// clock alignment their first bounds.
const QUICK_REQUESTS: u8 = 10;
const QUICK_PERIOD: TimeDelta = TimeDelta::from_millis(100);
/// A later reply says nothing useful about the clock.
const STALE: TimeDelta = TimeDelta::from_millis(5_000);
/// Most remembered requests: five seconds of quick ones.
const MAX_OPEN: usize = 50;

#[derive(Debug)]
struct OpenTimeRequest<C: Clock> {
    sent: Timestamp<C>,
    answered_by: BTreeSet<SessionSender>,
}

impl<C: Clock> OpenTimeRequest<C> {
    /// Whether a sender has replied already; a reply from an unknown peer counts for every peer with its address.
    fn is_answered_by(&self, sender: SessionSender) -> bool {
        let of_address = |peer| SessionSender { peer, ..sender };
        let is_unknown_peer = self.answered_by.contains(&of_address(None));
        is_unknown_peer
            || match sender.peer {
                Some(_) => self.answered_by.contains(&sender),
                None => self.answered_by.range(of_address(None)..=of_address(Some(PeerId(u32::MAX)))).next().is_some(),
            }
    }
}

/// The open requests, and when the next one is due.
#[derive(Debug)]
pub(super) struct TimeRequests<C: Clock> {
    period: Option<TimeDelta>,
    next: Timestamp<C>,
    quick_remaining: u8,
    open: VecDeque<OpenTimeRequest<C>>,
}

impl<C: Clock> TimeRequests<C> {
    pub(super) fn new(period: Option<TimeDelta>, now: Timestamp<C>) -> Self {
        Self {
            period: period.map(|period| period.max(MIN_PERIOD)),
            next: now,
            quick_remaining: QUICK_REQUESTS,
            open: VecDeque::new(),
        }
    }

    /// Starts a new series of quick requests.
    pub(super) fn restart_quick(&mut self, now: Timestamp<C>) {
        self.quick_remaining = QUICK_REQUESTS;
        self.next = self.next.min(now + QUICK_PERIOD);
    }

    /// The timestamp to send in a request, if one is due.
    pub(super) fn due(&mut self, now: Timestamp<C>) -> Option<i64> {
        let period = self.period?;
        if now < self.next {
            return None;
        }
        self.expire_stale(now);
        let is_quick = self.quick_remaining > 0;
        self.quick_remaining = self.quick_remaining.saturating_sub(1);
        let wait = if is_quick { QUICK_PERIOD.min(period) } else { period };
        self.next = next_period(self.next, wait, now);
        if self.open.len() == MAX_OPEN {
            self.open.pop_front();
        }
        self.open.push_back(OpenTimeRequest { sent: now, answered_by: BTreeSet::new() });
        Some(now.as_nanos())
    }

    /// When the request was sent, if this is the first reply of `peer` to an open request.
    pub(super) fn match_response(
        &mut self,
        now: Timestamp<C>,
        sender: SessionSender,
        echoed_nanos: i64,
    ) -> Option<Timestamp<C>> {
        self.expire_stale(now);
        let request = self.open.iter_mut().find(|request| request.sent.as_nanos() == echoed_nanos)?;
        if request.is_answered_by(sender) {
            return None;
        }
        request.answered_by.insert(sender);
        Some(request.sent)
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<C>> {
        self.period.map(|_| self.next)
    }

    /// The clock fell: earlier timestamps cannot be compared any more.
    pub(super) fn shift_clock(&mut self, fall: TimeDelta) {
        self.next = self.next - fall;
        self.open.clear();
    }

    fn expire_stale(&mut self, now: Timestamp<C>) {
        while self.open.front().is_some_and(|request| now - request.sent > STALE) {
            self.open.pop_front();
        }
    }
}
