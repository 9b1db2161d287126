//! How the links are doing, for people: a few lines in the status block, tables at the end.

use std::fmt::Write as _;

use posebridge_report::tables::{NO_VALUE, TextTable};
use posebridge_telemetry::{LinkHealth, LinkId, SourceHealth, TimeDelta};

/// Between two parts of a line.
const GUTTER: &str = "  ";

/// The last word on one link.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkReport {
    /// Its counters.
    pub health: LinkHealth,
    /// What each sender sent on it.
    pub sources: Vec<SourceHealth>,
}

/// The state of a link besides its rates: the timing, and everything that went wrong. Nothing is said of what did not
/// happen.
#[must_use]
pub fn condition(report: &LinkReport) -> String {
    let health = &report.health;
    let mut parts = Vec::new();
    if let Some(round_trip) = health.round_trip {
        parts.push(format!("round trip {:.1} ms", round_trip.as_millis_f64()));
    }
    if let Some(uncertainty) = health.clock_uncertainty {
        parts.push(format!("clock ± {:.2} ms", uncertainty.as_millis_f64()));
    }
    parts.push(losses(report));
    let counts = [
        (health.checksum_errors, "damaged"),
        (health.garbage_bytes, "garbage bytes"),
        (health.timeouts, "stalls"),
        (health.unknown_ids, "unknown ids"),
        (health.rejected_frames, "refused"),
        (health.duplicates, "came twice"),
        (health.address_conflicts, "by another under our address"),
        (health.filtered, "filtered"),
        (health.forwarded, "passed on to it"),
        (health.rate_limited, "thinned"),
        (health.drops_out + health.port.drops_out, "not sent"),
        (u64::from(health.port.queued_frames), "waiting"),
        (health.reconnects, "reconnects"),
    ];
    for (count, name) in counts {
        if count > 0 {
            parts.push(format!("{name} {count}"));
        }
    }
    parts.join(GUTTER)
}

/// The losses, and whose they are if there are any.
fn losses(report: &LinkReport) -> String {
    let mut text = format!("lost {}", report.health.frames_lost);
    let losers: Vec<String> = report
        .sources
        .iter()
        .filter(|counts| counts.lost > 0)
        .map(|counts| format!("{}: {}", counts.source, counts.lost))
        .collect();
    if !losers.is_empty() {
        // Writing to a String cannot fail.
        let _ = write!(text, " ({})", losers.join(", "));
    }
    text
}

/// Tables of all links: what came, what left, who sent.
#[must_use]
pub fn tables<'a>(links: impl Iterator<Item = (&'a LinkId, &'a LinkReport)> + Clone) -> String {
    let received = links.clone().map(|(id, report)| received(*id, &report.health));
    let sent = links.clone().map(|(id, report)| sent(*id, &report.health));
    let senders = links.flat_map(|(id, report)| {
        let of_link = report.sources.iter();
        of_link.map(|counts| sender(*id, counts))
    });
    let mut text = table(
        [
            "received on",
            "frames",
            "lost",
            "damaged",
            "garbage B",
            "stalls",
            "unknown",
            "refused",
            "twice",
            "filtered",
            "round trip ms",
            "clock ± ms",
        ],
        received,
    );
    text += "\n";
    text += &table(
        [
            "sent on",
            "frames",
            "bytes",
            "forwarded",
            "thinned",
            "not sent",
            "waiting",
            "waiting B",
            "takes B/s",
            "peers",
            "reconnects",
        ],
        sent,
    );
    let senders: Vec<[String; 4]> = senders.collect();
    if !senders.is_empty() {
        text += "\n";
        text += &table(["sender", "frames", "lost", "lost %"], senders);
    }
    text
}

fn received(id: LinkId, health: &LinkHealth) -> [String; 12] {
    let millis = |span: Option<TimeDelta>| {
        span.map_or_else(|| NO_VALUE.to_owned(), |span| format!("{:.2}", span.as_millis_f64()))
    };
    [
        format!("link {id}"),
        health.frames_in.to_string(),
        health.frames_lost.to_string(),
        health.checksum_errors.to_string(),
        health.garbage_bytes.to_string(),
        health.timeouts.to_string(),
        health.unknown_ids.to_string(),
        health.rejected_frames.to_string(),
        health.duplicates.to_string(),
        health.filtered.to_string(),
        millis(health.round_trip),
        millis(health.clock_uncertainty),
    ]
}

fn sent(id: LinkId, health: &LinkHealth) -> [String; 11] {
    let capacity = health.port.capacity_bytes_per_s;
    [
        format!("link {id}"),
        health.frames_out.to_string(),
        health.bytes_out.to_string(),
        health.forwarded.to_string(),
        health.rate_limited.to_string(),
        (health.drops_out + health.port.drops_out).to_string(),
        health.port.queued_frames.to_string(),
        health.port.queued_bytes.to_string(),
        capacity.map_or_else(|| NO_VALUE.to_owned(), |rate| format!("{rate:.0}")),
        health.port.peers.to_string(),
        health.reconnects.to_string(),
    ]
}

fn sender(id: LinkId, counts: &SourceHealth) -> [String; 4] {
    let whole = counts.frames + counts.lost;
    let share =
        if whole == 0 { NO_VALUE.to_owned() } else { format!("{:.2}", counts.lost as f64 / whole as f64 * 100.0) };
    [format!("link {id} {}", counts.source), counts.frames.to_string(), counts.lost.to_string(), share]
}

fn table<const COLUMNS: usize>(header: [&str; COLUMNS], rows: impl IntoIterator<Item = [String; COLUMNS]>) -> String {
    let mut table = TextTable::new(header);
    for row in rows {
        table.push(row);
    }
    table.render()
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkCounts};

    fn report() -> LinkReport {
        LinkReport {
            health: LinkHealth {
                frames_in: 300,
                frames_lost: 3,
                garbage_bytes: 12,
                forwarded: 7,
                rate_limited: 4,
                drops_out: 2,
                port: LinkCounts { drops_out: 3, queued_frames: 9, queued_bytes: 400, ..LinkCounts::default() },
                round_trip: Some(TimeDelta::from_micros(31_250)),
                ..LinkHealth::default()
            },
            sources: vec![
                SourceHealth { source: Address::new(1, 1), frames: 97, lost: 3 },
                SourceHealth { source: Address::new(1, 100), frames: 203, lost: 0 },
            ],
        }
    }

    #[test]
    fn a_condition_names_what_went_wrong_and_whose_frames_are_missing() {
        assert_eq!(
            condition(&report()),
            "round trip 31.2 ms  lost 3 (1/1: 3)  garbage bytes 12  passed on to it 7  thinned 4  not sent 5  waiting 9"
        );
        assert_eq!(condition(&LinkReport::default()), "lost 0");
    }

    #[test]
    fn the_tables_have_a_row_for_each_link_and_each_sender() {
        let links = [(LinkId(0), report()), (LinkId(1), LinkReport::default())];
        let text = tables(links.iter().map(|(id, report)| (id, report)));
        let row = |start: &str| -> Vec<&str> {
            let line = text.lines().find(|line| line.starts_with(start));
            line.unwrap_or_default().split_whitespace().collect()
        };
        assert_eq!(row("link 0 "), ["link", "0", "300", "3", "0", "12", "0", "0", "0", "0", "0", "31.25", "-"]);
        assert_eq!(row("link 0 1/1 "), ["link", "0", "1/1", "97", "3", "3.00"]);
        assert_eq!(row("link 0 1/100"), ["link", "0", "1/100", "203", "0", "0.00"]);
        assert!(text.contains("link 1"));
        let nothing = tables(std::iter::empty());
        assert!(nothing.starts_with("received on") && !nothing.contains("sender"));
    }
}
