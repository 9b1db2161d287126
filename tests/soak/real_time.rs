//! Two bricks over two bad links for as long as one likes, in real time and with the real program: one on a pseudo-terminal behind
//! the profile `harsh`, one on UDP behind a profile that is as bad to datagrams.
//!
//! The station's account of its losses must be that of the relays to the frame, its memory must not grow, and whoever falls silent must
//! be heard again. Every commit runs it for a quarter of a minute; docs/soak.md tells of longer runs:
//!
//! ```text
//! POSEBRIDGE_SOAK_REAL_HOURS=1 cargo test --release --test soak real_time -- --nocapture
//! ```

use std::collections::BTreeSet;
use std::path::Path;

use crate::support::{RunningProgram, write_text};
use crate::{FrameAccount, max_unseen};
use serde_json::Value;

/// Length of the run that every commit makes, s.
const SHORT_S: f64 = 15.0;
/// Runs of at least this length check outages and keep the relays' recordings, s.
const LONG_S: f64 = 300.0;
/// Warm-up, s: the allocator keeps what the first long stalls and the end of the first part of the recording needed for a moment.
const WARM_UP_S: f64 = 600.0;
/// Runs of at least this length compare the memory with that after the warm-up, s.
const MEMORY_S: f64 = 900.0;
/// Memory may grow by this share.
const GROWTH: f64 = 0.02;
/// Lines of the station between two that are shown; it says one every five seconds.
const SHOWN: usize = 60;

/// A brick that writes on while the link holds everything back: what it does not send the relay cannot know to be missing. A stall of
/// 10 s and an outage of 5 s are longer than the default.
const PATIENT_UDP: &str = "udp://127.0.0.1:0?idle_s=60";

/// What `harsh` is to a stream, for datagrams.
const HARSH_DATAGRAMS: &str = include_str!("../data/harsh-datagrams.toml");

/// The bricks' frames are none of each other's business.
const STATION: &str = include_str!("../data/two-links.toml");

#[test]
fn over_two_bad_links_the_losses_are_those_of_the_relays_and_the_memory_stays() {
    let hours =
        std::env::var("POSEBRIDGE_SOAK_REAL_HOURS").ok().map(|hours| hours.parse::<f64>().expect("a number of hours"));
    let length_s = hours.map_or(SHORT_S, |hours| hours * 3_600.0);
    let mut folder = tempfile::tempdir().unwrap();
    let is_long = length_s >= LONG_S;
    // What a long run has found out is not thrown away if it fails.
    folder.disable_cleanup(is_long);
    println!("in {}", folder.path().display());
    let mut setup = SoakSetup::set(folder.path(), length_s);
    let watched = setup.watch(length_s);
    println!("{watched:?}");
    // A torn frame whose checksum fits by chance is not to be expected of a quarter of a minute.
    let unseen = if is_long { max_unseen(length_s / 3_600.0) } else { 0.0 };
    let outages = setup.end(unseen);
    println!("{outages} outages");
    if is_long {
        assert!(outages > 0);
    }
    if length_s >= MEMORY_S {
        let growth = watched.highest_kib as f64 / watched.settled_kib as f64 - 1.0;
        println!("memory grew by {:.2} %", growth * 100.0);
        assert!(growth <= GROWTH, "{watched:?}");
    }
    folder.disable_cleanup(false);
}

/// Two bricks, two relays, one station.
struct SoakSetup {
    bricks: [RunningProgram; 2],
    relays: [RunningProgram; 2],
    station: RunningProgram,
}

/// What was seen of the station.
#[derive(Clone, Copy, Debug, Default)]
struct ProcessUsage {
    lines: usize,
    settled_kib: u64,
    highest_kib: u64,
}

impl SoakSetup {
    /// Sets it up for a run of so many seconds; in a long one the relays record what they hand over.
    fn set(folder: &Path, length_s: f64) -> Self {
        write_text(folder, "datagrams.toml", HARSH_DATAGRAMS);
        let start = |args: &[&str]| RunningProgram::posebridge(folder, args);
        let laps = ["--laps", "10000"];
        let mut wired = start(&[&["sim", "square", "--listen", "pty:brick.tty"], &laps[..]].concat());
        wired.wait_for("brick up");
        let udp = "udp://127.0.0.1:0";
        let mut wireless = start(&[&["sim", "square", "--seed", "2", "--listen", PATIENT_UDP], &laps[..]].concat());
        let brick = address(&wireless.wait_for("listening on"));
        let relay = |ends: &[&str], profile: &str, seed: &str| {
            let options = ["--impair", profile, "--seed", seed, "--json"];
            let path = format!("relay-{seed}.mcap");
            let recorded = ["--record", &path];
            let recorded = if length_s >= LONG_S { &recorded[..] } else { &[] };
            start(&[&["relay"], ends, &options[..], recorded].concat())
        };
        let brick = format!("udp://{brick}");
        let mut by_air = relay(&[&brick, "--listen", udp], "datagrams.toml", "4");
        let at = address(&by_air.wait_for("station end listening on"));
        write_text(folder, "station.toml", &STATION.replace("RELAY", &at));
        let mut station = start(&["run", "--config", "station.toml", "--out", "run", "--verbose"]);
        // Its terminal is there once it hears anybody.
        station.wait_for("robot 1/1/1 detected");
        // The station owns it: a relay that opens it waits where it is full, as it is after a stall, and drops nothing.
        let by_wire = relay(&["serial:brick.tty", "serial:station.tty"], "harsh", "3");
        station.wait_for("robot 0/1/1 detected");
        Self { bricks: [wired, wireless], relays: [by_wire, by_air], station }
    }

    /// Watches the station until the time is over and everybody is heard.
    fn watch(&mut self, length_s: f64) -> ProcessUsage {
        let mut watched = ProcessUsage::default();
        let mut silent = BTreeSet::new();
        loop {
            let line = self.station.wait_for("\n");
            let line = line.trim();
            if let Some((robot, _)) = line.split_once(" lost: silent") {
                silent.insert(robot.to_owned());
            } else if let Some(robot) = line.strip_suffix(" detected") {
                silent.remove(robot);
            } else if let Some(time) = line.strip_prefix("time ") {
                let time_s = seconds(time);
                watched.record(self.station.id(), time_s);
                if watched.lines.is_multiple_of(SHOWN) {
                    println!("{} KiB, {line}", memory_kib(self.station.id()));
                }
                if time_s >= length_s && silent.is_empty() {
                    return watched;
                }
            }
        }
    }

    /// Ends all and compares the accounts, which may differ by so many unseen frames; returns how often the links were away.
    fn end(self, unseen: f64) -> u64 {
        let Self { bricks, relays, mut station } = self;
        for brick in bricks {
            brick.interrupt();
        }
        // What was on its way arrives, and the station tells of it once per second.
        for _ in 0..2 {
            station.wait_for("time ");
        }
        let reports =
            relays.map(|relay| serde_json::from_str::<Value>(&relay.interrupt()).expect("it prints one object"));
        station.wait_for("time ");
        let table = station.interrupt();
        println!("{table}");
        let mut differences = Vec::new();
        for (link, report) in reports.iter().enumerate() {
            println!("{report:#}");
            for source in ["1/1", "1/100"] {
                let frames = &report["to_station"]["frames"][source];
                let count = |key: &str| frames[key].as_u64().expect("there is such a count");
                let told = account(&table, link, source);
                let made =
                    FrameAccount { received: count("whole") + count("repeated"), lost: count("missing_between") };
                assert!(told.received > 0, "link {link} {source}");
                if !told.agrees(made, unseen, count("undatable")) {
                    differences.push(format!("link {link} {source}: {told:?}, not {made:?}"));
                }
            }
            for untaken in ["bytes_untaken", "chunks_dropped"] {
                assert_eq!(report["to_station"][untaken], 0, "link {link}");
            }
        }
        assert!(differences.is_empty(), "{differences:#?}");
        reports.iter().filter_map(|report| report["outages"].as_u64()).sum()
    }
}

impl ProcessUsage {
    fn record(&mut self, process: u32, time_s: f64) {
        let kib = memory_kib(process);
        self.lines += 1;
        if time_s < WARM_UP_S {
            return;
        }
        if self.settled_kib == 0 {
            self.settled_kib = kib;
        }
        self.highest_kib = self.highest_kib.max(kib);
    }
}

/// The station's frames and losses of one sender.
fn account(table: &str, link: usize, source: &str) -> FrameAccount {
    let link = link.to_string();
    let row = table
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>())
        .find(|row| row.starts_with(&["link", &link, source]))
        .expect("the sender has a row");
    let count = |column: usize| row[column].parse().expect("a count");
    FrameAccount { received: count(3), lost: count(4) }
}

fn seconds(text: &str) -> f64 {
    let number = text.split_whitespace().next().expect("a time");
    number.parse().expect("a number of seconds")
}

/// What a process keeps in memory.
fn memory_kib(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).expect("it runs");
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().nth(1));
    number.expect("the system tells").parse().expect("a number")
}

fn address(line: &str) -> String {
    let address = line.split("listening on ").nth(1).expect("it says where");
    address.trim().to_owned()
}
