//! The thread that consumes the events: live status block, event file, and data for the report.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use posebridge_recording::event_json;
use posebridge_telemetry::{Event, HostClock, TimeDelta, Timestamp};

use super::event_collector::EventCollector;
use super::live_status::LiveView;
use super::per_robot::PerRobot;

/// Batches queued for the terminal before further ones are dropped and counted: forty seconds of a brick that is read 100 times a
/// second.
const QUEUE_CAPACITY: usize = 4_096;
const DRAW_PERIOD: TimeDelta = TimeDelta::from_millis(200);

pub struct Observer {
    sender: Sender<(Timestamp<HostClock>, Arc<[Event]>)>,
    thread: JoinHandle<Result<PerRobot<EventCollector>>>,
    dropped: u64,
    /// With an event file no event may be missing: the station loop then waits for the disk.
    blocks_when_full: bool,
}

impl Observer {
    /// `events` is a file that gets every event as a line of text.
    pub fn start(events: Option<&Path>, view: LiveView) -> Result<Self> {
        let file = events.map(create).transpose()?;
        let (sender, batches) = bounded(QUEUE_CAPACITY);
        let thread = std::thread::Builder::new()
            .name("observer".to_owned())
            .spawn(move || run_observer(&batches, file, view))
            .context("starting the observer's thread")?;
        Ok(Self { sender, thread, dropped: 0, blocks_when_full: events.is_some() })
    }

    /// Queues the outputs of an input; drops them if the terminal is far behind, unless there is an event file.
    pub fn push(&mut self, now: Timestamp<HostClock>, events: &Arc<[Event]>) {
        if events.is_empty() {
            return;
        }
        let batch = (now, Arc::clone(events));
        let is_taken =
            if self.blocks_when_full { self.sender.send(batch).is_ok() } else { self.sender.try_send(batch).is_ok() };
        if !is_taken {
            self.dropped += events.len() as u64;
        }
    }

    /// Joins the thread; returns its data and the number of dropped events.
    pub fn finish(self) -> Result<(PerRobot<EventCollector>, u64)> {
        drop(self.sender);
        let collectors = self.thread.join().map_err(|_panic| anyhow!("the observer's thread died"))??;
        Ok((collectors, self.dropped))
    }
}

pub fn create(path: &Path) -> Result<BufWriter<File>> {
    let file = File::create(path).with_context(|| format!("creating the event file `{}`", path.display()))?;
    Ok(BufWriter::new(file))
}

/// Writes an event as a line: every number with all its digits, so that two runs can be compared bit for bit.
pub fn write_event(file: &mut impl Write, event: &Event) -> std::io::Result<()> {
    writeln!(file, "{}", event_json::to_json_line(event))
}

fn run_observer(
    batches: &Receiver<(Timestamp<HostClock>, Arc<[Event]>)>,
    mut file: Option<BufWriter<File>>,
    mut view: LiveView,
) -> Result<PerRobot<EventCollector>> {
    let mut collectors = PerRobot::new(EventCollector::live);
    let mut drawn = Timestamp::<HostClock>::ZERO;
    loop {
        match batches.recv_timeout(Duration::from_nanos(DRAW_PERIOD.as_nanos().unsigned_abs())) {
            Ok((now, events)) => {
                for event in events.iter() {
                    if let Some(file) = &mut file {
                        write_event(file, event).context("writing the event file")?;
                    }
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
    if let Some(mut file) = file {
        file.flush().context("writing the event file")?;
    }
    Ok(collectors)
}
