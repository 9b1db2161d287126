//! What a station has put out, until it is taken.
//!
//! The station's own output leaves first, then frames of others on their way to another link: no robot steers by them.

use std::collections::VecDeque;

use posebridge_telemetry::{Event, LinkId, Output};

use crate::forwarding::ForwardingReport;

/// Outputs, oldest first.
#[derive(Debug, Default)]
pub(crate) struct OutputQueue {
    own: VecDeque<Output>,
    forwarded: VecDeque<Output>,
    /// What was routed in this input and is to be counted and forwarded after the station's own output.
    reports: Vec<(LinkId, ForwardingReport)>,
    /// Work is left to be done for the last input.
    is_unfinished: bool,
}

impl OutputQueue {
    /// Puts an output behind the station's own. Not inlined: an output is large, and is then made where it is copied from.
    #[inline(never)]
    pub(crate) fn push(&mut self, output: Output) {
        self.own.push_back(output);
    }

    /// Puts an event behind the station's own output.
    #[inline]
    pub(crate) fn emit(&mut self, event: Event) {
        self.push(Output::Event(event));
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
    pub(crate) fn has_no_own(&self) -> bool {
        self.own.is_empty()
    }

    pub(crate) fn pop(&mut self) -> Option<Output> {
        if self.own.is_empty() { self.forwarded.pop_front() } else { self.own.pop_front() }
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
    fn the_stations_own_output_leaves_before_forwarded_frames_and_each_in_its_order() {
        let mut queue = OutputQueue::default();
        assert!(queue.pop().is_none());
        for number in 0..3 {
            queue.push_forwarded(Output::Event(event(10 + number)));
            queue.emit(event(number));
        }
        assert!(!queue.has_no_own());
        let order = std::iter::from_fn(|| queue.pop());
        assert!(order.eq([0, 1, 2, 10, 11, 12].map(|number| Output::Event(event(number)))));
        assert!(queue.has_no_own());
    }
}
