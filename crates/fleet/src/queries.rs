//! What stations ask each other about a robot, and the states that they keep.

use std::collections::BTreeSet;

use posebridge_telemetry::TimeDelta;

use crate::epoch::OwnershipToken;
use crate::event::{ClaimReason, StopReason};
use crate::io::{AnswerContent, Output, QueryId, QueryTarget, Reception, StateAnswer, StateSnapshot};
use crate::names::{RobotName, StationId};
use crate::ownership::Ownership;
use crate::robot_entry::{PendingQuery, Role};

/// What lies between the moment at which an owner would hand over and the question, so that it is not too early.
const QUERY_MARGIN: TimeDelta = TimeDelta::from_millis(5);

impl Ownership {
    /// Asks the owner, or everybody, or claims, if this is due.
    pub(crate) fn advance_stand_by(&mut self, robot: &RobotName) {
        if !self.status.may_serve() {
            return;
        }
        let Some(entry) = self.robots.get(robot) else { return };
        let Role::StandBy(stand_by) = &entry.role else { return };
        match &stand_by.query {
            Some(query) if query.expires <= self.now => self.on_query_expired(robot),
            Some(_) => {}
            None if stand_by.next_query > self.now => {}
            None => {
                let has_joined_since =
                    entry.epoch_known_at.is_none_or(|known_at| self.last_join.is_some_and(|join| join >= known_at));
                match entry.tokens.last() {
                    Some(owner) => self.send_query(robot, QueryTarget::Owner(owner.station.clone())),
                    None if has_joined_since && !self.stations.is_empty() => {
                        self.send_query(robot, QueryTarget::Everyone);
                    }
                    None => self.claim(robot, ClaimReason::Unowned),
                }
            }
        }
    }

    fn send_query(&mut self, robot: &RobotName, target: QueryTarget) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let heard_for = entry.reception.heard_for(self.now);
        let Role::StandBy(stand_by) = &mut entry.role else { return };
        let id = QueryId(self.last_query.0.wrapping_add(1));
        self.last_query = id;
        let waiting_for = match &target {
            QueryTarget::Owner(_) => BTreeSet::new(),
            QueryTarget::Everyone => self.stations.clone(),
        };
        let expires = self.now + self.config.query_timeout;
        stand_by.query = Some(PendingQuery { id, target: target.clone(), expires, waiting_for, distant_owner: None });
        self.outputs.push_back(Output::QueryState { robot: robot.clone(), target, id, heard_for });
    }

    fn on_query_expired(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let Role::StandBy(stand_by) = &mut entry.role else { return };
        let Some(query) = stand_by.query.take() else { return };
        match query.target {
            QueryTarget::Everyone => self.on_everyone_asked(robot, query.distant_owner.as_ref()),
            QueryTarget::Owner(owner) => {
                stand_by.unanswered += 1;
                let is_responsive = stand_by.responsive.as_ref() == Some(&owner);
                if is_responsive && stand_by.unanswered < self.config.max_unanswered {
                    self.send_query(robot, QueryTarget::Owner(owner));
                } else {
                    self.claim(robot, ClaimReason::OwnerUnresponsive(owner));
                }
            }
        }
    }

    pub(crate) fn on_state_query(&mut self, from: StationId, robot: RobotName, id: QueryId, heard_for: TimeDelta) {
        if from == self.station {
            self.refusals.own_id += 1;
            return;
        }
        let (now, config) = (self.now, &self.config);
        let Some(entry) = self.robots.get_mut(&robot) else {
            let content = AnswerContent::NotOwner { owner: None, highest_epoch: None, state: None };
            self.outputs.push_back(Output::AnswerState { to: from, robot, id, content });
            return;
        };
        let content = match &entry.role {
            // It may be replaced already; silence lets the asker decide.
            Role::Suspended { .. } => return,
            Role::Bystander | Role::StandBy(_) => AnswerContent::NotOwner {
                owner: entry.tokens.last().filter(|owner| owner.station != from).cloned(),
                highest_epoch: entry.highest_epoch,
                state: entry.cached.as_ref().map(|cached| cached.snapshot(now)),
            },
            Role::Promised { epoch, to, .. } if *to == from => AnswerContent::HandOver { epoch: *epoch },
            Role::Promised { .. } => AnswerContent::Promised,
            Role::Owner(owner) => {
                let epoch = owner.epoch;
                if let Some(silent_in) = entry.reception.departs_in(now, heard_for, config) {
                    let heard_ago = entry.reception.last().map_or(TimeDelta::ZERO, |last| now - last);
                    AnswerContent::Serving { epoch, heard_ago, silent_in }
                } else {
                    let until = now + config.hand_over_timeout;
                    entry.role = Role::Promised { epoch, to: from.clone(), until };
                    let content = AnswerContent::HandOver { epoch };
                    let answer = Output::AnswerState { to: from.clone(), robot: robot.clone(), id, content };
                    self.outputs.push_back(answer);
                    self.stop(&robot, epoch, StopReason::HandedOver(from));
                    return;
                }
            }
        };
        self.outputs.push_back(Output::AnswerState { to: from, robot, id, content });
    }

    pub(crate) fn on_state_answer(&mut self, from: &StationId, robot: &RobotName, id: QueryId, answer: StateAnswer) {
        let Some(entry) = self.robots.get_mut(robot) else {
            self.refusals.answers += 1;
            return;
        };
        let query = match &mut entry.role {
            Role::StandBy(stand_by) => stand_by.query.as_mut(),
            Role::Bystander | Role::Owner(_) | Role::Suspended { .. } | Role::Promised { .. } => None,
        };
        let Some(query) = query.filter(|query| query.id == id && is_asked(&query.target, from)) else {
            self.refusals.answers += 1;
            return;
        };
        let is_for_everyone = query.target == QueryTarget::Everyone;
        match answer {
            StateAnswer::Serving { epoch, silent_in, .. } => {
                let token = OwnershipToken { epoch, station: from.clone() };
                // Known already, unless its token was refused or is still on its way.
                self.on_token_appeared(robot, token);
                if let Some(Role::StandBy(stand_by)) = self.robots.get_mut(robot).map(|entry| &mut entry.role) {
                    stand_by.responsive = Some(from.clone());
                    stand_by.unanswered = 0;
                    stand_by.back_off(self.now, silent_in + QUERY_MARGIN, &self.config);
                }
            }
            StateAnswer::HandOver(state) => {
                entry.raise_epoch(state.epoch);
                self.cache_state(robot, state);
                self.claim(robot, ClaimReason::HandedOver(from.clone()));
            }
            StateAnswer::Promised => {
                if let Role::StandBy(stand_by) = &mut entry.role {
                    stand_by.query = None;
                    stand_by.next_query = self.now + self.config.query_timeout;
                }
            }
            StateAnswer::NotOwner { owner, highest_epoch, state } => {
                query.distant_owner =
                    owner.filter(|owner| owner.station != self.station).or(query.distant_owner.take());
                if let Some(epoch) = highest_epoch {
                    entry.raise_epoch(epoch);
                }
                if let Some(state) = state {
                    self.cache_state(robot, state);
                }
                if is_for_everyone {
                    self.forget_station(robot, from);
                } else {
                    self.on_ownership_denied(robot, from);
                }
            }
        }
    }

    /// The station does not own the robot after all: its token is about to vanish. The new owner's may be on its way.
    fn on_ownership_denied(&mut self, robot: &RobotName, station: &StationId) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        entry.tokens.retain(|token| token.station != *station);
        if let Role::StandBy(stand_by) = &mut entry.role {
            stand_by.query = None;
            stand_by.next_query = self.now + self.config.query_backoff;
        }
    }

    /// Waits for this station no longer.
    fn forget_station(&mut self, robot: &RobotName, station: &StationId) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let Role::StandBy(stand_by) = &mut entry.role else { return };
        let Some(query) = &mut stand_by.query else { return };
        if query.waiting_for.remove(station) && query.waiting_for.is_empty() {
            let distant_owner = query.distant_owner.take();
            self.on_everyone_asked(robot, distant_owner.as_ref());
        }
    }

    /// Nobody who answered owns the robot. An owner that only others are connected with gets the time of a rejoin.
    fn on_everyone_asked(&mut self, robot: &RobotName, distant_owner: Option<&OwnershipToken>) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let Role::StandBy(stand_by) = &mut entry.role else { return };
        let since = *stand_by.distant_owner_since.get_or_insert(self.now);
        if distant_owner.is_some() && self.now - since < self.config.rejoin_grace {
            stand_by.query = None;
            stand_by.next_query = self.now + self.config.departed_after;
        } else {
            self.claim(robot, ClaimReason::Unowned);
        }
    }

    pub(crate) fn on_station_vanished(&mut self, station: &StationId) {
        self.stations.remove(station);
        for robot in self.robots.names(|entry| matches!(entry.role, Role::StandBy(_))) {
            self.forget_station(&robot, station);
        }
    }

    pub(crate) fn on_state_published(
        &mut self,
        from: StationId,
        robot: &RobotName,
        reception: Reception,
        state: StateSnapshot,
    ) {
        let token = OwnershipToken { epoch: state.epoch, station: from };
        let Some(entry) = self.robots.get_mut(robot).filter(|entry| entry.tokens.contains(&token)) else {
            self.refusals.states += 1;
            return;
        };
        let is_owner = entry.tokens.last() == Some(&token);
        if let Role::StandBy(stand_by) = &mut entry.role
            && is_owner
            && reception == Reception::Silent
        {
            stand_by.backoff = self.config.query_backoff;
            stand_by.next_query = self.now;
        }
        self.cache_state(robot, state);
        self.advance_stand_by(robot);
    }

    fn cache_state(&mut self, robot: &RobotName, state: StateSnapshot) {
        if state.bytes.len() > self.config.max_state_len {
            self.refusals.states += 1;
        } else if let Some(entry) = self.robots.get_mut(robot) {
            entry.cache(self.now, state);
        }
    }
}

fn is_asked(target: &QueryTarget, station: &StationId) -> bool {
    match target {
        QueryTarget::Owner(owner) => owner == station,
        QueryTarget::Everyone => true,
    }
}
