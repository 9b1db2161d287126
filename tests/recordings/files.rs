//! The files of a recording when they grow, when the disk fills and when somebody takes them away: each ends readable, and what they
//! lack is said.

use std::path::{Path, PathBuf};

use posebridge::config::RecordingLimits;
use posebridge::station::recorder::Recorder;
use posebridge::station::recording_parts::{RecordingParts, part_path};
use posebridge_recording::container::{FORMAT, RecordingEnd, RecordingHeader, RecordingReader};
use posebridge_telemetry::{HostClock, Input, LinkId, PeerId, TimeDelta, Timestamp};

type Recorded = (Timestamp<HostClock>, Input);

/// Neither parts nor a floor.
const UNLIMITED: RecordingLimits =
    RecordingLimits { part_bytes: None, part_duration: None, min_free_bytes: 0, output_interval: TimeDelta::ZERO };

fn header() -> RecordingHeader {
    RecordingHeader { format: FORMAT, utc_start_micros: 1_700_000_000_000_000, ..RecordingHeader::default() }
}

/// One input of 400 bytes every 20 ms.
fn inputs(count: i64) -> Vec<Recorded> {
    let input = |n: i64| {
        let bytes = vec![n as u8; 400];
        let (link, peer) = (LinkId(0), PeerId::default());
        (Timestamp::from_millis(20 * n), Input::Bytes { link, peer, bytes })
    };
    (0..count).map(input).collect()
}

fn record(parts: &mut RecordingParts, inputs: &[Recorded]) -> anyhow::Result<()> {
    for (now, input) in inputs {
        parts.record(*now, parts.next(), input)?;
    }
    Ok(())
}

/// What a file holds; it must have ended properly.
fn whole(path: &Path) -> Vec<Recorded> {
    let bytes = std::fs::read(path).unwrap();
    let reader = RecordingReader::open(&bytes).unwrap();
    assert_eq!(reader.recording_end(), RecordingEnd::Complete, "{}", path.display());
    reader.map(Result::unwrap).collect()
}

/// Records until an error, which is told; the file is then closed.
fn error_of(path: &Path, limits: RecordingLimits, before: impl FnOnce()) -> String {
    let mut parts = RecordingParts::create(path, header(), limits, 0).unwrap();
    let all = inputs(400);
    record(&mut parts, &all[..40]).unwrap();
    before();
    format!("{:#}", record(&mut parts, &all[40..]).unwrap_err())
}

/// The parts hold everything once, in order, each with the number of its first input; gives where each begins.
fn joined(first: &Path, count: u32, all: &[Recorded]) -> Vec<PathBuf> {
    let paths: Vec<PathBuf> = (1..=count).map(|number| part_path(first, number)).collect();
    let mut found = Vec::new();
    for (index, path) in paths.iter().enumerate() {
        let bytes = std::fs::read(path).unwrap();
        let begins = RecordingReader::open(&bytes).unwrap().part_header().clone();
        assert_eq!(begins.part as usize, index + 1);
        assert_eq!(begins.inputs_before, found.len() as u64);
        let before = index.checked_sub(1).map(|before| &paths[before]);
        let name = before.map(|path| path.file_name().unwrap().to_str().unwrap());
        assert_eq!(begins.continues.as_deref(), name);
        found.extend(whole(path));
    }
    assert_eq!(found, all);
    paths
}

#[test]
fn a_large_or_old_recording_goes_on_in_another_file_without_a_gap() {
    let by_size = RecordingLimits { part_bytes: Some(100_000), ..UNLIMITED };
    let by_age = RecordingLimits { part_duration: Some(TimeDelta::from_millis(5_000)), ..UNLIMITED };
    // The size is looked at once a second, in which 25 kB come.
    for (limits, parts_expected, largest_bytes) in [(by_size, 4..=5, 140_000), (by_age, 3..=4, u64::MAX)] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        let all = inputs(1_000);
        let mut parts = RecordingParts::create(&path, header(), limits, 0).unwrap();
        record(&mut parts, &all).unwrap();
        let kept = parts.finish(1_000).unwrap();
        assert_eq!((kept.inputs, kept.lost), (1_000, 0));
        assert!(parts_expected.contains(&kept.parts), "{kept:?}");
        for path in joined(&path, kept.parts, &all) {
            assert!(std::fs::metadata(path).unwrap().len() < largest_bytes);
        }
        assert!(folder.path().join("recording.2.mcap").exists());
    }
}

#[test]
fn a_part_that_cannot_be_begun_leaves_the_one_before_complete() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.mcap");
    let limits = RecordingLimits { part_duration: Some(TimeDelta::from_millis(2_000)), ..UNLIMITED };
    std::fs::write(folder.path().join("recording.2.mcap"), "somebody's").unwrap();
    let mut parts = RecordingParts::create(&path, header(), limits, 0).unwrap();
    let told = record(&mut parts, &inputs(1_000)).unwrap_err();
    assert!(format!("{told:#}").contains("recording.2.mcap"), "{told:#}");
    let told = parts.flush().unwrap_err().to_string();
    assert!(told.contains("has ended"), "{told}");
    drop(parts);
    let kept = whole(&path);
    assert_eq!(kept, inputs(kept.len() as i64));
    assert!((90..300).contains(&kept.len()), "{}", kept.len());
    let others = std::fs::read_to_string(folder.path().join("recording.2.mcap"));
    assert_eq!(others.unwrap(), "somebody's");
}

#[test]
fn a_disk_without_room_ends_the_recording_and_what_was_written_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.mcap");
    let limits = RecordingLimits { min_free_bytes: u64::MAX, ..UNLIMITED };
    let error = error_of(&path, limits, || {});
    assert!(error.contains("record.min_free_mb"), "{error}");
    assert!(error.contains("recording.mcap"), "{error}");
    let kept = whole(&path);
    assert_eq!(kept, inputs(kept.len() as i64));
    assert!(kept.len() >= 40, "{}", kept.len());
}

#[test]
fn a_folder_that_is_moved_ends_the_recording_and_its_file_is_whole_where_it_went() {
    let folder = tempfile::tempdir().unwrap();
    let (here, there) = (folder.path().join("here"), folder.path().join("there"));
    std::fs::create_dir(&here).unwrap();
    let path = here.join("recording.mcap");
    let error = error_of(&path, UNLIMITED, || {
        std::fs::rename(&here, &there).unwrap();
        // Another file in its place is not ours.
        std::fs::create_dir(&here).unwrap();
        std::fs::write(&path, "a note").unwrap();
    });
    assert!(error.contains("deleted or moved"), "{error}");
    let kept = whole(&there.join("recording.mcap"));
    assert_eq!(kept, inputs(kept.len() as i64));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "a note");
}

#[test]
#[cfg(target_os = "linux")]
fn a_device_that_is_full_fails_when_the_header_is_written() {
    let full = std::fs::File::options().write(true).open("/dev/full");
    let writer = posebridge_recording::container::RecordingWriter::create(full.unwrap(), &header());
    let error = anyhow::Error::from(writer.err().unwrap());
    assert!(format!("{error:#}").contains("No space left"), "{error:#}");
}

#[test]
fn a_recording_that_begins_in_the_session_says_so_and_numbers_its_inputs_by_the_session() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("later.mcap");
    let all = inputs(100);
    let mut recorder = Recorder::start_in_session(&path, &header(), UNLIMITED, 60).unwrap();
    for (now, input) in &all[60..] {
        recorder.record(*now, input.clone()).unwrap();
    }
    let kept = recorder.stop().wait().unwrap();
    assert_eq!((kept.inputs, kept.lost), (40, 0));
    assert_eq!(whole(&path), all[60..]);
    let bytes = std::fs::read(&path).unwrap();
    let begins = RecordingReader::open(&bytes).unwrap().part_header().clone();
    assert_eq!((begins.inputs_before, begins.continues), (60, None));
}
