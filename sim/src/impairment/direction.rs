//! One direction of a link: bytes are offered with the time of departure and polled at the time of arrival.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::byte_log::{ByteAccount, ByteOutcome, Counters, LogEntry, LossCause};
use super::profile::{DirectionProfile, Fragment, LinkKind, PieceSizes};
use super::stages::{GilbertElliott, RateLimiter, SentRange, Slots, UnitDraw, UnitDraws};
use crate::random::RandomStream;

/// What is offered beyond is dropped as by a full buffer, so that a long delay does not fill the memory.
const MAX_IN_TRANSIT_BYTES: u64 = 16 * 1024 * 1024;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery {
    pub at: Timestamp<HostClock>,
    pub bytes: Vec<u8>,
}

struct OfferedUnit<'a> {
    number: u64,
    bytes: &'a [u8],
    draw: UnitDraw,
}

#[derive(Clone, Debug)]
struct TransitChunk {
    unit: u64,
    /// Byte ranges of the unit; lost bytes leave gaps.
    runs: Vec<Range<usize>>,
    bytes: Vec<u8>,
    is_duplicate: bool,
}

/// One direction of a link, without IO.
///
/// Call [`poll`](Self::poll) until it returns `None` before time advances; [`deadline`](Self::deadline) returns when the next bytes
/// arrive. Instants must not decrease; an earlier one is clamped to the latest.
///
/// ```
/// use posebridge_sim::impairment::{Delay, DirectionProfile, ImpairedDirection, LinkKind};
/// use posebridge_telemetry::Timestamp;
/// let profile = DirectionProfile { delay: Delay { base_ms: 15.0, jitter_mean_ms: 0.0 }, ..DirectionProfile::default() };
/// let mut direction = ImpairedDirection::new(&profile, LinkKind::Stream, 7, "to station");
/// direction.offer(Timestamp::ZERO, b"frame");
/// assert_eq!(direction.deadline(), Some(Timestamp::from_millis(15)));
/// assert_eq!(direction.poll(Timestamp::from_millis(14)), None);
/// assert_eq!(direction.poll(Timestamp::from_millis(15)).map(|delivery| delivery.bytes), Some(b"frame".to_vec()));
/// ```
#[derive(Clone, Debug)]
pub struct ImpairedDirection {
    kind: LinkKind,
    is_up: bool,
    rate_limiter: RateLimiter,
    unit_draws: UnitDraws,
    burst_loss: Option<GilbertElliott>,
    slots: Option<Slots>,
    fragments: Option<Fragments>,
    /// Sorted by arrival, then by the order of offering.
    in_transit: BTreeMap<(Timestamp<HostClock>, u64), TransitChunk>,
    next_order: u64,
    arrived: VecDeque<Delivery>,
    /// Of a unit that does not overtake.
    last_arrival: Timestamp<HostClock>,
    latest: Timestamp<HostClock>,
    account: ByteAccount,
}

impl ImpairedDirection {
    /// A direction with nothing in transit. Its random numbers derive from `seed` and `name`, so that the two directions of a link
    /// differ.
    pub fn new(profile: &DirectionProfile, kind: LinkKind, seed: u64, name: &str) -> Self {
        let stream = |stage: &str| RandomStream::new(seed, &format!("link {name} {stage}"));
        Self {
            kind,
            is_up: true,
            rate_limiter: RateLimiter::new(profile.rate, kind),
            unit_draws: UnitDraws::new(profile, kind, stream),
            burst_loss: profile.burst_loss.map(|settings| GilbertElliott::new(settings, stream("burst states"))),
            slots: profile.slot_ms.map(|period| Slots::new(period, stream("slots"))),
            fragments: profile.fragment.map(|settings| Fragments::new(settings, stream("fragments"))),
            in_transit: BTreeMap::new(),
            next_order: 0,
            arrived: VecDeque::new(),
            last_arrival: Timestamp::from_nanos(i64::MIN),
            latest: Timestamp::from_nanos(i64::MIN / 2),
            account: ByteAccount::default(),
        }
    }

    /// Offers a unit sent at `now`: a datagram, or one write to a stream. Returns its number in the log.
    pub fn offer(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) -> u64 {
        let now = self.advance_to(now);
        let unit = self.account.counters.units_offered;
        let in_transit = self.account.counters.bytes_on_the_way;
        self.account.on_offered(bytes.len());
        let drawn = self.unit_draws.draw(bytes.len());
        if let Some(burst_loss) = &mut self.burst_loss {
            burst_loss.advance_to(now);
        }
        if !self.is_up {
            self.record_loss(unit, 0..bytes.len(), LossCause::LinkDown);
            return unit;
        }
        let sent = if in_transit.saturating_add(bytes.len() as u64) > MAX_IN_TRANSIT_BYTES {
            Vec::new()
        } else {
            self.rate_limiter.send(now, bytes.len())
        };
        let left = sent.last().map_or(0, |chunk| chunk.bytes.end);
        self.record_loss(unit, left..bytes.len(), LossCause::BufferFull);
        if drawn.is_lost {
            self.record_loss(unit, 0..left, LossCause::Unit);
        } else if drawn.stalled > TimeDelta::ZERO {
            let by = drawn.stalled;
            self.account.record(unit, 0..left, ByteOutcome::Stalled { by });
        }
        let unit = OfferedUnit { number: unit, bytes, draw: drawn };
        for chunk in sent {
            // A link that stalls holds up what comes behind, even if the unit of the stall is lost.
            self.last_arrival = self.last_arrival.max(chunk.at + unit.draw.delay);
            if !unit.draw.is_lost {
                self.send(&unit, &chunk, self.last_arrival);
            }
        }
        unit.number
    }

    /// The next bytes that have arrived by `now`, in the order of arrival.
    pub fn poll(&mut self, now: Timestamp<HostClock>) -> Option<Delivery> {
        self.advance_to(now);
        self.arrived.pop_front()
    }

    /// When the next bytes arrive if nothing else is offered.
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let waiting = self.arrived.front().map(|delivery| delivery.at);
        waiting.or_else(|| self.in_transit.first_key_value().map(|((at, _), _)| *at))
    }

    pub const fn counters(&self) -> Counters {
        self.account.counters
    }

    /// The entries since the last call, in the order of the decisions.
    pub fn take_log(&mut self) -> Vec<LogEntry> {
        self.account.take_log()
    }

    /// The link goes down: everything in transit is lost, and everything offered until [`Self::reconnect`].
    pub fn disconnect(&mut self, now: Timestamp<HostClock>) {
        let now = self.advance_to(now);
        self.is_up = false;
        for chunk in std::mem::take(&mut self.in_transit).into_values() {
            // A copy is no byte that was offered.
            if !chunk.is_duplicate {
                for run in chunk.runs {
                    self.record_loss(chunk.unit, run, LossCause::LinkDown);
                }
            }
        }
        self.rate_limiter.clear(now);
        self.last_arrival = self.last_arrival.min(now);
    }

    pub fn reconnect(&mut self, now: Timestamp<HostClock>) {
        self.advance_to(now);
        self.is_up = true;
    }

    /// Delivers what arrives by `now`. Returns the present instant, which never decreases.
    fn advance_to(&mut self, now: Timestamp<HostClock>) -> Timestamp<HostClock> {
        self.latest = self.latest.max(now);
        while let Some(entry) = self.in_transit.first_entry() {
            let at = entry.key().0;
            if at > self.latest {
                break;
            }
            let chunk = entry.remove();
            self.deliver(at, chunk);
        }
        self.latest
    }

    /// Delivers a chunk together with all others of its slot.
    fn deliver(&mut self, at: Timestamp<HostClock>, chunk: TransitChunk) {
        let mut bytes = self.arrive(at, chunk);
        if self.slots.is_some() && self.kind == LinkKind::Stream {
            while let Some(entry) = self.in_transit.first_entry() {
                if entry.key().0 != at {
                    break;
                }
                let next = entry.remove();
                bytes.append(&mut self.arrive(at, next));
            }
        }
        let chunks = match &mut self.fragments {
            Some(fragments) => fragments.split(bytes),
            None => vec![bytes],
        };
        self.account.counters.chunks_delivered += chunks.len() as u64;
        let deliveries = chunks.into_iter().map(|bytes| Delivery { at, bytes });
        self.arrived.extend(deliveries);
    }

    fn arrive(&mut self, at: Timestamp<HostClock>, chunk: TransitChunk) -> Vec<u8> {
        for run in chunk.runs {
            let outcome =
                if chunk.is_duplicate { ByteOutcome::Duplicated { at } } else { ByteOutcome::Delivered { at } };
            self.account.record(chunk.unit, run, outcome);
        }
        chunk.bytes
    }

    /// Applies loss and damage to a part of a unit and queues the rest, to arrive at `at`.
    fn send(&mut self, unit: &OfferedUnit<'_>, sent: &SentRange, at: Timestamp<HostClock>) {
        let causes = self.losses(sent, &unit.draw);
        let data = self.damaged(unit, sent, &causes);
        let (runs, bytes) = self.survivors(unit.number, sent, &causes, &data);
        if bytes.is_empty() {
            return;
        }
        let mut at = at;
        if let Some(by) = unit.draw.held_back {
            at = at + by;
            self.account.record(unit.number, sent.bytes.clone(), ByteOutcome::HeldBack { by });
        }
        if let Some(slots) = self.slots {
            at = slots.next(at);
        }
        let chunk = TransitChunk { unit: unit.number, runs, bytes, is_duplicate: false };
        let copy = unit.draw.is_duplicated.then(|| TransitChunk { is_duplicate: true, ..chunk.clone() });
        self.enqueue(at, chunk);
        if let Some(copy) = copy {
            self.enqueue(at, copy);
        }
    }

    fn enqueue(&mut self, at: Timestamp<HostClock>, chunk: TransitChunk) {
        self.in_transit.insert((at, self.next_order), chunk);
        self.next_order += 1;
    }

    /// The loss of each byte of a part; `None` is not lost.
    fn losses(&mut self, sent: &SentRange, drawn: &UnitDraw) -> Vec<Option<LossCause>> {
        let mut causes: Vec<Option<LossCause>> = vec![None; sent.bytes.len()];
        for offset in within(&drawn.missing_bytes, &sent.bytes, 1) {
            if let Some(cause) = causes.get_mut(offset as usize) {
                *cause = Some(LossCause::Byte);
            }
        }
        let Some(burst_loss) = &mut self.burst_loss else {
            return causes;
        };
        if self.kind == LinkKind::Datagram {
            let draw = drawn.burst_draws.first().copied().unwrap_or_default();
            if burst_loss.is_lost(sent.at, draw) {
                causes.fill(Some(LossCause::Burst));
            }
            return causes;
        }
        let draws = drawn.burst_draws.get(sent.bytes.clone());
        for (cause, draw) in causes.iter_mut().zip(draws.unwrap_or_default()) {
            if burst_loss.is_lost(sent.at, *draw) {
                *cause = Some(LossCause::Burst);
            }
        }
        causes
    }

    /// The bytes of a part after bit errors; lost bytes have none.
    fn damaged(&mut self, unit: &OfferedUnit<'_>, sent: &SentRange, causes: &[Option<LossCause>]) -> Vec<u8> {
        let data = unit.bytes.get(sent.bytes.clone()).unwrap_or_default();
        let mut data = data.to_vec();
        for hit in within(&unit.draw.flipped_bits, &sent.bytes, 8) {
            let (index, bit) = ((hit / 8) as usize, (hit % 8) as u8);
            if let (Some(byte), Some(None)) = (data.get_mut(index), causes.get(index)) {
                *byte ^= 1 << bit;
                let offset = sent.bytes.start + index;
                self.account.record(unit.number, offset..offset + 1, ByteOutcome::Flipped { bit });
            }
        }
        data
    }

    /// The bytes that survive the losses: their ranges within the unit, and the bytes.
    fn survivors(
        &mut self,
        unit: u64,
        sent: &SentRange,
        causes: &[Option<LossCause>],
        data: &[u8],
    ) -> (Vec<Range<usize>>, Vec<u8>) {
        let mut runs = Vec::new();
        let mut bytes = Vec::with_capacity(data.len());
        let mut start = 0;
        for group in causes.chunk_by(|before, after| before == after) {
            let end = start + group.len();
            let run = sent.bytes.start + start..sent.bytes.start + end;
            if let Some(cause) = group.first().copied().flatten() {
                self.record_loss(unit, run, cause);
            } else {
                runs.push(run);
                bytes.extend_from_slice(data.get(start..end).unwrap_or_default());
            }
            start = end;
        }
        (runs, bytes)
    }

    fn record_loss(&mut self, unit: u64, bytes: Range<usize>, cause: LossCause) {
        self.account.record(unit, bytes, ByteOutcome::Lost(cause));
    }
}

/// The hits within a part of a unit, counted from its beginning; `per_byte` positions per byte.
fn within(hits: &[u64], range: &Range<usize>, per_byte: u64) -> impl Iterator<Item = u64> {
    let (start, end) = (range.start as u64 * per_byte, range.end as u64 * per_byte);
    let from = hits.partition_point(|hit| *hit < start);
    let to = hits.partition_point(|hit| *hit < end);
    let hits = hits.get(from..to).unwrap_or_default();
    hits.iter().map(move |hit| hit - start)
}

/// Cuts a stream at delivery, because a reader must not treat one read as one frame.
#[derive(Clone, Debug)]
struct Fragments {
    settings: Fragment,
    stream: RandomStream,
}

impl Fragments {
    const fn new(settings: Fragment, stream: RandomStream) -> Self {
        Self { settings, stream }
    }

    fn split(&mut self, mut chunk: Vec<u8>) -> Vec<Vec<u8>> {
        let mut chunks = Vec::new();
        loop {
            let size = self.size();
            if chunk.len() <= size {
                break;
            }
            let rest = chunk.split_off(size);
            chunks.push(std::mem::replace(&mut chunk, rest));
        }
        chunks.push(chunk);
        chunks
    }

    fn size(&mut self) -> usize {
        let most = self.settings.most_bytes.max(1);
        match self.settings.sizes {
            PieceSizes::Fixed => most as usize,
            PieceSizes::Random => 1 + self.stream.uniform(0.0, f64::from(most)) as usize,
        }
    }
}
