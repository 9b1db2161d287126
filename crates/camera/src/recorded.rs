//! Recorded pictures, played at their own speed.

use std::path::{Path, PathBuf};
use std::{fs, io};

use posebridge_link::OpenError;
use posebridge_link::transport::PICTURES_PER_SECOND;
use posebridge_telemetry::{TimeDelta, Timestamp};

use crate::capture::{Capture, CaptureError};
use crate::picture::{EncodedPicture, PictureTime};

/// Plays a folder of pictures, in the order of their names.
pub(crate) fn play(capture: &mut Capture) -> Result<(), CaptureError> {
    let path = capture.url.path().to_owned();
    let pictures = pictures_of(&path)?;
    capture.report_open(format!("{} pictures of {}", pictures.len(), path.display()));
    let period = TimeDelta::from_secs_f64(1.0 / f64::from(capture.url.integer(&PICTURES_PER_SECOND)));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().map_err(io_error(&path))?;
    let mut due = capture.timer.now();
    for file in pictures {
        let bytes = fs::read(&file).map_err(io_error(&file))?;
        if !runtime.block_on(wait_until(capture, due)) {
            return Ok(());
        }
        capture.slot.put(EncodedPicture { time: PictureTime::Exposed { earliest: due, latest: due }, bytes });
        capture.slot.wait_until_taken();
        due = due + period;
    }
    Ok(())
}

/// False once the link is closed.
async fn wait_until(capture: &Capture, due: Timestamp<posebridge_telemetry::HostClock>) -> bool {
    tokio::select! {
        () = capture.timer.sleep_until(due) => true,
        () = capture.stop.cancelled() => false,
    }
}

fn pictures_of(folder: &Path) -> Result<Vec<PathBuf>, OpenError> {
    let listed = fs::read_dir(folder).and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
    let mut files: Vec<PathBuf> = listed.map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => OpenError::FileNotFound {
            path: folder.to_owned(),
            advice: "write /dev/video0 for a webcam, http://... for a phone, or a folder of pictures",
        },
        _ => io_error(folder)(error),
    })?;
    let is_picture = |path: &PathBuf| {
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        ["jpg", "jpeg", "png", "pgm"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    };
    files.retain(is_picture);
    files.sort_unstable();
    if files.is_empty() {
        let reason = "the folder holds no .jpg, .png or .pgm".to_owned();
        return Err(OpenError::CameraRefused { url: folder.display().to_string(), reason });
    }
    Ok(files)
}

fn io_error(path: &Path) -> impl Fn(io::Error) -> OpenError {
    let what = path.display().to_string();
    move |source| OpenError::Io { what: what.clone(), source }
}
