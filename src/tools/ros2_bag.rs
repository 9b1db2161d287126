//! ROS 2 bags as foreign recordings: their files, and the descriptor that is made for them.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use flate2::read::MultiGzDecoder;
use posebridge_recording::ros2::bag::{BagPlan, BagSummary, WheelGeometry};

use crate::console::print_lines;
use crate::station::input_file::{InputFile, InputKind};
use crate::text_file::read_text;

/// The description that rosbag2 writes into the folder of a bag.
pub(super) const METADATA: &str = "metadata.yaml";

/// Whether a path is a bag: a folder, whose files [`open`] checks, or a file that says so itself.
pub fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        return true;
    }
    let is_descriptor = path.extension().is_some_and(|extension| extension == "toml");
    !is_descriptor && InputFile::open(path).is_ok_and(|file| file.kind == InputKind::Descriptor)
}

/// Reads a bag and chooses what is taken of it; says so.
pub fn plan(path: &Path, geometry: WheelGeometry) -> Result<BagPlan> {
    let name = path.display();
    let input = open(path).with_context(|| format!("reading the bag `{name}`"))?;
    let summary = BagSummary::read(BufReader::new(input)).with_context(|| format!("bag `{name}`"))?;
    print_lines(&summary.notes());
    let run = path.file_stem().unwrap_or_default().to_string_lossy();
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let plan = BagPlan::new(&summary, &run, &file, geometry).with_context(|| format!("bag `{name}`"))?;
    print_lines(&plan.report);
    Ok(plan)
}

/// The bytes of a bag: of a file, or of the files of a folder, one after the other. A read of no bytes is the end of a file.
pub fn open(path: &Path) -> io::Result<Box<dyn Read>> {
    if !path.is_dir() {
        let file = File::open(path)?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let is_packed = has_ending(&stem, "mcap") && path.extension().is_some_and(|extension| extension == "gz");
        return Ok(if is_packed { Box::new(MultiGzDecoder::new(file)) } else { Box::new(file) });
    }
    let files = files(path).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, format!("{error:#}")))?;
    Ok(Box::new(FileSequence { files: files.into_iter(), open: None }))
}

/// Files that are read one after another.
struct FileSequence {
    files: std::vec::IntoIter<PathBuf>,
    open: Option<File>,
}

impl Read for FileSequence {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.open.is_none() {
            self.open = self.files.next().map(File::open).transpose()?;
        }
        let Some(file) = &mut self.open else { return Ok(0) };
        let read = file.read(buffer)?;
        if read == 0 && !buffer.is_empty() {
            self.open = None;
        }
        Ok(read)
    }
}

/// The files of a bag in their order: those of its metadata, else all of the folder by name.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let metadata = folder.join(METADATA);
    let mut names = Vec::new();
    if metadata.is_file() {
        let name = metadata.display();
        let text = read_text(&metadata).with_context(|| format!("reading `{name}`"))?;
        if let Some(mode) = value_of(&text, "compression_mode").filter(|mode| !mode.is_empty() && *mode != "storage") {
            let mode = mode.to_ascii_lowercase();
            ensure!(
                mode == "none",
                "`{name}`: the bag is compressed by `{mode}`: only the compression of the storage itself is read; \
                 write it again with `ros2 bag convert`"
            );
        }
        names = file_names(&text);
    }
    if names.is_empty() {
        let found = std::fs::read_dir(folder).with_context(|| format!("reading the folder `{}`", folder.display()))?;
        for entry in found {
            names.push(entry?.file_name().to_string_lossy().into_owned());
        }
        names.retain(|name| has_ending(name, "mcap") || has_ending(name, "db3"));
        names.sort();
        let is_other = |name: &&String| {
            has_ending(name, "mcap")
                && InputFile::open(&folder.join(name)).is_ok_and(|file| file.kind != InputKind::Descriptor)
        };
        if let Some(name) = names.iter().find(is_other) {
            bail!(
                "the folder `{}` has no {METADATA}, and its file `{name}` is no ROS 2 bag: name the file that is meant",
                folder.display()
            );
        }
    }
    if let Some(name) = names.iter().find(|name| !has_ending(name, "mcap")) {
        bail!(
            "`{}`: `{name}` is not MCAP: convert the bag with `ros2 bag convert`, or `rosbags-convert --dst-storage mcap`",
            folder.display()
        );
    }
    ensure!(!names.is_empty(), "the folder `{}` holds no file of a bag (*.mcap)", folder.display());
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

fn has_ending(name: &str, ending: &str) -> bool {
    Path::new(name).extension().is_some_and(|found| found == ending)
}

/// The list below `relative_file_paths`. Only names within the folder: older versions of rosbag2 put its name before them.
fn file_names(metadata: &str) -> Vec<String> {
    let mut lines = metadata.lines().map(str::trim).skip_while(|line| !line.starts_with("relative_file_paths:"));
    let first = lines.next().and_then(|line| line.split_once(':')).map_or("", |(_, list)| list.trim());
    let inline =
        first.trim_start_matches('[').trim_end_matches(']').split(',').map(str::trim).filter(|one| !one.is_empty());
    let below = lines.map_while(|line| line.strip_prefix("- ")).map(str::trim);
    let name = |entry: &str| entry.trim_matches(['"', '\'']).rsplit('/').next().unwrap_or_default().to_owned();
    inline.chain(below).map(name).filter(|name| !name.is_empty() && name != "..").collect()
}

fn value_of<'a>(metadata: &'a str, key: &str) -> Option<&'a str> {
    let entries = metadata.lines().filter_map(|line| line.trim().split_once(':'));
    let mut values = entries.filter(|(name, _)| *name == key);
    values.next().map(|(_, value)| value.trim().trim_matches(['"', '\'']))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_of_a_bag_are_those_of_its_metadata_and_lie_in_its_folder() {
        let text = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - drive_0.mcap\n    - \"old/drive_1.mcap\"\n  \
                    duration:\n    - 4\n";
        assert_eq!(file_names(text), ["drive_0.mcap", "drive_1.mcap"]);
        assert_eq!(file_names("relative_file_paths: [a.mcap, '../../b.mcap']"), ["a.mcap", "b.mcap"]);
        assert!(file_names("files: 3").is_empty());
        assert_eq!(value_of("  compression_mode: \"FILE\"\n", "compression_mode"), Some("FILE"));
    }

    #[test]
    fn a_folder_without_a_bag_and_one_with_a_database_say_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let error = files(folder.path()).unwrap_err().to_string();
        assert!(error.contains("holds no file of a bag"), "{error}");
        std::fs::write(folder.path().join("drive_0.db3"), "").unwrap();
        let error = files(folder.path()).unwrap_err().to_string();
        assert!(error.contains("rosbags-convert"), "{error}");
    }
}
