//! The thread that consumes the events: live status block and data for the report. The event file has a thread of its own.

use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use posebridge_telemetry::{Event, HostClock, TimeDelta, Timestamp};

use super::event_collector::EventCollector;
use super::event_file::EventFileWriter;
use super::live_status::LiveView;
use super::per_robot::PerRobot;

/// Batches queued before further ones are dropped and counted: forty seconds of a brick that is read 100 times a second.
const QUEUE_CAPACITY: usize = 4_096;
const DRAW_PERIOD: TimeDelta = TimeDelta::from_millis(200);

pub struct Observer {
    sender: Sender<(Timestamp<HostClock>, Arc<[Event]>)>,
    thread: JoinHandle<PerRobot<EventCollector>>,
    dropped: u64,
    file: Option<EventFileWriter>,
}

/// What remains of an observer.
pub struct ObserverResults {
    pub collectors: PerRobot<EventCollector>,
    pub dropped: u64,
    /// Whether the event file is whole, if there is one.
    pub event_file: Result<()>,
}

impl Observer {
    /// `events` is a file that gets every event as a line of text.
    pub fn start(events: Option<&Path>, view: LiveView) -> Result<Self> {
        let file = events.map(EventFileWriter::start).transpose()?;
        let (sender, batches) = bounded(QUEUE_CAPACITY);
        let thread = std::thread::Builder::new()
            .name("observer".to_owned())
            .spawn(move || run_observer(&batches, view))
            .context("starting the observer's thread")?;
        Ok(Self { sender, thread, dropped: 0, file })
    }

    /// Queues the outputs of an input, without waiting. An event file that takes no more is removed, with its error.
    pub fn push(&mut self, now: Timestamp<HostClock>, events: &Arc<[Event]>) -> Result<()> {
        if events.is_empty() {
            return Ok(());
        }
        let ended = self.file.take_if(|file| !file.push(events)).map_or(Ok(()), EventFileWriter::finish);
        if self.sender.try_send((now, Arc::clone(events))).is_err() {
            self.dropped += events.len() as u64;
        }
        ended
    }

    /// Ends the threads.
    pub fn finish(self) -> Result<ObserverResults> {
        drop(self.sender);
        let collectors = self.thread.join().map_err(|_panic| anyhow!("the observer's thread died"))?;
        let event_file = self.file.map_or(Ok(()), EventFileWriter::finish);
        Ok(ObserverResults { collectors, dropped: self.dropped, event_file })
    }
}

fn run_observer(
    batches: &Receiver<(Timestamp<HostClock>, Arc<[Event]>)>,
    mut view: LiveView,
) -> PerRobot<EventCollector> {
    let mut collectors = PerRobot::new(EventCollector::live);
    let mut drawn = Timestamp::<HostClock>::ZERO;
    loop {
        match batches.recv_timeout(Duration::from_nanos(DRAW_PERIOD.as_nanos().unsigned_abs())) {
            Ok((now, events)) => {
                for event in events.iter() {
                    collectors.push(event, EventCollector::on_event);
                    view.on_event(now, event);
                }
                if now - drawn >= DRAW_PERIOD {
                    view.draw();
                    drawn = now;
                }
            }
            Err(RecvTimeoutError::Timeout) => view.draw(),
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    view.finish();
    collectors
}
