//! The thread that takes the pictures of a camera.

use std::os::unix::fs::FileTypeExt as _;
use std::path::Path;
use std::sync::Arc;
use std::{io, thread};

use posebridge_link::{HostTimer, LinkError, LinkUrl, OpenError};
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use crate::capture::{Capture, CaptureError};
use crate::picture_slot::{PictureSlot, StreamEnd};
use crate::{http_stream, recorded, webcam};

/// A thread that takes pictures. It ends when this is dropped.
pub(crate) struct RunningCapture {
    pub(crate) slot: Arc<PictureSlot>,
    stop: CancellationToken,
}

impl RunningCapture {
    /// Starts the thread. What is received tells whether the camera could be opened, and its description.
    pub(crate) fn start(
        url: LinkUrl,
        timer: HostTimer,
    ) -> Result<(Self, oneshot::Receiver<Result<String, OpenError>>), OpenError> {
        let (opened, is_open) = oneshot::channel();
        let (slot, stop) = (Arc::new(PictureSlot::default()), CancellationToken::new());
        let what = url.to_string();
        let capture = Capture { url, timer, slot: Arc::clone(&slot), stop: stop.clone(), opened: Some(opened) };
        spawn("camera", what, move || run(capture))?;
        Ok((Self { slot, stop }, is_open))
    }
}

impl Drop for RunningCapture {
    fn drop(&mut self) {
        self.stop.cancel();
        self.slot.end(StreamEnd::Finished);
    }
}

fn run(mut capture: Capture) {
    let target = capture.url.path().to_string_lossy().into_owned();
    let ended = if target.contains("://") {
        http_stream::receive(&mut capture, &target)
    } else if is_device(capture.url.path()) {
        webcam::receive(&mut capture)
    } else {
        recorded::play(&mut capture)
    };
    match (capture.opened.take(), ended) {
        (Some(opened), Err(CaptureError::Open(error))) => drop(opened.send(Err(error))),
        (_, Err(CaptureError::Open(error))) => capture.slot.end(StreamEnd::Lost(LinkError::Camera(error.to_string()))),
        (_, Err(CaptureError::Lost(error))) => capture.slot.end(StreamEnd::Lost(error)),
        (_, Ok(())) => capture.slot.end(StreamEnd::Finished),
    }
}

pub(crate) fn spawn(name: &str, what: String, work: impl FnOnce() + Send + 'static) -> Result<(), OpenError> {
    let started = thread::Builder::new().name(name.to_owned()).spawn(work);
    started.map(drop).map_err(|source| OpenError::Io { what, source })
}

pub(crate) fn died(what: String) -> OpenError {
    OpenError::Io { what, source: io::Error::other("the thread of its pictures died") }
}

/// A webcam, also one that is not plugged in.
fn is_device(path: &Path) -> bool {
    let is_device = |metadata: std::fs::Metadata| metadata.file_type().is_char_device();
    path.metadata().map_or_else(|_missing| path.starts_with("/dev"), is_device)
}
