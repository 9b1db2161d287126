//! The record of one attempt to use an observation.

use crate::clock::{BrickClock, TimeDelta, Timestamp};
use crate::ids::SensorId;

/// One attempt to use an observation, and its outcome.
#[derive(Clone, Debug, PartialEq)]
pub struct FusionRecord {
    pub sensor: SensorId,
    /// The observation's kind, as [`crate::ObservationKind::kind`] names it.
    pub kind: &'static str,
    pub stamp: Timestamp<BrickClock>,
    /// How far behind the filter's time it was.
    pub lag: TimeDelta,
    pub outcome: FusionOutcome,
    /// Observed minus predicted, SI units, up to three components; unused ones are zero.
    pub innovation: [f64; 3],
    /// Innovation covariance S, 3 x 3; the block of unused components is zero.
    pub innovation_covariance: [[f64; 3]; 3],
    /// Normalised innovation squared; zero where nothing was predicted.
    pub nis: f64,
    /// Degrees of freedom of `nis`: the number of components used.
    pub degrees_of_freedom: u8,
    /// Log-likelihood of the innovation under N(0, S); zero where nothing was predicted.
    pub log_likelihood: f64,
}

impl FusionRecord {
    /// A record without an innovation: its lag and statistics are zero.
    pub const fn new(
        sensor: SensorId,
        kind: &'static str,
        stamp: Timestamp<BrickClock>,
        outcome: FusionOutcome,
    ) -> Self {
        Self {
            sensor,
            kind,
            stamp,
            lag: TimeDelta::ZERO,
            outcome,
            innovation: [0.0; 3],
            innovation_covariance: [[0.0; 3]; 3],
            nis: 0.0,
            degrees_of_freedom: 0,
            log_likelihood: 0.0,
        }
    }
}

/// Whether an observation was used, and why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FusionOutcome {
    /// Used; state and covariance changed.
    Accepted,
    /// Used, but the motion that it implies contradicts the gyro beyond chance: the wheels slipped, and the filter used the gyro instead. The
    /// slip may have begun before this observation, which is the sensor's first one after the detection.
    Slip,
    /// Further from the prediction than the gate allows; state untouched.
    Gated,
    /// Older than the oldest state kept for late observations; state untouched.
    TooOld,
    /// Not finite, negative where it cannot be, or of zero duration; state untouched.
    Malformed,
    /// The counters jumped to another base: taken as the new base, not as motion.
    Rebased,
    /// The estimate was moved to this observation after a long disagreement.
    PoseReset,
    /// The filter has no use for this kind of observation.
    Unused,
}

impl FusionOutcome {
    /// Whether the observation changed the estimate.
    pub const fn is_used(self) -> bool {
        matches!(self, Self::Accepted | Self::Slip | Self::PoseReset)
    }

    /// The outcome in words, as logs and reports print it.
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Slip => "slip",
            Self::Gated => "gated",
            Self::TooOld => "too old",
            Self::Malformed => "malformed",
            Self::Rebased => "re-based",
            Self::PoseReset => "reset to",
            Self::Unused => "unused",
        }
    }
}
