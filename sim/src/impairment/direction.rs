//! One direction of a link: bytes are offered with the instant of their departure and polled at that of their arrival.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::account::{Account, Cause, Counters, Fate, LogEntry};
use super::burst_loss::GilbertElliott;
use super::chances::{Chances, Drawn};
use super::delay::Delays;
use super::fragments::Fragments;
use super::line::{Line, Sent};
use super::outages::Presence;
use super::settings::{DirectionProfile, LinkKind};
use super::slots::Slots;
use crate::random::Stream;

/// Most bytes on the way; what is offered beyond is dropped as by a full buffer. A long delay must not fill the memory.
const ON_THE_WAY_BYTES: u64 = 16 * 1024 * 1024;

/// Bytes that arrive together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// When.
    pub at: Stamp<HostClock>,
    /// The bytes, at least one.
    pub bytes: Vec<u8>,
}

/// A unit that is being offered.
struct Unit<'a> {
    number: u64,
    bytes: &'a [u8],
    drawn: Drawn,
}

/// Bytes of one unit that travel together.
#[derive(Clone, Debug)]
struct Piece {
    unit: u64,
    /// Which of the unit's bytes they are; there are gaps where bytes were lost.
    runs: Vec<Range<usize>>,
    bytes: Vec<u8>,
    is_copy: bool,
}

/// One direction of a link, as a value.
///
/// Call [`poll`](Self::poll) until it returns `None` before time passes on; [`deadline`](Self::deadline) says when the next bytes
/// arrive. Instants must not fall; one that does is taken for the latest before it.
///
/// ```
/// use posebridge_sim::impairment::{Delay, DirectionProfile, Impairment, LinkKind};
/// use posebridge_telemetry::Stamp;
/// let profile = DirectionProfile { delay: Delay { base_ms: 15.0, jitter_mean_ms: 0.0 }, ..DirectionProfile::default() };
/// let mut direction = Impairment::new(&profile, LinkKind::Stream, 7, "to station");
/// direction.offer(Stamp::ZERO, b"frame");
/// assert_eq!(direction.deadline(), Some(Stamp::from_millis(15)));
/// assert_eq!(direction.poll(Stamp::from_millis(14)), None);
/// assert_eq!(direction.poll(Stamp::from_millis(15)).map(|delivery| delivery.bytes), Some(b"frame".to_vec()));
/// ```
#[derive(Clone, Debug)]
pub struct Impairment {
    kind: LinkKind,
    presence: Presence,
    line: Line,
    chances: Chances,
    burst_loss: Option<GilbertElliott>,
    delays: Delays,
    slots: Option<Slots>,
    fragments: Option<Fragments>,
    /// By arrival, then in the order of offering.
    on_the_way: BTreeMap<(Stamp<HostClock>, u64), Piece>,
    next_order: u64,
    arrived: VecDeque<Delivery>,
    latest: Stamp<HostClock>,
    account: Account,
}

impl Impairment {
    /// A direction on which nothing travels yet. Its randomness derives from `seed` and `name`, so that the two directions of one
    /// link differ.
    #[must_use]
    pub fn new(profile: &DirectionProfile, kind: LinkKind, seed: u64, name: &str) -> Self {
        let stream = |stage: &str| Stream::new(seed, &format!("link {name} {stage}"));
        Self {
            kind,
            presence: Presence::Up,
            line: Line::new(profile.rate, kind),
            chances: Chances::new(profile, kind, stream),
            burst_loss: profile.burst_loss.map(|settings| GilbertElliott::new(settings, stream("burst states"))),
            delays: Delays::new(profile, stream("jitter"), stream("stalls")),
            slots: profile.slot_ms.map(|period| Slots::new(period, stream("slots"))),
            fragments: profile.fragment.map(|settings| Fragments::new(settings, stream("fragments"))),
            on_the_way: BTreeMap::new(),
            next_order: 0,
            arrived: VecDeque::new(),
            latest: Stamp::from_nanos(i64::MIN / 2),
            account: Account::default(),
        }
    }

    /// Offers a unit that is sent at `now`: a datagram, or one write to a stream. Returns its number, by which the log names it.
    pub fn offer(&mut self, now: Stamp<HostClock>, bytes: &[u8]) -> u64 {
        let now = self.pass_to(now);
        let unit = self.account.counters.units_offered;
        let on_the_way = self.account.counters.bytes_on_the_way;
        self.account.offered(bytes.len());
        let drawn = self.chances.draw(bytes.len());
        let delay = self.delays.draw();
        if let Some(burst_loss) = &mut self.burst_loss {
            burst_loss.pass_to(now);
        }
        if self.presence == Presence::Down {
            self.lose(unit, 0..bytes.len(), Cause::LinkDown);
            return unit;
        }
        let sent = if on_the_way.saturating_add(bytes.len() as u64) > ON_THE_WAY_BYTES {
            Vec::new()
        } else {
            self.line.send(now, bytes.len())
        };
        let left = sent.last().map_or(0, |piece| piece.bytes.end);
        self.lose(unit, left..bytes.len(), Cause::BufferFull);
        if drawn.is_lost {
            self.lose(unit, 0..left, Cause::Alone);
        } else if delay.stalled > Span::ZERO {
            let by = delay.stalled;
            self.account.note(unit, 0..left, Fate::Stalled { by });
        }
        let unit = Unit { number: unit, bytes, drawn };
        for piece in sent {
            // A link that stalls holds up what comes behind, even if the unit of the stall is lost.
            let at = self.delays.arrival(piece.at, delay.delay);
            if !unit.drawn.is_lost {
                self.carry(&unit, &piece, at);
            }
        }
        unit.number
    }

    /// The next bytes that have arrived by `now`, in the order of their arrival.
    pub fn poll(&mut self, now: Stamp<HostClock>) -> Option<Delivery> {
        self.pass_to(now);
        self.arrived.pop_front()
    }

    /// When the next bytes arrive, if nothing else is offered.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<HostClock>> {
        let waiting = self.arrived.front().map(|delivery| delivery.at);
        waiting.or_else(|| self.on_the_way.first_key_value().map(|((at, _), _)| *at))
    }

    /// Counts since the direction was made.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.account.counters
    }

    /// What happened since the log was last taken, in the order in which it was decided.
    pub fn take_log(&mut self) -> Vec<LogEntry> {
        self.account.take_log()
    }

    /// The link goes down: what is on the way is lost, and so is what is offered until [`Self::restore`].
    pub fn cut(&mut self, now: Stamp<HostClock>) {
        let now = self.pass_to(now);
        self.presence = Presence::Down;
        for piece in std::mem::take(&mut self.on_the_way).into_values() {
            // A copy is no byte that was offered.
            if !piece.is_copy {
                for run in piece.runs {
                    self.lose(piece.unit, run, Cause::LinkDown);
                }
            }
        }
        self.line.clear(now);
        self.delays.clear(now);
    }

    /// The link is up again.
    pub fn restore(&mut self, now: Stamp<HostClock>) {
        self.pass_to(now);
        self.presence = Presence::Up;
    }

    /// Lets time pass: what arrives by then is handed over. Returns the present instant, which never falls.
    fn pass_to(&mut self, now: Stamp<HostClock>) -> Stamp<HostClock> {
        self.latest = self.latest.max(now);
        while let Some(entry) = self.on_the_way.first_entry() {
            let at = entry.key().0;
            if at > self.latest {
                break;
            }
            let piece = entry.remove();
            self.hand_over(at, piece);
        }
        self.latest
    }

    /// Hands a piece over, with all that share its slot.
    fn hand_over(&mut self, at: Stamp<HostClock>, piece: Piece) {
        let mut bytes = self.arrive(at, piece);
        if self.slots.is_some() && self.kind == LinkKind::Stream {
            while let Some(entry) = self.on_the_way.first_entry() {
                if entry.key().0 != at {
                    break;
                }
                let next = entry.remove();
                bytes.append(&mut self.arrive(at, next));
            }
        }
        let pieces = match &mut self.fragments {
            Some(fragments) => fragments.cut(bytes),
            None => vec![bytes],
        };
        self.account.counters.chunks_delivered += pieces.len() as u64;
        let deliveries = pieces.into_iter().map(|bytes| Delivery { at, bytes });
        self.arrived.extend(deliveries);
    }

    /// Notes the arrival of a piece and returns its bytes.
    fn arrive(&mut self, at: Stamp<HostClock>, piece: Piece) -> Vec<u8> {
        for run in piece.runs {
            let fate = if piece.is_copy { Fate::Repeated { at } } else { Fate::Delivered { at } };
            self.account.note(piece.unit, run, fate);
        }
        piece.bytes
    }

    /// Takes a piece of a unit through loss and damage and puts what is left on the way, to arrive at `at`.
    fn carry(&mut self, unit: &Unit<'_>, sent: &Sent, at: Stamp<HostClock>) {
        let causes = self.losses(sent, &unit.drawn);
        let data = self.damaged(unit, sent, &causes);
        let (runs, bytes) = self.survivors(unit.number, sent, &causes, &data);
        if bytes.is_empty() {
            return;
        }
        let mut at = at;
        if let Some(by) = unit.drawn.held_back {
            at = at + by;
            self.account.note(unit.number, sent.bytes.clone(), Fate::HeldBack { by });
        }
        if let Some(slots) = self.slots {
            at = slots.next(at);
        }
        let piece = Piece { unit: unit.number, runs, bytes, is_copy: false };
        let copy = unit.drawn.is_repeated.then(|| Piece { is_copy: true, ..piece.clone() });
        self.put(at, piece);
        if let Some(copy) = copy {
            self.put(at, copy);
        }
    }

    fn put(&mut self, at: Stamp<HostClock>, piece: Piece) {
        self.on_the_way.insert((at, self.next_order), piece);
        self.next_order += 1;
    }

    /// What becomes of each byte of a piece; `None` travels on.
    fn losses(&mut self, sent: &Sent, drawn: &Drawn) -> Vec<Option<Cause>> {
        let mut causes: Vec<Option<Cause>> = vec![None; sent.bytes.len()];
        for place in within(&drawn.missing, &sent.bytes, 1) {
            if let Some(cause) = causes.get_mut(place as usize) {
                *cause = Some(Cause::Byte);
            }
        }
        let Some(burst_loss) = &mut self.burst_loss else {
            return causes;
        };
        if self.kind == LinkKind::Datagram {
            let luck = drawn.burst_luck.first().copied().unwrap_or_default();
            if burst_loss.takes(sent.at, luck) {
                causes.fill(Some(Cause::Burst));
            }
            return causes;
        }
        let luck = drawn.burst_luck.get(sent.bytes.clone());
        for (cause, luck) in causes.iter_mut().zip(luck.unwrap_or_default()) {
            if burst_loss.takes(sent.at, *luck) {
                *cause = Some(Cause::Burst);
            }
        }
        causes
    }

    /// The bytes of a piece with bits turned over, except in bytes that are lost.
    fn damaged(&mut self, unit: &Unit<'_>, sent: &Sent, causes: &[Option<Cause>]) -> Vec<u8> {
        let data = unit.bytes.get(sent.bytes.clone()).unwrap_or_default();
        let mut data = data.to_vec();
        for hit in within(&unit.drawn.failing, &sent.bytes, 8) {
            let (index, bit) = ((hit / 8) as usize, (hit % 8) as u8);
            if let (Some(byte), Some(None)) = (data.get_mut(index), causes.get(index)) {
                *byte ^= 1 << bit;
                let place = sent.bytes.start + index;
                self.account.note(unit.number, place..place + 1, Fate::Flipped { bit });
            }
        }
        data
    }

    /// What of a piece the losses leave: its ranges within the unit, and its bytes.
    fn survivors(
        &mut self,
        unit: u64,
        sent: &Sent,
        causes: &[Option<Cause>],
        data: &[u8],
    ) -> (Vec<Range<usize>>, Vec<u8>) {
        let mut runs = Vec::new();
        let mut bytes = Vec::with_capacity(data.len());
        let mut start = 0;
        for group in causes.chunk_by(|before, after| before == after) {
            let end = start + group.len();
            let run = sent.bytes.start + start..sent.bytes.start + end;
            if let Some(cause) = group.first().copied().flatten() {
                self.lose(unit, run, cause);
            } else {
                runs.push(run);
                bytes.extend_from_slice(data.get(start..end).unwrap_or_default());
            }
            start = end;
        }
        (runs, bytes)
    }

    fn lose(&mut self, unit: u64, bytes: Range<usize>, cause: Cause) {
        self.account.note(unit, bytes, Fate::Lost(cause));
    }
}

/// Those of a unit's hits, each with `per_byte` places in a byte, that fall into a piece, counted from its beginning.
fn within(hits: &[u64], piece: &Range<usize>, per_byte: u64) -> impl Iterator<Item = u64> {
    let (start, end) = (piece.start as u64 * per_byte, piece.end as u64 * per_byte);
    let from = hits.partition_point(|hit| *hit < start);
    let to = hits.partition_point(|hit| *hit < end);
    let hits = hits.get(from..to).unwrap_or_default();
    hits.iter().map(move |hit| hit - start)
}
