//! The server's counters, shared by all tasks.

use std::sync::atomic::{AtomicU64, Ordering};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ServerCounter {
    /// On the way to the dashboard.
    EventsDropped,
    /// Because a message was full.
    PointsDropped,
    Connections,
    /// Current readers of the stream.
    Clients,
    FramesSent,
    /// Messages that slow readers missed.
    FramesMissed,
    /// Messages that slow readers in this process missed.
    TapFramesMissed,
    Commands,
    /// Not in use, ended to make room for a new one.
    ConnectionsReplaced,
    TooManyConnections,
    /// Rejected: too many readers of the stream.
    TooManyClients,
    /// Rejected: the Host is not this station, as in DNS rebinding.
    WrongHost,
    WrongOrigin,
    /// Rejected: no token, or a wrong one.
    WrongToken,
    /// Rejected: a command of somebody who may only look.
    WrongRole,
    /// Rejected: passed on by a proxy to a station that asks for no token.
    UnknownProxy,
    /// Rejected: a request that is not HTTP, too large, too slow or malformed.
    BadRequest,
    NotFound,
    BadCommand,
    /// Rejected: a command for a robot of another station, by that station or because it did not answer.
    FleetCommand,
    /// Rejected: a command while too many wait.
    CommandsFull,
    /// Rejected: a command above the rate limit.
    CommandRate,
    /// Rejected: a replay while another one runs.
    ReplayBusy,
    /// Readers that were disconnected: they received nothing for too long, or broke the protocol. Readers that left do
    /// not count.
    ClientsDropped,
}

/// All counters: the name in `/metrics`, the reason of a rejection, the description.
#[rustfmt::skip]
pub(crate) const COUNTER_TABLE: &[CounterRow] = &[
    total_counter(ServerCounter::EventsDropped, "events_dropped_total", "Events that found no room on their way to the dashboard."),
    total_counter(ServerCounter::PointsDropped, "points_dropped_total", "Points that found no room in a message, or of robots beyond those that are shown."),
    CounterRow { kind: "gauge", ..total_counter(ServerCounter::Connections, "connections", "Open connections.") },
    CounterRow { kind: "gauge", ..total_counter(ServerCounter::Clients, "clients", "Readers of the stream.") },
    total_counter(ServerCounter::FramesSent, "frames_sent_total", "Messages handed to readers of the stream."),
    total_counter(ServerCounter::FramesMissed, "frames_missed_total", "Messages that readers have missed because they were slow."),
    total_counter(ServerCounter::TapFramesMissed, "tap_frames_missed_total", "Messages that the terminal view or PlotJuggler's sender has missed because it was slow."),
    total_counter(ServerCounter::Commands, "commands_total", "Commands handed to the engine."),
    total_counter(ServerCounter::ClientsDropped, "clients_dropped_total", "Readers let go because they took nothing for too long or sent what is no WebSocket."),
    total_counter(ServerCounter::ConnectionsReplaced, "connections_replaced_total", "Connections not in use that ended to make room for new ones."),
    refusal_counter(ServerCounter::TooManyConnections, "connections"),
    refusal_counter(ServerCounter::TooManyClients, "clients"),
    refusal_counter(ServerCounter::WrongHost, "host"),
    refusal_counter(ServerCounter::WrongOrigin, "origin"),
    refusal_counter(ServerCounter::WrongToken, "token"),
    refusal_counter(ServerCounter::WrongRole, "role"),
    refusal_counter(ServerCounter::UnknownProxy, "proxy"),
    refusal_counter(ServerCounter::BadRequest, "request"),
    refusal_counter(ServerCounter::NotFound, "not_found"),
    refusal_counter(ServerCounter::BadCommand, "command"),
    refusal_counter(ServerCounter::FleetCommand, "fleet"),
    refusal_counter(ServerCounter::CommandsFull, "commands_full"),
    refusal_counter(ServerCounter::CommandRate, "command_rate"),
    refusal_counter(ServerCounter::ReplayBusy, "replay"),
];

pub(crate) struct CounterRow {
    pub(crate) count: ServerCounter,
    pub(crate) name: &'static str,
    pub(crate) kind: &'static str,
    pub(crate) help: &'static str,
    pub(crate) reason: Option<&'static str>,
}

const fn total_counter(count: ServerCounter, name: &'static str, help: &'static str) -> CounterRow {
    CounterRow { count, name, kind: "counter", help, reason: None }
}

const fn refusal_counter(count: ServerCounter, reason: &'static str) -> CounterRow {
    CounterRow {
        reason: Some(reason),
        ..total_counter(count, "refused_total", "Connections, requests and commands that were refused.")
    }
}

#[derive(Debug, Default)]
pub(crate) struct ServerCounters {
    cells: [AtomicU64; COUNTER_TABLE.len()],
}

impl ServerCounters {
    pub(crate) fn increment(&self, count: ServerCounter) {
        self.add(count, 1);
    }

    pub(crate) fn add(&self, count: ServerCounter, amount: u64) {
        self.counter_cell(count).fetch_add(amount, Ordering::Relaxed);
    }

    pub(crate) fn decrement(&self, count: ServerCounter) {
        self.counter_cell(count).fetch_sub(1, Ordering::Relaxed);
    }

    pub(crate) fn set(&self, count: ServerCounter, number: u64) {
        self.counter_cell(count).store(number, Ordering::Relaxed);
    }

    pub(crate) fn value(&self, count: ServerCounter) -> u64 {
        self.counter_cell(count).load(Ordering::Relaxed)
    }

    pub(crate) fn refused(&self) -> u64 {
        let refusals = COUNTER_TABLE.iter().filter(|row| row.reason.is_some());
        refusals.map(|row| self.value(row.count)).sum()
    }

    fn counter_cell(&self, count: ServerCounter) -> &AtomicU64 {
        &self.cells[count as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_count_has_a_row_and_a_cell_of_its_own() {
        let mut indices: Vec<usize> = COUNTER_TABLE.iter().map(|row| row.count as usize).collect();
        indices.sort_unstable();
        assert_eq!(indices, (0..COUNTER_TABLE.len()).collect::<Vec<_>>());
        let counts = ServerCounters::default();
        for (index, row) in COUNTER_TABLE.iter().enumerate() {
            counts.add(row.count, index as u64 + 1);
        }
        for (index, row) in COUNTER_TABLE.iter().enumerate() {
            assert_eq!(counts.value(row.count), index as u64 + 1, "{}", row.name);
        }
    }

    #[test]
    fn refusals_are_summed() {
        let counts = ServerCounters::default();
        counts.increment(ServerCounter::WrongHost);
        counts.increment(ServerCounter::WrongToken);
        counts.increment(ServerCounter::FramesSent);
        assert_eq!(counts.refused(), 2);
    }
}
