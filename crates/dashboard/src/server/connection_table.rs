//! The open connections: who may connect, which one makes room, and which ones end with a token.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use posebridge_telemetry::{Admission, AdmissionLimits, ClientNetwork, ConnectionUse, HostClock, Occupant, Timestamp};
use tokio_util::sync::CancellationToken;

use crate::api::HostClockSource;
use crate::counters::{ServerCounter, ServerCounters};
use crate::limits::{CONNECTION_LIMITS, OPERATOR_READERS, READER_LIMITS};
use crate::token::{AccessRole, GrantId};

pub(crate) struct ConnectionTable {
    rows: Mutex<ConnectionRows>,
    counts: Arc<ServerCounters>,
    clock: Arc<HostClockSource>,
}

#[derive(Default)]
struct ConnectionRows {
    by_id: BTreeMap<u64, ConnectionRow>,
    next_id: u64,
}

struct ConnectionRow {
    client: ClientNetwork,
    since: Timestamp<HostClock>,
    /// Requests that were let in and whose responses are not yet sent, streams included.
    open_requests: usize,
    was_served: bool,
    is_reader: bool,
    /// Of the token that its last request showed.
    grant: Option<GrantId>,
    end: CancellationToken,
}

impl ConnectionRow {
    fn occupant(&self) -> Occupant {
        let usage = if self.open_requests > 0 || self.grant.is_some() {
            ConnectionUse::Active
        } else if self.was_served {
            ConnectionUse::Idle
        } else {
            ConnectionUse::Unproven
        };
        Occupant { client: self.client, usage, since: self.since }
    }
}

impl ConnectionTable {
    pub(crate) fn new(counts: Arc<ServerCounters>, clock: Arc<HostClockSource>) -> Self {
        Self { rows: Mutex::default(), counts, clock }
    }

    fn rows(&self) -> MutexGuard<'_, ConnectionRows> {
        self.rows.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a new connection; `None` if all are in use. May end a connection that is not in use.
    pub(super) fn admit(self: &Arc<Self>, from: IpAddr) -> Option<ConnectionSlot> {
        let (client, since) = (network_of(from), (self.clock)());
        let mut rows = self.rows();
        let (ids, occupants): (Vec<u64>, Vec<Occupant>) =
            rows.by_id.iter().map(|(id, row)| (*id, row.occupant())).unzip();
        match CONNECTION_LIMITS.admit(client, &occupants) {
            Admission::Free => {}
            Admission::Replaces(index) => {
                let replaced = ids.get(index).and_then(|id| rows.by_id.remove(id));
                replaced.inspect(|row| row.end.cancel());
                self.counts.increment(ServerCounter::ConnectionsReplaced);
            }
            Admission::ClientFull | Admission::AllFull => {
                self.counts.increment(ServerCounter::TooManyConnections);
                return None;
            }
        }
        let id = rows.next_id;
        rows.next_id += 1;
        let end = CancellationToken::new();
        let row = ConnectionRow {
            client,
            since,
            open_requests: 0,
            was_served: false,
            is_reader: false,
            grant: None,
            end: end.clone(),
        };
        rows.by_id.insert(id, row);
        self.counts.increment(ServerCounter::Connections);
        Some(ConnectionSlot { id, end, table: Arc::clone(self) })
    }

    /// Ends the connections that showed a token which holds no longer.
    pub(crate) fn end_grants(&self, revoked: &[GrantId]) {
        for row in self.rows().by_id.values() {
            if row.grant.is_some_and(|grant| revoked.contains(&grant)) {
                row.end.cancel();
            }
        }
    }
}

fn network_of(ip: IpAddr) -> ClientNetwork {
    let ip = match ip {
        IpAddr::V4(v4) => v4.to_ipv6_mapped(),
        IpAddr::V6(v6) => v6,
    };
    ClientNetwork::from_ipv6_octets(ip.octets())
}

/// The place of a connection; dropping it frees the place.
pub(super) struct ConnectionSlot {
    id: u64,
    end: CancellationToken,
    table: Arc<ConnectionTable>,
}

impl ConnectionSlot {
    /// Cancelled when the connection made room for another, or its token was revoked.
    pub(super) const fn end(&self) -> &CancellationToken {
        &self.end
    }

    /// Counts a request that was let in, until the result is dropped.
    pub(super) fn begin_request(self: &Arc<Self>, grant: Option<GrantId>) -> OpenRequest {
        if let Some(row) = self.table.rows().by_id.get_mut(&self.id) {
            row.open_requests += 1;
            row.was_served = true;
            row.grant = grant;
        }
        OpenRequest { slot: Arc::clone(self) }
    }

    /// Makes the connection a reader of the stream; false if no more are allowed. The last places are for operators.
    pub(super) fn become_reader(&self, role: AccessRole) -> bool {
        let mut rows = self.table.rows();
        let readers = rows.by_id.values().filter(|row| row.is_reader);
        // Readers are not replaced, whatever they do.
        let readers = readers.map(|row| Occupant { usage: ConnectionUse::Active, ..row.occupant() });
        let readers: Vec<Occupant> = readers.collect();
        let limits = match role {
            AccessRole::Operator => READER_LIMITS,
            AccessRole::Reader => AdmissionLimits { total: READER_LIMITS.total - OPERATOR_READERS, ..READER_LIMITS },
        };
        let Some(row) = rows.by_id.get_mut(&self.id) else {
            return false;
        };
        row.is_reader = limits.admit(row.client, &readers) == Admission::Free;
        self.table.counts.add(ServerCounter::Clients, u64::from(row.is_reader));
        row.is_reader
    }

    /// Ends what [`Self::become_reader`] began.
    pub(super) fn stop_reading(&self) {
        let mut rows = self.table.rows();
        let row = rows.by_id.get_mut(&self.id);
        if row.is_some_and(|row| std::mem::take(&mut row.is_reader)) {
            self.table.counts.decrement(ServerCounter::Clients);
        }
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.stop_reading();
        self.table.rows().by_id.remove(&self.id);
        self.table.counts.decrement(ServerCounter::Connections);
    }
}

/// A request from its admission to the end of its response or stream.
pub(super) struct OpenRequest {
    slot: Arc<ConnectionSlot>,
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        let now = (self.slot.table.clock)();
        if let Some(row) = self.slot.table.rows().by_id.get_mut(&self.slot.id) {
            row.open_requests = row.open_requests.saturating_sub(1);
            row.since = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use posebridge_telemetry::Timestamp;

    use crate::token::{AccessToken, TokenGrant, TokenTable};

    fn table() -> Arc<ConnectionTable> {
        let clock: Arc<HostClockSource> = Arc::new(|| Timestamp::ZERO);
        Arc::new(ConnectionTable::new(Arc::default(), clock))
    }

    fn address(last: u8) -> IpAddr {
        IpAddr::from([192, 0, 2, last])
    }

    fn admit(table: &Arc<ConnectionTable>, last: u8) -> Arc<ConnectionSlot> {
        Arc::new(table.admit(address(last)).unwrap())
    }

    #[test]
    fn a_request_that_is_being_answered_and_a_client_with_a_token_keep_their_places() {
        let table = table();
        let grant = TokenGrant { token: AccessToken::random().unwrap(), role: AccessRole::Reader };
        let tokens = TokenTable::new(vec![grant.clone()]);
        let (id, _) = tokens.find(grant.token.expose()).unwrap();
        let (answered, with_token, served) = (admit(&table, 1), admit(&table, 1), admit(&table, 1));
        let _open = answered.begin_request(None);
        drop(with_token.begin_request(Some(id)));
        drop(served.begin_request(None));
        let silent: Vec<_> = (0..CONNECTION_LIMITS.per_client - 3).map(|_| admit(&table, 1)).collect();
        let newcomers: Vec<_> = (0..silent.len()).map(|_| admit(&table, 1)).collect();
        assert!(silent.iter().all(|slot| slot.end().is_cancelled()), "those that said nothing go first");
        assert!(!served.end().is_cancelled());
        for newcomer in &newcomers {
            drop(newcomer.begin_request(Some(id)));
        }
        let _last = admit(&table, 1);
        assert!(served.end().is_cancelled(), "then those that want nothing");
        assert!(!answered.end().is_cancelled() && !with_token.end().is_cancelled());
        // The token of all of them but the first and the last.
        table.end_grants(&tokens.replace(Vec::new()));
        assert!(!answered.end().is_cancelled() && with_token.end().is_cancelled());
        assert!(newcomers.iter().all(|slot| slot.end().is_cancelled()));
    }

    #[test]
    fn one_address_leaves_places_for_others_and_those_who_look_leave_some_for_operators() {
        let table = table();
        let mut slots = Vec::new();
        let mut readers = |role, last, count: usize| {
            let opened: Vec<_> = (0..count).map(|_| admit(&table, last)).collect();
            let became = opened.iter().filter(|slot| slot.become_reader(role)).count();
            slots.extend(opened);
            became
        };
        assert_eq!(readers(AccessRole::Operator, 1, 70), 64, "of one address");
        assert_eq!(readers(AccessRole::Reader, 2, 20), 8, "up to the last eight");
        assert_eq!(readers(AccessRole::Operator, 2, 20), 8, "which are for operators");
        assert_eq!(table.counts.value(ServerCounter::Clients), 80);
        slots.clear();
        assert_eq!(table.counts.value(ServerCounter::Clients), 0);
        assert_eq!(table.counts.value(ServerCounter::Connections), 0);
    }
}
