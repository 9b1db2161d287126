//! The task that owns the hub: takes what the shard tells, sends what is new, answers questions.

use std::sync::Arc;

use axum::extract::ws::Utf8Bytes;
use tokio::sync::{broadcast, mpsc, oneshot};
use tokio::time::{MissedTickBehavior, interval};

use super::Clock;
use crate::counts::{Count, Counts};
use crate::feed::{Batches, TruthSample};
use crate::hub::Hub;
use crate::limits::{TICK, WAITING_FRAMES};
use crate::metrics;
use crate::model::{Message, RecordingRow};
use crate::recordings::Recordings;
use crate::taps::Taps;

/// So many batches are taken between two messages; with more the reader of the next one waits no longer than the others.
const MOST_BATCHES: usize = 6_000;
/// The same for samples of the truth.
const MOST_SAMPLES: usize = 1_024;

/// What the hub's task is asked.
pub(crate) enum Question {
    /// The first message and all that follow, for a new reader.
    Hello(Vec<RecordingRow>, oneshot::Sender<Greeting>),
    /// Something as text.
    Text(Subject, oneshot::Sender<String>),
    /// Which file is being recorded into.
    Recording(oneshot::Sender<Option<String>>),
}

/// What can be asked for as text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Subject {
    State,
    Robots,
    Sources,
    Parameters,
    Metrics,
}

/// What a new reader gets.
pub(crate) struct Greeting {
    pub(crate) hello: Utf8Bytes,
    pub(crate) frames: broadcast::Receiver<Utf8Bytes>,
}

/// Where what is known comes from.
pub(crate) struct Inlets {
    pub(crate) batches: Batches,
    pub(crate) truth: Option<Box<dyn FnMut() -> Option<TruthSample> + Send>>,
    pub(crate) clock: Arc<Clock>,
    pub(crate) questions: mpsc::Receiver<Question>,
    pub(crate) recordings: Recordings,
    pub(crate) counts: Arc<Counts>,
    /// Readers in this process.
    pub(crate) taps: Taps,
}

/// Runs until the shard is gone.
pub(crate) async fn run_hub(mut hub: Hub, mut inlets: Inlets) {
    let (frames, _) = broadcast::channel(WAITING_FRAMES);
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = inlets.batches.crowd() => {}
            _ = ticks.tick() => {}
            Some(question) = inlets.questions.recv() => {
                answer(&hub, &inlets.counts, question, &frames);
                continue;
            }
        }
        if !take_all(&mut hub, &mut inlets) {
            return;
        }
        send_news(&mut hub, &mut inlets, &frames);
    }
}

/// Takes what has come; false when the shard is gone.
fn take_all(hub: &mut Hub, inlets: &mut Inlets) -> bool {
    if let Some(truth) = &mut inlets.truth {
        for sample in std::iter::from_fn(truth).take(MOST_SAMPLES) {
            hub.take_truth(&sample);
        }
    }
    for _ in 0..MOST_BATCHES {
        match inlets.batches.try_recv() {
            Ok(batch) => hub.take(&batch),
            Err(mpsc::error::TryRecvError::Empty) => break,
            Err(mpsc::error::TryRecvError::Disconnected) => return false,
        }
    }
    true
}

/// Writes what is new once, for all readers.
fn send_news(hub: &mut Hub, inlets: &mut Inlets, frames: &broadcast::Sender<Utf8Bytes>) {
    let now = (inlets.clock)();
    let Some(frame) = hub.news(now, |name| inlets.recordings.now(name)) else {
        return;
    };
    if !inlets.taps.is_empty() {
        let missed = inlets.taps.tell(&Arc::new(frame.clone()));
        inlets.counts.add(Count::TapFramesMissed, missed);
    }
    if frames.receiver_count() > 0 {
        // Nobody left in the meantime is as good.
        drop(frames.send(text(&Message::Frame(Box::new(frame))).into()));
    }
}

fn answer(hub: &Hub, counts: &Counts, question: Question, frames: &broadcast::Sender<Utf8Bytes>) {
    match question {
        Question::Hello(recordings, reply) => {
            let hello = text(&Message::Hello(Box::new(hub.hello(recordings))));
            // Whoever asked may have gone.
            drop(reply.send(Greeting { hello: hello.into(), frames: frames.subscribe() }));
        }
        Question::Text(subject, reply) => drop(reply.send(about(hub, counts, subject))),
        Question::Recording(reply) => drop(reply.send(hub.recording.clone())),
    }
}

fn about(hub: &Hub, counts: &Counts, subject: Subject) -> String {
    match subject {
        Subject::State => text(&hub.state(counts)),
        Subject::Robots => text(&hub.robots()),
        Subject::Sources => text(&hub.sources()),
        Subject::Parameters => text(&hub.parameters()),
        Subject::Metrics => {
            counts.set(Count::PointsDropped, hub.dropped());
            metrics::page(hub, counts)
        }
    }
}

/// Plain structs of numbers and texts can always be written.
fn text<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}
