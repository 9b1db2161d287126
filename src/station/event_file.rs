//! `--events FILE`: every event as a line of JSON, written by a thread of its own, so that nobody waits for the disk.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, ensure};
use crossbeam_channel::{Receiver, Sender, bounded};
use posebridge_recording::event_json;
use posebridge_telemetry::Event;

/// Batches queued for the disk before further ones are dropped and counted: 16 s of a robot that sends a thousand times a second.
const QUEUE_CAPACITY: usize = 16_384;
/// How long the end of a run waits for a disk that takes nothing.
const END_TIMEOUT: Duration = Duration::from_secs(5);

pub struct EventFileWriter {
    path: PathBuf,
    batches: Sender<Arc<[Event]>>,
    /// The thread's result, when it has ended.
    ended: Receiver<Result<()>>,
    dropped: u64,
}

impl EventFileWriter {
    pub fn start(path: &Path) -> Result<Self> {
        let mut file = create(path)?;
        let (batches, queue) = bounded::<Arc<[Event]>>(QUEUE_CAPACITY);
        let (end, ended) = bounded(1);
        let write = move || -> Result<()> {
            for batch in queue {
                batch.iter().try_for_each(|event| write_event(&mut file, event))?;
            }
            Ok(file.flush()?)
        };
        let thread = std::thread::Builder::new().name("events".to_owned());
        thread.spawn(move || end.try_send(write())).context("starting the thread of the event file")?;
        Ok(Self { path: path.to_owned(), batches, ended, dropped: 0 })
    }

    pub fn push(&mut self, events: &Arc<[Event]>) {
        if self.batches.try_send(Arc::clone(events)).is_err() {
            self.dropped += events.len() as u64;
        }
    }

    /// Waits until the file is written.
    ///
    /// # Errors
    /// It cannot be written, lacks events, or its disk takes nothing.
    pub fn finish(self) -> Result<()> {
        drop(self.batches);
        let ended = self.ended.recv_timeout(END_TIMEOUT);
        let written = ended.unwrap_or_else(|_stuck| Err(anyhow!("its disk takes nothing; what is queued is lost")));
        let name = self.path.display();
        written.with_context(|| format!("writing the event file `{name}`"))?;
        ensure!(self.dropped == 0, "the event file `{name}` lacks {} events: its disk was too slow", self.dropped);
        Ok(())
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
