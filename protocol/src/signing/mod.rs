//! Message signing of MAVLink 2: only a holder of the key may send, and a frame cannot be replayed.
//!
//! Gets verified frames from [`crate::framing`] and verifies their signatures; signs the frames of
//! [`crate::dialect::Encoder`]. One [`LinkSigner`] per link. It reads no clock and no file: the time is an argument,
//! and what must survive a restart is a value ([`SigningState`]). It does not encrypt: signed frames are readable.
//!
//! # Model
//! ```text
//! frame     = header (10, with flag 0x01) payload CRC (2) signature (13)
//! signature = link id (1)  timestamp (6, little-endian)  mac (6)
//! mac       = first 6 bytes of SHA-256(key (32), header, payload, CRC, link id, timestamp)
//! timestamp = units of 10 µs since 2015-01-01 00:00 UTC
//! ```
//! A stream is a (system, component, link id). A frame is refused when
//! ```text
//! it has no signature, and its id is not excepted        Unsigned
//! its mac is another one                                 WrongSignature
//! its timestamp is not later than its stream's last      Replayed
//! its stream is new and it is over a minute behind us    Stale
//! ```
//! in this order, so that only a holder of the key can change the remembered state.
//!
//! # Sources
//! MAVLink guide, "Message Signing": signature, timestamp handling, accepting signed and unsigned packets.

mod key;
mod signature;
mod signer;
mod state;
mod verifier;

pub use crate::framing::FLAG_SIGNED;
pub use key::{Key, KeyError};
pub use signature::{FrameSigner, SigningTime};
pub use signer::{LinkSigner, SigningConfig};
pub use state::{ShutdownKind, SignedStreamState, SigningState, StreamId};
pub use verifier::UnsignedPolicy;

/// RADIO_STATUS: telemetry radios inject it and hold no key.
pub const RADIO_STATUS: u32 = 109;
