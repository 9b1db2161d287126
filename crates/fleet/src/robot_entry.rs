//! What a station knows of one robot.

use std::collections::BTreeSet;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::config::OwnershipConfig;
use crate::epoch::{Epoch, OwnershipToken};
use crate::io::{QueryId, QueryTarget, Reception, StartState, StateSnapshot};
use crate::names::StationId;
use crate::reception::ReceptionMonitor;

#[derive(Clone, Debug)]
pub(crate) struct RobotEntry {
    /// Those of other stations that have not vanished.
    pub(crate) tokens: BTreeSet<OwnershipToken>,
    /// Also of tokens that have vanished.
    pub(crate) highest_epoch: Option<Epoch>,
    /// When a token or everybody's answers last told the highest epoch.
    pub(crate) epoch_known_at: Option<Timestamp<HostClock>>,
    pub(crate) reception: ReceptionMonitor,
    pub(crate) cached: Option<CachedState>,
    /// The last epoch in which this station owned the robot.
    pub(crate) last_owned: Option<Epoch>,
    pub(crate) retiring: Option<RetiringToken>,
    pub(crate) role: Role,
    pub(crate) last_used: Timestamp<HostClock>,
}

/// A state of another station.
#[derive(Clone, Debug)]
pub(crate) struct CachedState {
    state: StateSnapshot,
    received: Timestamp<HostClock>,
}

/// A token of this station that no longer holds and is soon withdrawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RetiringToken {
    pub(crate) epoch: Epoch,
    pub(crate) withdraw_at: Timestamp<HostClock>,
}

#[derive(Clone, Debug)]
pub(crate) enum Role {
    /// The robot is not heard here and not owned.
    Bystander,
    /// It is heard here and not owned.
    StandBy(StandBy),
    Owner(Owner),
    /// This station was frozen, and does not know whether it still is the owner.
    Suspended {
        epoch: Epoch,
        since: Timestamp<HostClock>,
    },
    /// Handed over; the token stays until the other station has claimed.
    Promised {
        epoch: Epoch,
        to: StationId,
        until: Timestamp<HostClock>,
    },
}

#[derive(Clone, Debug)]
pub(crate) struct StandBy {
    pub(crate) query: Option<PendingQuery>,
    /// No query is sent earlier.
    pub(crate) next_query: Timestamp<HostClock>,
    pub(crate) backoff: TimeDelta,
    /// The owner that has answered a query.
    pub(crate) responsive: Option<StationId>,
    /// Queries in a row without an answer.
    pub(crate) unanswered: u32,
    /// Since when others tell of an owner that is not connected with this station.
    pub(crate) distant_owner_since: Option<Timestamp<HostClock>>,
}

#[derive(Clone, Debug)]
pub(crate) struct PendingQuery {
    pub(crate) id: QueryId,
    pub(crate) target: QueryTarget,
    pub(crate) expires: Timestamp<HostClock>,
    /// Of a query to everyone, those that have not answered.
    pub(crate) waiting_for: BTreeSet<StationId>,
    /// An owner of which an answer tells.
    pub(crate) distant_owner: Option<OwnershipToken>,
}

#[derive(Clone, Debug)]
pub(crate) struct Owner {
    pub(crate) epoch: Epoch,
    pub(crate) since: Timestamp<HostClock>,
    pub(crate) next_publication: Timestamp<HostClock>,
    /// As it was last announced.
    pub(crate) reception: Reception,
}

impl StandBy {
    pub(crate) const fn new(next_query: Timestamp<HostClock>, config: &OwnershipConfig) -> Self {
        Self {
            query: None,
            next_query,
            backoff: config.query_backoff,
            responsive: None,
            unanswered: 0,
            distant_owner_since: None,
        }
    }

    /// Sets the next query, after an answer that leaves the owner in place.
    pub(crate) fn back_off(&mut self, now: Timestamp<HostClock>, at_least: TimeDelta, config: &OwnershipConfig) {
        self.query = None;
        self.next_query = now + at_least.max(self.backoff).min(config.max_query_backoff);
        self.backoff = (self.backoff + self.backoff).min(config.max_query_backoff);
    }
}

impl RobotEntry {
    pub(crate) const fn new(now: Timestamp<HostClock>) -> Self {
        Self {
            tokens: BTreeSet::new(),
            highest_epoch: None,
            epoch_known_at: None,
            reception: ReceptionMonitor::new(),
            cached: None,
            last_owned: None,
            retiring: None,
            role: Role::Bystander,
            last_used: now,
        }
    }

    /// Whether the robot is heard, owned or about to be withdrawn here.
    pub(crate) const fn is_local(&self) -> bool {
        !matches!(self.role, Role::Bystander) || self.retiring.is_some()
    }

    /// The epoch of this station's token, unless it retires.
    pub(crate) const fn own_epoch(&self) -> Option<Epoch> {
        match &self.role {
            Role::Owner(Owner { epoch, .. }) | Role::Suspended { epoch, .. } | Role::Promised { epoch, .. } => {
                Some(*epoch)
            }
            Role::Bystander | Role::StandBy(_) => None,
        }
    }

    pub(crate) fn raise_epoch(&mut self, epoch: Epoch) {
        self.highest_epoch = self.highest_epoch.max(Some(epoch));
    }

    /// Keeps the state unless a later owner's is known.
    pub(crate) fn cache(&mut self, now: Timestamp<HostClock>, state: StateSnapshot) {
        self.raise_epoch(state.epoch);
        let age = |cached: &CachedState| cached.age(now);
        let is_newer = self
            .cached
            .as_ref()
            .is_none_or(|cached| (state.epoch, -state.age.as_nanos()) >= (cached.state.epoch, -age(cached).as_nanos()));
        if is_newer {
            self.cached = Some(CachedState { state, received: now });
        }
    }

    /// The last known state, if it is not older than what this station has had itself.
    pub(crate) fn start_state(&self, now: Timestamp<HostClock>) -> StartState {
        match (&self.cached, self.last_owned) {
            (Some(cached), own) if own.is_none_or(|own| cached.state.epoch > own) => {
                StartState::Received(cached.snapshot(now))
            }
            (_, Some(_)) => StartState::Kept,
            (_, None) => StartState::Cold,
        }
    }

    /// When the robot's timers have to be looked at, for a station that may serve or not.
    pub(crate) fn due(&self, serving: Serving, config: &OwnershipConfig) -> Option<Timestamp<HostClock>> {
        let retiring = self.retiring.map(|token| token.withdraw_at);
        let role = match &self.role {
            Role::Bystander | Role::Suspended { .. } => None,
            Role::StandBy(stand_by) => {
                let silent_at = self.reception.silent_at(config);
                match (serving, &stand_by.query) {
                    (Serving::Allowed, Some(query)) => Some(query.expires),
                    (Serving::Allowed, None) => earliest(Some(stand_by.next_query), silent_at),
                    (Serving::Forbidden, _) => silent_at,
                }
            }
            Role::Owner(owner) => {
                let silent_at = match owner.reception {
                    Reception::Heard => self.reception.silent_at(config),
                    Reception::Silent => None,
                };
                earliest(earliest(Some(owner.next_publication), silent_at), Some(self.release_at(owner, config)))
            }
            Role::Promised { until, .. } => Some(*until),
        };
        earliest(retiring, role)
    }

    /// When the owner gives the robot up.
    pub(crate) fn release_at(&self, owner: &Owner, config: &OwnershipConfig) -> Timestamp<HostClock> {
        self.reception.last().map_or(owner.since, |last| last.max(owner.since)) + config.release_after
    }
}

impl CachedState {
    fn age(&self, now: Timestamp<HostClock>) -> TimeDelta {
        self.state.age + (now - self.received)
    }

    /// The state with its age now.
    pub(crate) fn snapshot(&self, now: Timestamp<HostClock>) -> StateSnapshot {
        StateSnapshot { age: self.age(now), ..self.state.clone() }
    }
}

/// Whether the station may query and claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Serving {
    Allowed,
    Forbidden,
}

/// The earlier of two times that may be missing.
pub(crate) fn earliest(
    one: Option<Timestamp<HostClock>>,
    other: Option<Timestamp<HostClock>>,
) -> Option<Timestamp<HostClock>> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (one, other) => one.or(other),
    }
}
