//! Both directions of a link and the outages that they share, in the order of time.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, Stamp};

use super::account::{Counters, LogEntry};
use super::direction::{Delivery, Impairment};
use super::outages::{Outages, Presence};
use super::profile::LinkProfile;
use crate::random::Stream;

/// An end of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The robot's.
    Brick,
    /// The station's.
    Station,
}

impl End {
    /// The end that hears this one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::Brick => Self::Station,
            Self::Station => Self::Brick,
        }
    }
}

/// What happens on a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// Bytes arrive.
    Arrived {
        /// Where.
        end: End,
        /// Which, and when.
        delivery: Delivery,
    },
    /// Both directions are gone, with all that was on the way.
    Down {
        /// Since when.
        at: Stamp<HostClock>,
    },
    /// Both directions are back.
    Up {
        /// Since when.
        at: Stamp<HostClock>,
    },
}

/// Both directions of a link, as a value; used like an [`Impairment`].
#[derive(Clone, Debug)]
pub struct ImpairedLink {
    to_station: Impairment,
    to_brick: Impairment,
    outages: Option<Outages>,
    events: VecDeque<LinkEvent>,
}

impl ImpairedLink {
    /// A link that is up at `now`.
    #[must_use]
    pub fn new(profile: &LinkProfile, seed: u64, now: Stamp<HostClock>) -> Self {
        let outages = |settings| Outages::new(settings, Stream::new(seed, "link outages"), now);
        Self {
            to_station: Impairment::new(&profile.to_station, profile.kind, seed, "to station"),
            to_brick: Impairment::new(&profile.to_brick, profile.kind, seed, "to brick"),
            outages: profile.disconnects.map(outages),
            events: VecDeque::new(),
        }
    }

    /// Offers a unit that the end `from` sends at `now`; see [`Impairment::offer`].
    pub fn offer(&mut self, from: End, now: Stamp<HostClock>, bytes: &[u8]) -> u64 {
        self.pass_to(now);
        self.towards(from.other()).offer(now, bytes)
    }

    /// The next thing that has happened by `now`, in the order of time.
    pub fn poll(&mut self, now: Stamp<HostClock>) -> Option<LinkEvent> {
        self.pass_to(now);
        self.events.pop_front()
    }

    /// When the next thing happens, if nothing else is offered.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<HostClock>> {
        let told = self.events.front().map(|event| match event {
            LinkEvent::Arrived { delivery, .. } => delivery.at,
            LinkEvent::Down { at } | LinkEvent::Up { at } => *at,
        });
        told.or_else(|| self.next().map(|(at, _)| at))
    }

    /// Counts of the direction that ends at `end`.
    #[must_use]
    pub const fn counters(&self, end: End) -> Counters {
        match end {
            End::Station => self.to_station.counters(),
            End::Brick => self.to_brick.counters(),
        }
    }

    /// The log of the direction that ends at `end`; see [`Impairment::take_log`].
    pub fn take_log(&mut self, end: End) -> Vec<LogEntry> {
        self.towards(end).take_log()
    }

    const fn towards(&mut self, end: End) -> &mut Impairment {
        match end {
            End::Station => &mut self.to_station,
            End::Brick => &mut self.to_brick,
        }
    }

    /// What happens next, and when. What arrives at the very instant of an outage has arrived.
    fn next(&self) -> Option<(Stamp<HostClock>, Next)> {
        let arrival = |end, deadline: Option<Stamp<HostClock>>| deadline.map(|at| (at, Next::Arrival(end)));
        let outage = self.outages.as_ref().map(|outages| (outages.changes_at(), Next::Outage));
        [arrival(End::Station, self.to_station.deadline()), arrival(End::Brick, self.to_brick.deadline()), outage]
            .into_iter()
            .flatten()
            .min_by_key(|(at, _)| *at)
    }

    fn pass_to(&mut self, now: Stamp<HostClock>) {
        while let Some((at, next)) = self.next().filter(|(at, _)| *at <= now) {
            match next {
                Next::Arrival(end) => {
                    let delivery = self.towards(end).poll(at);
                    let event = delivery.map(|delivery| LinkEvent::Arrived { end, delivery });
                    self.events.extend(event);
                }
                Next::Outage => self.change(at),
            }
        }
    }

    fn change(&mut self, at: Stamp<HostClock>) {
        let Some(outages) = &mut self.outages else {
            return;
        };
        let event = match outages.change() {
            Presence::Down => {
                self.to_station.cut(at);
                self.to_brick.cut(at);
                LinkEvent::Down { at }
            }
            Presence::Up => {
                self.to_station.restore(at);
                self.to_brick.restore(at);
                LinkEvent::Up { at }
            }
        };
        self.events.push_back(event);
    }
}

/// What happens next on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Next {
    /// Bytes arrive at this end.
    Arrival(End),
    /// The link goes away or comes back.
    Outage,
}
