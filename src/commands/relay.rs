//! `posebridge relay`: two real links, and between them a link as bad as one likes.
//!
//! What one end sends is offered to the model of a link ([`posebridge_sim::impairment`]) and handed to the other end when it has
//! arrived there. A datagram is one unit, and so is whatever one read of a stream brings; frames are looked for only to tell at the
//! end how many of each sender arrived whole. An outage
//! of the model is silence; the real links stay open. It never sends back what an end has sent, so the peers of one end do not
//! hear each other.

mod ends;
mod outbox;
mod report;

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_link::{HostTimer, Port, PortEvent};
use posebridge_recording::container::{FORMAT, Header};
use posebridge_sim::impairment::{End, FrameLedger, ImpairedLink, LinkEvent, LinkKind, LinkProfile};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, Span, Stamp};

pub use self::ends::RelayEnds;
use self::outbox::Outbox;
use self::report::{DirectionReport, Report};
use super::run::Signals;
use super::{Failure, Stage, station_link};
use crate::cli::{RelayArgs, StationLink};
use crate::config::{Config, LinkSection};
use crate::link_profile;
use crate::stderr::say;
use crate::stdout;
use crate::tasks::recorder::{Kept, Recorder};

/// How long a chunk that an end does not take waits before it is offered again: a timer's width.
const RETRY: Span = Span::from_millis(2);
/// What has arrived when the relay is stopped is still handed over, but not for longer than this.
const LAST_WORDS: Span = Span::from_millis(1_000);

/// Relays until Ctrl-C, `--duration`, or the end of a file that is played.
///
/// # Errors
/// The profile or a link makes no sense, or the recording cannot be written.
pub fn execute(args: &RelayArgs) -> Result<(), Failure> {
    let profile = link_profile::load(&args.impair).at_start()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().at_start()?;
    let result = runtime.block_on(relay(args, &profile));
    // An attempt to open a device that hangs must not keep the program alive.
    runtime.shutdown_background();
    result
}

async fn relay(args: &RelayArgs, profile: &LinkProfile) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let mut signals = Signals::listen().at_start()?;
    let brick = RealEnd::open("brick", &args.ends.brick, timer, profile.kind).await.at_start()?;
    let station = RealEnd::open("station", &args.ends.station, timer, profile.kind).await.at_start()?;
    let recorder = start_recorder(args, &timer).at_start()?;
    let start = timer.now();
    let mut relay = Relay {
        timer,
        brick,
        station,
        link: ImpairedLink::new(profile, args.seed, start),
        to_station: FrameLedger::new(),
        to_brick: FrameLedger::new(),
        outages: 0,
        told_up: false,
        recorder,
        recording_failure: None,
    };
    relay.record(start, Input::Link { link: TO_STATION, state: LinkState::Up });
    let end = args.duration.map(|duration| start + Span::from_secs_f64(duration));
    tokio::select! {
        () = relay.run(end) => {}
        () = signals.received() => {}
    }
    relay.hand_over_the_rest().await;
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
    let header = Header {
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
struct RealEnd {
    name: &'static str,
    port: Port,
    outbox: Outbox,
    /// Opened at least once.
    was_up: bool,
    /// A file that was played to its end.
    is_finished: bool,
}

impl RealEnd {
    async fn open(name: &'static str, flags: &StationLink, timer: HostTimer, kind: LinkKind) -> Result<Self> {
        let mut port = station_link::port(flags, timer).with_context(|| format!("{name} end"))?;
        let place = station_link::open(flags, &mut port).await?;
        say(&format!("{name} end {place}"));
        match (kind, port.is_datagram()) {
            (LinkKind::Stream, true) => say(&format!(
                "{name} end: the profile is for streams, so that a datagram may leave in pieces or lack bytes"
            )),
            (LinkKind::Datagram, false) => say(&format!(
                "{name} end: the profile is for datagrams, so that each read of this stream counts as one"
            )),
            (LinkKind::Stream, false) | (LinkKind::Datagram, true) => {}
        }
        Ok(Self { name, port, outbox: Outbox::default(), was_up: false, is_finished: false })
    }

    fn note(&mut self, event: &PortEvent) {
        match event {
            PortEvent::Up { detail, .. } => {
                self.was_up = true;
                say(&format!("{} end up: {detail}", self.name));
            }
            PortEvent::Down { reason, .. } => say(&format!("{} end DOWN: {reason}", self.name)),
            PortEvent::Finished { .. } => self.is_finished = true,
            PortEvent::Bytes { .. } => {}
        }
    }
}

/// Both real links with the model between them.
struct Relay {
    timer: HostTimer,
    brick: RealEnd,
    station: RealEnd,
    link: ImpairedLink,
    /// What became of the frames on their way to each end.
    to_station: FrameLedger,
    to_brick: FrameLedger,
    outages: u64,
    told_up: bool,
    recorder: Option<Recorder>,
    recording_failure: Option<anyhow::Error>,
}

impl Relay {
    async fn run(&mut self, end: Option<Stamp<HostClock>>) {
        loop {
            let retry = self.has_waiting().then(|| self.timer.now() + RETRY);
            let wake = [self.link.deadline(), end, retry].into_iter().flatten().min();
            let (from, event) = tokio::select! {
                event = self.brick.port.next() => (End::Brick, Some(event)),
                event = self.station.port.next() => (End::Station, Some(event)),
                () = sleep_until(self.timer, wake) => (End::Brick, None),
            };
            if let Some(event) = event {
                self.take(from, &event);
            }
            let now = self.timer.now();
            self.pass_to(now);
            if end.is_some_and(|end| now >= end) || self.is_played() {
                return;
            }
        }
    }

    fn take(&mut self, from: End, event: &PortEvent) {
        self.real(from).note(event);
        if let PortEvent::Bytes { arrival, bytes, .. } = event {
            let unit = self.link.offer(from, *arrival, bytes);
            self.ledger(from.other()).offer(*arrival, unit, bytes);
        }
        if !self.told_up && self.brick.was_up && self.station.was_up {
            self.told_up = true;
            say("relaying");
        }
    }

    /// Hands over what has arrived.
    fn pass_to(&mut self, now: Stamp<HostClock>) {
        while let Some(event) = self.link.poll(now) {
            match event {
                LinkEvent::Arrived { end, delivery } => {
                    let link = match end {
                        End::Station => TO_STATION,
                        End::Brick => TO_BRICK,
                    };
                    if self.recorder.is_some() {
                        let bytes = delivery.bytes.clone();
                        let peer = PeerId::default();
                        self.record(delivery.at, Input::Bytes { link, peer, bytes });
                    }
                    let real = self.real(end);
                    real.outbox.push(delivery.bytes, &mut real.port);
                }
                LinkEvent::Down { at } => {
                    self.outages += 1;
                    self.tell_state(at, LinkState::Down);
                }
                LinkEvent::Up { at } => self.tell_state(at, LinkState::Up),
            }
        }
        for end in [End::Brick, End::Station] {
            let real = self.real(end);
            real.outbox.flush(&mut real.port);
            let log = self.link.take_log(end);
            self.ledger(end).follow(&log);
        }
    }

    fn tell_state(&mut self, at: Stamp<HostClock>, state: LinkState) {
        say(match state {
            LinkState::Down => "the link between is DOWN",
            LinkState::Up => "the link between is up",
        });
        let link = TO_STATION;
        self.record(at, Input::Link { link, state });
    }

    fn record(&mut self, at: Stamp<HostClock>, input: Input) {
        let is_lost = self.recorder.as_mut().is_some_and(|recorder| recorder.record(at, input).is_err());
        if is_lost && let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
            tracing::error!(error = format!("{error:#}"), "the recording ends here");
            self.recording_failure = Some(error);
        }
    }

    const fn real(&mut self, end: End) -> &mut RealEnd {
        match end {
            End::Brick => &mut self.brick,
            End::Station => &mut self.station,
        }
    }

    /// The ledger of the frames that travel to an end.
    const fn ledger(&mut self, end: End) -> &mut FrameLedger {
        match end {
            End::Brick => &mut self.to_brick,
            End::Station => &mut self.to_station,
        }
    }

    /// Whether an end still has to take something.
    fn has_waiting(&self) -> bool {
        !self.brick.outbox.is_empty(&self.brick.port) || !self.station.outbox.is_empty(&self.station.port)
    }

    /// Whether a file has been played and nothing of it is left. What goes to the end of the file waits for nobody.
    fn is_played(&self) -> bool {
        let mut is_played = false;
        for (from, to, end) in [(&self.brick, &self.station, End::Station), (&self.station, &self.brick, End::Brick)] {
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
    async fn hand_over_the_rest(&mut self) {
        let end = self.timer.now() + LAST_WORDS;
        while self.has_waiting() && self.timer.now() < end {
            let retry = self.timer.now() + RETRY;
            tokio::select! {
                event = self.brick.port.next() => self.brick.note(&event),
                event = self.station.port.next() => self.station.note(&event),
                () = self.timer.sleep_until(retry) => {}
            }
            for real in [&mut self.brick, &mut self.station] {
                real.outbox.flush(&mut real.port);
            }
        }
    }

    fn finish(self, args: &RelayArgs, start: Stamp<HostClock>) -> Result<(), Failure> {
        let direction = |end: End, real: &RealEnd, ledger: &FrameLedger| DirectionReport {
            link: self.link.counters(end),
            frames: report::by_sender(ledger),
            bytes_untaken: real.outbox.untaken_bytes,
            chunks_dropped: real.port.counters().drops_out,
        };
        let report = Report {
            profile: args.impair.clone(),
            seed: args.seed,
            duration_s: (self.timer.now() - start).as_secs_f64(),
            outages: self.outages,
            to_station: direction(End::Station, &self.station, &self.to_station),
            to_brick: direction(End::Brick, &self.brick, &self.to_brick),
        };
        let text =
            if args.json { serde_json::to_string_pretty(&report).while_running()? + "\n" } else { report.table() };
        stdout::print(&text).while_running()?;
        let recorded = self.recorder.map(Recorder::finish).transpose();
        match self.recording_failure {
            Some(error) => Err(error),
            None => recorded.and_then(|kept| kept.map_or(Ok(()), Kept::whole)),
        }
        .context("the recording is not whole")
        .while_running()
    }
}

async fn sleep_until(timer: HostTimer, wake: Option<Stamp<HostClock>>) {
    match wake {
        Some(wake) => timer.sleep_until(wake).await,
        None => std::future::pending().await,
    }
}
