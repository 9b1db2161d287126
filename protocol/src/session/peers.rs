//! Who else is on the link, and what we still have to ask of them.
//!
//! COMMAND_ACK names the command and not its parameters, so a robot is asked for one message interval at a time: otherwise
//! nobody could tell which request was answered.

use std::collections::BTreeMap;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, Span, Stamp};

use crate::message::Heartbeat;

/// MAV_AUTOPILOT_INVALID: a participant that is not a vehicle.
const NOT_AN_AUTOPILOT: u8 = 8;
/// MAV_TYPE_GCS: some ground stations claim an autopilot.
const GROUND_STATION: u8 = 6;
/// Times that one interval is requested before the next one gets its turn.
const MOST_ATTEMPTS: u8 = 5;
/// Time between the attempts.
const RETRY_PERIOD: Span = Span::from_millis(1_000);

/// Where we are with the requests to one robot.
#[derive(Clone, Copy, Debug)]
struct Asking<C: Clock> {
    /// Which of the wanted messages.
    index: usize,
    attempts: u8,
    next: Stamp<C>,
}

impl<C: Clock> Asking<C> {
    const fn from_the_start(now: Stamp<C>) -> Self {
        Self { index: 0, attempts: 0, next: now }
    }

    const fn after(index: usize, now: Stamp<C>) -> Self {
        Self { index: index + 1, attempts: 0, next: now }
    }
}

#[derive(Debug)]
struct Peer<C: Clock> {
    last_heard: Stamp<C>,
    is_robot: bool,
    asking: Option<Asking<C>>,
}

/// Everybody whose heartbeat was heard lately.
#[derive(Debug)]
pub(super) struct Peers<C: Clock> {
    timeout: Span,
    peers: BTreeMap<Address, Peer<C>>,
}

impl<C: Clock> Peers<C> {
    pub(super) const fn new(timeout: Span) -> Self {
        Self { timeout, peers: BTreeMap::new() }
    }

    /// Any message keeps a known peer alive.
    pub(super) fn heard(&mut self, now: Stamp<C>, from: Address) {
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.last_heard = now;
        }
    }

    /// Takes note of a heartbeat; true if its sender is new.
    pub(super) fn introduce(&mut self, now: Stamp<C>, from: Address, heartbeat: Heartbeat) -> bool {
        if self.peers.contains_key(&from) {
            return false;
        }
        let is_robot = heartbeat.autopilot != NOT_AN_AUTOPILOT && heartbeat.vehicle_type != GROUND_STATION;
        let peer = Peer { last_heard: now, is_robot, asking: is_robot.then(|| Asking::from_the_start(now)) };
        self.peers.insert(from, peer);
        true
    }

    pub(super) fn request_again(&mut self, now: Stamp<C>, peer: Address) {
        if let Some(peer) = self.peers.get_mut(&peer).filter(|peer| peer.is_robot) {
            peer.asking = Some(Asking::from_the_start(now));
        }
    }

    /// Removes and returns the peers that have been silent for too long, with their silence.
    pub(super) fn take_lost(&mut self, now: Stamp<C>) -> Vec<(Address, Span)> {
        let mut lost = Vec::new();
        self.peers.retain(|&address, peer| {
            let silence = now - peer.last_heard;
            let is_lost = silence >= self.timeout;
            if is_lost {
                lost.push((address, silence));
            }
            !is_lost
        });
        lost
    }

    /// Whom to ask now for which of `wanted` messages.
    pub(super) fn due_requests(&mut self, now: Stamp<C>, wanted: usize) -> Vec<(Address, usize)> {
        self.peers.iter_mut().filter_map(|(&address, peer)| Some((address, peer.due_request(now, wanted)?))).collect()
    }

    /// The robot has answered the request that is open, whatever it said: on to the next one.
    pub(super) fn request_answered(&mut self, now: Stamp<C>, from: Address) {
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.asking =
                peer.asking.map(|asking| if asking.attempts == 0 { asking } else { Asking::after(asking.index, now) });
        }
    }

    pub(super) fn deadline(&self) -> Option<Stamp<C>> {
        let lost = self.peers.values().map(|peer| peer.last_heard + self.timeout);
        let asking = self.peers.values().filter_map(|peer| Some(peer.asking?.next));
        lost.chain(asking).min()
    }

    pub(super) fn set_back(&mut self, fall: Span) {
        for peer in self.peers.values_mut() {
            peer.last_heard = peer.last_heard - fall;
            if let Some(asking) = &mut peer.asking {
                asking.next = asking.next - fall;
            }
        }
    }
}

impl<C: Clock> Peer<C> {
    fn due_request(&mut self, now: Stamp<C>, wanted: usize) -> Option<usize> {
        let mut asking = self.asking.filter(|asking| now >= asking.next)?;
        if asking.attempts == MOST_ATTEMPTS {
            asking = Asking::after(asking.index, now);
        }
        if asking.index >= wanted {
            self.asking = None;
            return None;
        }
        let index = asking.index;
        asking.attempts += 1;
        asking.next = now + RETRY_PERIOD;
        self.asking = Some(asking);
        Some(index)
    }
}
