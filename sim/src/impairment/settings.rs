//! The impairments of one direction of a link, as plain numbers: the tables of a profile.

use serde::Deserialize;

use super::checks;

/// What travels on a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// Bytes in their order; boundaries mean nothing; loss takes bytes.
    #[default]
    Stream,
    /// Datagrams: each arrives whole or not at all, perhaps twice, perhaps overtaken.
    Datagram,
}

/// One direction of a link. The default passes everything on at once.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DirectionProfile {
    /// How fast bytes leave, and how many may wait; without it at once.
    pub rate: Option<Rate>,
    /// Probability that a unit is lost whole, independently of all others.
    #[serde(deserialize_with = "checks::probability")]
    pub loss: f64,
    /// Loss that comes in bursts: of datagrams, or of a stream's bytes.
    pub burst_loss: Option<BurstLoss>,
    /// Probability that a byte of a stream is missing, independently of all others.
    #[serde(deserialize_with = "checks::probability")]
    pub byte_loss: f64,
    /// Probability that a bit arrives wrong, independently of all others.
    #[serde(deserialize_with = "checks::bit_error_rate")]
    pub bit_error_rate: f64,
    /// How long everything takes.
    pub delay: Delay,
    /// What takes longer now and then.
    pub stalls: Vec<Stall>,
    /// Datagrams that are overtaken.
    pub reorder: Option<Reorder>,
    /// Probability that a datagram arrives twice.
    #[serde(deserialize_with = "checks::probability")]
    pub duplicate: f64,
    /// Arrived data is delivered only at this interval in milliseconds, a stream's bytes together; without it at once.
    #[serde(deserialize_with = "checks::slot_millis")]
    pub slot_ms: Option<f64>,
    /// A stream is handed over in pieces.
    pub fragment: Option<Fragment>,
}

/// A token bucket with a finite buffer in front of it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rate {
    /// Bytes that leave per second.
    #[serde(deserialize_with = "checks::bytes_per_s")]
    pub bytes_per_s: f64,
    /// Bytes that may wait, the one that is leaving included; what comes beyond is dropped: a stream's last bytes, a datagram whole.
    #[serde(deserialize_with = "checks::buffer_bytes")]
    pub buffer_bytes: u32,
    /// Bytes that a line which has rested passes on at once.
    #[serde(default, deserialize_with = "checks::burst_bytes")]
    pub burst_bytes: u32,
}

/// Gilbert's and Elliott's two states in continuous time.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BurstLoss {
    /// Mean time in the good state, in seconds.
    #[serde(deserialize_with = "checks::secs")]
    pub mean_good_s: f64,
    /// Mean time in the bad state, in seconds.
    #[serde(deserialize_with = "checks::secs")]
    pub mean_bad_s: f64,
    /// Probability of loss in the good state, per datagram or per byte of a stream.
    #[serde(deserialize_with = "checks::probability")]
    pub loss_good: f64,
    /// Probability of loss in the bad state, per datagram or per byte of a stream.
    #[serde(deserialize_with = "checks::probability")]
    pub loss_bad: f64,
}

/// A constant and an exponential share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Delay {
    /// The least, in milliseconds.
    #[serde(deserialize_with = "checks::millis")]
    pub base_ms: f64,
    /// Mean of what is added to it, in milliseconds.
    #[serde(deserialize_with = "checks::millis")]
    pub jitter_mean_ms: f64,
}

/// A pause that holds up everything behind it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stall {
    /// Probability per unit.
    #[serde(deserialize_with = "checks::probability")]
    pub probability: f64,
    /// The shortest, in milliseconds.
    #[serde(deserialize_with = "checks::millis")]
    pub from_ms: f64,
    /// The longest, in milliseconds; all between are equally likely.
    #[serde(deserialize_with = "checks::millis")]
    pub to_ms: f64,
}

/// A datagram that waits while those behind it pass.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reorder {
    /// Probability per datagram.
    #[serde(deserialize_with = "checks::probability")]
    pub probability: f64,
    /// The shortest wait, in milliseconds.
    #[serde(deserialize_with = "checks::millis")]
    pub from_ms: f64,
    /// The longest wait, in milliseconds; all between are equally likely.
    #[serde(deserialize_with = "checks::millis")]
    pub to_ms: f64,
}

/// How a stream is cut where it is handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fragment {
    /// The largest piece, in bytes.
    #[serde(deserialize_with = "checks::piece_bytes")]
    pub most_bytes: u32,
    /// How large the pieces are.
    #[serde(default)]
    pub sizes: PieceSizes,
}

/// How large the pieces of a stream are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PieceSizes {
    /// As large as possible.
    #[default]
    Fixed,
    /// From one byte to the largest, all equally likely.
    Random,
}

/// Both directions go away together.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disconnects {
    /// Mean time until the link goes down, in seconds; exponential.
    #[serde(deserialize_with = "checks::secs")]
    pub mean_up_s: f64,
    /// The shortest time down, in seconds.
    #[serde(deserialize_with = "checks::secs")]
    pub down_from_s: f64,
    /// The longest time down, in seconds; all between are equally likely.
    #[serde(deserialize_with = "checks::secs")]
    pub down_to_s: f64,
}
