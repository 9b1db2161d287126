//! What a pipeline has to say, until somebody takes it.
//!
//! An output is large, and who replays a recording looks at most of them and takes none: one that was looked at stays where it is until
//! the last has been, instead of being moved out of the queue to be forgotten.

use posebridge_telemetry::{Event, Output};

/// Outputs, oldest first.
#[derive(Clone, Debug, Default)]
pub(super) struct Outbox {
    outputs: Vec<Option<Output>>,
    /// So many of them were taken or passed over.
    gone: usize,
}

impl Outbox {
    /// Puts one behind the others.
    pub(super) fn push(&mut self, output: Output) {
        self.outputs.push(Some(output));
    }

    /// The same for something that happened.
    #[inline]
    pub(super) fn tell(&mut self, event: Event) {
        self.outputs.push(Some(Output::Event(event)));
    }

    /// Whether nothing waits.
    pub(super) const fn is_empty(&self) -> bool {
        self.gone == self.outputs.len()
    }

    /// The oldest.
    pub(super) fn front(&self) -> Option<&Output> {
        self.outputs.get(self.gone)?.as_ref()
    }

    /// Takes the oldest.
    pub(super) fn pop(&mut self) -> Option<Output> {
        let output = self.outputs.get_mut(self.gone)?.take();
        self.step();
        output
    }

    /// Leaves out the oldest; whether there was one.
    pub(super) fn pass_over(&mut self) -> bool {
        let was_one = !self.is_empty();
        if was_one {
            self.step();
        }
        was_one
    }

    fn step(&mut self) {
        self.gone += 1;
        if self.is_empty() {
            self.outputs.clear();
            self.gone = 0;
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
        let mut outbox = Outbox::default();
        assert!(!outbox.pass_over() && outbox.pop().is_none() && outbox.front().is_none());
        let mut next = 0;
        let mut expected = 0;
        for round in 0..50 {
            for _ in 0..=round % 3 {
                outbox.tell(event(next));
                next += 1;
            }
            let wanted = Output::Event(event(expected));
            assert_eq!(outbox.front(), Some(&wanted));
            if round % 2 == 0 {
                assert_eq!(outbox.pop(), Some(wanted));
            } else {
                assert!(outbox.pass_over());
            }
            expected += 1;
        }
        while let Some(output) = outbox.pop() {
            assert_eq!(output, Output::Event(event(expected)));
            expected += 1;
        }
        assert_eq!(expected, next);
        assert!(outbox.is_empty() && outbox.outputs.is_empty());
    }
}
