//! What a station has put out, until somebody takes it.
//!
//! The station's own output leaves first, then frames of others on their way to another link: nobody steers by them.
//!
//! An output is large, and a replay looks at most of them and takes none: one that was looked at stays where it is until the last has
//! been, instead of being moved out of the queue to be dropped.

use std::collections::VecDeque;

use posebridge_telemetry::{Event, LinkId, Output};

use crate::forwarding::ForwardingReport;

/// Outputs, oldest first.
#[derive(Debug, Default)]
pub(crate) struct OutputQueue {
    own: Vec<Option<Output>>,
    /// How many of them were taken or skipped.
    popped: usize,
    forwarded: VecDeque<Output>,
    /// What was routed in this input and is to be counted and forwarded after the station's own output.
    reports: Vec<(LinkId, ForwardingReport)>,
    /// Work is left to be done for the last input.
    is_unfinished: bool,
}

impl OutputQueue {
    /// Puts an output behind the station's own.
    pub(crate) fn push(&mut self, output: Output) {
        self.own.push(Some(output));
    }

    /// Puts an event behind the station's own output.
    #[inline]
    pub(crate) fn emit(&mut self, event: Event) {
        self.own.push(Some(Output::Event(event)));
    }

    /// Puts a frame of somebody else behind the others.
    pub(crate) fn push_forwarded(&mut self, output: Output) {
        self.forwarded.push_back(output);
    }

    /// Keeps what was routed, until [`Self::take_reports`].
    pub(crate) fn push_report(&mut self, link: LinkId, report: ForwardingReport) {
        if report.has_content() {
            self.reports.push((link, report));
        }
    }

    pub(crate) fn take_reports(&mut self) -> Vec<(LinkId, ForwardingReport)> {
        std::mem::take(&mut self.reports)
    }

    /// Work is left to be done for this input.
    pub(crate) const fn set_unfinished(&mut self) {
        self.is_unfinished = true;
    }

    /// Whether work was left to be done; from now on it is not.
    pub(crate) const fn take_unfinished(&mut self) -> bool {
        std::mem::replace(&mut self.is_unfinished, false)
    }

    /// Whether none of the station's own output is left.
    pub(crate) const fn has_no_own(&self) -> bool {
        self.popped == self.own.len()
    }

    pub(crate) fn front(&self) -> Option<&Output> {
        if self.has_no_own() {
            return self.forwarded.front();
        }
        self.own.get(self.popped)?.as_ref()
    }

    pub(crate) fn pop(&mut self) -> Option<Output> {
        if self.has_no_own() {
            return self.forwarded.pop_front();
        }
        let output = self.own.get_mut(self.popped)?.take();
        self.advance();
        output
    }

    /// Drops the next output where it is.
    pub(crate) fn skip(&mut self) {
        if self.has_no_own() {
            self.forwarded.pop_front();
        } else {
            self.advance();
        }
    }

    fn advance(&mut self) {
        self.popped += 1;
        if self.has_no_own() {
            self.own.clear();
            self.popped = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{LinkId, LinkState};

    fn event(number: u16) -> Event {
        Event::Link { link: LinkId(number), state: LinkState::Up }
    }

    #[test]
    fn what_is_taken_looked_at_and_put_in_between_keeps_its_order() {
        let mut queue = OutputQueue::default();
        queue.skip();
        assert!(queue.pop().is_none() && queue.front().is_none());
        let mut next = 0;
        let mut expected = 0;
        for round in 0..50 {
            for _ in 0..=round % 3 {
                queue.emit(event(next));
                next += 1;
            }
            let wanted = Output::Event(event(expected));
            assert_eq!(queue.front(), Some(&wanted));
            if round % 2 == 0 {
                assert_eq!(queue.pop(), Some(wanted));
            } else {
                queue.skip();
            }
            expected += 1;
        }
        while let Some(output) = queue.pop() {
            assert_eq!(output, Output::Event(event(expected)));
            expected += 1;
        }
        assert_eq!(expected, next);
        assert!(queue.has_no_own() && queue.own.is_empty());
    }
}
