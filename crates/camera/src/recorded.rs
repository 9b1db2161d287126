//! Recorded pictures, played at their own speed: videos, and folders of pictures.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use posebridge_link::transport::PICTURES_PER_SECOND;
use posebridge_link::{LinkError, OpenError};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use posebridge_vision::{AviError, AviReader, GreyPicture, Y4mReader, parse_picture_times};

use crate::capture::{Capture, CaptureError};
use crate::picture::{EncodedPicture, PictureTime};

/// The table of times in a folder of pictures.
pub(crate) const TIMES_FILE: &str = "times.csv";
const PICTURE_ENDINGS: [&str; 4] = ["jpg", "jpeg", "png", "pgm"];

/// A picture, and when it was taken since the first one, s. One that cannot be read is empty.
type TimedPicture = (f64, Vec<u8>);

trait Recording {
    /// `None` at the end.
    fn next(&mut self) -> Result<Option<TimedPicture>, CaptureError>;
}

/// Plays the file or folder of the link to its end.
pub(crate) fn play(capture: &mut Capture) -> Result<(), CaptureError> {
    let path = capture.url.path().to_owned();
    let mut recording = open(&path, f64::from(capture.url.integer(&PICTURES_PER_SECOND)))?;
    capture.report_open(format!("playing {}", path.display()));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().map_err(io_error(&path))?;
    let start = capture.timer.now();
    while let Some((time_s, bytes)) = recording.next()? {
        let due = start + TimeDelta::from_secs_f64(time_s);
        if !runtime.block_on(wait_until(capture, due)) {
            return Ok(());
        }
        capture.slot.put(EncodedPicture { time: PictureTime::Exposed { earliest: due, latest: due }, bytes });
        // Nothing of a recording is skipped.
        capture.slot.wait_until_taken();
    }
    Ok(())
}

fn open(path: &Path, pictures_per_s: f64) -> Result<Box<dyn Recording>, OpenError> {
    let missing = || OpenError::FileNotFound {
        path: path.to_owned(),
        advice: "write /dev/video0 for a webcam, http://... for a phone, a video file or a folder of pictures",
    };
    let metadata =
        path.metadata().map_err(|error| if is_missing(&error) { missing() } else { io_error(path)(error) })?;
    if metadata.is_dir() {
        return Ok(Box::new(open_folder(path, pictures_per_s)?));
    }
    let file = File::open(path).map_err(io_error(path))?;
    let refused = |reason: String| OpenError::CameraRefused { url: path.display().to_string(), reason };
    match ending(path).as_str() {
        "y4m" => Ok(Box::new(Y4mReader::new(file).map_err(|error| refused(error.to_string()))?)),
        "avi" => match AviReader::new(file) {
            Ok(reader) => Ok(Box::new(reader)),
            Err(AviError::OtherCodec { .. }) => Ok(Box::new(ConvertedVideo::open(path)?)),
            Err(error) => Err(refused(error.to_string())),
        },
        _ => Ok(Box::new(ConvertedVideo::open(path)?)),
    }
}

/// False once the link is closed.
async fn wait_until(capture: &Capture, due: Timestamp<HostClock>) -> bool {
    tokio::select! {
        () = capture.timer.sleep_until(due) => true,
        () = capture.stop.cancelled() => false,
    }
}

impl<R: Read> Recording for Y4mReader<R> {
    fn next(&mut self) -> Result<Option<TimedPicture>, CaptureError> {
        let mut picture = GreyPicture::default();
        let frame = self.read_frame(&mut picture).map_err(|error| lost(&error))?;
        Ok(frame.map(|frame| (frame.time_s, picture.to_pgm())))
    }
}

impl<R: Read> Recording for AviReader<R> {
    fn next(&mut self) -> Result<Option<TimedPicture>, CaptureError> {
        let mut picture = GreyPicture::default();
        let rate = self.rate().frames_per_second();
        match self.read_frame(&mut picture) {
            Ok(frame) => Ok(frame.map(|frame| (frame.time_s, picture.to_pgm()))),
            Err(AviError::Picture { number, .. }) => Ok(Some((number as f64 / rate, Vec::new()))),
            Err(error) => Err(lost(&error)),
        }
    }
}

/// Pictures of a folder, in their order.
struct PictureFolder {
    pictures: std::vec::IntoIter<(f64, PathBuf)>,
}

impl Recording for PictureFolder {
    fn next(&mut self) -> Result<Option<TimedPicture>, CaptureError> {
        let Some((time_s, file)) = self.pictures.next() else { return Ok(None) };
        Ok(Some((time_s, fs::read(&file).map_err(io_error(&file))?)))
    }
}

/// By the table of times, or else in the order of the names.
fn open_folder(folder: &Path, pictures_per_s: f64) -> Result<PictureFolder, OpenError> {
    let refused = |reason: String| OpenError::CameraRefused { url: folder.display().to_string(), reason };
    let table = folder.join(TIMES_FILE);
    if table.exists() {
        let text = fs::read_to_string(&table).map_err(io_error(&table))?;
        let times = parse_picture_times(&text).map_err(|error| refused(format!("{TIMES_FILE}, {error}")))?;
        let first_s = times.first().map_or(0.0, |first| first.time_s);
        let pictures: Vec<_> = times.into_iter().map(|row| (row.time_s - first_s, folder.join(row.file))).collect();
        return Ok(PictureFolder { pictures: pictures.into_iter() });
    }
    let listed = fs::read_dir(folder).and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
    let mut files: Vec<PathBuf> = listed.map_err(io_error(folder))?;
    files.retain(|path| PICTURE_ENDINGS.contains(&ending(path).as_str()));
    files.sort_unstable();
    if files.is_empty() {
        return Err(refused("the folder holds no .jpg, .png or .pgm".to_owned()));
    }
    let pictures = files.into_iter().enumerate().map(|(number, file)| (number as f64 / pictures_per_s, file));
    Ok(PictureFolder { pictures: pictures.collect::<Vec<_>>().into_iter() })
}

/// A video of any other kind, as ffmpeg decodes it.
struct ConvertedVideo {
    frames: Y4mReader<ChildStdout>,
    ffmpeg: Child,
}

impl ConvertedVideo {
    fn open(path: &Path) -> Result<Self, OpenError> {
        let started = Command::new("ffmpeg")
            .args(["-v", "error", "-i"])
            .arg(path)
            .args(["-f", "yuv4mpegpipe", "-pix_fmt", "gray", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let refused = |reason: String| OpenError::CameraRefused { url: path.display().to_string(), reason };
        let mut ffmpeg = started.map_err(|error| {
            if !is_missing(&error) {
                return io_error(Path::new("ffmpeg"))(error);
            }
            refused(
                "videos other than .y4m and .avi (MJPEG) are decoded by `ffmpeg`, which is not installed: install it, or convert the \
                 video elsewhere"
                    .to_owned(),
            )
        })?;
        let output = ffmpeg.stdout.take().ok_or_else(|| refused("ffmpeg has no output".to_owned()))?;
        let frames = Y4mReader::new(output).map_err(|_no_header| refused("ffmpeg finds no video in it".to_owned()))?;
        Ok(Self { frames, ffmpeg })
    }
}

impl Recording for ConvertedVideo {
    fn next(&mut self) -> Result<Option<TimedPicture>, CaptureError> {
        self.frames.next()
    }
}

impl Drop for ConvertedVideo {
    fn drop(&mut self) {
        // It may have ended by itself.
        drop(self.ffmpeg.kill());
        drop(self.ffmpeg.wait());
    }
}

/// In lower case.
fn ending(path: &Path) -> String {
    path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn lost(error: &dyn std::error::Error) -> CaptureError {
    CaptureError::Lost(LinkError::Camera(error.to_string()))
}

fn is_missing(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::NotFound
}

fn io_error(path: &Path) -> impl Fn(io::Error) -> OpenError {
    let what = path.display().to_string();
    move |source| OpenError::Io { what: what.clone(), source }
}
