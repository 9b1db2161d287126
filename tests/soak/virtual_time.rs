//! A brick that drives its laps without end and a station, for a virtual day over the worst link there is: nothing leaks, every
//! outage is recovered from, and the station's account of its losses is that of the link's log to the frame.
//!
//! Every commit runs half an hour of virtual time; docs/soak.md tells of longer runs:
//!
//! ```text
//! POSEBRIDGE_SOAK_HOURS=24 POSEBRIDGE_SOAK_SEED=3 cargo test --release --test soak virtual_time -- --nocapture
//! ```

use std::collections::BTreeMap;

use crate::{FrameAccount, max_unseen};
use allocation_counter::{measure, opt_out};
use posebridge::config::Config;
use posebridge::station::event_collector::EventCollector;
use posebridge_protocol::framing::TransportKind;
use posebridge_sim::impairment::{
    FrameCounts, FrameLedger, ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile,
};
use posebridge_sim::{Scenario, Simulation};
use posebridge_station::Station;
use posebridge_telemetry::{
    Address, Event, HostClock, Input, LinkHealth, LinkId, LinkState, Output, PeerId, SourceHealth, TimeDelta, Timestamp,
};

/// Length of the run that every commit makes, hours of virtual time.
const SHORT_HOURS: f64 = 0.5;
/// Seed of the link; that of the world is the scenario's.
const SHORT_SEED: u64 = 3;
/// The most that is kept is compared with the most in this share of the run.
const SETTLED_SHARE: f64 = 0.1;
/// The accounts are compared this often, and at the end.
const CHECK_PERIOD: TimeDelta = TimeDelta::from_millis(600_000);
/// Frames may be on their way between the link and the accounts, and late ones wait for the next with a stamp; so many seconds in a row
/// the accounts may differ for that. The link can be away and stalled for 15 of them, several times in a row.
const PATIENCE: u32 = 60;
/// What is kept may grow by this share.
const GROWTH: f64 = 0.02;
/// Longest a sender may be silent: an outage of 5 s within stalls of 10 s that follow each other.
const LONGEST_SILENCE: TimeDelta = TimeDelta::from_millis(60_000);

const BRICK: Address = Address::new(1, 1);
const CAMERA: Address = Address::new(1, 100);
const STATION: Address = Address::new(1, 197);

#[test]
fn a_day_on_the_worst_link_leaks_nothing_and_every_lost_frame_is_known() {
    soak(&LinkProfile::bundled("harsh").expect("it is bundled"));
}

#[test]
fn a_day_of_datagrams_that_overtake_each_other_and_come_twice_leaks_nothing_either() {
    let text = include_str!("../data/harsh-datagrams.toml");
    soak(&LinkProfile::from_toml(text).expect("it makes sense"));
}

fn soak(profile: &LinkProfile) {
    let hours: f64 = from_environment("POSEBRIDGE_SOAK_HOURS").unwrap_or(SHORT_HOURS);
    let seed = from_environment("POSEBRIDGE_SOAK_SEED").unwrap_or(SHORT_SEED);
    let end = Timestamp::from_secs_f64(hours * 3_600.0);
    let mut soak = Soak::new(profile, seed);
    let settled = Timestamp::from_secs_f64(hours * 3_600.0 * SETTLED_SHARE);
    let (mut settled_bytes, mut highest_bytes) = (0, 0);
    let mut until = Timestamp::ZERO;
    while until < end {
        until = end.min(until + CHECK_PERIOD);
        soak.run_until(until);
        soak.compare();
        highest_bytes = highest_bytes.max(soak.kept_bytes);
        if settled_bytes == 0 || until <= settled {
            settled_bytes = highest_bytes;
        }
        println!("{:8.0} s  {}", until.as_secs_f64(), soak.summary());
    }
    let growth = highest_bytes as f64 / settled_bytes as f64 - 1.0;
    println!(
        "the station kept {settled_bytes} bytes at most in the first tenth, {highest_bytes} in all: {:+.2} %",
        growth * 100.0
    );
    assert!(growth <= GROWTH, "{growth}");
    soak.check_the_conversation();
}

/// What the caller wishes otherwise.
fn from_environment<T: std::str::FromStr<Err: std::fmt::Debug>>(variable: &str) -> Option<T> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().expect("a number"))
}

/// Brick, link and station with nothing but counts.
struct Soak {
    id: LinkId,
    now: Timestamp<HostClock>,
    station: Station,
    simulation: Simulation,
    link: ImpairedLink,
    to_station: FrameLedger,
    to_brick: FrameLedger,
    /// What a live run keeps for its tables.
    collector: EventCollector,
    /// Live bytes of station and collector.
    kept_bytes: i64,
    totals: StationTotals,
    outages: OutageCounts,
    /// Seconds at which the two accounts were equal and not.
    equal: u64,
    unequal: u64,
    unequal_in_a_row: u32,
}

/// What the station has reported: the latest, or counts.
#[derive(Default)]
struct StationTotals {
    health: LinkHealth,
    sources: Vec<SourceHealth>,
    estimates: u64,
    alignments: u64,
    restarts: u64,
    last_estimate: Option<Timestamp<HostClock>>,
    longest_silence: TimeDelta,
}

/// How the outages went.
#[derive(Debug, Default)]
struct OutageCounts {
    begun: u64,
    recovered: u64,
    /// The next one came before anything else.
    cut_short: u64,
    is_pending: bool,
}

impl Soak {
    fn new(profile: &LinkProfile, seed: u64) -> Self {
        let scenario = Scenario::bundled("square").expect("it is bundled").with_laps(10_000);
        let mut config = Config::default().with_camera_of(&scenario).station_config().expect("the default makes sense");
        if let Some(link) = config.links.first_mut() {
            link.framing = match profile.kind {
                LinkKind::Stream => TransportKind::Stream,
                LinkKind::Datagram => TransportKind::Datagram,
            };
        }
        let mut started = None;
        let made = measure(|| {
            let config = config.clone();
            let station = Station::new(config, Timestamp::ZERO).expect("the default makes sense");
            started = Some((station, EventCollector::live()));
        });
        let (station, collector) = started.expect("it was made");
        let mut soak = Self {
            id: config.links.first().map_or(LinkId(0), |link| link.id),
            now: Timestamp::ZERO,
            station,
            simulation: Simulation::new(scenario).without_history(),
            link: ImpairedLink::new(profile, seed, Timestamp::ZERO),
            to_station: FrameLedger::new(),
            to_brick: FrameLedger::new(),
            collector,
            kept_bytes: made.bytes_current,
            totals: StationTotals::default(),
            outages: OutageCounts::default(),
            equal: 0,
            unequal: 0,
            unequal_in_a_row: 0,
        };
        soak.set_link_state(Timestamp::ZERO, LinkState::Up);
        soak
    }

    fn run_until(&mut self, until: Timestamp<HostClock>) {
        while self.now < until {
            self.simulation.step();
            self.now = Timestamp::ZERO + self.simulation.elapsed();
            self.pass_to(self.now);
            while let Some(bytes) = self.simulation.poll() {
                let unit = self.link.offer(LinkEnd::Brick, self.now, &bytes);
                self.to_station.offer(self.now, unit, &bytes);
                self.pass_to(self.now);
            }
            let is_due = |due: Timestamp<HostClock>| due <= self.now;
            if self.station.deadline().is_some_and(is_due) {
                self.handle(self.now, &Input::Tick);
                self.pass_to(self.now);
            }
        }
    }

    fn pass_to(&mut self, now: Timestamp<HostClock>) {
        while let Some(at) = self.link.deadline().filter(|at| *at <= now) {
            while let Some(event) = self.link.poll(at) {
                self.on_link_event(event);
            }
        }
        self.to_station.apply_log(&self.link.take_log(LinkEnd::Station));
        self.to_brick.apply_log(&self.link.take_log(LinkEnd::Brick));
    }

    fn on_link_event(&mut self, event: ImpairedLinkEvent) {
        match event {
            ImpairedLinkEvent::Arrived { end: LinkEnd::Brick, delivery } => self.simulation.receive(&delivery.bytes),
            ImpairedLinkEvent::Arrived { end: LinkEnd::Station, delivery } => {
                if std::mem::take(&mut self.outages.is_pending) {
                    self.outages.recovered += 1;
                }
                let (link, peer, bytes) = (self.id, PeerId::default(), delivery.bytes);
                self.handle(delivery.at, &Input::Bytes { link, peer, bytes });
            }
            ImpairedLinkEvent::Down { at } => {
                self.outages.begun += 1;
                if std::mem::replace(&mut self.outages.is_pending, true) {
                    self.outages.cut_short += 1;
                }
                self.set_link_state(at, LinkState::Down);
            }
            ImpairedLinkEvent::Up { at } => self.set_link_state(at, LinkState::Up),
        }
    }

    fn set_link_state(&mut self, at: Timestamp<HostClock>, state: LinkState) {
        let link = self.id;
        self.handle(at, &Input::Link { link, state });
    }

    fn handle(&mut self, at: Timestamp<HostClock>, input: &Input) {
        let change = measure(|| {
            self.station.handle(at, input);
            while let Some(output) = self.station.poll() {
                match output {
                    // The link and the test itself keep what is theirs.
                    Output::Transmit { bytes, .. } => opt_out(|| {
                        let unit = self.link.offer(LinkEnd::Station, at, &bytes);
                        self.to_brick.offer(at, unit, &bytes);
                    }),
                    Output::Event(event) => {
                        self.collector.on_event(&event);
                        opt_out(|| self.on_event(at, &event));
                    }
                    Output::Request(request) => panic!("nobody asked for {request:?}"),
                }
            }
        });
        self.kept_bytes += change.bytes_current;
    }

    fn on_event(&mut self, at: Timestamp<HostClock>, event: &Event) {
        self.totals.on_event(at, event);
        if matches!(event, Event::Health { .. }) {
            // What has arrived in this very millisecond is not in the log's account yet.
            self.to_station.apply_log(&self.link.take_log(LinkEnd::Station));
            self.to_brick.apply_log(&self.link.take_log(LinkEnd::Brick));
            let is_equal = self.differences().is_empty();
            self.equal += u64::from(is_equal);
            self.unequal += u64::from(!is_equal);
            self.unequal_in_a_row = if is_equal { 0 } else { self.unequal_in_a_row + 1 };
            assert!(self.unequal_in_a_row <= PATIENCE, "{at:?}: {}", self.differences().join("\n"));
        }
    }

    /// Where the station's account differs from the log's.
    fn differences(&self) -> Vec<String> {
        let truth: BTreeMap<Address, FrameCounts> = self.to_station.counts().collect();
        let mut differences = Vec::new();
        for source in [BRICK, CAMERA] {
            let said = self.totals.sources.iter().find(|said| said.source == source);
            let totals =
                said.map_or(FrameAccount::default(), |said| FrameAccount { received: said.frames, lost: said.lost });
            let counts = truth.get(&source).copied().unwrap_or_default();
            let made = FrameAccount { received: counts.whole + counts.repeated, lost: counts.missing_between };
            let unseen = max_unseen(self.now.as_secs_f64() / 3_600.0);
            let is_equal = totals.agrees(made, unseen, counts.undatable);
            if !is_equal {
                differences.push(format!("{source}: told {totals:?}; {counts:?}"));
            }
        }
        differences
    }

    /// The two accounts are equal now, or as soon as what is on its way has come.
    fn compare(&mut self) {
        for _ in 0..PATIENCE {
            if self.unequal_in_a_row == 0 {
                return;
            }
            self.run_until(self.now + TimeDelta::from_millis(1_000));
        }
        assert_eq!(self.unequal_in_a_row, 0, "{:?}", self.differences());
    }

    /// The other direction, the clocks and the outages.
    fn check_the_conversation(&self) {
        let truth: BTreeMap<Address, FrameCounts> = self.to_brick.counts().collect();
        let counts = truth.get(&STATION).copied().unwrap_or_default();
        println!("to the brick: {counts:?}, it heard {:?}", self.simulation.receive_counters());
        assert_eq!(truth.len(), 1, "nobody else speaks there");
        assert!(counts.sent >= self.totals.health.frames_out);
        assert!(counts.lost > 0);
        // One may wait behind a torn one for the brick's next bytes.
        let came = counts.whole + counts.repeated;
        let heard = self.simulation.receive_counters().frames;
        assert!(came <= heard + 1, "{came} {heard}");
        let formed = heard.saturating_sub(came);
        assert!(formed as f64 <= max_unseen(self.now.as_secs_f64() / 3_600.0));
        let OutageCounts { begun, recovered, cut_short, is_pending } = self.outages;
        assert!(begun > 0);
        assert_eq!(recovered + cut_short + u64::from(is_pending), begun);
        assert!(cut_short * 10 < begun, "{cut_short} of {begun}");
        assert_eq!(self.totals.restarts, 0);
        assert!(self.totals.longest_silence < LONGEST_SILENCE);
        assert!(self.equal > 10 * self.unequal, "{}", self.summary());
    }

    /// Where a run stands, for a person who waits for it.
    fn summary(&self) -> String {
        let counts: Vec<_> = self.to_station.counts().collect();
        let silence_s = self.totals.longest_silence.as_secs_f64();
        format!(
            "{counts:?}; {} bytes, {} estimates, {} alignments, silent for {silence_s:.1} s at most; {:?}; equal in {} of {} s",
            self.kept_bytes,
            self.totals.estimates,
            self.totals.alignments,
            self.outages,
            self.equal,
            self.equal + self.unequal,
        )
    }
}

impl StationTotals {
    fn on_event(&mut self, at: Timestamp<HostClock>, event: &Event) {
        match event {
            Event::Health { health, sources, .. } => {
                self.health = *health;
                self.sources.clone_from(sources);
            }
            Event::EstimateUpdated { estimate, .. } => {
                assert!(estimate.pose.x.0.is_finite() && estimate.pose.heading.rad().is_finite());
                self.estimates += 1;
                let before = self.last_estimate.replace(at).unwrap_or(at);
                self.longest_silence = self.longest_silence.max(at - before);
            }
            Event::BrickClockAligned { .. } => self.alignments += 1,
            Event::BrickRestarted { .. } => self.restarts += 1,
            _ => {}
        }
    }
}
