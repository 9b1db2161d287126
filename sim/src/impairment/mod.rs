//! Link impairment without IO: delays, batches, fragments, loses, damages and duplicates bytes, and interrupts the link.
//!
//! Bytes are offered with the time of sending and polled with the time of arrival. A [`LinkProfile`] configures a link; the bundled ones
//! are in [`PROFILES`].
//!
//! # Model
//! ```text
//! offered ▸ line (rate, buffer) ▸ lost whole ▸ burst loss, lost bytes ▸ bit errors ▸ delay + jitter + stall ▸ held back, repeated
//!         ▸ slot ▸ cut ▸ delivered            an outage loses what is on the way and what is offered meanwhile
//! ```
//! The bytes of one offer are a *unit*: a datagram, or one write to a stream. A datagram is lost, duplicated and reordered as a whole; a
//! stream keeps its order and loses bytes. A log records the fate of every byte, a [`FrameLedger`] that of the frames.
//!
//! # Sources
//! docs/impairment.md, with the formulas and the origin of the profiles' values.

mod byte_log;
mod direction;
mod frame_ledger;
mod profile;
mod stages;

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, Timestamp};

use self::stages::Outages;
use crate::random::RandomStream;

pub use crate::config_file::ConfigFileError as ProfileError;
pub use byte_log::{ByteOutcome, Counters, LogEntry, LossCause};
pub use direction::{Delivery, ImpairedDirection};
pub use frame_ledger::{FrameCounts, FrameLedger};
pub use profile::{
    BurstLoss, Delay, DirectionProfile, Disconnects, Fragment, LinkKind, LinkProfile, PROFILES, PieceSizes,
    RandomDelay, Rate,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEnd {
    Brick,
    Station,
}

impl LinkEnd {
    pub const fn other(self) -> Self {
        match self {
            Self::Brick => Self::Station,
            Self::Station => Self::Brick,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImpairedLinkEvent {
    Arrived {
        end: LinkEnd,
        delivery: Delivery,
    },
    /// Both directions go down; everything in transit is lost.
    Down {
        at: Timestamp<HostClock>,
    },
    Up {
        at: Timestamp<HostClock>,
    },
}

/// Both directions of a link, without IO; used like an [`ImpairedDirection`].
#[derive(Clone, Debug)]
pub struct ImpairedLink {
    to_station: ImpairedDirection,
    to_brick: ImpairedDirection,
    outages: Option<Outages>,
    events: VecDeque<ImpairedLinkEvent>,
}

impl ImpairedLink {
    /// The link is up at `now`.
    pub fn new(profile: &LinkProfile, seed: u64, now: Timestamp<HostClock>) -> Self {
        let outages = |settings| Outages::new(settings, RandomStream::new(seed, "link outages"), now);
        Self {
            to_station: ImpairedDirection::new(&profile.to_station, profile.kind, seed, "to station"),
            to_brick: ImpairedDirection::new(&profile.to_brick, profile.kind, seed, "to brick"),
            outages: profile.disconnects.map(outages),
            events: VecDeque::new(),
        }
    }

    /// Offers a unit that `from` sends at `now`; see [`ImpairedDirection::offer`].
    pub fn offer(&mut self, from: LinkEnd, now: Timestamp<HostClock>, bytes: &[u8]) -> u64 {
        self.advance_to(now);
        self.direction_mut(from.other()).offer(now, bytes)
    }

    pub fn poll(&mut self, now: Timestamp<HostClock>) -> Option<ImpairedLinkEvent> {
        self.advance_to(now);
        self.events.pop_front()
    }

    /// When the next event happens if nothing else is offered.
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let waiting = self.events.front().map(|event| match event {
            ImpairedLinkEvent::Arrived { delivery, .. } => delivery.at,
            ImpairedLinkEvent::Down { at } | ImpairedLinkEvent::Up { at } => *at,
        });
        waiting.or_else(|| self.next().map(|(at, _)| at))
    }

    pub const fn counters(&self, end: LinkEnd) -> Counters {
        match end {
            LinkEnd::Station => self.to_station.counters(),
            LinkEnd::Brick => self.to_brick.counters(),
        }
    }

    /// The log of the direction that ends at `end`; see [`ImpairedDirection::take_log`].
    pub fn take_log(&mut self, end: LinkEnd) -> Vec<LogEntry> {
        self.direction_mut(end).take_log()
    }

    const fn direction_mut(&mut self, end: LinkEnd) -> &mut ImpairedDirection {
        match end {
            LinkEnd::Station => &mut self.to_station,
            LinkEnd::Brick => &mut self.to_brick,
        }
    }

    /// The next change. Bytes that arrive at the very instant of an outage have arrived.
    fn next(&self) -> Option<(Timestamp<HostClock>, NextChange)> {
        let arrival = |end, deadline: Option<Timestamp<HostClock>>| deadline.map(|at| (at, NextChange::Arrival(end)));
        let outage = self.outages.as_ref().map(|outages| (outages.changes_at, NextChange::Outage));
        [
            arrival(LinkEnd::Station, self.to_station.deadline()),
            arrival(LinkEnd::Brick, self.to_brick.deadline()),
            outage,
        ]
        .into_iter()
        .flatten()
        .min_by_key(|(at, _)| *at)
    }

    fn advance_to(&mut self, now: Timestamp<HostClock>) {
        while let Some((at, next)) = self.next().filter(|(at, _)| *at <= now) {
            match next {
                NextChange::Arrival(end) => {
                    let delivery = self.direction_mut(end).poll(at);
                    let event = delivery.map(|delivery| ImpairedLinkEvent::Arrived { end, delivery });
                    self.events.extend(event);
                }
                NextChange::Outage => self.toggle_outage(at),
            }
        }
    }

    fn toggle_outage(&mut self, at: Timestamp<HostClock>) {
        let Some(outages) = &mut self.outages else {
            return;
        };
        let event = if outages.toggle() {
            self.to_station.reconnect(at);
            self.to_brick.reconnect(at);
            ImpairedLinkEvent::Up { at }
        } else {
            self.to_station.disconnect(at);
            self.to_brick.disconnect(at);
            ImpairedLinkEvent::Down { at }
        };
        self.events.push_back(event);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NextChange {
    Arrival(LinkEnd),
    Outage,
}
