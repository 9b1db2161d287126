//! The loop that owns a pipeline and its ports: bytes in, reply out, in one wake-up.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use posebridge_link::{Alarm, HostTimer, Outgoing, PortEvent, PortSet};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::TruthSample;
use posebridge_telemetry::{Event, HostClock, Input, LinkId, LinkState, Output, Priority, Span, Stamp};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::calendar::CalendarWatch;
use super::dashboard::{Outlet, next_command, standing_of};
use super::desk::{Desk, WARNING};
use super::observer::Observer;
use super::recorder::Recorder;
use super::tlog_recorder::TlogRecorder;
use super::truth_tap::TruthTap;
use crate::failures::Failures;
use crate::signing::Keeper;

/// How often the pipeline is told what its ports have counted: as often as it tells of its links' health.
const COUNTS_PERIOD: Span = Span::from_millis(1_000);

/// An observation makes three events: it came, it was fused, this is the estimate.
const USUAL_EVENTS: usize = 4;

/// What ends a shard.
#[derive(Clone, Debug)]
pub struct Ending {
    /// Somebody asked for it, or the simulated brick has finished.
    pub stop: CancellationToken,
    /// How much of its drive the simulated brick has done, if there is one; at 1 it pulls its plug.
    pub progress: Option<watch::Receiver<f64>>,
    /// The session is over at this instant.
    pub at: Option<Stamp<HostClock>>,
    /// No byte for this long, once one has come.
    pub silence: Option<Span>,
}

impl Ending {
    /// Whether the simulated brick has driven all that it was to drive.
    fn is_driven(&self) -> bool {
        let progress = self.progress.as_ref();
        progress.is_some_and(|progress| *progress.borrow() >= 1.0)
    }
}

/// A pipeline with its links and what hangs off it.
pub struct Shard {
    /// The engine.
    pub pipeline: Pipeline,
    /// Its links.
    pub ports: PortSet,
    /// The session's clock.
    pub timer: HostTimer,
    /// The recording, if there is one. It can be taken away and another one put here while the shard runs; such a one begins after
    /// [`Self::given`] inputs.
    pub recorder: Option<Recorder>,
    /// How many inputs the pipeline has been given.
    pub given: u64,
    /// The telemetry log beside it, if there is one.
    pub tlog: Option<TlogRecorder>,
    /// The terminal.
    pub observer: Observer,
    /// The dashboard, if there is one.
    pub dashboard: Option<Outlet>,
    /// What ended before the run, a recording or the telemetry log, and why.
    pub failures: Failures,
    /// What keeps the stamps of signed links, if there are any.
    pub signing: Option<Keeper>,
    /// What carries out the pipeline's requests.
    pub desk: Desk,
    /// Where the simulated robot really is, if there is one.
    pub truth: Option<TruthTap>,
}

impl Shard {
    /// Runs until the ending says so; the recorder and the observer then finish what waits.
    /// A recorder that fails is put away with its reason: a full disk must not stop a robot that steers by us.
    pub async fn run(&mut self, ending: &Ending) {
        let mut next_counts = self.timer.now() + COUNTS_PERIOD;
        let mut last_byte: Option<Stamp<HostClock>> = None;
        let mut finished: BTreeSet<LinkId> = BTreeSet::new();
        let mut states: BTreeMap<LinkId, LinkState> = BTreeMap::new();
        let stopped = ending.stop.cancelled();
        tokio::pin!(stopped);
        let mut alarm = Alarm::new(self.timer);
        let mut calendar = CalendarWatch::default();
        while !ending.stop.is_cancelled() && finished.len() < self.ports.iter().len() {
            let silent_at = ending.silence.and_then(|span| last_byte.map(|last| last + span));
            let end_at = [ending.at, silent_at].into_iter().flatten().min();
            let deadline = self.pipeline.deadline().into_iter().chain(end_at).min();
            let (now, input) = tokio::select! {
                // What came goes first; the pipeline sees by its instant what is due, and the loop whether it has to end.
                biased;
                (link, event) = self.ports.next() => {
                    if matches!(event, PortEvent::Finished { .. }) {
                        finished.insert(link);
                    }
                    let (at, input) = input_of(link, event, ending);
                    if !changes_state(link, &input, &mut states) {
                        continue;
                    }
                    if matches!(input, Input::Bytes { .. }) {
                        last_byte = Some(at);
                    }
                    (at, input)
                }
                command = next_command(&mut self.dashboard) => (self.timer.now(), Input::Command(command)),
                report = self.desk.reported() => (self.timer.now(), report),
                () = alarm.reached(deadline) => (self.timer.now(), Input::Tick),
                () = &mut stopped => return,
            };
            if end_at.is_some_and(|end| now >= end) {
                return;
            }
            self.take(now, input);
            if now >= next_counts {
                next_counts = now + COUNTS_PERIOD;
                self.tell_counts(now);
                self.look_at_the_calendar(now, &mut calendar);
                self.show_calibration(now);
                self.show_standing(now);
                self.show_truth();
            }
        }
    }

    /// Writes down with which stamps the signed links have ended; nothing may be handled after it.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn keep_last_stamps(&mut self) -> anyhow::Result<()> {
        let keeper = self.signing.take();
        keeper.map_or(Ok(()), |keeper| keeper.finish(self.timer.now(), &self.pipeline))
    }

    /// Tells the pipeline what its ports have counted.
    fn tell_counts(&mut self, now: Stamp<HostClock>) {
        let counts: Vec<_> = self.ports.iter().map(|port| (port.id(), port.counts())).collect();
        for (link, counts) in counts {
            self.take(now, Input::Port { link, counts });
        }
    }

    /// Says so when the computer's date was set: the recording goes on by the date at its start.
    fn look_at_the_calendar(&mut self, now: Stamp<HostClock>, calendar: &mut CalendarWatch) {
        let Some(leap) = calendar.leap(self.timer.calendar_ahead()) else {
            return;
        };
        let text = format!(
            "the computer's date was set by {:+.1} s; the session goes on by its own clock, its recording by the date at its start",
            leap.as_secs_f64()
        );
        tracing::warn!("{text}");
        if let Some(recorder) = &mut self.recorder {
            recorder.show_line(now, 4, &text);
        }
    }

    /// Keeps what the filter has learned beside the inputs.
    fn show_calibration(&mut self, now: Stamp<HostClock>) {
        if let (Some(recorder), Some(learned)) = (&mut self.recorder, self.pipeline.calibration()) {
            recorder.show_calibration(now, learned);
        }
    }

    /// Tells the dashboard what stands.
    fn show_standing(&self, now: Stamp<HostClock>) {
        if let Some(dashboard) = &self.dashboard {
            let standing = standing_of(&self.pipeline, self.recorder.as_ref());
            dashboard.tell_standing(now, standing, self.desk.orders());
        }
    }

    /// Keeps where the simulated robot really was beside the inputs.
    pub fn show_truth(&mut self) {
        let Some(tap) = &mut self.truth else {
            return;
        };
        let missed = tap.missed();
        let samples = tap.take().into_iter().map(|live| TruthSample {
            stamp: live.sample.brick,
            pose: live.sample.pose,
            odometry: Some(live.sample.odometry),
        });
        if let Some(recorder) = &mut self.recorder {
            recorder.show_truth(samples.collect());
        }
        if tap.missed() > missed {
            let samples = tap.missed() - missed;
            tracing::warn!(samples, "the truth has a hole in the recording: the station was too slow");
        }
    }

    fn take(&mut self, now: Stamp<HostClock>, input: Input) {
        self.pipeline.handle(now, &input);
        self.given += 1;
        // The reply first: to wake the threads that watch and record must not delay it.
        let mut events = Vec::with_capacity(USUAL_EVENTS);
        let mut sent = Vec::new();
        let mut requests = Vec::new();
        while let Some(output) = self.pipeline.poll() {
            match output {
                Output::Transmit { link, to, priority, bytes } => {
                    if let Some(port) = self.ports.get_mut(link) {
                        let frame = &bytes;
                        port.give(&Outgoing { to, priority, frame });
                    }
                    if self.tlog.is_some() {
                        sent.push((link, priority, bytes));
                    }
                }
                Output::Event(event) => events.push(event),
                Output::Request(request) => requests.push(request),
            }
        }
        // One copy for all that watch and record: what a stall has held back comes at once, and waits for each of them.
        let events: Arc<[Event]> = events.into();
        if let Some(dashboard) = &self.dashboard {
            dashboard.tell(now, &events);
        }
        let is_command = matches!(input, Input::Command(_));
        let logged = self.log_traffic(now, &input, &sent);
        self.desk.note(&input);
        let recorded = self.record(now, input, &events);
        self.observer.show(now, &events);
        if let Some(keeper) = &mut self.signing {
            keeper.offer(now, &self.pipeline);
        }
        if let Some(report) = recorded {
            self.take(now, report);
        }
        if let Some(report) = logged {
            self.take(now, report);
        }
        // After the input that led to it: a recording that it ends holds it.
        for request in requests {
            let moment = (now, self.given);
            let report = self.desk.carry_out(moment, &request, &mut self.recorder);
            if let Some(report) = report {
                self.take(now, report);
            }
        }
        if is_command {
            self.show_standing(now);
        }
    }

    /// Hands the recorder what came in and what came out. One that has failed is put away; then gives what is to be said.
    fn record(&mut self, now: Stamp<HostClock>, input: Input, events: &Arc<[Event]>) -> Option<Input> {
        let recorder = self.recorder.as_mut()?;
        if recorder.record(now, input).is_ok() {
            recorder.show(now, events);
            return None;
        }
        let ended = self.recorder.take().map(Recorder::finish);
        self.desk.lose_recording();
        let Some(Err(error)) = ended else {
            return None;
        };
        tracing::error!(error = format!("{error:#}"), "the recording ends here");
        let report = warning(format!("no longer recording: {error:#}"));
        self.failures.note::<()>(Err(error.context("the recording is not whole")));
        Some(report)
    }

    /// Gives the telemetry log what came and what was sent for it. One that fails is put away, as a recorder is; then gives what is to
    /// be said.
    fn log_traffic(
        &mut self,
        now: Stamp<HostClock>,
        input: &Input,
        sent: &[(LinkId, Priority, Vec<u8>)],
    ) -> Option<Input> {
        let tlog = self.tlog.as_mut()?;
        let mut taken = tlog.received(now, input);
        for (link, priority, frame) in sent {
            taken = taken.and_then(|()| tlog.sent(now, *link, *priority, frame));
        }
        if taken.is_ok() {
            return None;
        }
        let Some(Err(error)) = self.tlog.take().map(TlogRecorder::finish) else {
            return None;
        };
        tracing::error!(error = format!("{error:#}"), "the telemetry log ends here");
        let report = warning(format!("no more telemetry log: {error:#}"));
        self.failures.note::<()>(Err(error.context("the telemetry log is not whole")));
        Some(report)
    }
}

/// What the pipeline is told of something that failed.
fn warning(text: String) -> Input {
    let severity = WARNING;
    Input::Report { severity, text }
}

/// Whether an input about a link's state tells anything new: a port tells each new reason of one loss.
fn changes_state(link: LinkId, input: &Input, states: &mut BTreeMap<LinkId, LinkState>) -> bool {
    if let Input::Link { state, .. } = input {
        return states.insert(link, *state) != Some(*state);
    }
    true
}

/// What a port's event is to the pipeline.
fn input_of(link: LinkId, event: PortEvent, ending: &Ending) -> (Stamp<HostClock>, Input) {
    match event {
        PortEvent::Bytes { peer, arrival, bytes } => (arrival, Input::Bytes { link, peer, bytes }),
        PortEvent::Up { at, detail } => {
            tracing::info!(link = link.0, detail, "link up");
            (at, Input::Link { link, state: LinkState::Up })
        }
        PortEvent::Down { at, reason, retry_in } => {
            if ending.is_driven() {
                tracing::info!(link = link.0, reason, "link down at the end of the drive");
            } else {
                let retry_ms = retry_in.as_millis_f64().round();
                tracing::warn!(link = link.0, reason, retry_ms, "link down");
            }
            (at, Input::Link { link, state: LinkState::Down })
        }
        PortEvent::Finished { at } => (at, Input::Link { link, state: LinkState::Down }),
    }
}
