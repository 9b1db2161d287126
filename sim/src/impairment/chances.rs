//! What chance holds for one unit, drawn before anybody knows what becomes of it.
//!
//! A stage that drew only for what reaches it would shift its whole sequence with every unit that an earlier stage takes
//! away: with a little more loss, other bits would fail and other datagrams come twice. So every stage draws for every unit
//! and every byte that is offered. Two links of one seed that differ in one stage then differ in what that stage does, and
//! in nothing else.

use posebridge_telemetry::Span;

use super::copies::Copies;
use super::damage::Gaps;
use super::settings::{DirectionProfile, LinkKind};
use crate::random::Stream;

/// What was drawn for one unit.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drawn {
    /// It is lost whole.
    pub(super) is_lost: bool,
    /// Its luck in bursts, on [0, 1): of a datagram, or of each byte of a stream. Empty on a link without bursts.
    pub(super) burst_luck: Vec<f64>,
    /// Which of its bytes go missing.
    pub(super) missing: Vec<u64>,
    /// Which of its bits fail; eight times the byte, and the bit.
    pub(super) failing: Vec<u64>,
    /// How long it is held back while others pass, if it is.
    pub(super) held_back: Option<Span>,
    /// It arrives twice.
    pub(super) is_repeated: bool,
}

/// The sequences of the stages whose chances do not depend on time.
#[derive(Clone, Debug)]
pub(super) struct Chances {
    kind: LinkKind,
    loss: f64,
    losing: Stream,
    bursts: Option<Stream>,
    missing_bytes: Gaps,
    bit_errors: Gaps,
    copies: Copies,
}

impl Chances {
    /// The chances of a direction; `stream` gives each stage its sequence.
    pub(super) fn new(profile: &DirectionProfile, kind: LinkKind, stream: impl Fn(&str) -> Stream) -> Self {
        Self {
            kind,
            loss: profile.loss,
            losing: stream("loss"),
            bursts: profile.burst_loss.map(|_| stream("burst loss")),
            missing_bytes: Gaps::new(profile.byte_loss, stream("byte loss")),
            bit_errors: Gaps::new(profile.bit_error_rate, stream("bit errors")),
            copies: Copies::new(profile, stream("reorder"), stream("duplicate")),
        }
    }

    /// Draws for the next unit, of so many bytes.
    pub(super) fn draw(&mut self, bytes: usize) -> Drawn {
        let is_datagram = self.kind == LinkKind::Datagram;
        let trials = if is_datagram { 1 } else { bytes };
        let burst_luck = match &mut self.bursts {
            Some(stream) => (0..trials).map(|_| stream.uniform(0.0, 1.0)).collect(),
            None => Vec::new(),
        };
        Drawn {
            is_lost: self.losing.happens(self.loss),
            burst_luck,
            missing: self.missing_bytes.hits(bytes as u64),
            failing: self.bit_errors.hits(8 * bytes as u64),
            held_back: is_datagram.then(|| self.copies.held_back()).flatten(),
            is_repeated: is_datagram && self.copies.is_repeated(),
        }
    }
}
