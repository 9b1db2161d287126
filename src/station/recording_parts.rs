//! The files of a recording: consecutive parts, each readable by itself.
//! It has no thread and no queue, for tests. It flushes 600 ms after the last flush, and syncs the disk every five seconds and at
//! the end of each part. Once a second it checks that the file exists, that the disk has space, and whether the part is large or
//! old enough.

use std::fs::File;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use nix::sys::statvfs::statvfs;
use posebridge_recording::container::{
    OutputHandover, PartHeader, RecordingGap, RecordingHeader, RecordingWriter, WriteError,
};
use posebridge_telemetry::{HostClock, Input, TimeDelta, Timestamp};

use crate::config::RecordingLimits;

/// Maximum time between flushes, so that a killed program loses less than a second, with 400 ms of sparse inputs and scheduling delays
/// included. Each flush ends a chunk, whose index entry stays in memory until the part ends: more frequent flushes would let the memory
/// of a long recording grow.
pub const FLUSH_PERIOD: TimeDelta = TimeDelta::from_millis(600);
/// The error of all inputs after a part that could not be ended, or a next one that could not begin.
const RECORDING_ENDED: &str = "the recording has ended: it could not go on in another file";
/// A power cut loses what came since: each sync may hold up the disk for others.
pub const SYNC_PERIOD: TimeDelta = TimeDelta::from_millis(5_000);
const DISK_CHECK_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecordingTotals {
    pub inputs: u64,
    /// Inputs lost because the disk was too slow.
    pub lost: u64,
    pub parts: u32,
}

impl RecordingTotals {
    pub fn check_complete(self) -> Result<()> {
        ensure!(self.lost == 0, "the disk was too slow for {} inputs; a replay is not exact", self.lost);
        Ok(())
    }
}

pub struct RecordingParts {
    first: PathBuf,
    header: RecordingHeader,
    limits: RecordingLimits,
    /// The part being written; `None` after a failed change of parts.
    part: Option<OpenPart>,
    totals: RecordingTotals,
    /// Number of the next input of the session.
    next: u64,
    last: Timestamp<HostClock>,
    last_flush: Timestamp<HostClock>,
    last_sync: Timestamp<HostClock>,
    /// Nothing was written since the last sync.
    is_synced: bool,
    last_disk_check: Timestamp<HostClock>,
}

struct OpenPart {
    file: WatchedFile,
    writer: RecordingWriter<File>,
    begun: Option<Timestamp<HostClock>>,
}

impl OpenPart {
    fn create(path: &Path, header: &RecordingHeader, begins: &PartHeader, spacing: TimeDelta) -> Result<Self> {
        let (out, file) = WatchedFile::create("recording", path)?;
        let mut writer = RecordingWriter::create_part(out, header, begins).with_context(|| file.name())?;
        writer.set_output_spacing(spacing);
        Ok(Self { file, writer, begun: None })
    }
}

impl RecordingParts {
    /// Creates the first file, after `inputs_before` inputs of the session. Never overwrites a file.
    pub fn create(path: &Path, header: RecordingHeader, limits: RecordingLimits, inputs_before: u64) -> Result<Self> {
        let begins = PartHeader { inputs_before, ..PartHeader::default() };
        let part = OpenPart::create(path, &header, &begins, limits.output_interval)?;
        Ok(Self {
            first: path.to_owned(),
            header,
            limits,
            part: Some(part),
            totals: RecordingTotals { parts: 1, ..RecordingTotals::default() },
            next: inputs_before,
            last: Timestamp::ZERO,
            last_flush: Timestamp::ZERO,
            last_sync: Timestamp::ZERO,
            is_synced: false,
            last_disk_check: Timestamp::ZERO,
        })
    }

    /// Records the input with this number in the session; missing numbers before it become a gap. Fails with the reason if the
    /// recording has ended; earlier data stays readable.
    pub fn record(&mut self, now: Timestamp<HostClock>, number: u64, input: &Input) -> Result<()> {
        self.record_gap(now, number)?;
        self.check_disk(now)?;
        self.open()?.begun.get_or_insert(now);
        self.write(|writer| writer.record(now, input))?;
        self.totals.inputs += 1;
        self.next = number + 1;
        self.last = now;
        // With this input: where few come, the next one may be the one that is lost.
        if now - self.last_flush >= FLUSH_PERIOD {
            self.last_flush = now;
            self.flush()?;
        }
        if now - self.last_sync >= SYNC_PERIOD {
            self.last_sync = now;
            self.sync()?;
        }
        Ok(())
    }

    /// Brings everything to the disk, beyond the reach of a power cut.
    pub fn sync(&mut self) -> Result<()> {
        if !self.is_synced {
            self.flush()?;
            self.open()?.file.sync()?;
            self.is_synced = true;
        }
        Ok(())
    }

    /// Writes outputs of the station; `write` gets the time of the last input.
    pub fn record_outputs(
        &mut self,
        write: impl FnOnce(&mut RecordingWriter<File>, Timestamp<HostClock>) -> Result<(), WriteError>,
    ) -> Result<()> {
        let last = self.last;
        self.write(|writer| write(writer, last))
    }

    pub fn flush(&mut self) -> Result<()> {
        self.write(RecordingWriter::flush)
    }

    /// Ends the file; `input_count` is the number of the session's inputs so far.
    pub fn finish(mut self, input_count: u64) -> Result<RecordingTotals> {
        self.record_gap(self.last, input_count)?;
        self.end_part()?;
        Ok(self.totals)
    }

    pub const fn next(&self) -> u64 {
        self.next
    }

    /// Number of the part being written, from 1.
    pub const fn part(&self) -> u32 {
        self.totals.parts
    }

    fn open(&mut self) -> Result<&mut OpenPart> {
        self.part.as_mut().context(RECORDING_ENDED)
    }

    fn write(&mut self, one: impl FnOnce(&mut RecordingWriter<File>) -> Result<(), WriteError>) -> Result<()> {
        self.is_synced = false;
        let part = self.open()?;
        one(&mut part.writer).with_context(|| part.file.name())
    }

    /// Ends the part; returns its path and the state for the next.
    fn end_part(&mut self) -> Result<(PathBuf, OutputHandover)> {
        let ended = self.part.take().context(RECORDING_ENDED)?;
        let handover = ended.writer.finish_part();
        let handover = handover.with_context(|| ended.file.name())?;
        ended.file.sync()?;
        Ok((ended.file.path().to_owned(), handover))
    }

    fn record_gap(&mut self, now: Timestamp<HostClock>, number: u64) -> Result<()> {
        let inputs = number.saturating_sub(self.next);
        if inputs == 0 {
            return Ok(());
        }
        self.totals.lost += inputs;
        self.next = number;
        let gap = RecordingGap { inputs, from: self.last, to: now };
        self.write(|writer| writer.record_gap(&gap))
    }

    fn check_disk(&mut self, now: Timestamp<HostClock>) -> Result<()> {
        if now - self.last_disk_check < DISK_CHECK_PERIOD {
            return Ok(());
        }
        self.last_disk_check = now;
        let limits = self.limits;
        let part = self.open()?;
        let bytes = part.file.file_size()?;
        part.file.check_free_space(limits.min_free_bytes)?;
        let age = part.begun.map_or(TimeDelta::ZERO, |begun| now - begun);
        let is_full =
            limits.part_bytes.is_some_and(|most| bytes >= most) || limits.part_duration.is_some_and(|most| age >= most);
        if is_full { self.begin_next_part() } else { Ok(()) }
    }

    /// Ends the previous part first, so that only one index is in memory: it is a recorder's largest allocation.
    fn begin_next_part(&mut self) -> Result<()> {
        let number = self.totals.parts + 1;
        let (before, handover) = self.end_part()?;
        let begins = PartHeader {
            part: number,
            inputs_before: self.next,
            continues: before.file_name().map(|name| name.to_string_lossy().into_owned()),
        };
        let path = part_path(&self.first, number);
        let mut next = OpenPart::create(&path, &self.header, &begins, self.limits.output_interval)?;
        next.writer.restore_outputs(handover);
        self.part = Some(next);
        self.totals.parts = number;
        Ok(())
    }
}

/// The path of a part: `recording.mcap`, `recording.2.mcap`, `recording.3.mcap` and so on.
pub fn part_path(first: &Path, number: u32) -> PathBuf {
    match (number, first.extension()) {
        (..=1, _) => first.to_owned(),
        (_, Some(extension)) => {
            let extension = extension.to_string_lossy();
            first.with_extension(format!("{number}.{extension}"))
        }
        (_, None) => first.with_extension(number.to_string()),
    }
}

/// A file being written, identified by its inode.
#[derive(Debug)]
pub struct WatchedFile {
    description: &'static str,
    path: PathBuf,
    /// Another handle of the file.
    handle: File,
    /// Device and inode.
    identity: (u64, u64),
}

impl WatchedFile {
    /// Creates the file; `what` names it in errors. Never overwrites a file.
    pub fn create(what: &'static str, path: &Path) -> Result<(File, Self)> {
        let name = path.display();
        let file = File::create_new(path).with_context(|| format!("creating the {what} `{name}`"))?;
        let identity = file.metadata().map(|found| (found.dev(), found.ino()));
        let identity = identity.with_context(|| format!("looking at `{name}`"))?;
        let handle = file.try_clone().with_context(|| format!("opening `{name}` again"))?;
        if let Some(folder) = path.parent() {
            // Else a power cut could take the name away. A file system that cannot do it needs it not.
            drop(File::open(folder).and_then(|folder| folder.sync_all()));
        }
        Ok((file, Self { description: what, path: path.to_owned(), handle, identity }))
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Brings what was written to the disk.
    pub fn sync(&self) -> Result<()> {
        self.handle.sync_data().with_context(|| self.name())
    }

    pub fn name(&self) -> String {
        format!("{} `{}`", self.description, self.path.display())
    }

    /// Fails if the file was deleted or moved: further writes would be lost.
    pub fn file_size(&self) -> Result<u64> {
        let found = std::fs::metadata(&self.path).ok();
        match found.filter(|found| (found.dev(), found.ino()) == self.identity) {
            Some(found) => Ok(found.len()),
            None => bail!("{}: the file or its folder has been deleted or moved", self.name()),
        }
    }

    /// Fails if the disk has less free space.
    pub fn check_free_space(&self, floor_bytes: u64) -> Result<()> {
        // A file system that does not report its free space may have enough.
        let Ok(disk) = statvfs(&self.path) else {
            return Ok(());
        };
        let free_bytes = disk.blocks_available().saturating_mul(disk.fragment_size());
        if free_bytes >= floor_bytes {
            return Ok(());
        }
        bail!(
            "{}: the disk has {} MB left, less than `record.min_free_mb` = {}; what was written is whole",
            self.name(),
            free_bytes / 1_000_000,
            floor_bytes / 1_000_000
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_recording::container::FORMAT;

    #[test]
    fn the_disk_is_synced_every_five_seconds_and_in_a_silence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        let header = RecordingHeader { format: FORMAT, ..RecordingHeader::default() };
        let mut parts = RecordingParts::create(&path, header, RecordingLimits::default(), 0).unwrap();
        for second in 0..=12 {
            parts.record(Timestamp::from_millis(1_000 * second), parts.next(), &Input::Tick).unwrap();
            let expected_ms = second / 5 * 5_000;
            assert_eq!(
                (parts.last_sync, parts.is_synced),
                (Timestamp::from_millis(expected_ms), second > 0 && second % 5 == 0)
            );
        }
        parts.sync().unwrap();
        assert!(parts.is_synced);
    }
}
