//! `--events FILE`: every event as a line of JSON, written by a thread of its own, so that nobody waits for the disk.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, Result, ensure};
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use posebridge_recording::event_json;
use posebridge_telemetry::Event;

use super::writer_thread::WriterThread;

/// Batches queued for the disk before further ones are dropped and counted: 16 s of a robot that sends a thousand times a second.
const QUEUE_CAPACITY: usize = 16_384;

pub struct EventFileWriter {
    path: PathBuf,
    batches: Sender<Arc<[Event]>>,
    thread: WriterThread<()>,
    queued: u64,
    dropped: u64,
}

impl EventFileWriter {
    pub fn start(path: &Path) -> Result<Self> {
        let file = create(path)?;
        let (batches, queue) = bounded::<Arc<[Event]>>(QUEUE_CAPACITY);
        let thread = WriterThread::spawn("events", move |written| write(file, &queue, written))?;
        Ok(Self { path: path.to_owned(), batches, thread, queued: 0, dropped: 0 })
    }

    /// False if the file takes no more: [`Self::finish`] says why.
    pub fn push(&mut self, events: &Arc<[Event]>) -> bool {
        match self.batches.try_send(Arc::clone(events)) {
            Ok(()) => self.queued += 1,
            Err(TrySendError::Full(_)) => self.dropped += events.len() as u64,
            Err(TrySendError::Disconnected(_)) => return false,
        }
        true
    }

    /// Waits until the file is written.
    ///
    /// # Errors
    /// It cannot be written, lacks events, or its disk takes nothing.
    pub fn finish(self) -> Result<()> {
        drop(self.batches);
        let name = self.path.display();
        self.thread.wait(self.queued).with_context(|| format!("writing the event file `{name}`"))?;
        ensure!(self.dropped == 0, "the event file `{name}` lacks {} events: its disk was too slow", self.dropped);
        Ok(())
    }
}

fn write(mut file: BufWriter<File>, queue: &Receiver<Arc<[Event]>>, written: &AtomicU64) -> Result<()> {
    for batch in queue {
        batch.iter().try_for_each(|event| write_event(&mut file, event))?;
        written.fetch_add(1, Ordering::Relaxed);
    }
    Ok(file.flush()?)
}

pub fn create(path: &Path) -> Result<BufWriter<File>> {
    let file = File::create(path).with_context(|| format!("creating the event file `{}`", path.display()))?;
    Ok(BufWriter::new(file))
}

/// Writes an event as a line: every number with all its digits, so that two runs can be compared bit for bit.
pub fn write_event(file: &mut impl Write, event: &Event) -> std::io::Result<()> {
    writeln!(file, "{}", event_json::to_json_line(event))
}
