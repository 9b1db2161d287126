//! The other participants of the link, and the message intervals to request from them.
//!
//! COMMAND_ACK names the command and not its parameters, so a robot gets one request for a message interval at a time:
//! otherwise an acknowledgement could not be assigned to its request.

use std::collections::BTreeMap;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, TimeDelta, Timestamp};

use crate::message::Heartbeat;

/// MAV_AUTOPILOT_GENERIC.
const GENERIC_AUTOPILOT: u8 = 0;
/// Number of requests of one interval before the next one is requested.
const MAX_ATTEMPTS: u8 = 5;
const RETRY_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// The messages that are requested from every new vehicle, with their intervals.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RequestedMessages {
    /// From a robot of no particular autopilot, which may speak our dialect.
    pub of_robots: Vec<(u32, TimeDelta)>,
    /// From one of a known autopilot, such as ArduPilot or PX4.
    pub of_autopilots: Vec<(u32, TimeDelta)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PeerKind {
    /// A camera, a ground station, a companion computer.
    NoVehicle,
    Robot,
    Autopilot,
}

impl PeerKind {
    const fn of(heartbeat: Heartbeat) -> Self {
        match heartbeat.autopilot {
            _ if !heartbeat.is_vehicle() => Self::NoVehicle,
            GENERIC_AUTOPILOT => Self::Robot,
            _ => Self::Autopilot,
        }
    }

    fn messages(self, requested: &RequestedMessages) -> &[(u32, TimeDelta)] {
        match self {
            Self::NoVehicle => &[],
            Self::Robot => &requested.of_robots,
            Self::Autopilot => &requested.of_autopilots,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct RequestProgress<C: Clock> {
    index: usize,
    attempts: u8,
    next: Timestamp<C>,
}

impl<C: Clock> RequestProgress<C> {
    const fn new(index: usize, now: Timestamp<C>) -> Self {
        Self { index, attempts: 0, next: now }
    }
}

#[derive(Debug)]
struct SessionPeer<C: Clock> {
    last_seen: Timestamp<C>,
    kind: PeerKind,
    request_progress: Option<RequestProgress<C>>,
}

#[derive(Debug)]
pub(super) struct PeerTable<C: Clock> {
    timeout: TimeDelta,
    peers: BTreeMap<Address, SessionPeer<C>>,
}

impl<C: Clock> PeerTable<C> {
    pub(super) const fn new(timeout: TimeDelta) -> Self {
        Self { timeout, peers: BTreeMap::new() }
    }

    pub(super) fn record_activity(&mut self, now: Timestamp<C>, from: Address) {
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.last_seen = now;
        }
    }

    /// Records a heartbeat; true if its sender is new.
    pub(super) fn record_heartbeat(&mut self, now: Timestamp<C>, from: Address, heartbeat: Heartbeat) -> bool {
        if self.peers.contains_key(&from) {
            return false;
        }
        let kind = PeerKind::of(heartbeat);
        let request_progress = (kind != PeerKind::NoVehicle).then(|| RequestProgress::new(0, now));
        self.peers.insert(from, SessionPeer { last_seen: now, kind, request_progress });
        true
    }

    pub(super) fn restart_requests(&mut self, now: Timestamp<C>, peer: Address) {
        if let Some(peer) = self.peers.get_mut(&peer).filter(|peer| peer.kind != PeerKind::NoVehicle) {
            peer.request_progress = Some(RequestProgress::new(0, now));
        }
    }

    /// Removes and returns the peers that have been silent for longer than the time-out, with their silence.
    pub(super) fn take_lost(&mut self, now: Timestamp<C>) -> Vec<(Address, TimeDelta)> {
        let mut lost = Vec::new();
        self.peers.retain(|&address, peer| {
            let silence = now - peer.last_seen;
            let is_lost = silence >= self.timeout;
            if is_lost {
                lost.push((address, silence));
            }
            !is_lost
        });
        lost
    }

    /// The peers to send a request now, each with the message and its interval.
    pub(super) fn due_requests(
        &mut self,
        now: Timestamp<C>,
        requested: &RequestedMessages,
    ) -> Vec<(Address, (u32, TimeDelta))> {
        let due = self.peers.iter_mut().filter_map(|(&address, peer)| {
            let messages = peer.kind.messages(requested);
            let index = peer.due_request(now, messages.len())?;
            Some((address, messages[index]))
        });
        due.collect()
    }

    /// The robot has replied to the open request, whatever the result: continues with the next one.
    pub(super) fn record_response(&mut self, now: Timestamp<C>, from: Address) {
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.request_progress = peer.request_progress.map(|progress| {
                if progress.attempts == 0 { progress } else { RequestProgress::new(progress.index + 1, now) }
            });
        }
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<C>> {
        let lost = self.peers.values().map(|peer| peer.last_seen + self.timeout);
        let next_attempts = self.peers.values().filter_map(|peer| Some(peer.request_progress?.next));
        lost.chain(next_attempts).min()
    }

    pub(super) fn shift_clock(&mut self, fall: TimeDelta) {
        for peer in self.peers.values_mut() {
            peer.last_seen = peer.last_seen - fall;
            if let Some(progress) = &mut peer.request_progress {
                progress.next = progress.next - fall;
            }
        }
    }
}

impl<C: Clock> SessionPeer<C> {
    fn due_request(&mut self, now: Timestamp<C>, requested_count: usize) -> Option<usize> {
        let mut progress = self.request_progress.filter(|progress| now >= progress.next)?;
        if progress.attempts == MAX_ATTEMPTS {
            progress = RequestProgress::new(progress.index + 1, now);
        }
        if progress.index >= requested_count {
            self.request_progress = None;
            return None;
        }
        let index = progress.index;
        progress.attempts += 1;
        progress.next = now + RETRY_PERIOD;
        self.request_progress = Some(progress);
        Some(index)
    }
}
