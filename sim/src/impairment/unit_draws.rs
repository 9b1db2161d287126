//! The random draws of one unit, made before its fate is known.
//!
//! A stage that drew only for the units that reach it would shift its whole sequence with every unit that an earlier
//! stage drops: with a little more loss, other bits would fail and other datagrams be duplicated. So every stage draws
//! for every offered unit and byte. Two links of one seed that differ in one stage then differ only in the effect of
//! that stage.

use posebridge_telemetry::TimeDelta;

use super::duplication::Duplication;
use super::error_gaps::ErrorGaps;
use super::settings::{DirectionProfile, LinkKind};
use crate::random::RandomStream;

/// What was drawn for one unit.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct UnitDraw {
    /// It is lost whole.
    pub(super) is_lost: bool,
    /// Its luck in bursts, on [0, 1): of a datagram, or of each byte of a stream. Empty on a link without bursts.
    pub(super) burst_draws: Vec<f64>,
    /// Which of its bytes go missing.
    pub(super) missing_bytes: Vec<u64>,
    /// Which of its bits fail; eight times the byte, and the bit.
    pub(super) flipped_bits: Vec<u64>,
    /// How long it is held back while others pass, if it is.
    pub(super) held_back: Option<TimeDelta>,
    /// It arrives twice.
    pub(super) is_duplicated: bool,
}

/// The sequences of the stages whose chances do not depend on time.
#[derive(Clone, Debug)]
pub(super) struct UnitDraws {
    kind: LinkKind,
    loss: f64,
    losing: RandomStream,
    bursts: Option<RandomStream>,
    missing_bytes: ErrorGaps,
    bit_errors: ErrorGaps,
    copies: Duplication,
}

impl UnitDraws {
    /// The chances of a direction; `stream` gives each stage its sequence.
    pub(super) fn new(profile: &DirectionProfile, kind: LinkKind, stream: impl Fn(&str) -> RandomStream) -> Self {
        Self {
            kind,
            loss: profile.loss,
            losing: stream("loss"),
            bursts: profile.burst_loss.map(|_| stream("burst loss")),
            missing_bytes: ErrorGaps::new(profile.byte_loss, stream("byte loss")),
            bit_errors: ErrorGaps::new(profile.bit_error_rate, stream("bit errors")),
            copies: Duplication::new(profile, stream("reorder"), stream("duplicate")),
        }
    }

    /// Draws for the next unit, which has this number of bytes.
    pub(super) fn draw(&mut self, bytes: usize) -> UnitDraw {
        let is_datagram = self.kind == LinkKind::Datagram;
        let trials = if is_datagram { 1 } else { bytes };
        let burst_luck = match &mut self.bursts {
            Some(stream) => (0..trials).map(|_| stream.uniform(0.0, 1.0)).collect(),
            None => Vec::new(),
        };
        UnitDraw {
            is_lost: self.losing.bernoulli(self.loss),
            burst_draws: burst_luck,
            missing_bytes: self.missing_bytes.hits(bytes as u64),
            flipped_bits: self.bit_errors.hits(8 * bytes as u64),
            held_back: is_datagram.then(|| self.copies.held_back()).flatten(),
            is_duplicated: is_datagram && self.copies.is_duplicated(),
        }
    }
}
