//! What the server counts, from whichever task.

use std::sync::atomic::{AtomicU64, Ordering};

/// One thing that is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Count {
    /// Events that found no room on their way to the dashboard.
    EventsDropped,
    /// Points that found no room in a message.
    PointsDropped,
    /// Connections at the moment.
    Connections,
    /// Readers of the stream at the moment.
    Clients,
    /// Messages handed to readers.
    FramesSent,
    /// Messages that readers have missed because they were slow.
    FramesMissed,
    /// The same of readers in this process.
    TapFramesMissed,
    /// Commands handed to the engine.
    Commands,
    /// Refused: too many connections.
    TooManyConnections,
    /// Refused: too many readers of the stream.
    TooManyClients,
    /// Refused: no Host of this station, as DNS rebinding would have it.
    WrongHost,
    /// Refused: the page of another origin.
    WrongOrigin,
    /// Refused: no token, or another one.
    WrongToken,
    /// Refused: a request that is no HTTP, too large, too slow, or not to be had.
    BadRequest,
    /// Refused: there is no such thing.
    NotFound,
    /// Refused: a command that makes no sense.
    BadCommand,
    /// Refused: a command while too many wait.
    CommandsFull,
    /// Refused: a command while too many come.
    CommandRate,
    /// Refused: a replay while another one runs.
    ReplayBusy,
    /// Readers that were let go: they took nothing for too long, or sent what is no WebSocket. Whoever just goes is none of them.
    ClientsDropped,
}

/// Everything that is counted: the name in `/metrics`, the reason for a refusal, what it is.
pub(crate) const COUNTS: &[Row] = &[
    total(Count::EventsDropped, "events_dropped_total", "Events that found no room on their way to the dashboard."),
    total(
        Count::PointsDropped,
        "points_dropped_total",
        "Points that found no room in a message, or of robots beyond those that are shown.",
    ),
    Row { kind: "gauge", ..total(Count::Connections, "connections", "Open connections.") },
    Row { kind: "gauge", ..total(Count::Clients, "clients", "Readers of the stream.") },
    total(Count::FramesSent, "frames_sent_total", "Messages handed to readers of the stream."),
    total(Count::FramesMissed, "frames_missed_total", "Messages that readers have missed because they were slow."),
    total(
        Count::TapFramesMissed,
        "tap_frames_missed_total",
        "Messages that the terminal view or PlotJuggler's sender has missed because it was slow.",
    ),
    total(Count::Commands, "commands_total", "Commands handed to the engine."),
    total(
        Count::ClientsDropped,
        "clients_dropped_total",
        "Readers let go because they took nothing for too long or sent what is no WebSocket.",
    ),
    refusal(Count::TooManyConnections, "connections"),
    refusal(Count::TooManyClients, "clients"),
    refusal(Count::WrongHost, "host"),
    refusal(Count::WrongOrigin, "origin"),
    refusal(Count::WrongToken, "token"),
    refusal(Count::BadRequest, "request"),
    refusal(Count::NotFound, "not_found"),
    refusal(Count::BadCommand, "command"),
    refusal(Count::CommandsFull, "commands_full"),
    refusal(Count::CommandRate, "command_rate"),
    refusal(Count::ReplayBusy, "replay"),
];

/// A row of [`COUNTS`].
pub(crate) struct Row {
    pub(crate) count: Count,
    pub(crate) name: &'static str,
    pub(crate) kind: &'static str,
    pub(crate) help: &'static str,
    /// Why, for refusals.
    pub(crate) reason: Option<&'static str>,
}

const fn total(count: Count, name: &'static str, help: &'static str) -> Row {
    Row { count, name, kind: "counter", help, reason: None }
}

const fn refusal(count: Count, reason: &'static str) -> Row {
    Row {
        reason: Some(reason),
        ..total(count, "refused_total", "Connections, requests and commands that were refused.")
    }
}

/// The counters.
#[derive(Debug, Default)]
pub(crate) struct Counts {
    cells: [AtomicU64; COUNTS.len()],
}

impl Counts {
    /// Counts one.
    pub(crate) fn one(&self, count: Count) {
        self.add(count, 1);
    }

    /// Counts several.
    pub(crate) fn add(&self, count: Count, several: u64) {
        self.cell(count).fetch_add(several, Ordering::Relaxed);
    }

    /// One less of what is counted at the moment.
    pub(crate) fn less(&self, count: Count) {
        self.cell(count).fetch_sub(1, Ordering::Relaxed);
    }

    /// What was counted elsewhere.
    pub(crate) fn set(&self, count: Count, number: u64) {
        self.cell(count).store(number, Ordering::Relaxed);
    }

    /// How many there are.
    pub(crate) fn of(&self, count: Count) -> u64 {
        self.cell(count).load(Ordering::Relaxed)
    }

    /// All refusals.
    pub(crate) fn refused(&self) -> u64 {
        let refusals = COUNTS.iter().filter(|row| row.reason.is_some());
        refusals.map(|row| self.of(row.count)).sum()
    }

    fn cell(&self, count: Count) -> &AtomicU64 {
        &self.cells[count as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_count_has_a_row_and_a_cell_of_its_own() {
        let mut seen: Vec<usize> = COUNTS.iter().map(|row| row.count as usize).collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..COUNTS.len()).collect::<Vec<_>>());
        let counts = Counts::default();
        for (index, row) in COUNTS.iter().enumerate() {
            counts.add(row.count, index as u64 + 1);
        }
        for (index, row) in COUNTS.iter().enumerate() {
            assert_eq!(counts.of(row.count), index as u64 + 1, "{}", row.name);
        }
    }

    #[test]
    fn refusals_are_summed() {
        let counts = Counts::default();
        counts.one(Count::WrongHost);
        counts.one(Count::WrongToken);
        counts.one(Count::FramesSent);
        assert_eq!(counts.refused(), 2);
    }
}
