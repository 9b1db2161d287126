//! Any text as a link profile: it is rejected with a line, or it makes a link whose time advances and whose counters
//! balance.

use posebridge_sim::impairment::{
    Counters, DirectionProfile, ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile,
};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::operands::Operands;

/// Events of one input beyond which its outages are those of no link that anybody studies; the rest is left out.
const MAX_EVENTS: u32 = 3_000;
/// What is still on the way arrives within this, or never does by the profile.
const AFTERWARDS: TimeDelta = TimeDelta::from_millis(1_000);

/// Input: seed, number of bytes of a program, the program, then the text.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    let seed = operands.byte();
    let length = usize::from(operands.byte());
    let program = operands.take_up_to(length);
    let Ok(text) = std::str::from_utf8(operands.remaining()) else {
        // The program reads the file as text; what is none never comes this far.
        return;
    };
    match LinkProfile::from_toml(text) {
        Ok(profile) => drive(&profile, u64::from(seed), program),
        Err(error) => {
            let message = error.to_string();
            assert!(message.contains("line "), "{message}");
        }
    }
}

/// Offers what the program says, and takes everything at its deadline.
fn drive(profile: &LinkProfile, seed: u64, program: &[u8]) {
    let mut bench = LinkBench::new(profile, seed);
    let mut operands = Operands::new(program);
    let mut now = Timestamp::ZERO;
    while !operands.is_empty() {
        let (what, size) = (operands.byte(), operands.byte());
        now = now + TimeDelta::from_micros(i64::from(what >> 1) * i64::from(what >> 1) * 10);
        bench.advance_to(now);
        let from = if what & 1 == 0 { LinkEnd::Brick } else { LinkEnd::Station };
        bench.offer(from, now, usize::from(size) * 8);
        bench.advance_to(now);
    }
    bench.advance_to(now + AFTERWARDS);
    bench.finish();
}

/// A link, its twin, and what went in and came out at both ends.
struct LinkBench<'a> {
    profile: &'a LinkProfile,
    link: ImpairedLink,
    twin: ImpairedLink,
    latest: Timestamp<HostClock>,
    events: u32,
    is_up: bool,
    /// By the end that hears: the brick first.
    offered: [Vec<u8>; 2],
    delivered: [Vec<u8>; 2],
    next: u8,
}

impl<'a> LinkBench<'a> {
    fn new(profile: &'a LinkProfile, seed: u64) -> Self {
        let open = || ImpairedLink::new(profile, seed, Timestamp::ZERO);
        Self {
            profile,
            link: open(),
            twin: open(),
            latest: Timestamp::ZERO,
            events: 0,
            is_up: true,
            offered: [Vec::new(), Vec::new()],
            delivered: [Vec::new(), Vec::new()],
            next: 0,
        }
    }

    fn offer(&mut self, from: LinkEnd, now: Timestamp<HostClock>, size: usize) {
        let next = &mut self.next;
        let bytes: Vec<u8> = std::iter::repeat_with(|| {
            *next = next.wrapping_add(1);
            *next
        })
        .take(size)
        .collect();
        let unit = self.link.offer(from, now, &bytes);
        assert_eq!(self.twin.offer(from, now, &bytes), unit);
        self.offered[index(from.other())].extend(bytes);
    }

    /// Takes what happens until `now`, each thing at the deadline that was told.
    fn advance_to(&mut self, now: Timestamp<HostClock>) {
        while let Some(due) = self.link.deadline().filter(|due| *due <= now) {
            assert!(due >= self.latest, "time runs back to {due:?}");
            self.latest = due;
            self.events += 1;
            if self.events > MAX_EVENTS {
                return;
            }
            let event = self.link.poll(due);
            assert_eq!(self.twin.poll(due), event, "the same seed, another link");
            match event {
                Some(event) => self.on_event(event),
                None => panic!("nothing happens at the deadline {due:?}"),
            }
        }
    }

    fn on_event(&mut self, event: ImpairedLinkEvent) {
        match event {
            ImpairedLinkEvent::Arrived { end, delivery } => {
                assert!(!delivery.bytes.is_empty());
                assert!(self.is_up, "something arrives over a link that is down");
                self.delivered[index(end)].extend(delivery.bytes);
            }
            ImpairedLinkEvent::Down { .. } => assert!(std::mem::replace(&mut self.is_up, false)),
            ImpairedLinkEvent::Up { .. } => assert!(!std::mem::replace(&mut self.is_up, true)),
        }
    }

    fn finish(&self) {
        for (end, direction) in [(LinkEnd::Brick, &self.profile.to_brick), (LinkEnd::Station, &self.profile.to_station)]
        {
            let (offered, delivered) = (&self.offered[index(end)], &self.delivered[index(end)]);
            let counters = self.link.counters(end);
            check_totals(counters, offered.len());
            if self.events > MAX_EVENTS {
                continue;
            }
            let told = counters.bytes_delivered + counters.bytes_repeated;
            assert!(delivered.len() as u64 <= told, "more came than was told");
            if self.is_harmless(direction) {
                assert!(offered.starts_with(delivered), "a harmless link harms");
            }
        }
    }

    /// Nothing is lost, turned over or overtaken: what comes is the beginning of what was sent.
    fn is_harmless(&self, direction: &DirectionProfile) -> bool {
        self.profile.kind == LinkKind::Stream
            && self.profile.disconnects.is_none()
            && direction.rate.is_none()
            && direction.loss == 0.0
            && direction.burst_loss.is_none()
            && direction.byte_loss == 0.0
            && direction.bit_error_rate == 0.0
    }
}

const fn index(end: LinkEnd) -> usize {
    match end {
        LinkEnd::Brick => 0,
        LinkEnd::Station => 1,
    }
}

/// Every byte that was offered came, was lost for a cause, or is on the way.
fn check_totals(counters: Counters, offered: usize) {
    assert_eq!(counters.bytes_offered, offered as u64);
    let told = counters.bytes_delivered + counters.bytes_lost() + counters.bytes_on_the_way;
    assert_eq!(told, counters.bytes_offered, "{counters:?}");
}
