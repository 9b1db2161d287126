//! Any frames from any endpoints: each goes exactly where the model of `protocol::routing` says, none goes back to its
//! origin, the memory is bounded, and no limit of a link is exceeded.
//!
//! [`model`] is a second, independent implementation of the model, without hashes and without bounds.

mod model;

use std::collections::BTreeMap;

use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::routing::{
    AllowBlockList, DuplicateStatus, Endpoint, ForwardPolicy, ForwardedDialects, FrameFilter, FrameRouter,
    LinkRateLimiter, LinkRules, MessageTarget, RateLimits, RouterConfig, RoutingDecision, SenderCheck, priority_of,
    target_of,
};
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, Priority, Recipients, SystemId, TimeDelta, Timestamp};

use self::model::{MAX_ROUTES, RouterModel};
use crate::operands::Operands;

const STATION: Address = Address::new(1, 197);
/// Links that have rules; a fifth has none.
const LINKS: u16 = 4;
/// Frames of one input, all in all, apart from crowds; together with those they stay within what is remembered of duplicates.
const MAX_FRAMES: u32 = 1_000;
/// Peers that are heard for the first time by one operation, and how often that may be: together a few more than are remembered.
const PEER_BURST: u32 = 1_024;
const SMALL_PEER_BURST: u32 = 32;
const MAX_PEER_BURSTS: u32 = 4;
const MAX_SMALL_PEER_BURSTS: u32 = 8;
/// Messages with a target, with a time, with neither, and one that nobody knows.
const MESSAGES: [u32; 12] = [0, 4, 23, 24, 30, 69, 75, 76, 77, 331, 42_100, 60_000];

/// Input: one byte that chooses router or limits, then the rules, then operations.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    if operands.byte() % 4 == 3 {
        return check_limits(operands);
    }
    let mut bench = RouterBench::new(rules(&mut operands));
    while !operands.is_empty() && bench.frames < MAX_FRAMES {
        match operands.byte() % 8 {
            0 => bench.now = bench.now + TimeDelta::from_millis(i64::from(operands.number())),
            1..=3 => bench.build(&mut operands),
            4 => {
                let way = endpoint(operands.byte());
                let length = usize::from(operands.byte()) * 4;
                bench.route_scanned(way, operands.take_up_to(length));
            }
            5 => bench.repeat_last(endpoint(operands.byte())),
            6 => bench.forget(LinkId(u16::from(operands.byte()) % (LINKS + 1))),
            _ => bench.add_peer_burst(operands.byte()),
        }
    }
}

/// Four links; groups, filters and what is forwarded as the bytes say.
fn rules(operands: &mut Operands<'_>) -> RouterConfig {
    let window = TimeDelta::from_millis([0, 1_000, 1_000, 60_000][usize::from(operands.byte() % 4)]);
    let links = (0..LINKS).map(|id| (LinkId(id), LinkRules { dialects: dialects(id), ..link_rules(operands.byte()) }));
    RouterConfig { own: STATION, duplicate_window: window, links: links.collect() }
}

fn link_rules(byte: u8) -> LinkRules {
    let group = [None, Some(1), Some(2), None][usize::from(byte % 4)];
    let forward = match byte >> 2 & 3 {
        0 => ForwardPolicy::ByRole,
        1 => ForwardPolicy::All,
        2 => ForwardPolicy::Targeted,
        _ => ForwardPolicy::Disabled,
    };
    LinkRules {
        group,
        forward,
        inward: filter(byte >> 4 & 3),
        outward: filter(byte >> 6),
        dialects: ForwardedDialects::default(),
        limits: RateLimits::default(),
    }
}

/// The last link is one of a ground station.
const fn dialects(link: u16) -> ForwardedDialects {
    if link + 1 == LINKS { ForwardedDialects::Stock } else { ForwardedDialects::All }
}

fn filter(choice: u8) -> FrameFilter {
    let mut filter = FrameFilter::default();
    match choice {
        2 => filter.messages.block = vec![0, 60_000],
        3 => filter.systems = AllowBlockList { allow: (1..5).map(SystemId).collect(), block: vec![SystemId(3)] },
        _ => {}
    }
    filter
}

/// One of fifteen ways: three peers on each of four links and on one without rules.
fn endpoint(byte: u8) -> Endpoint {
    Endpoint { link: LinkId(u16::from(byte) % (LINKS + 1)), peer: PeerId(u32::from(byte >> 4) % 3) }
}

/// The frame of these parts; checksums are the framer's business.
fn bytes_of(source: Address, message_id: u32, payload: &[u8]) -> Vec<u8> {
    let [a, b, c, _] = message_id.to_le_bytes();
    let (system, component) = (source.system.0, source.component.0);
    let mut bytes = vec![0xFD, payload.len() as u8, 0, 0, 0, system, component, a, b, c];
    bytes.extend_from_slice(payload);
    bytes.extend_from_slice(&[0, 0]);
    bytes
}

fn frame_of(bytes: &[u8]) -> FrameRef<'_> {
    FrameRef {
        version: WireVersion::V2,
        message_id: u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0]),
        source: Address::new(bytes[5], bytes[6]),
        sequence: bytes[4],
        payload: &bytes[10..bytes.len() - 2],
        raw: bytes,
    }
}

/// The router, and what it must do.
struct RouterBench {
    router: FrameRouter,
    model: RouterModel,
    now: Timestamp<HostClock>,
    frames: u32,
    peer_bursts: u32,
    small_peer_bursts: u32,
    next_peer: u32,
    last: Option<(Vec<u8>, SenderCheck)>,
}

impl RouterBench {
    fn new(config: RouterConfig) -> Self {
        Self {
            router: FrameRouter::new(config.clone()),
            model: RouterModel::new(config),
            now: Timestamp::ZERO,
            frames: 0,
            peer_bursts: 0,
            small_peer_bursts: 0,
            next_peer: 16,
            last: None,
        }
    }

    /// Somebody says something that may be for somebody.
    fn build(&mut self, operands: &mut Operands<'_>) {
        let way = endpoint(operands.byte());
        let (who, what) = (operands.byte(), operands.byte());
        let source = match who % 16 {
            0 => STATION,
            _ => Address::new(1 + who % 5, [0, 1, 2, 190][usize::from(who >> 6)]),
        };
        let message_id = MESSAGES[usize::from(what % 12)];
        let fill = operands.byte() % 6;
        let length = usize::from(operands.byte()) % 64;
        let mut payload = vec![fill; length];
        payload.extend_from_slice(operands.take_up_to(4));
        let check = match what >> 6 {
            3 => SenderCheck::Unverifiable,
            _ => SenderCheck::Verified,
        };
        let bytes = bytes_of(source, message_id, &payload);
        if source == STATION && who & 0x10 != 0 {
            self.router.record_sent(&bytes);
            self.model.record_sent(&frame_of(&bytes));
        }
        self.receive(way, bytes, check);
    }

    /// Bytes as they come from a link.
    fn route_scanned(&mut self, way: Endpoint, bytes: &[u8]) {
        let mut found = Vec::new();
        Framer::new(FramerConfig::default()).push(self.now, bytes, &mut |scanned| match scanned {
            FramerOutput::Frame(frame) => found.push((frame.raw.to_vec(), SenderCheck::Verified)),
            FramerOutput::UnknownFrame(frame) => found.push((frame.raw.to_vec(), SenderCheck::Unverifiable)),
            FramerOutput::Error(_) => {}
        });
        for (bytes, check) in found {
            self.receive(way, bytes, check);
        }
    }

    /// What came last comes again.
    fn repeat_last(&mut self, way: Endpoint) {
        if let Some((bytes, check)) = self.last.clone() {
            self.receive(way, bytes, check);
        }
    }

    fn forget(&mut self, link: LinkId) {
        self.router.forget_link(link);
        self.model.forget(link);
    }

    /// Many peers of one system on one link, and then a word to that system: no more ways than are remembered.
    fn add_peer_burst(&mut self, who: u8) {
        let (crowds, most, size) = match who & 0xC3 {
            0 => (&mut self.peer_bursts, MAX_PEER_BURSTS, PEER_BURST),
            _ => (&mut self.small_peer_bursts, MAX_SMALL_PEER_BURSTS, SMALL_PEER_BURST),
        };
        if *crowds >= most {
            return;
        }
        *crowds += 1;
        // Nobody else has this component, so that none of these frames has come before.
        let source = Address::new(2 + who % 3, 77);
        let link = LinkId(u16::from(who >> 4) % LINKS);
        let first = self.next_peer;
        self.next_peer += size;
        for number in first..self.next_peer {
            let peer = PeerId(number);
            let bytes = bytes_of(source, 0, &number.to_le_bytes());
            let (from, frame) = (Endpoint { link, peer }, frame_of(&bytes));
            if self.router.admits(link, &frame) {
                let routed = self.router.route(self.now, from, &frame, SenderCheck::Verified);
                assert_eq!(routed.duplicate_status, DuplicateStatus::New);
                self.model.learn_route(self.now, source, from);
            }
        }
        // COMMAND_LONG: the target's system and component stand behind seven floats and the command.
        let mut payload = [9; 33];
        payload[30] = source.system.0;
        payload[31] = 0;
        let bytes = bytes_of(Address::new(9, 9), 76, &payload);
        self.receive(endpoint(who ^ 1), bytes, SenderCheck::Verified);
    }

    fn receive(&mut self, from: Endpoint, bytes: Vec<u8>, check: SenderCheck) {
        self.frames += 1;
        let frame = frame_of(&bytes);
        check_target(&frame);
        if self.router.admits(from.link, &frame) {
            let expected = self.model.route(self.now, from, &frame, check);
            let routed = self.router.route(self.now, from, &frame, check);
            self.check_routed(from, &routed);
            if self.model.is_exact() {
                assert_eq!(routed, expected, "{from:?} {frame:?}");
            } else {
                assert_eq!(routed.duplicate_status, expected.duplicate_status);
                assert!(routed.to.iter().all(|to| expected.to.contains(to)));
            }
        }
        self.last = Some((bytes, check));
    }

    /// What holds for every frame.
    fn check_routed(&self, from: Endpoint, routed: &RoutingDecision) {
        assert!(routed.to.len() <= MAX_ROUTES, "{} ways", routed.to.len());
        assert!(routed.to.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        let mut copies = BTreeMap::new();
        for (link, audience) in &routed.to {
            let is_back = *link == from.link && audience.includes(from.peer);
            assert!(!is_back, "back to {from:?}");
            assert!(*link == from.link || !self.router.are_redundant(*link, from.link));
            if let Recipients::Peer(peer) = audience {
                let copies = copies.entry((*link, *peer)).or_insert(0);
                *copies += 1;
                assert_eq!(*copies, 1, "{peer:?} of {link:?} gets it twice");
            }
        }
    }
}

/// Zeros at the end of a payload may be cut off and change no target; a command to nobody in particular is no command to one.
fn check_target(frame: &FrameRef<'_>) {
    let target = target_of(frame.message_id, frame.payload);
    let zeros = frame.payload.iter().rev().take_while(|byte| **byte == 0);
    let cut = &frame.payload[..frame.payload.len() - zeros.count()];
    assert_eq!(target_of(frame.message_id, cut), target);
    if priority_of(frame) == Priority::Command {
        assert_ne!(target, MessageTarget::Broadcast);
    }
}

/// A frame with signature; so much may leave beyond the budget.
const LARGEST_FRAME: i64 = 280;
/// What may leave at once: a quarter of a second's worth.
const BURSTS_PER_S: i64 = 4;
/// The message that has an interval.
const LIMITED_MESSAGE: u32 = 30;

/// Input: rate, interval, then operations.
fn check_limits(mut operands: Operands<'_>) {
    let rate = u32::from(operands.number());
    let interval = TimeDelta::from_millis(i64::from(operands.byte()) * 10);
    let limits = RateLimits {
        min_intervals: BTreeMap::from([(LIMITED_MESSAGE, interval)]),
        bytes_per_s: (rate > 0).then_some(rate),
    };
    let mut now = Timestamp::ZERO;
    let mut limiter = LinkRateLimiter::new(limits, now);
    let mut last = BTreeMap::new();
    let mut left: i64 = 0;
    while !operands.is_empty() {
        let (what, size) = (operands.byte(), operands.byte());
        let bytes = 12 + usize::from(size);
        match what % 4 {
            0 => now = now + TimeDelta::from_millis(i64::from(what >> 2) * i64::from(size)),
            1 => limiter.charge(now, bytes),
            kind => {
                let message_id = if kind == 2 { LIMITED_MESSAGE } else { 0 };
                let source = Address::new(1 + (what >> 2) % 8, 1);
                if !limiter.admits(now, source, message_id, bytes) {
                    continue;
                }
                left += bytes as i64;
                let before = last.insert((message_id, source), now);
                if let (Some(before), LIMITED_MESSAGE) = (before, message_id) {
                    assert!(now - before >= interval, "{:?}", now - before);
                }
            }
        }
        let earned = (now - Timestamp::ZERO).as_nanos() / 1_000 * i64::from(rate) / 1_000_000;
        let burst = (i64::from(rate) / BURSTS_PER_S).max(LARGEST_FRAME);
        let allowed = earned + burst + LARGEST_FRAME + 1;
        assert!(rate == 0 || left <= allowed, "{left} bytes of {allowed}");
    }
}
