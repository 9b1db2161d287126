//! What callbacks of a session share with its thread.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crossbeam_channel::Sender;
use posebridge_fleet::{Epoch, FleetKeys, FleetTable, Input, QueryId, RobotName, StationId};
use posebridge_link::HostTimer;
use posebridge_telemetry::{HostClock, Timestamp};
use tokio::sync::mpsc;
use zenoh::query::Query;

use crate::io::{FleetCommand, FleetEvent};

/// Questions of others that wait for an answer.
const MAX_QUESTIONS: usize = 4_096;

/// What callbacks of the session share with its thread.
pub(crate) struct SessionState {
    pub(crate) station: StationId,
    pub(crate) keys: FleetKeys,
    pub(crate) timer: HostTimer,
    pub(crate) table: Arc<Mutex<FleetTable>>,
    pub(crate) events: mpsc::Sender<FleetEvent>,
    pub(crate) own_tokens: Mutex<BTreeSet<(RobotName, Epoch)>>,
    pub(crate) stations: Mutex<BTreeSet<StationId>>,
    pub(crate) questions: Mutex<BTreeMap<(StationId, QueryId), Query>>,
    pub(crate) commands: Sender<FleetCommand>,
    pub(crate) published: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) missed: AtomicU64,
    pub(crate) invalid: AtomicU64,
}

/// A poisoned lock has whole content: nothing that holds one panics half-way.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SessionState {
    /// Hands an event to the station, or counts it.
    pub(crate) fn emit(&self, event: FleetEvent) {
        if self.events.try_send(event).is_err() {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }

    pub(crate) fn emit_input(&self, input: Input) {
        self.emit(FleetEvent::Ownership(input));
    }

    /// Gives the session's own thread something to do, which a callback may not.
    pub(crate) fn command(&self, command: FleetCommand) {
        // The thread has ended: so has the session.
        drop(self.commands.send(command));
    }

    /// Keeps a question until the station has decided.
    pub(crate) fn keep_question(&self, from: &StationId, id: QueryId, query: Query) {
        let mut questions = lock(&self.questions);
        if questions.len() >= MAX_QUESTIONS {
            // The oldest of a station: its asker has given up long ago.
            questions.pop_first();
        }
        questions.insert((from.clone(), id), query);
    }

    /// Questions of a station that left.
    pub(crate) fn drop_questions(&self, of: &StationId) {
        lock(&self.questions).retain(|(from, _), _| from != of);
    }

    pub(crate) fn count_invalid(&self, what: &dyn std::fmt::Display) {
        if self.invalid.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!("the fleet sent {what}; further ones are counted only");
        }
    }
}

/// What signs of life are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReportPurpose {
    /// To compare clocks.
    Clock,
    /// To know all tokens.
    Confirmation,
}

/// One question to all stations. Zenoh drops it when all have answered or the time is over.
pub(crate) struct ReportRound {
    pub(crate) shared: Arc<SessionState>,
    pub(crate) purpose: ReportPurpose,
    pub(crate) sent: Timestamp<HostClock>,
    pub(crate) answers: AtomicU64,
    /// Stations that did not answer in time.
    pub(crate) failures: AtomicU64,
}

impl Drop for ReportRound {
    fn drop(&mut self) {
        if self.purpose == ReportPurpose::Clock {
            return;
        }
        if self.answers.load(Ordering::Relaxed) > 0 {
            self.shared.emit_input(Input::FleetConfirmed);
        } else if self.failures.load(Ordering::Relaxed) == 0 && lock(&self.shared.stations).is_empty() {
            self.shared.emit_input(Input::FleetDisconnected);
        } else {
            // Somebody is connected and does not answer yet: the station asks again.
        }
    }
}
