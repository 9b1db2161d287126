//! `posebridge relay`: two real links, and between them a link as bad as one likes.
//!
//! What one end sends is offered to the model of a link ([`posebridge_sim::impairment`]) and handed to the other end when it has
//! arrived there. A datagram is one unit, and so is whatever one read of a stream brings; frames are decoded only to report at
//! the end how many of each sender arrived complete. An outage of the model is silence; the real links stay open. It never sends
//! back what an end has sent, so the peers of one end do not receive each other's frames.

mod ends;
mod outbox;
mod report;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use posebridge_link::{HostTimer, Link, LinkEvent};
use posebridge_recording::container::{FORMAT, RecordingHeader};
use posebridge_sim::impairment::{FrameLedger, ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, TimeDelta, Timestamp};

pub use self::ends::RelayEnds;
use self::outbox::RelayQueue;
use self::report::{DirectionReport, RelayReport};
use super::link_profile;
use super::station_link;
use crate::config::{Config, LinkSection};
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};
use crate::flags::{StationLink, positive};
use crate::station::recorder::{Recorder, RecordingTotals};
use crate::station::signals::Signals;

/// Flags of `relay`.
#[derive(Args, Clone, Debug)]
pub struct RelayArgs {
    /// Both links.
    #[command(flatten)]
    pub ends: RelayEnds,
    /// What the link between them is like: a bundled profile's name or a TOML file (docs/impairment.md).
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    pub impair: String,
    /// Seed of its randomness.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Record what reached the station (link 0) and the brick (link 1); `posebridge replay` estimates from the former.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub duration: Option<f64>,
    /// Print one JSON object at the end instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// How long a chunk that an end does not take waits before it is offered again: a timer's width.
const RETRY_PERIOD: TimeDelta = TimeDelta::from_millis(2);
/// What has arrived when the relay is stopped is still handed over, but not for longer than this.
const DRAIN_TIMEOUT: TimeDelta = TimeDelta::from_millis(1_000);

/// Relays until Ctrl-C, `--duration`, or the end of a file that is played.
///
/// # Errors
/// The profile or a link makes no sense, or the recording cannot be written.
pub fn execute(args: &RelayArgs) -> Result<(), Failure> {
    let profile = link_profile::load(&args.impair).before_start()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().before_start()?;
    let result = runtime.block_on(relay(args, &profile));
    // An attempt to open a device that hangs must not keep the program alive.
    runtime.shutdown_background();
    result
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

/// The link of the recording that holds what reached the station: a replay estimates what a station there would have.
const TO_STATION: LinkId = LinkId(0);
/// The link of the recording that holds what reached the brick.
const TO_BRICK: LinkId = LinkId(1);

fn start_recorder(args: &RelayArgs, timer: &HostTimer) -> Result<Option<Recorder>> {
    let Some(path) = &args.record else {
        return Ok(None);
    };
    let urls = [&args.ends.brick, &args.ends.station].map(|end| url_of(end).to_owned());
    let config = Config { links: urls.iter().take(1).map(|url| LinkSection::new(url)).collect(), ..Config::default() };
    let header = RecordingHeader {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros: timer.utc_start(),
        config_toml: toml::to_string(&config).context("writing the configuration into the recording")?,
        links: urls.to_vec(),
    };
    Recorder::start(Path::new(path), &header).map(Some)
}

fn url_of(end: &StationLink) -> &str {
    end.listen.as_deref().or(end.link.as_deref()).unwrap_or_default()
}

/// A real link at one end.
struct RelayEndpoint {
    name: &'static str,
    port: Link,
    outbox: RelayQueue,
    /// Opened at least once.
    was_up: bool,
    /// A file that was played to its end.
    is_finished: bool,
}

impl RelayEndpoint {
    async fn open(name: &'static str, flags: &StationLink, timer: HostTimer, kind: LinkKind) -> Result<Self> {
        let mut port = station_link::port(flags, timer).with_context(|| format!("{name} end"))?;
        let place = station_link::open(flags, &mut port).await?;
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
    /// What became of the frames on their way to each end.
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

    /// Hands over what has arrived.
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
        let is_lost = self.recorder.as_mut().is_some_and(|recorder| recorder.record(at, input).is_err());
        if is_lost && let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
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

    /// The ledger of the frames that travel to an end.
    const fn ledger_mut(&mut self, end: LinkEnd) -> &mut FrameLedger {
        match end {
            LinkEnd::Brick => &mut self.to_brick,
            LinkEnd::Station => &mut self.to_station,
        }
    }

    /// Whether an end still has to take something.
    fn has_waiting(&self) -> bool {
        !self.brick.outbox.is_empty(&self.brick.port) || !self.station.outbox.is_empty(&self.station.port)
    }

    /// Whether a file has been played and nothing of it is left. A file that is appended to has no backlog.
    fn is_played(&self) -> bool {
        let mut is_played = false;
        for (from, to, end) in
            [(&self.brick, &self.station, LinkEnd::Station), (&self.station, &self.brick, LinkEnd::Brick)]
        {
            if !from.is_finished {
                continue;
            }
            is_played = true;
            let on_the_way = self.link.counters(end).bytes_on_the_way;
            if on_the_way > 0 || !to.outbox.is_empty(&to.port) {
                return false;
            }
        }
        is_played
    }

    /// What has arrived goes out; what is on the way stays there, and nothing is taken in any more.
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
            frames: report::by_sender(ledger),
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
