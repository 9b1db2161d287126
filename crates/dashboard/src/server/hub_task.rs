//! The task that owns the hub: applies batches of events, broadcasts frames, answers queries.

use std::sync::Arc;

use axum::extract::ws::Utf8Bytes;
use tokio::sync::{broadcast, mpsc, oneshot};
use tokio::time::{MissedTickBehavior, interval};

use crate::api::HostClockSource;
use crate::counters::{ServerCounter, ServerCounters};
use crate::feed::{EventBatches, SimulatedTruth};
use crate::hub::Hub;
use crate::limits::{MAX_WAITING_FRAMES, TICK};
use crate::model::{Message, RecordingRow};
use crate::recordings::RecordingFolder;
use crate::taps::FrameTaps;
use crate::token::AccessRole;

/// Bound per tick; with more, the next message would be late.
const MAX_BATCHES_PER_TICK: usize = 6_000;
const MAX_TRUTH_PER_TICK: usize = 1_024;

pub(crate) enum HubQuery {
    /// The first message, to somebody with this role, and a receiver of the following ones.
    Hello(Vec<RecordingRow>, AccessRole, oneshot::Sender<StreamStart>),
    Text(Topic, oneshot::Sender<String>),
    Recording(oneshot::Sender<Option<String>>),
}

/// Text about what the hub knows.
pub(crate) type Topic = fn(&Hub, &ServerCounters) -> String;

pub(crate) struct StreamStart {
    pub(crate) hello: Utf8Bytes,
    pub(crate) frames: broadcast::Receiver<Utf8Bytes>,
}

pub(crate) struct HubInputs {
    pub(crate) batches: EventBatches,
    pub(crate) truth: Option<Box<dyn FnMut() -> Option<SimulatedTruth> + Send>>,
    pub(crate) clock: Arc<HostClockSource>,
    pub(crate) queries: mpsc::Receiver<HubQuery>,
    pub(crate) recordings: RecordingFolder,
    pub(crate) counts: Arc<ServerCounters>,
    pub(crate) taps: FrameTaps,
}

pub(crate) async fn run_hub(mut hub: Hub, mut inputs: HubInputs) {
    let (frames, _) = broadcast::channel(MAX_WAITING_FRAMES);
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = inputs.batches.backlog() => {}
            _ = ticks.tick() => {}
            Some(query) = inputs.queries.recv() => {
                answer_query(&hub, &inputs.counts, query, &frames);
                continue;
            }
        }
        if !drain_inputs(&mut hub, &mut inputs) {
            return;
        }
        broadcast_frame(&mut hub, &mut inputs, &frames);
    }
}

/// Applies the waiting inputs; false when the station loop has ended.
fn drain_inputs(hub: &mut Hub, inputs: &mut HubInputs) -> bool {
    if let Some(truth) = &mut inputs.truth {
        for sample in std::iter::from_fn(truth).take(MAX_TRUTH_PER_TICK) {
            hub.push_truth(&sample);
        }
    }
    for _ in 0..MAX_BATCHES_PER_TICK {
        match inputs.batches.try_recv() {
            Ok(batch) => hub.push_batch(&batch),
            Err(mpsc::error::TryRecvError::Empty) => break,
            Err(mpsc::error::TryRecvError::Disconnected) => return false,
        }
    }
    true
}

/// Serializes the updates once and sends them to all readers.
fn broadcast_frame(hub: &mut Hub, inputs: &mut HubInputs, frames: &broadcast::Sender<Utf8Bytes>) {
    let now = (inputs.clock)();
    let Some(frame) = hub.next_frame(now, |name| inputs.recordings.current(name)) else {
        return;
    };
    if !inputs.taps.is_empty() {
        let missed = inputs.taps.send(&Arc::new(frame.clone()));
        inputs.counts.add(ServerCounter::TapFramesMissed, missed);
    }
    if frames.receiver_count() > 0 {
        // An error means that the last reader has left.
        drop(frames.send(to_json(&Message::Frame(Box::new(frame))).into()));
    }
}

fn answer_query(hub: &Hub, counts: &ServerCounters, query: HubQuery, frames: &broadcast::Sender<Utf8Bytes>) {
    match query {
        HubQuery::Hello(recordings, role, reply) => {
            let hello = to_json(&Message::Hello(Box::new(hub.hello(recordings, role))));
            // The client may have left.
            drop(reply.send(StreamStart { hello: hello.into(), frames: frames.subscribe() }));
        }
        HubQuery::Text(topic, reply) => drop(reply.send(topic(hub, counts))),
        HubQuery::Recording(reply) => drop(reply.send(hub.recording.clone())),
    }
}

/// Plain structs of numbers and texts always serialize.
pub(crate) fn to_json<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}
