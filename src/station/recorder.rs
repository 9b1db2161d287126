//! The thread that writes the recording's files.
//! No other thread waits for it: items that do not fit into its queue are dropped and counted, outputs of the station first and inputs
//! last. The recording states its gaps.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use posebridge_recording::container::{RecordingHeader, RecordingWriter, TruthSample, WriteError};
use posebridge_telemetry::{Calibration, Event, HostClock, Input, RobotId, Timestamp};

use super::recording_parts::{FLUSH_PERIOD, RecordingParts, SYNC_PERIOD, part_path};
use super::writer_thread::{END_TIMEOUT, WriterThread};
use crate::config::RecordingLimits;

pub use super::recording_parts::RecordingTotals;

/// Several seconds of a busy link.
const QUEUE_CAPACITY: usize = 8_192;
/// Number of queued items from which only inputs are accepted.
const OUTPUT_QUEUE_CAPACITY: usize = QUEUE_CAPACITY / 2;

/// Writes outputs of the station; the time is that of the last input.
type OutputWriter = dyn FnOnce(&mut RecordingWriter<File>, Timestamp<HostClock>) -> Result<(), WriteError> + Send;

enum RecorderItem {
    Input(Timestamp<HostClock>, u64, Input),
    Outputs(Box<OutputWriter>),
    /// The last item: the number of inputs of the session.
    End(u64),
}

pub struct Recorder {
    /// Boxed, because the channel allocates its full capacity.
    sender: Sender<Box<RecorderItem>>,
    thread: WriterThread<RecordingTotals>,
    /// Items in the queue so far.
    queued: u64,
    first: PathBuf,
    /// Part number, updated by the thread.
    part: Arc<AtomicU32>,
    input_count: u64,
    lost: u64,
    lost_outputs: u64,
}

impl Recorder {
    /// Creates the file and starts the thread, at the start of a session. Never overwrites a file.
    pub fn start(path: &Path, header: &RecordingHeader, limits: RecordingLimits) -> Result<Self> {
        let parts = RecordingParts::create(path, header.clone(), limits, 0)?;
        Self::spawn(path, 0, move || Ok(parts))
    }

    /// Starts the thread within a session, after `inputs_before` inputs. The thread creates the file, so that the caller does not wait
    /// for the disk. If that fails, the next [`Self::record`] reports it.
    ///
    /// The header states the missing inputs: replaying the recording does not replay the session.
    pub fn start_in_session(
        path: &Path,
        header: &RecordingHeader,
        limits: RecordingLimits,
        inputs_before: u64,
    ) -> Result<Self> {
        let (first, header) = (path.to_owned(), header.clone());
        Self::spawn(path, inputs_before, move || RecordingParts::create(&first, header, limits, inputs_before))
    }

    fn spawn(
        first: &Path,
        input_count: u64,
        open: impl FnOnce() -> Result<RecordingParts> + Send + 'static,
    ) -> Result<Self> {
        let (sender, items) = bounded(QUEUE_CAPACITY);
        let part = Arc::new(AtomicU32::new(1));
        let current_part = Arc::clone(&part);
        let thread = WriterThread::spawn("recorder", move |written| write(open()?, &items, &current_part, written))?;
        Ok(Self { sender, thread, queued: 0, first: first.to_owned(), part, input_count, lost: 0, lost_outputs: 0 })
    }

    /// Records an input without waiting; counts it as lost if the queue is full. Fails if the recorder has stopped because of a write
    /// error: [`Self::finish`] returns it.
    pub fn record(&mut self, now: Timestamp<HostClock>, input: Input) -> Result<()> {
        let item = RecorderItem::Input(now, self.input_count, input);
        self.input_count += 1;
        match self.try_send(item) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => {
                if self.lost == 0 {
                    tracing::error!(
                        "the disk is too slow: inputs are missing in the recording from here on, its replay will not be exact"
                    );
                }
                self.lost += 1;
                Ok(())
            }
            Err(TrySendError::Disconnected(_)) => Err(anyhow!("the recorder has stopped")),
        }
    }

    /// Records outputs of the station for viewers, without waiting and with lower priority than inputs.
    pub fn record_events(&mut self, now: Timestamp<HostClock>, events: &Arc<[Event]>) {
        if events.iter().any(Event::is_for_viewers) {
            let events = Arc::clone(events);
            self.offer(move |writer, _| events.iter().try_for_each(|event| writer.record_event(now, event)));
        }
    }

    /// Records the estimated constants of a robot, like [`Self::record_events`].
    pub fn record_calibration(&mut self, now: Timestamp<HostClock>, robot: RobotId, calibration: Calibration) {
        self.offer(move |writer, _| writer.record_calibration(now, Some(robot), &calibration));
    }

    /// Records a log line with its MAVLink severity, like [`Self::record_events`].
    pub fn record_message(&mut self, now: Timestamp<HostClock>, severity: u8, text: &str) {
        let text = text.to_owned();
        self.offer(move |writer, _| writer.record_log_message(now, severity, &text));
    }

    /// Records true poses of a simulated robot, in time order, like [`Self::record_events`].
    pub fn record_truth(&mut self, truth: Vec<TruthSample>) {
        if !truth.is_empty() {
            self.offer(move |writer, last| writer.record_truth(last, &truth));
        }
    }

    pub fn current(&self) -> PathBuf {
        part_path(&self.first, self.part.load(Ordering::Relaxed))
    }

    /// Ends the recording without waiting for the disk.
    pub fn stop(self) -> StoppingRecorder {
        let end = Box::new(RecorderItem::End(self.input_count));
        // With a full queue the last gap is not recorded; it ends where its channel does.
        drop(self.sender.try_send(end));
        StoppingRecorder { thread: self.thread, queued: self.queued }
    }

    /// Writes the queued items, ends the file and returns its totals. Waits as long as the disk takes anything.
    pub fn finish(self) -> Result<RecordingTotals> {
        let (end, current) = (Box::new(RecorderItem::End(self.input_count)), self.current());
        // A thread that has gone says why when it is waited for. Behind a disk that takes nothing the queue stays full.
        drop(self.sender.send_timeout(end, END_TIMEOUT));
        let Self { sender, thread, queued, .. } = self;
        drop(sender);
        StoppingRecorder { thread, queued }.wait().with_context(|| format!("`{}`", current.display()))
    }

    /// Queues outputs, which have a lower priority than inputs.
    fn offer(
        &mut self,
        write: impl FnOnce(&mut RecordingWriter<File>, Timestamp<HostClock>) -> Result<(), WriteError> + Send + 'static,
    ) {
        let is_backlogged = self.sender.len() >= OUTPUT_QUEUE_CAPACITY;
        if is_backlogged || self.try_send(RecorderItem::Outputs(Box::new(write))).is_err() {
            self.lost_outputs += 1;
        }
    }

    fn try_send(&mut self, item: RecorderItem) -> Result<(), TrySendError<Box<RecorderItem>>> {
        self.sender.try_send(Box::new(item))?;
        self.queued += 1;
        Ok(())
    }
}

pub struct StoppingRecorder {
    thread: WriterThread<RecordingTotals>,
    queued: u64,
}

impl StoppingRecorder {
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    pub fn wait(self) -> Result<RecordingTotals> {
        self.thread.wait(self.queued)
    }
}

fn write(
    mut parts: RecordingParts,
    items: &Receiver<Box<RecorderItem>>,
    part: &AtomicU32,
    written: &AtomicU64,
) -> Result<RecordingTotals> {
    let (mut input_count, mut silent_flushes) = (None, 0);
    loop {
        let flush_timeout = Duration::from_nanos(FLUSH_PERIOD.as_nanos().unsigned_abs());
        let item = match items.recv_timeout(flush_timeout) {
            Ok(item) => item,
            Err(RecvTimeoutError::Timeout) => {
                parts.flush()?;
                silent_flushes += 1;
                // In a silence no input brings it about.
                if silent_flushes == SYNC_PERIOD.as_nanos() / FLUSH_PERIOD.as_nanos() {
                    parts.sync()?;
                }
                continue;
            }
            Err(RecvTimeoutError::Disconnected) => break,
        };
        silent_flushes = 0;
        match *item {
            RecorderItem::Input(now, number, input) => {
                parts.record(now, number, &input)?;
                part.store(parts.part(), Ordering::Relaxed);
            }
            RecorderItem::Outputs(write) => parts.record_outputs(write)?,
            RecorderItem::End(number) => input_count = Some(number),
        }
        written.fetch_add(1, Ordering::Relaxed);
    }
    let last = input_count.unwrap_or_else(|| parts.next());
    parts.finish(last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::station::page_history::station_status;
    use posebridge_recording::container::{FORMAT, ReadError, RecordingReader};
    use posebridge_station::Station;
    use posebridge_telemetry::{LinkId, LinkState, TimeDelta};
    use std::sync::mpsc::{SyncSender, sync_channel};

    const LIMITS: RecordingLimits =
        RecordingLimits { part_bytes: None, part_duration: None, min_free_bytes: 0, output_interval: TimeDelta::ZERO };

    #[test]
    fn the_end_of_a_run_does_not_wait_for_a_disk_that_takes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let (mut recorder, stuck) = behind_a_stuck_disk(&folder.path().join("recording.mcap"));
        for n in 0..QUEUE_CAPACITY {
            recorder.record(Timestamp::from_millis(i64::try_from(n).unwrap()), Input::Tick).unwrap();
        }
        let error = format!("{:#}", recorder.finish().unwrap_err());
        assert!(error.contains("recording.mcap") && error.contains("the last 8192 items are not written"), "{error}");
        drop(stuck);
    }

    /// A recorder whose disk does nothing until the sender is dropped.
    fn behind_a_stuck_disk(path: &Path) -> (Recorder, SyncSender<()>) {
        let (stuck, gate) = sync_channel::<()>(1);
        let header = RecordingHeader { format: FORMAT, ..RecordingHeader::default() };
        let first = path.to_owned();
        let recorder = Recorder::spawn(path, 0, move || {
            assert!(gate.recv().is_err(), "it is never sent anything");
            RecordingParts::create(&first, header, LIMITS, 0)
        });
        (recorder.unwrap(), stuck)
    }

    fn some_events() -> Arc<[Event]> {
        Arc::from([Event::Link { link: LinkId(0), state: LinkState::Up }])
    }

    #[test]
    fn a_stuck_disk_holds_nobody_up_and_the_recording_says_what_it_lacks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        let (mut recorder, stuck) = behind_a_stuck_disk(&path);
        let now = |n: u64| Timestamp::from_millis(i64::try_from(n).unwrap());
        let input_count = QUEUE_CAPACITY as u64 + 500;
        for n in 0..input_count {
            recorder.record(now(n), Input::Tick).unwrap();
            recorder.record_events(now(n), &some_events());
        }
        let (lost, lost_outputs) = (recorder.lost, recorder.lost_outputs);
        // What came out gives way at half the queue, and the inputs have the other half to themselves.
        let outputs = OUTPUT_QUEUE_CAPACITY as u64 / 2;
        assert_eq!(lost_outputs, input_count - outputs);
        assert_eq!(lost, outputs + 500);
        drop(stuck);
        while !recorder.sender.is_empty() {
            assert!(!recorder.thread.is_finished(), "the recorder has stopped");
            std::thread::yield_now();
        }
        recorder.record(now(input_count), Input::Tick).unwrap();
        let kept = recorder.finish().unwrap();
        assert_eq!((kept.inputs, kept.lost), (input_count - lost + 1, lost));

        let bytes = std::fs::read(&path).unwrap();
        let found: Vec<_> = RecordingReader::open(&bytes).unwrap().collect();
        let gaps: Vec<_> = found.iter().filter_map(|item| item.as_ref().err()).collect();
        let expected = u32::try_from(input_count - lost).unwrap();
        let [ReadError::Gap { expected: at, found: next, .. }] = gaps[..] else {
            panic!("{gaps:?}");
        };
        assert_eq!((*at, u64::from(*next)), (expected, input_count));
        assert_eq!(found.last(), Some(&Ok((now(input_count), Input::Tick))));
    }

    #[test]
    fn the_recording_that_viewers_are_told_is_the_part_that_is_being_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        let header = RecordingHeader { format: FORMAT, ..RecordingHeader::default() };
        let limits = RecordingLimits { part_duration: Some(TimeDelta::from_millis(2_000)), ..LIMITS };
        let mut recorder = Recorder::start(&path, &header, limits).unwrap();
        assert_eq!(recorder.current(), path);
        for now_ms in (0..=2_500).step_by(500) {
            recorder.record(Timestamp::from_millis(now_ms), Input::Tick).unwrap();
        }
        let second = folder.path().join("recording.2.mcap");
        while recorder.current() != second {
            assert!(!recorder.thread.is_finished(), "the recorder has stopped");
            std::thread::yield_now();
        }
        assert!(second.is_file());
        let config = Config::default().station_config().unwrap();
        let station = Station::new(config, Timestamp::ZERO).unwrap();
        let status = station_status(&station, Some(&recorder));
        assert_eq!(status.recording.as_deref(), Some("recording.2.mcap"));
        assert_eq!(recorder.finish().unwrap().parts, 2);
    }

    #[test]
    fn what_is_missing_at_the_end_is_told_as_well() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        let (mut recorder, stuck) = behind_a_stuck_disk(&path);
        for n in 0..QUEUE_CAPACITY + 3 {
            let now = Timestamp::from_millis(i64::try_from(n).unwrap());
            recorder.record(now, Input::Tick).unwrap();
        }
        drop(stuck);
        let kept = recorder.finish().unwrap();
        assert_eq!((kept.inputs, kept.lost), (QUEUE_CAPACITY as u64, 3));
        let bytes = std::fs::read(&path).unwrap();
        let gap = b"\"inputs\":3";
        assert!(bytes.windows(gap.len()).any(|found| found == gap));
    }
}
