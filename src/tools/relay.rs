//! `posebridge relay`: connects two real links through an impaired one ([`posebridge_sim::impairment`]). A datagram is one unit, and so
//! is one read of a stream; frames are decoded only for the final report. An outage of the model is silence; the real links stay open.
//! An end never gets its own data back, so the peers of one end do not receive each other's frames.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkUrl};
use posebridge_recording::container::RecordingHeader;
use posebridge_sim::impairment::{
    Counters, FrameCounts, FrameLedger, ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile,
};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, TimeDelta, Timestamp};
use serde::Serialize;

use crate::config::{Config, LinkSection, RecordingLimits, load_link_profile};
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure, Signals};
use crate::flags::{LinkFlag, links_in_order, positive};
use crate::runtime::run_in_runtime;
use crate::station::recorder::{Recorder, RecordingTotals};
use crate::station::recording_files::header;

/// Flags of `relay`.
#[derive(Args, Clone, Debug)]
pub struct RelayArgs {
    /// Both links.
    #[command(flatten)]
    pub ends: RelayEnds,
    /// Link profile: a bundled one by name, or a TOML file (docs/impairment.md).
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    pub impair: String,
    /// Seed of the random impairments.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Record the bytes that reached the station (link 0) and the robot (link 1); `posebridge replay` uses link 0.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Stop after this number of seconds.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub duration: Option<f64>,
    /// At the end, print one JSON object instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// The two ends, connecting or listening, in the order of the command line: a profile distinguishes the brick's end from the station's.
#[derive(Clone, Debug)]
pub struct RelayEnds {
    pub brick: LinkFlag,
    pub station: LinkFlag,
}

const DIAL: &str = "url";
const LISTEN: &str = "listen";

impl Args for RelayEnds {
    fn augment_args(command: Command) -> Command {
        let link =
            |id: &'static str, help: &'static str| Arg::new(id).value_name("URL").action(ArgAction::Append).help(help);
        command.args([
            link(DIAL, "Connect to this link. The first link goes to the robot, the second to the station")
                .num_args(0..),
            link(LISTEN, "Wait for a connection on this link. It counts at its position among the links").long(LISTEN),
        ])
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for RelayEnds {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let ends = links_in_order(matches, [(DIAL, ConnectRole::Dial), (LISTEN, ConnectRole::Listen)]);
        let count = ends.len();
        let ends = <[LinkFlag; 2]>::try_from(ends).map_err(|_other_count| {
            let message = format!(
                "a relay has two ends and was given {count}: URL calls a link, --listen URL waits on one; \
                 the brick's end comes first\n"
            );
            clap::Error::raw(ErrorKind::WrongNumberOfValues, message)
        })?;
        let [brick, station] = ends;
        Ok(Self { brick, station })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// Retry period of a chunk that an end does not accept: the resolution of a timer.
const RETRY_PERIOD: TimeDelta = TimeDelta::from_millis(2);
/// Limit of the time for delivering arrived data when the relay is stopped.
const DRAIN_TIMEOUT: TimeDelta = TimeDelta::from_millis(1_000);

/// Runs until Ctrl-C, `--duration`, or the end of a played file.
pub fn execute(args: &RelayArgs) -> Result<(), Failure> {
    let profile = load_link_profile(&args.impair).before_start()?;
    run_in_runtime(relay(args, &profile)).before_start()?
}

async fn relay(args: &RelayArgs, profile: &LinkProfile) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let mut signals = Signals::listen().before_start()?;
    let brick = RelayEndpoint::open("brick", &args.ends.brick, timer, profile.kind).await.before_start()?;
    let station = RelayEndpoint::open("station", &args.ends.station, timer, profile.kind).await.before_start()?;
    let recorder = start_recorder(args, &timer).before_start()?;
    let start = timer.now();
    let mut relay = Relay {
        timer,
        brick,
        station,
        link: ImpairedLink::new(profile, args.seed, start),
        to_station: FrameLedger::new(),
        to_brick: FrameLedger::new(),
        outages: 0,
        reported_up: false,
        recorder,
        recording_failure: None,
    };
    relay.record(start, Input::Link { link: TO_STATION, state: LinkState::Up });
    let end = args.duration.map(|duration| start + TimeDelta::from_secs_f64(duration));
    tokio::select! {
        () = relay.run(end) => {}
        () = signals.received() => {}
    }
    relay.flush_remaining().await;
    relay.finish(args, start)
}

/// Link id of the data to the station in the recording, so that a replay estimates what a station there would.
const TO_STATION: LinkId = LinkId(0);
/// Link id of the data to the brick in the recording.
const TO_BRICK: LinkId = LinkId(1);

fn start_recorder(args: &RelayArgs, timer: &HostTimer) -> Result<Option<Recorder>> {
    let Some(path) = &args.record else {
        return Ok(None);
    };
    let urls = [args.ends.brick.url.clone(), args.ends.station.url.clone()];
    let config = Config { links: urls.iter().take(1).map(|url| LinkSection::new(url)).collect(), ..Config::default() };
    let header = RecordingHeader { links: urls.to_vec(), ..header(&config, timer.utc_start())? };
    Recorder::start(path, &header, RecordingLimits::default()).map(Some)
}

struct RelayEndpoint {
    name: &'static str,
    port: Link,
    outbox: RelayQueue,
    was_up: bool,
    is_finished: bool,
}

impl RelayEndpoint {
    async fn open(name: &'static str, flag: &LinkFlag, timer: HostTimer, kind: LinkKind) -> Result<Self> {
        LinkUrl::parse(&flag.url).map(drop).with_context(|| format!("{name} end"))?;
        let (port, place) = flag.open(timer).await?;
        print_line(&format!("{name} end {place}"));
        match (kind, port.is_datagram()) {
            (LinkKind::Stream, true) => print_line(&format!(
                "{name} end: the profile is for streams, so that a datagram may leave in pieces or lack bytes"
            )),
            (LinkKind::Datagram, false) => print_line(&format!(
                "{name} end: the profile is for datagrams, so that each read of this stream counts as one"
            )),
            (LinkKind::Stream, false) | (LinkKind::Datagram, true) => {}
        }
        Ok(Self { name, port, outbox: RelayQueue::default(), was_up: false, is_finished: false })
    }

    fn on_link_event(&mut self, event: &LinkEvent) {
        match event {
            LinkEvent::Up { detail, .. } => {
                self.was_up = true;
                print_line(&format!("{} end up: {detail}", self.name));
            }
            LinkEvent::Down { reason, .. } => print_line(&format!("{} end DOWN: {reason}", self.name)),
            LinkEvent::Finished { .. } => self.is_finished = true,
            LinkEvent::Bytes { .. } => {}
        }
    }
}

/// Both real links with the model between them.
struct Relay {
    timer: HostTimer,
    brick: RelayEndpoint,
    station: RelayEndpoint,
    link: ImpairedLink,
    /// Outcome of the frames on their way to each end.
    to_station: FrameLedger,
    to_brick: FrameLedger,
    outages: u64,
    reported_up: bool,
    recorder: Option<Recorder>,
    recording_failure: Option<anyhow::Error>,
}

impl Relay {
    async fn run(&mut self, end: Option<Timestamp<HostClock>>) {
        loop {
            let retry = self.has_waiting().then(|| self.timer.now() + RETRY_PERIOD);
            let wake = [self.link.deadline(), end, retry].into_iter().flatten().min();
            let (from, event) = tokio::select! {
                event = self.brick.port.next_event() => (LinkEnd::Brick, Some(event)),
                event = self.station.port.next_event() => (LinkEnd::Station, Some(event)),
                () = sleep_until(self.timer, wake) => (LinkEnd::Brick, None),
            };
            if let Some(event) = event {
                self.on_link_event(from, &event);
            }
            let now = self.timer.now();
            self.advance_to(now);
            if end.is_some_and(|end| now >= end) || self.is_played() {
                return;
            }
        }
    }

    fn on_link_event(&mut self, from: LinkEnd, event: &LinkEvent) {
        self.endpoint_mut(from).on_link_event(event);
        if let LinkEvent::Bytes { arrival, bytes, .. } = event {
            let unit = self.link.offer(from, *arrival, bytes);
            self.ledger_mut(from.other()).offer(*arrival, unit, bytes);
        }
        if !self.reported_up && self.brick.was_up && self.station.was_up {
            self.reported_up = true;
            print_line("relaying");
        }
    }

    fn advance_to(&mut self, now: Timestamp<HostClock>) {
        while let Some(event) = self.link.poll(now) {
            match event {
                ImpairedLinkEvent::Arrived { end, delivery } => {
                    let link = match end {
                        LinkEnd::Station => TO_STATION,
                        LinkEnd::Brick => TO_BRICK,
                    };
                    if self.recorder.is_some() {
                        let bytes = delivery.bytes.clone();
                        let peer = PeerId::default();
                        self.record(delivery.at, Input::Bytes { link, peer, bytes });
                    }
                    let real = self.endpoint_mut(end);
                    real.outbox.push(delivery.bytes, &mut real.port);
                }
                ImpairedLinkEvent::Down { at } => {
                    self.outages += 1;
                    self.report_link_state(at, LinkState::Down);
                }
                ImpairedLinkEvent::Up { at } => self.report_link_state(at, LinkState::Up),
            }
        }
        for end in [LinkEnd::Brick, LinkEnd::Station] {
            let real = self.endpoint_mut(end);
            real.outbox.flush(&mut real.port);
            let log = self.link.take_log(end);
            self.ledger_mut(end).apply_log(&log);
        }
    }

    fn report_link_state(&mut self, at: Timestamp<HostClock>, state: LinkState) {
        print_line(match state {
            LinkState::Down => "the link between is DOWN",
            LinkState::Up => "the link between is up",
        });
        let link = TO_STATION;
        self.record(at, Input::Link { link, state });
    }

    fn record(&mut self, at: Timestamp<HostClock>, input: Input) {
        let has_failed = self.recorder.as_mut().is_some_and(|recorder| recorder.record(at, input).is_err());
        if has_failed && let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
            tracing::error!(error = format!("{error:#}"), "the recording ends here");
            self.recording_failure = Some(error);
        }
    }

    const fn endpoint_mut(&mut self, end: LinkEnd) -> &mut RelayEndpoint {
        match end {
            LinkEnd::Brick => &mut self.brick,
            LinkEnd::Station => &mut self.station,
        }
    }

    /// Frames that travel to `end`.
    const fn ledger_mut(&mut self, end: LinkEnd) -> &mut FrameLedger {
        match end {
            LinkEnd::Brick => &mut self.to_brick,
            LinkEnd::Station => &mut self.to_station,
        }
    }

    fn has_waiting(&self) -> bool {
        !self.brick.outbox.is_empty(&self.brick.port) || !self.station.outbox.is_empty(&self.station.port)
    }

    /// Whether a file was played completely. False for a file that is still appended to.
    fn is_played(&self) -> bool {
        let mut is_played = false;
        for (from, to, end) in
            [(&self.brick, &self.station, LinkEnd::Station), (&self.station, &self.brick, LinkEnd::Brick)]
        {
            if !from.is_finished {
                continue;
            }
            is_played = true;
            let in_transit = self.link.counters(end).bytes_on_the_way;
            if in_transit > 0 || !to.outbox.is_empty(&to.port) {
                return false;
            }
        }
        is_played
    }

    /// Delivers arrived data; drops data in transit and reads no more.
    async fn flush_remaining(&mut self) {
        let end = self.timer.now() + DRAIN_TIMEOUT;
        while self.has_waiting() && self.timer.now() < end {
            let retry = self.timer.now() + RETRY_PERIOD;
            tokio::select! {
                event = self.brick.port.next_event() => self.brick.on_link_event(&event),
                event = self.station.port.next_event() => self.station.on_link_event(&event),
                () = self.timer.sleep_until(retry) => {}
            }
            for real in [&mut self.brick, &mut self.station] {
                real.outbox.flush(&mut real.port);
            }
        }
    }

    fn finish(self, args: &RelayArgs, start: Timestamp<HostClock>) -> Result<(), Failure> {
        let direction = |end: LinkEnd, real: &RelayEndpoint, ledger: &FrameLedger| DirectionReport {
            link: self.link.counters(end),
            frames: ledger.counts().map(|(source, counts)| (source.to_string(), counts)).collect(),
            bytes_untaken: real.outbox.untaken_bytes,
            chunks_dropped: real.port.counters().drops_out,
        };
        let report = RelayReport {
            profile: args.impair.clone(),
            seed: args.seed,
            duration_s: (self.timer.now() - start).as_secs_f64(),
            outages: self.outages,
            to_station: direction(LinkEnd::Station, &self.station, &self.to_station),
            to_brick: direction(LinkEnd::Brick, &self.brick, &self.to_brick),
        };
        let text =
            if args.json { serde_json::to_string_pretty(&report).while_running()? + "\n" } else { report.table() };
        print_result(&text).while_running()?;
        let recorded = self.recorder.map(Recorder::finish).transpose();
        match self.recording_failure {
            Some(error) => Err(error),
            None => recorded.and_then(|kept| kept.map_or(Ok(()), RecordingTotals::check_complete)),
        }
        .context("the recording is not whole")
        .while_running()
    }
}

async fn sleep_until(timer: HostTimer, wake: Option<Timestamp<HostClock>>) {
    match wake {
        Some(wake) => timer.sleep_until(wake).await,
        None => std::future::pending().await,
    }
}

/// Bound of the queued bytes; on overflow they are dropped and counted.
const CAPACITY_BYTES: usize = 16 * 1024 * 1024;

#[derive(Debug, Default)]
struct RelayQueue {
    chunks: VecDeque<Vec<u8>>,
    bytes: usize,
    /// Undelivered bytes: the end was closed, or too slow for too long.
    untaken_bytes: u64,
}

impl RelayQueue {
    /// Queues a chunk, then sends what the port accepts.
    fn push(&mut self, chunk: Vec<u8>, port: &mut Link) {
        if self.bytes + chunk.len() > CAPACITY_BYTES {
            self.untaken_bytes += chunk.len() as u64;
            return;
        }
        self.bytes += chunk.len();
        self.chunks.push_back(chunk);
        self.flush(port);
    }

    /// Sends what the port accepts.
    fn flush(&mut self, port: &mut Link) {
        while port.port_counts().queued_frames == 0 {
            let Some(chunk) = self.chunks.pop_front() else {
                return;
            };
            self.bytes -= chunk.len();
            if port.is_up() {
                port.send(&chunk);
            } else {
                self.untaken_bytes += chunk.len() as u64;
            }
        }
    }

    /// Whether neither this queue nor the port's holds data.
    fn is_empty(&self, port: &Link) -> bool {
        self.chunks.is_empty() && port.port_counts().queued_frames == 0
    }
}

#[derive(Clone, Debug, Serialize)]
struct RelayReport {
    profile: String,
    seed: u64,
    duration_s: f64,
    outages: u64,
    to_station: DirectionReport,
    to_brick: DirectionReport,
}

#[derive(Clone, Debug, Serialize)]
struct DirectionReport {
    #[serde(flatten)]
    link: Counters,
    /// Delivered bytes that the real end did not accept: it was closed, or too slow.
    bytes_untaken: u64,
    /// Chunks that the real end's port dropped.
    chunks_dropped: u64,
    /// By sender, `system/component`.
    frames: BTreeMap<String, FrameCounts>,
}

impl RelayReport {
    fn table(&self) -> String {
        let mut text = format!(
            "link {}, seed {}, {:.1} s, {} outages\n\n{:<34}{:>14}{:>14}\n",
            self.profile, self.seed, self.duration_s, self.outages, "", "to station", "to brick"
        );
        let (station, brick) = (&self.to_station, &self.to_brick);
        for ((name, to_station), (_, to_brick)) in rows(station).into_iter().zip(rows(brick)) {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{name:<34}{to_station:>14}{to_brick:>14}");
        }
        for (end, direction) in [("station", station), ("brick", brick)] {
            for (source, frames) in &direction.frames {
                let FrameCounts { sent, whole, lost, .. } = frames;
                let _ =
                    writeln!(text, "frames of {source} to the {end}: {sent} sent, {whole} arrived whole, {lost} lost");
            }
        }
        text
    }
}

fn rows(direction: &DirectionReport) -> [(&'static str, u64); 16] {
    let link = direction.link;
    [
        ("units offered", link.units_offered),
        ("bytes offered", link.bytes_offered),
        ("bytes delivered", link.bytes_delivered),
        ("bytes on the way at the end", link.bytes_on_the_way),
        ("bytes lost to a full buffer", link.bytes_lost_to_full_buffer),
        ("bytes of units lost whole", link.bytes_lost_alone),
        ("bytes lost in bursts", link.bytes_lost_in_bursts),
        ("single bytes missing", link.bytes_missing),
        ("bytes lost to outages", link.bytes_lost_to_outages),
        ("bits turned over", link.bits_flipped),
        ("stalls", link.stalls),
        ("datagrams held back", link.held_back),
        ("datagrams repeated", link.repeated),
        ("chunks delivered", link.chunks_delivered),
        ("bytes that the end did not take", direction.bytes_untaken),
        ("chunks that its port dropped", direction.chunks_dropped),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(words: &[&str]) -> Result<RelayEnds, clap::Error> {
        let matches = RelayEnds::augment_args(Command::new("relay")).try_get_matches_from(words)?;
        RelayEnds::from_arg_matches(&matches)
    }

    #[test]
    fn the_first_link_is_the_bricks_however_it_is_opened() {
        let ends = parse(&["relay", "--listen", "tcp://:1", "udp://host:2"]).unwrap();
        assert_eq!((ends.brick.url.as_str(), ends.brick.role), ("tcp://:1", ConnectRole::Listen));
        assert_eq!((ends.station.url.as_str(), ends.station.role), ("udp://host:2", ConnectRole::Dial));
        let ends = parse(&["relay", "serial:/dev/ttyUSB0", "--listen", "tcp://:1"]).unwrap();
        assert_eq!(ends.brick.role, ConnectRole::Dial);
        assert_eq!(ends.station.role, ConnectRole::Listen);
    }

    #[test]
    fn one_end_or_three_are_refused() {
        for words in [&["relay", "udp://:1"][..], &["relay", "a", "b", "--listen", "c"]] {
            assert!(parse(words).is_err(), "{words:?}");
        }
    }
}
