//! The outputs of a session as a ROS 2 bag beside the recording, in chunks of a second: after a crash everything before the last flush is
//! readable.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use posebridge_recording::ros2::RosBagWriter;
use posebridge_telemetry::{Event, HostClock, Timestamp};

use super::side_file::{SideFile, SideFileFormat};

/// The events of one input.
pub struct EventBatch {
    now: Timestamp<HostClock>,
    events: Arc<[Event]>,
}

pub type BagRecorder = SideFile<RosBagWriter<File>>;

impl BagRecorder {
    /// `utc_start_micros` is the date at the host clock's zero.
    pub fn create(path: &Path, utc_start_micros: u64, floor_bytes: u64) -> Result<Self> {
        Self::start(path, floor_bytes, |out| Ok(RosBagWriter::create(out, utc_start_micros)?))
    }

    /// Fails if the bag has ended because of a write error.
    pub fn record(&mut self, now: Timestamp<HostClock>, events: &Arc<[Event]>) -> Result<()> {
        if events.is_empty() { Ok(()) } else { self.offer(EventBatch { now, events: Arc::clone(events) }) }
    }
}

impl SideFileFormat for RosBagWriter<File> {
    type Item = EventBatch;

    const KIND: &'static str = "ROS 2 bag";
    const THREAD: &'static str = "ros2-bag";
    const QUEUE_CAPACITY: usize = 8_192;

    fn write(&mut self, batch: &EventBatch) -> Result<Timestamp<HostClock>> {
        for event in &*batch.events {
            self.record(batch.now, event)?;
        }
        Ok(batch.now)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(Self::flush(self)?)
    }

    fn finish(self) -> Result<u64> {
        let (_, messages) = Self::finish(self)?;
        Ok(messages)
    }
}
