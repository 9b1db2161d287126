//! The files that a run of the engine writes as it goes: tables, a telemetry log, a ROS 2 bag.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_recording::csv::CsvWriter;
use posebridge_recording::ros2::RosBagWriter;
use posebridge_telemetry::{Event, HostClock, Input, LinkId, Priority, Timestamp};

use super::atomic_file::AtomicFile;
use crate::console::print_line;
use crate::station::tlog_writer::TrafficLog;
use crate::tools::ros2_bag::METADATA;

/// The folder for the files, and the recording after which they are named.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutputFolder<'a> {
    pub(super) folder: &'a Path,
    pub(super) recording: &'a Path,
}

impl OutputFolder<'_> {
    /// Creates `NAME` and the suffix in the folder; never overwrites a file.
    pub(super) fn create_new(self, suffix: &str) -> Result<(File, AtomicFile)> {
        AtomicFile::create(self.folder.join(format!("{}{suffix}", self.stem())))
    }

    /// The recording's name without its extensions.
    pub(super) fn stem(self) -> String {
        stem(self.recording)
    }
}

fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let without = Path::new(name).file_stem().unwrap_or_default();
    without.to_string_lossy().into_owned()
}

pub(super) fn print_written(path: &Path, count: u64, what: &str) {
    print_line(&format!("wrote `{}`: {count} {what}", path.display()));
}

/// Those that were asked for.
#[derive(Default)]
pub(super) struct RunFiles {
    csv: Option<(CsvWriter<'static, File>, PathBuf)>,
    tlog: Option<(TrafficLog<BufWriter<File>>, AtomicFile)>,
    bag: Option<(RosBagWriter<File>, BagFolder, AtomicFile)>,
}

/// A bag as rosbag2 makes it: a folder with its storage and `metadata.yaml`.
struct BagFolder {
    path: PathBuf,
    /// Of the storage.
    file: String,
}

impl RunFiles {
    /// Tables in a folder; overwrites those of an earlier export.
    pub(super) fn add_tables(&mut self, folder: &Path) {
        let folder = folder.to_owned();
        let to = folder.clone();
        self.csv = Some((CsvWriter::new(move |name: &str| File::create(to.join(format!("{name}.csv")))), folder));
    }

    pub(super) fn add_traffic(&mut self, log: TrafficLog<BufWriter<File>>, file: AtomicFile) {
        self.tlog = Some((log, file));
    }

    /// `utc_start_micros` is the Unix time of the host clock's zero.
    pub(super) fn add_bag(&mut self, output: OutputFolder<'_>, utc_start_micros: u64) -> Result<()> {
        let name = format!("{}-ros2", output.stem());
        let folder = BagFolder { path: output.folder.join(&name), file: format!("{name}_0.mcap") };
        let (out, file) = AtomicFile::create_in_folder(&folder.path, &folder.file)?;
        self.bag = Some((RosBagWriter::create(out, utc_start_micros)?, folder, file));
        Ok(())
    }

    pub(super) fn record_input(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<()> {
        if let (Some((tlog, _)), Input::Bytes { link, peer, bytes }) = (&mut self.tlog, input) {
            tlog.received(now, *link, *peer, bytes).context("writing the telemetry log")?;
        }
        Ok(())
    }

    pub(super) fn record_event(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        if let Some((csv, _)) = &mut self.csv {
            csv.record(now, event).context("writing CSV")?;
        }
        if let Some((bag, _, _)) = &mut self.bag {
            bag.record(now, event).context("writing the ROS 2 bag")?;
        }
        Ok(())
    }

    pub(super) fn record_sent(
        &mut self,
        now: Timestamp<HostClock>,
        link: LinkId,
        priority: Priority,
        bytes: &[u8],
    ) -> Result<()> {
        if let Some((tlog, _)) = &mut self.tlog {
            tlog.sent(now, link, priority, bytes).context("writing the telemetry log")?;
        }
        Ok(())
    }

    pub(super) fn finish(self) -> Result<()> {
        if let Some((csv, folder)) = self.csv {
            for (name, lines) in csv.finish().context("writing CSV")? {
                print_written(&folder.join(format!("{name}.csv")), lines, "lines");
            }
        }
        if let Some((tlog, file)) = self.tlog {
            let (_, frames) = tlog.finish().context("writing the telemetry log")?;
            print_written(file.path(), frames, "frames");
            file.finish()?;
        }
        if let Some((bag, folder, file)) = self.bag {
            let metadata = bag.metadata(&folder.file);
            let (_, messages) = bag.finish().context("writing the ROS 2 bag")?;
            file.finish()?;
            let path = folder.path.join(METADATA);
            std::fs::write(&path, metadata).with_context(|| format!("writing `{}`", path.display()))?;
            print_written(&folder.path, messages, "messages");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_named_after_its_recording() {
        assert_eq!(stem(Path::new("a/drive.2.tlog.gz")), "drive.2");
        assert_eq!(stem(Path::new("recording.mcap")), "recording");
    }
}
