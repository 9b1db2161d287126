//! What a link does to the bytes that travel on it: it delays, gathers, cuts, loses, damages, repeats, and goes away.
//!
//! An [`Impairment`] is one direction of a link, an [`ImpairedLink`] both with their common outages. Bytes are offered with the
//! instant at which they were sent and polled with the instant at which they arrive; there is no clock, no socket and no thread,
//! and all randomness comes from one seed. The simulator drives it in virtual time, `posebridge relay` in real time. A
//! [`LinkProfile`] says what a link is like; the bundled ones stand in [`PROFILES`].
//!
//! # Model
//! ```text
//! offered ▸ line (rate, buffer) ▸ lost whole ▸ burst loss, lost bytes ▸ bit errors ▸ delay + jitter + stall ▸ held back, repeated
//!         ▸ slot ▸ cut ▸ delivered            an outage loses what is on the way and what is offered meanwhile
//! ```
//! What is offered at once is a *unit*: a datagram, or one write to a stream. A datagram is lost, repeated and overtaken whole; a
//! stream keeps its order and loses bytes. Every stage has a sequence of random numbers of its own and draws for every unit and
//! byte that is offered, whatever became of it before, so that a changed value shifts nothing else. A log says what became of
//! every byte, a [`FrameLedger`] what that means for the frames.
//!
//! # Sources
//! docs/impairment.md, with the formulas and the origin of the profiles' values.

mod account;
mod bundled;
mod burst_loss;
mod chances;
mod checks;
mod copies;
mod damage;
mod delay;
mod direction;
mod draws;
mod fragments;
mod frames;
mod line;
mod link;
mod outages;
mod profile;
mod settings;
mod slots;

pub use account::{Cause, Counters, Fate, LogEntry};
pub use bundled::PROFILES;
pub use direction::{Delivery, Impairment};
pub use frames::{FrameCounts, FrameLedger};
pub use link::{End, ImpairedLink, LinkEvent};
pub use profile::{LinkProfile, ProfileError};
pub use settings::{
    BurstLoss, Delay, DirectionProfile, Disconnects, Fragment, LinkKind, PieceSizes, Rate, Reorder, Stall,
};
