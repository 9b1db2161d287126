//! The loop that owns a pipeline and its ports: bytes in, reply out, in one wake-up.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_link::{Alarm, HostTimer, Outgoing, PortEvent, PortSet};
use posebridge_pipeline::Pipeline;
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, Output, Span, Stamp};
use tokio_util::sync::CancellationToken;

use super::observer::Observer;
use super::recorder::Recorder;
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
    /// The session is over at this instant.
    pub at: Option<Stamp<HostClock>>,
    /// No byte for this long, once one has come.
    pub silence: Option<Span>,
}

/// A pipeline with its links and what hangs off it.
pub struct Shard {
    /// The engine.
    pub pipeline: Pipeline,
    /// Its links.
    pub ports: PortSet,
    /// The session's clock.
    pub timer: HostTimer,
    /// The recording, if there is one.
    pub recorder: Option<Recorder>,
    /// The terminal.
    pub observer: Observer,
    /// Why the recording ended before the run.
    pub recording_failure: Option<anyhow::Error>,
    /// What keeps the stamps of signed links, if there are any.
    pub signing: Option<Keeper>,
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
        while !ending.stop.is_cancelled() {
            let silent_at = ending
                .silence
                .and_then(|span| last_byte.map(|last| last + span));
            let end_at = [ending.at, silent_at].into_iter().flatten().min();
            let deadline = self.pipeline.deadline().into_iter().chain(end_at).min();
            let (now, input) = tokio::select! {
                // What came goes first; the pipeline sees by its instant what is due, and the loop whether it has to end.
                biased;
                (link, event) = self.ports.next() => {
                    if matches!(event, PortEvent::Finished { .. }) {
                        finished.insert(link);
                    }
                    let (at, input) = input_of(link, event);
                    if !changes_state(link, &input, &mut states) {
                        continue;
                    }
                    if matches!(input, Input::Bytes { .. }) {
                        last_byte = Some(at);
                    }
                    (at, input)
                }
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
            }
            if finished.len() == self.ports.iter().len() {
                return;
            }
        }
    }

    /// Writes down with which stamps the signed links have ended; nothing may be handled after it.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn keep_last_stamps(&mut self) -> anyhow::Result<()> {
        let keeper = self.signing.take();
        keeper.map_or(Ok(()), |keeper| {
            keeper.finish(self.timer.now(), &self.pipeline)
        })
    }

    /// Tells the pipeline what its ports have counted.
    fn tell_counts(&mut self, now: Stamp<HostClock>) {
        let counts: Vec<_> = self
            .ports
            .iter()
            .map(|port| (port.id(), port.counts()))
            .collect();
        for (link, counts) in counts {
            self.take(now, Input::Port { link, counts });
        }
    }

    fn take(&mut self, now: Stamp<HostClock>, input: Input) {
        self.pipeline.handle(now, &input);
        // The reply first: to wake the threads that watch and record must not delay it.
        let mut events = Vec::with_capacity(USUAL_EVENTS);
        while let Some(output) = self.pipeline.poll() {
            match output {
                Output::Transmit {
                    link,
                    to,
                    priority,
                    bytes,
                } => {
                    if let Some(port) = self.ports.get_mut(link) {
                        let frame = &bytes;
                        port.give(&Outgoing {
                            to,
                            priority,
                            frame,
                        });
                    }
                }
                Output::Event(event) => events.push(event),
            }
        }
        for event in events {
            self.observer.show(now, event);
        }
        if let Some(keeper) = &mut self.signing {
            keeper.offer(now, &self.pipeline);
        }
        let is_lost = self
            .recorder
            .as_ref()
            .is_some_and(|recorder| recorder.record(now, input).is_err());
        if is_lost && let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
            tracing::error!(error = format!("{error:#}"), "the recording ends here");
            self.recording_failure = Some(error);
        }
    }
}

/// Whether an input about a link's state tells anything new: a port tells each new reason of one loss.
fn changes_state(link: LinkId, input: &Input, states: &mut BTreeMap<LinkId, LinkState>) -> bool {
    if let Input::Link { state, .. } = input {
        return states.insert(link, *state) != Some(*state);
    }
    true
}

/// What a port's event is to the pipeline.
fn input_of(link: LinkId, event: PortEvent) -> (Stamp<HostClock>, Input) {
    match event {
        PortEvent::Bytes {
            peer,
            arrival,
            bytes,
        } => (arrival, Input::Bytes { link, peer, bytes }),
        PortEvent::Up { at, detail } => {
            tracing::info!(link = link.0, detail, "link up");
            (
                at,
                Input::Link {
                    link,
                    state: LinkState::Up,
                },
            )
        }
        PortEvent::Down {
            at,
            reason,
            retry_in,
        } => {
            tracing::warn!(
                link = link.0,
                reason,
                retry_ms = retry_in.as_millis_f64(),
                "link down"
            );
            (
                at,
                Input::Link {
                    link,
                    state: LinkState::Down,
                },
            )
        }
        PortEvent::Finished { at } => (
            at,
            Input::Link {
                link,
                state: LinkState::Down,
            },
        ),
    }
}
