//! A simulated station and a simulated robot.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_fleet::{
    Epoch, EpochFence, Input, Ownership, OwnershipConfig, OwnershipToken, RobotName, StationId, StationName,
};
use posebridge_telemetry::{HostClock, Timestamp};

use crate::network::Micros;

/// What waits for a frozen station.
#[derive(Clone, Debug)]
pub(crate) enum Waiting {
    Input(Input),
    /// A message of a session.
    Message {
        from: usize,
        generation: u64,
        message: crate::network::Message,
    },
}

#[derive(Clone, Debug)]
pub(crate) struct SimulatedStation {
    pub(crate) id: StationId,
    pub(crate) ownership: Ownership,
    pub(crate) is_alive: bool,
    pub(crate) frozen_since: Option<Micros>,
    /// Stations that it was told of, and whether the fleet was confirmed last, or disconnected.
    pub(crate) peers: BTreeSet<StationId>,
    pub(crate) is_confirmed: bool,
    /// Its confirmed peers within reach when it was frozen last.
    pub(crate) peers_at_freeze: BTreeSet<StationId>,
    pub(crate) awake_since: Micros,
    /// How long the last freeze was.
    pub(crate) last_freeze: Micros,
    /// Its clock is ahead of the virtual time by this.
    pub(crate) clock_offset: Micros,
    pub(crate) waiting: VecDeque<Waiting>,
    pub(crate) robots_waiting: VecDeque<RobotName>,
    /// Tokens that it has declared and not withdrawn.
    pub(crate) declared: BTreeSet<(RobotName, OwnershipToken)>,
    /// Tokens of others that it was given.
    pub(crate) seen: BTreeSet<(RobotName, OwnershipToken)>,
    /// Its runs; events of an earlier one do not reach it.
    pub(crate) run: u64,
    /// Those that have sent all of their tokens.
    pub(crate) listed_peers: BTreeSet<usize>,
    pub(crate) ping: u64,
    /// Stations that were sent the last ping.
    pub(crate) pings: usize,
    pub(crate) pongs_missing: BTreeSet<usize>,
    pub(crate) next_tick: Option<Micros>,
}

impl SimulatedStation {
    pub(crate) fn new(index: usize, instance: u64, now: Micros, clock_offset: Micros) -> Self {
        let name = StationName::new(&format!("station-{index}")).expect("a name");
        let id = StationId { name, instance };
        let start = Timestamp::from_micros(now + clock_offset);
        Self {
            ownership: Ownership::new(OwnershipConfig::default(), id.clone(), start),
            id,
            is_alive: true,
            frozen_since: None,
            peers: BTreeSet::new(),
            is_confirmed: false,
            peers_at_freeze: BTreeSet::new(),
            awake_since: now,
            last_freeze: 0,
            clock_offset,
            waiting: VecDeque::new(),
            robots_waiting: VecDeque::new(),
            declared: BTreeSet::new(),
            seen: BTreeSet::new(),
            run: 0,
            listed_peers: BTreeSet::new(),
            ping: 0,
            pings: 0,
            pongs_missing: BTreeSet::new(),
            next_tick: None,
        }
    }

    pub(crate) fn clock(&self, now: Micros) -> Timestamp<HostClock> {
        Timestamp::from_micros(now + self.clock_offset)
    }

    pub(crate) fn is_running(&self) -> bool {
        self.is_alive && self.frozen_since.is_none()
    }
}

/// A station that has started to serve a robot.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    pub(crate) time: Micros,
    pub(crate) station: usize,
    pub(crate) token: OwnershipToken,
    pub(crate) has_state: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct SimulatedRobot {
    pub(crate) name: RobotName,
    pub(crate) period: Micros,
    /// The probability in percent that a message does not reach a station.
    pub(crate) loss_percent: u32,
    pub(crate) heard_by: BTreeSet<usize>,
    pub(crate) fence: EpochFence,
    /// The highest accepted epoch, kept apart from the fence.
    pub(crate) highest: Option<(Epoch, Micros)>,
    /// By station.
    pub(crate) last_accepted: BTreeMap<usize, Micros>,
    /// Since the robots were last watched.
    pub(crate) first_accepted_after: Option<Micros>,
    pub(crate) next_message: Micros,
    pub(crate) accepted: u64,
    pub(crate) dropped: u64,
    pub(crate) starts: Vec<Start>,
}

impl SimulatedRobot {
    pub(crate) fn new(index: usize, period: Micros, heard_by: BTreeSet<usize>) -> Self {
        Self {
            name: RobotName::new(&format!("robot-{index}")).expect("a name"),
            period,
            loss_percent: 0,
            heard_by,
            fence: EpochFence::default(),
            highest: None,
            last_accepted: BTreeMap::new(),
            first_accepted_after: None,
            next_message: 0,
            accepted: 0,
            dropped: 0,
            starts: Vec::new(),
        }
    }

    pub(crate) fn last_accepted(&self) -> Option<Micros> {
        self.last_accepted.values().max().copied()
    }
}
