//! Link impairment: delays, batches, fragments, loses, damages and duplicates bytes, and interrupts the link.
//!
//! An [`ImpairedDirection`] is one direction of a link, an [`ImpairedLink`] both with their common outages. Bytes are
//! offered with the time of sending and polled with the time of arrival; there is no clock, no socket and no thread,
//! and all randomness comes from one seed. The simulator drives it in virtual time, `posebridge relay` in real time. A
//! [`LinkProfile`] configures a link; the bundled ones are in [`PROFILES`].
//!
//! # Model
//! ```text
//! offered ▸ line (rate, buffer) ▸ lost whole ▸ burst loss, lost bytes ▸ bit errors ▸ delay + jitter + stall ▸ held back, repeated
//!         ▸ slot ▸ cut ▸ delivered            an outage loses what is on the way and what is offered meanwhile
//! ```
//! The bytes of one offer are a *unit*: a datagram, or one write to a stream. A datagram is lost, duplicated and
//! reordered as a whole; a stream keeps its order and loses bytes. Every stage has its own random stream and draws for
//! every offered unit and byte, whatever happened to it before, so that a changed value shifts nothing else. A log
//! records the fate of every byte, a [`FrameLedger`] that of the frames.
//!
//! # Sources
//! docs/impairment.md, with the formulas and the origin of the profiles' values.

mod byte_log;
mod direction;
mod frame_ledger;
mod link;
mod profile;
mod states;
mod timing;
mod unit_draws;

pub use crate::config_file::ConfigFileError as ProfileError;
pub use byte_log::{ByteOutcome, Counters, LogEntry, LossCause};
pub use direction::{Delivery, ImpairedDirection};
pub use frame_ledger::{FrameCounts, FrameLedger};
pub use link::{ImpairedLink, ImpairedLinkEvent, LinkEnd};
pub use profile::{
    BurstLoss, Delay, DirectionProfile, Disconnects, Fragment, LinkKind, LinkProfile, PROFILES, PieceSizes, Rate,
    Reorder, Stall,
};
