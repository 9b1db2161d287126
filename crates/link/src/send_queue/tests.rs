//! The promises of the queue, in examples and over random sequences.

use super::*;
use Priority::{Command, Forwarded, Session};
use proptest::prelude::*;

const fn estimate(stream: u32) -> Priority {
    Priority::Estimate { stream }
}

/// Everything that waits, in the order in which it would be written.
fn drained<D: PartialEq>(mut queue: SendQueue<D>) -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    while let Some(frame) = queue.head().map(|(_, rest)| rest.to_vec()) {
        frames.push(frame);
        queue.pop_head();
    }
    assert_eq!(queue.bytes(), 0);
    frames
}

/// The frames that are not started, in that order; they go on waiting.
fn waiting<D>(queue: &SendQueue<D>) -> Vec<Vec<u8>> {
    let waiting = queue.queues.iter().flatten();
    waiting.map(|waiting| waiting.frame.clone()).collect()
}

#[test]
fn the_highest_priority_goes_first_and_equals_keep_their_order() {
    let mut queue = SendQueue::new(100);
    for (priority, frame) in [
        (estimate(1), &b"e1"[..]),
        (Forwarded, b"f1"),
        (Session, b"c1"),
        (Command, b"x1"),
        (estimate(2), b"e2"),
        (Forwarded, b"f2"),
        (Session, b"c2"),
        (Command, b"x2"),
    ] {
        assert_eq!(queue.push((), priority, frame), 0);
    }
    let expected: [&[u8]; 8] = [b"x1", b"x2", b"c1", b"c2", b"f1", b"f2", b"e1", b"e2"];
    assert_eq!(queue.bytes(), 16);
    assert_eq!(drained(queue), expected);
}

#[test]
fn a_full_queue_drops_the_stalest_estimate_then_forwarded_then_conversation() {
    let mut queue = SendQueue::new(10);
    assert_eq!(queue.push((), estimate(1), b"e1"), 0);
    assert_eq!(queue.push((), estimate(2), b"e2"), 0);
    assert_eq!(queue.push((), Forwarded, b"f1"), 0);
    assert_eq!(queue.push((), Forwarded, b"f2"), 0);
    assert_eq!(queue.push((), Session, b"c1"), 0);
    // Stream 1 is renewed in its place, so stream 2 is the stalest.
    assert_eq!(queue.push((), estimate(1), b"E1"), 1);
    assert_eq!(queue.push((), Session, b"c2"), 1);
    assert_eq!(waiting(&queue), [&b"c1"[..], b"c2", b"f1", b"f2", b"E1"]);
    assert_eq!(queue.push((), Session, b"c3"), 1);
    assert_eq!(queue.push((), Session, b"c4"), 1);
    assert_eq!(waiting(&queue), [&b"c1"[..], b"c2", b"c3", b"c4", b"f2"]);
    assert_eq!(queue.push((), Session, b"c5"), 1);
    assert_eq!(queue.push((), Session, b"c6"), 1);
    let expected: [&[u8]; 5] = [b"c2", b"c3", b"c4", b"c5", b"c6"];
    assert_eq!(drained(queue), expected);
}

#[test]
fn nothing_worthier_is_dropped_for_a_newcomer() {
    let mut queue = SendQueue::new(4);
    assert_eq!(queue.push((), Session, b"cccc"), 0);
    assert_eq!(queue.push((), Forwarded, b"f"), 1);
    assert_eq!(queue.push((), estimate(1), b"e"), 1);
    assert_eq!(drained(queue), [b"cccc"]);
}

#[test]
fn a_frame_that_cannot_fit_drops_only_itself() {
    let mut queue = SendQueue::new(4);
    assert_eq!(queue.push((), Forwarded, b"aa"), 0);
    assert_eq!(queue.push((), Forwarded, b"bbbbb"), 1);
    assert_eq!(queue.push((), Session, b"ccccc"), 1);
    assert_eq!(drained(queue), [b"aa"]);
}

#[test]
fn a_begun_frame_is_finished_before_worthier_ones() {
    let mut queue = SendQueue::new(10);
    assert_eq!(queue.push((), estimate(1), b"aaaa"), 0);
    queue.advance(1);
    assert_eq!(queue.push((), estimate(1), b"AAAA"), 0);
    assert_eq!(queue.push((), Command, b"x"), 0);
    assert_eq!(queue.head(), Some((&(), &b"aaa"[..])));
    assert_eq!(queue.head_unstarted(), None);
    queue.advance(3);
    assert_eq!(queue.head(), Some((&(), &b"x"[..])));
    assert_eq!(queue.head_unstarted(), Some((&(), Command, &b"x"[..])));
}

#[test]
fn a_queue_without_capacity_keeps_only_begun_frames_and_commands() {
    let mut queue = SendQueue::new(0);
    assert_eq!(queue.push((), Session, b"a"), 1);
    assert!(queue.is_empty());
    queue.push_partial((), b"st");
    assert_eq!(queue.push((), Forwarded, b"b"), 1);
    assert_eq!(queue.push((), Command, b"x"), 0);
    assert_eq!((queue.len(), queue.bytes()), (2, 3));
    assert_eq!(queue.clear(), 2);
    assert!(queue.is_empty());
    assert_eq!(queue.bytes(), 0);
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Push(Priority, u8, usize),
    Write(usize),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let priority = prop_oneof![Just(Command), Just(Session), Just(Forwarded), (0..3_u32).prop_map(estimate),];
    let step = prop_oneof![
        3 => (priority, 0..2_u8, 1..40_usize).prop_map(|(p, to, len)| Step::Push(p, to, len)),
        1 => (0..60_usize).prop_map(Step::Write),
    ];
    prop::collection::vec(step, 0..200)
}

/// A queue with a writer behind it, and what should come out.
struct Bench {
    queue: SendQueue<u8>,
    accepted_commands: Vec<u32>,
    refused_commands: u64,
    offered: u64,
    dropped: u64,
    written: Vec<u32>,
    /// Number and unwritten length of the frame that is being written.
    begun: Option<(u32, usize)>,
}

/// A frame whose every byte is its number, so that a truncated or mixed one shows.
fn numbered(number: u32, length: usize) -> Vec<u8> {
    number.to_be_bytes().into_iter().cycle().take(length.max(4)).collect()
}

impl Bench {
    const LIMIT: usize = 200;
    const RESERVE: usize = 120;

    fn new() -> Self {
        Self {
            queue: SendQueue::with_reserve(Self::LIMIT, Self::RESERVE),
            accepted_commands: Vec::new(),
            refused_commands: 0,
            offered: 0,
            dropped: 0,
            written: Vec::new(),
            begun: None,
        }
    }

    fn push(&mut self, priority: Priority, to: u8, length: usize) {
        let number = self.offered as u32;
        let frame = numbered(number, length);
        let command_bytes = self.queue.command_bytes;
        let dropped = self.queue.push(to, priority, &frame);
        if priority == Command {
            let fits = command_bytes + frame.len() <= Self::RESERVE;
            assert_eq!(dropped, u64::from(!fits), "a command pushes nothing out");
            if fits {
                self.accepted_commands.push(number);
            } else {
                self.refused_commands += 1;
            }
        }
        self.offered += 1;
        self.dropped += dropped;
    }

    /// Lets the writer take `count` bytes, across frames.
    fn write(&mut self, mut count: usize) {
        while let Some((_, rest)) = self.queue.head() {
            if count == 0 {
                return;
            }
            let take = count.min(rest.len());
            if let Some((_, left)) = self.begun {
                assert_eq!(rest.len(), left, "a begun frame was replaced");
            } else {
                let number = u32::from_be_bytes([rest[0], rest[1], rest[2], rest[3]]);
                self.begun = Some((number, rest.len()));
            }
            let (number, left) = self.begun.expect("just set");
            self.begun = Some((number, left - take));
            if left == take {
                self.written.push(number);
                self.begun = None;
            }
            self.queue.advance(take);
            count -= take;
        }
    }
}

proptest! {
    #[test]
    fn commands_keep_their_order_none_is_lost_and_the_queue_is_bounded(steps in steps()) {
        let mut bench = Bench::new();
        for step in steps {
            match step {
                Step::Push(priority, to, length) => bench.push(priority, to, length),
                Step::Write(count) => bench.write(count),
            }
            // A begun frame was within the bounds when it was complete.
            prop_assert!(bench.queue.telemetry_bytes <= Bench::LIMIT);
            prop_assert!(bench.queue.command_bytes <= Bench::RESERVE);
            prop_assert!(bench.queue.bytes() <= Bench::LIMIT + Bench::RESERVE + 40);
            let departed = bench.written.len() as u64 + bench.dropped;
            prop_assert_eq!(bench.offered, departed + bench.queue.len() as u64);
        }
        bench.write(usize::MAX);
        prop_assert!(bench.queue.is_empty());
        prop_assert_eq!(bench.queue.bytes(), 0);
        let mut commands = bench.accepted_commands.clone();
        let is_command = |number: &&u32| bench.accepted_commands.contains(*number);
        let written: Vec<u32> = bench.written.iter().filter(is_command).copied().collect();
        commands.sort_unstable();
        prop_assert_eq!(written, commands);
    }

    #[test]
    fn of_each_stream_and_destination_only_the_newest_estimate_waits(
        pushes in prop::collection::vec((0..3_u32, 0..2_u8), 1..60)
    ) {
        let mut queue = SendQueue::new(10_000);
        let mut newest = std::collections::BTreeMap::new();
        for (number, (stream, to)) in pushes.iter().enumerate() {
            let dropped = queue.push(*to, estimate(*stream), &numbered(number as u32, 8));
            let replaced = newest.insert((*stream, *to), number as u32).is_some();
            prop_assert_eq!(dropped, u64::from(replaced));
        }
        let mut waiting: Vec<_> = drained(queue);
        waiting.sort();
        let mut expected: Vec<_> = newest.values().map(|number| numbered(*number, 8)).collect();
        expected.sort();
        prop_assert_eq!(waiting, expected);
    }
}
