//! The protocol as one value per station: inputs in, outputs out.

use std::collections::{BTreeSet, VecDeque};

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::config::OwnershipConfig;
use crate::epoch::{Epoch, OwnershipToken};
use crate::event::{ClaimReason, OwnershipEvent, StopReason};
use crate::fleet_status::FleetStatus;
use crate::io::{Input, Output, QueryId, Reception, RefusalCounts};
use crate::names::{RobotName, StationId};
use crate::robot_entry::{Owner, RobotEntry, Role, Serving, StandBy, earliest};
use crate::robot_table::RobotTable;

/// A station's part in the fleet: which robots it owns, and which it would take over.
///
/// Call [`Self::handle`] for each input and [`Self::poll`] until `None`, and give [`Input::Tick`] at [`Self::deadline`].
#[derive(Clone, Debug)]
pub struct Ownership {
    pub(crate) config: OwnershipConfig,
    pub(crate) station: StationId,
    pub(crate) robots: RobotTable,
    pub(crate) stations: BTreeSet<StationId>,
    /// When the last station appeared: it may know of epochs that are unknown here.
    pub(crate) last_join: Option<Timestamp<HostClock>>,
    pub(crate) status: FleetStatus,
    pub(crate) now: Timestamp<HostClock>,
    /// No robot is due before; `None` if none will be. Most inputs concern one robot, and a look at all of them for each would cost more than
    /// all the rest.
    next_due: Option<Timestamp<HostClock>>,
    pub(crate) last_query: QueryId,
    pub(crate) outputs: VecDeque<Output>,
    pub(crate) refusals: RefusalCounts,
}

/// What a station is to a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotRole {
    /// It does not hear the robot, or does not know it.
    None,
    /// It hears the robot, and does not own it.
    StandBy,
    /// It sends the robot estimates.
    Owner(Epoch),
    /// It has a token, and sends nothing: it was frozen, or has handed the robot over.
    Paused(Epoch),
}

impl Ownership {
    /// Nothing is claimed until the fleet is confirmed, which the first outputs request.
    pub fn new(config: OwnershipConfig, station: StationId, now: Timestamp<HostClock>) -> Self {
        let mut ownership = Self {
            robots: RobotTable::new(config.max_robots),
            config,
            station,
            stations: BTreeSet::new(),
            last_join: None,
            status: FleetStatus::Unconfirmed { since: now, next_request: now },
            now,
            next_due: None,
            last_query: QueryId(0),
            outputs: VecDeque::new(),
            refusals: RefusalCounts::default(),
        };
        ownership.advance_status();
        ownership
    }

    /// Takes an input. A time before the last one counts as that.
    pub fn handle(&mut self, now: Timestamp<HostClock>, input: Input) {
        if self.status == FleetStatus::Ended {
            return;
        }
        let elapsed = now - self.now;
        self.now = self.now.max(now);
        if elapsed > self.config.freeze_limit {
            self.check_freeze(elapsed);
            self.next_due = Some(self.now);
        }
        let status = self.status;
        let concerned = concerned_robot(&input).cloned();
        if concerned.is_none() && input != Input::Tick {
            self.next_due = Some(self.now);
        }
        match input {
            Input::RobotHeard { robot } => self.on_robot_heard(&robot),
            Input::RobotLinkClosed { robot } => self.on_robot_link_closed(&robot),
            Input::TokenAppeared { robot, token } => self.on_token_appeared(&robot, token),
            Input::TokenVanished { robot, token } => self.on_token_vanished(&robot, &token),
            Input::StationAppeared(station) => self.on_station_appeared(station),
            Input::StationVanished(station) => self.on_station_vanished(&station),
            Input::StateQuery { from, robot, id, heard_for } => self.on_state_query(from, robot, id, heard_for),
            Input::StateAnswer { from, robot, id, answer } => self.on_state_answer(&from, &robot, id, answer),
            Input::StatePublished { from, robot, reception, state } => {
                self.on_state_published(from, &robot, reception, state);
            }
            Input::FleetConfirmed => self.on_fleet_confirmed(),
            Input::FleetDisconnected => self.on_fleet_disconnected(),
            Input::Shutdown => self.on_shutdown(),
            Input::Tick => {}
        }
        self.advance_status();
        if self.status != status {
            self.next_due = Some(self.now);
        }
        let serving = self.serving();
        if let Some(entry) = concerned.and_then(|robot| self.robots.get(&robot)) {
            self.next_due = earliest(self.next_due, entry.due(serving, &self.config));
        }
        if self.next_due.is_some_and(|due| due <= self.now) {
            self.advance_due_robots();
        }
    }

    fn advance_due_robots(&mut self) {
        let serving = self.serving();
        for robot in self.robots.names(|entry| entry.due(serving, &self.config).is_some_and(|due| due <= self.now)) {
            self.advance_robot(&robot);
        }
        let due = self.robots.iter().filter_map(|(_, entry)| entry.due(serving, &self.config));
        self.next_due = due.min();
    }

    /// The next thing to do; `None` when all is done.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When [`Input::Tick`] is due if no other input comes; `None` if never.
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let has_local = self.robots.iter().any(|(_, entry)| entry.is_local());
        let tick = has_local.then(|| self.now + self.config.tick_interval);
        earliest(earliest(self.status.due(), self.next_due), tick)
    }

    /// The epoch in which an estimate may be sent to the robot now, if any. The shell asks before each estimate: the station may have
    /// been frozen since the last input.
    pub fn permit(&self, now: Timestamp<HostClock>, robot: &RobotName) -> Option<Epoch> {
        match self.role(robot) {
            RobotRole::Owner(epoch) if self.is_awake(now) => Some(epoch),
            RobotRole::Owner(_) | RobotRole::None | RobotRole::StandBy | RobotRole::Paused(_) => None,
        }
    }

    /// Whether the last input is so recent that this station has not been frozen since.
    pub fn is_awake(&self, now: Timestamp<HostClock>) -> bool {
        now - self.now <= self.config.freeze_limit
    }

    pub fn role(&self, robot: &RobotName) -> RobotRole {
        match self.robots.get(robot).map(|entry| &entry.role) {
            None | Some(Role::Bystander) => RobotRole::None,
            Some(Role::StandBy(_)) => RobotRole::StandBy,
            Some(Role::Owner(Owner { epoch, .. })) => RobotRole::Owner(*epoch),
            Some(Role::Suspended { epoch, .. } | Role::Promised { epoch, .. }) => RobotRole::Paused(*epoch),
        }
    }

    /// The highest token that is known for the robot: its owner's.
    pub fn owner(&self, robot: &RobotName) -> Option<OwnershipToken> {
        let entry = self.robots.get(robot)?;
        let own = entry.own_epoch().map(|epoch| OwnershipToken { epoch, station: self.station.clone() });
        own.max(entry.tokens.last().cloned())
    }

    /// Counts since the start.
    pub const fn refusals(&self) -> &RefusalCounts {
        &self.refusals
    }

    pub(crate) const fn serving(&self) -> Serving {
        if self.status.may_serve() { Serving::Allowed } else { Serving::Forbidden }
    }

    fn on_robot_heard(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.heard(robot, self.now) else {
            self.refusals.robots += 1;
            return;
        };
        entry.reception.hear(self.now, &self.config);
        match &mut entry.role {
            Role::Bystander => {
                entry.role = Role::StandBy(StandBy::new(self.now, &self.config));
                self.advance_stand_by(robot);
            }
            Role::Owner(owner) => owner.reception = Reception::Heard,
            Role::StandBy(_) | Role::Suspended { .. } | Role::Promised { .. } => {}
        }
    }

    fn on_robot_link_closed(&mut self, robot: &RobotName) {
        if let Some(entry) = self.robots.get_mut(robot) {
            entry.reception.close();
            self.advance_robot(robot);
        }
    }

    pub(crate) fn on_token_appeared(&mut self, robot: &RobotName, token: OwnershipToken) {
        if token.station == self.station {
            let entry = self.robots.get(robot);
            let own = entry.and_then(|entry| entry.own_epoch().or(entry.retiring.map(|retiring| retiring.epoch)));
            if own != Some(token.epoch) {
                self.refusals.own_id += 1;
            }
            return;
        }
        let Some(entry) = self.robots.reported(robot, self.now) else {
            self.refusals.robots += 1;
            return;
        };
        if !entry.tokens.insert(token.clone()) {
            return;
        }
        if entry.tokens.len() > self.config.max_stations {
            entry.tokens.pop_first();
            self.refusals.tokens += 1;
        }
        entry.raise_epoch(token.epoch);
        entry.epoch_known_at = Some(self.now);
        let own = entry.own_epoch().map(|epoch| OwnershipToken { epoch, station: self.station.clone() });
        let is_highest = entry.tokens.last() == Some(&token);
        if own.is_some_and(|own| token > own) {
            self.yield_to(robot, token);
        } else if let Role::StandBy(stand_by) = &mut entry.role
            && is_highest
        {
            // The new owner has just heard the robot, or will be asked soon.
            *stand_by = StandBy::new(self.now + self.config.departed_after, &self.config);
        }
    }

    fn on_token_vanished(&mut self, robot: &RobotName, token: &OwnershipToken) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let was_highest = entry.tokens.last() == Some(token);
        if !entry.tokens.remove(token) || !was_highest {
            return;
        }
        let is_unowned = entry.tokens.is_empty();
        let is_heard = entry.reception.at(self.now, &self.config) == Reception::Heard;
        if let Role::StandBy(stand_by) = &mut entry.role {
            *stand_by = StandBy::new(self.now, &self.config);
            if is_unowned && is_heard && self.status.may_serve() {
                self.claim(robot, ClaimReason::OwnerVanished(token.station.clone()));
            }
        }
    }

    fn on_station_appeared(&mut self, station: StationId) {
        if station == self.station {
            return;
        }
        if self.stations.len() >= self.config.max_stations && !self.stations.contains(&station) {
            self.refusals.stations += 1;
        } else if self.stations.insert(station) {
            self.last_join = Some(self.now);
        }
    }

    fn on_fleet_confirmed(&mut self) {
        if self.status == FleetStatus::Connected {
            return;
        }
        self.status = FleetStatus::Connected;
        self.resume();
    }

    fn on_fleet_disconnected(&mut self) {
        self.status = match self.status {
            FleetStatus::Connected => FleetStatus::Isolated,
            FleetStatus::Unconfirmed { since, .. } => {
                FleetStatus::Waiting { serve_from: since + self.config.rejoin_grace }
            }
            same @ (FleetStatus::Waiting { .. } | FleetStatus::Isolated | FleetStatus::Ended) => same,
        };
    }

    fn on_shutdown(&mut self) {
        for robot in self.robots.names(|entry| matches!(entry.role, Role::Owner(_))) {
            if let RobotRole::Owner(epoch) = self.role(&robot) {
                let reception = Reception::Silent;
                self.outputs.push_back(Output::PublishState { robot: robot.clone(), epoch, reception });
                self.stop(&robot, epoch, StopReason::Shutdown);
            }
        }
        for robot in self.robots.names(RobotEntry::is_local) {
            self.withdraw(&robot);
        }
        self.status = FleetStatus::Ended;
    }

    /// Between two calls the station was not running. Where others may have replaced it meanwhile, it stops until it knows.
    fn check_freeze(&mut self, duration: TimeDelta) {
        let is_idle = self.robots.iter().all(|(_, entry)| !entry.is_local());
        if is_idle || self.status == FleetStatus::Isolated {
            return;
        }
        self.status = FleetStatus::Unconfirmed { since: self.now, next_request: self.now };
        self.outputs.push_back(Output::Event(OwnershipEvent::Frozen { duration }));
        for robot in self.robots.names(RobotEntry::is_local) {
            let Some(entry) = self.robots.get_mut(&robot) else { continue };
            entry.reception.skip(duration);
            match entry.role {
                Role::Owner(Owner { epoch, .. }) => {
                    entry.role = Role::Suspended { epoch, since: self.now };
                    self.stop(&robot, epoch, StopReason::Frozen);
                }
                // An answer may wait to be read.
                Role::StandBy(_) => entry.role = Role::StandBy(StandBy::new(self.now, &self.config)),
                Role::Bystander | Role::Suspended { .. } | Role::Promised { .. } => {}
            }
        }
    }

    fn advance_status(&mut self) {
        match self.status {
            FleetStatus::Unconfirmed { since, next_request } if next_request <= self.now => {
                let next_request = self.now + self.config.confirmation_interval;
                self.status = FleetStatus::Unconfirmed { since, next_request };
                self.outputs.push_back(Output::ConfirmFleet);
            }
            FleetStatus::Waiting { serve_from } if serve_from <= self.now => {
                self.status = FleetStatus::Isolated;
                self.resume();
            }
            FleetStatus::Unconfirmed { .. }
            | FleetStatus::Waiting { .. }
            | FleetStatus::Connected
            | FleetStatus::Isolated
            | FleetStatus::Ended => {}
        }
    }
}

/// The only robot that an input changes anything for; `None` if it may change all.
const fn concerned_robot(input: &Input) -> Option<&RobotName> {
    match input {
        Input::RobotHeard { robot }
        | Input::RobotLinkClosed { robot }
        | Input::TokenAppeared { robot, .. }
        | Input::TokenVanished { robot, .. }
        | Input::StateQuery { robot, .. }
        | Input::StateAnswer { robot, .. }
        | Input::StatePublished { robot, .. } => Some(robot),
        Input::StationAppeared(_)
        | Input::StationVanished(_)
        | Input::FleetConfirmed
        | Input::FleetDisconnected
        | Input::Shutdown
        | Input::Tick => None,
    }
}
