//! The station's outputs until they are polled.
//!
//! The station's own output is sent first, then forwarded frames: no robot steers by them.

use std::collections::{BTreeSet, VecDeque};

use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Event, LinkId, Output};

use crate::receive_pass::ForwardingReport;

/// Outputs, oldest first.
#[derive(Debug, Default)]
pub(crate) struct OutputQueue {
    own: VecDeque<Output>,
    pub(crate) forwarded: VecDeque<Output>,
    /// Frames of this input to count and to forward after the station's own output.
    pub(crate) reports: Vec<(LinkId, ForwardingReport)>,
    /// Robots of other stations for which frames of others came.
    pub(crate) withheld: BTreeSet<Endpoint>,
    /// Deferred work is left for the last input.
    pub(crate) is_unfinished: bool,
}

impl OutputQueue {
    /// Appends one of the station's own outputs. Not inlined: an output is large, and is then constructed in place.
    #[inline(never)]
    pub(crate) fn push(&mut self, output: Output) {
        self.own.push_back(output);
    }

    #[inline]
    pub(crate) fn emit(&mut self, event: Event) {
        self.push(Output::Event(event));
    }

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
            queue.forwarded.push_back(Output::Event(event(10 + number)));
            queue.emit(event(number));
        }
        assert!(!queue.has_no_own());
        let order = std::iter::from_fn(|| queue.pop());
        assert!(order.eq([0, 1, 2, 10, 11, 12].map(|number| Output::Event(event(number)))));
        assert!(queue.has_no_own());
    }
}
