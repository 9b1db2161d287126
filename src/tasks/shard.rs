//! The loop that owns a pipeline and its ports: bytes in, reply out, in one wake-up.

use std::collections::BTreeMap;

use anyhow::Result;
use posebridge_link::{HostTimer, PeerId, PortEvent, PortSet};
use posebridge_pipeline::Pipeline;
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, Output, Span, Stamp};
use tokio_util::sync::CancellationToken;

use super::observer::Observer;
use super::recorder::Recorder;

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
}

impl Shard {
    /// Runs until the ending says so; the recorder and the observer then finish what waits.
    ///
    /// # Errors
    /// The recording could not be written.
    pub async fn run(&mut self, ending: &Ending) -> Result<()> {
        let mut last_byte: Option<Stamp<HostClock>> = None;
        let mut speakers: BTreeMap<LinkId, PeerId> = BTreeMap::new();
        let mut states: BTreeMap<LinkId, LinkState> = BTreeMap::new();
        loop {
            let silent_at = ending
                .silence
                .and_then(|span| last_byte.map(|last| last + span));
            let end_at = [ending.at, silent_at].into_iter().flatten().min();
            let deadline = self.pipeline.deadline().into_iter().chain(end_at).min();
            let (now, input) = tokio::select! {
                (link, event) = self.ports.next() => {
                    let is_stream = self.ports.get_mut(link).is_some_and(|port| !port.is_datagram());
                    if is_stream && !has_the_link(link, &event, &mut speakers) {
                        continue;
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
                () = sleep_until(self.timer, deadline) => (self.timer.now(), Input::Tick),
                () = ending.stop.cancelled() => return Ok(()),
            };
            if end_at.is_some_and(|end| now >= end) {
                return Ok(());
            }
            self.take(now, input)?;
        }
    }

    fn take(&mut self, now: Stamp<HostClock>, input: Input) -> Result<()> {
        self.pipeline.handle(now, &input);
        while let Some(output) = self.pipeline.poll() {
            match output {
                Output::Transmit { link, bytes } => {
                    if let Some(port) = self.ports.get_mut(link) {
                        port.send(&bytes);
                    }
                }
                Output::Event(event) => self.observer.show(now, event),
            }
        }
        match &self.recorder {
            Some(recorder) => recorder.record(now, input),
            None => Ok(()),
        }
    }
}

async fn sleep_until(timer: HostTimer, deadline: Option<Stamp<HostClock>>) {
    match deadline {
        Some(deadline) => timer.sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}

/// Whether the pipeline should see an event of a stream link. Bytes of several peers would mix in one scanner, so only the newest
/// peer is heard: a brick that calls again has a new number.
fn has_the_link(link: LinkId, event: &PortEvent, speakers: &mut BTreeMap<LinkId, PeerId>) -> bool {
    let PortEvent::Bytes { peer, .. } = event else {
        if matches!(event, PortEvent::Down { .. }) {
            speakers.remove(&link);
        }
        return true;
    };
    let speaker = speakers.entry(link).or_insert(*peer);
    if peer.0 > speaker.0 {
        tracing::info!(
            link = link.0,
            peer = peer.0,
            "a newer peer takes this link over"
        );
        *speaker = *peer;
    }
    *speaker == *peer
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
        PortEvent::Bytes { arrival, bytes, .. } => (arrival, Input::Bytes { link, bytes }),
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
