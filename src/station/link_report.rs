//! Link health as text: a few lines in the status block, tables at the end.

use std::fmt::Write as _;

use posebridge_report::tables::{NO_VALUE, TextTable};
use posebridge_telemetry::{LinkCounter, LinkHealth, LinkId, SourceHealth, TimeDelta};

const PROBLEM_COUNTERS: [LinkCounter; 16] = [
    LinkCounter::KERNEL_DROPS,
    LinkCounter::FLOOD_DROPS,
    LinkCounter::CHECKSUM_ERRORS,
    LinkCounter::GARBAGE_BYTES,
    LinkCounter::TIMEOUTS,
    LinkCounter::UNKNOWN_IDS,
    LinkCounter::REJECTED_FRAMES,
    LinkCounter::DUPLICATES,
    LinkCounter::ADDRESS_CONFLICTS,
    LinkCounter::FILTERED,
    LinkCounter::FORWARDED,
    LinkCounter::RATE_LIMITED,
    LinkCounter::EXCESS_REQUESTS,
    LinkCounter::UNSENT,
    LinkCounter::QUEUED_FRAMES,
    LinkCounter::RECONNECTS,
];

type Column = (&'static str, fn(&LinkHealth) -> String);

const RECEIVED_COLUMNS: [Column; 12] = [
    ("frames", |health| health.frames_in.to_string()),
    ("lost", |health| health.frames_lost.to_string()),
    ("dropped", |health| (health.port.kernel_drops + health.port.flood_drops).to_string()),
    ("damaged", |health| health.checksum_errors.to_string()),
    ("garbage B", |health| health.garbage_bytes.to_string()),
    ("stalls", |health| health.timeouts.to_string()),
    ("unknown", |health| health.unknown_ids.to_string()),
    ("refused", |health| health.rejected_frames.to_string()),
    ("twice", |health| health.duplicates.to_string()),
    ("filtered", |health| health.filtered.to_string()),
    ("round trip ms", |health| millis(health.round_trip)),
    ("clock ± ms", |health| millis(health.clock_uncertainty)),
];

const SENT_COLUMNS: [Column; 10] = [
    ("frames", |health| health.frames_out.to_string()),
    ("bytes", |health| health.bytes_out.to_string()),
    ("forwarded", |health| health.forwarded.to_string()),
    ("thinned", |health| health.rate_limited.to_string()),
    ("not sent", |health| (health.drops_out + health.port.drops_out).to_string()),
    ("waiting", |health| health.port.queued_frames.to_string()),
    ("waiting B", |health| health.port.queued_bytes.to_string()),
    ("takes B/s", |health| rounded(health.port.capacity_bytes_per_s)),
    ("peers", |health| health.port.peers.to_string()),
    ("reconnects", |health| health.reconnects.to_string()),
];

#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkReport {
    pub health: LinkHealth,
    pub sources: Vec<SourceHealth>,
}

/// The state of a link besides its rates: the timing, and all errors. Counters at zero are omitted.
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
    for counter in PROBLEM_COUNTERS {
        let count = (counter.read)(health);
        if count > 0 {
            parts.push(format!("{} {count}", counter.label));
        }
    }
    parts.join(", ")
}

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

/// Tables of all links: received, sent, senders.
pub fn tables<'a>(links: impl Iterator<Item = (&'a LinkId, &'a LinkReport)> + Clone) -> String {
    let mut text = link_table("received on", &RECEIVED_COLUMNS, links.clone());
    text += "\n";
    text += &link_table("sent on", &SENT_COLUMNS, links.clone());
    let senders = links.flat_map(|(id, report)| report.sources.iter().map(|counts| sender_row(*id, counts)));
    let senders: Vec<Vec<String>> = senders.collect();
    if !senders.is_empty() {
        text += "\n";
        text += &table(["sender", "frames", "lost", "lost %"], senders);
    }
    text
}

fn link_table<'a>(
    title: &str,
    columns: &[Column],
    links: impl Iterator<Item = (&'a LinkId, &'a LinkReport)>,
) -> String {
    let header = std::iter::once(title).chain(columns.iter().map(|(name, _)| *name));
    let rows = links.map(|(id, report)| {
        let cells = columns.iter().map(|(_, cell)| cell(&report.health));
        std::iter::once(format!("link {id}")).chain(cells).collect()
    });
    table(header, rows)
}

fn millis(duration: Option<TimeDelta>) -> String {
    duration.map_or_else(|| NO_VALUE.to_owned(), |duration| format!("{:.2}", duration.as_millis_f64()))
}

fn rounded(rate: Option<f64>) -> String {
    rate.map_or_else(|| NO_VALUE.to_owned(), |rate| format!("{rate:.0}"))
}

fn sender_row(id: LinkId, counts: &SourceHealth) -> Vec<String> {
    let whole = counts.frames + counts.lost;
    let share =
        if whole == 0 { NO_VALUE.to_owned() } else { format!("{:.2}", counts.lost as f64 / whole as f64 * 100.0) };
    vec![format!("link {id} {}", counts.source), counts.frames.to_string(), counts.lost.to_string(), share]
}

fn table<'h>(header: impl IntoIterator<Item = &'h str>, rows: impl IntoIterator<Item = Vec<String>>) -> String {
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
            "round trip 31.2 ms, lost 3 (1/1: 3), garbage bytes 12, passed on to it 7, thinned 4, not sent 5, waiting 9"
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
        assert_eq!(row("link 0 "), ["link", "0", "300", "3", "0", "0", "12", "0", "0", "0"]);
        assert_eq!(row("link 0 1/1 "), ["link", "0", "1/1", "97", "3", "3.00"]);
        assert_eq!(row("link 0 1/100"), ["link", "0", "1/100", "203", "0", "0.00"]);
        assert!(text.contains("link 1"));
        let nothing = tables(std::iter::empty());
        assert!(nothing.starts_with("received on") && !nothing.contains("sender"));
    }
}
