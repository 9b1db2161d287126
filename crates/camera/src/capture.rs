//! The thread that takes the pictures of a camera.

use std::os::unix::fs::FileTypeExt as _;
use std::path::Path;
use std::sync::Arc;
use std::{io, thread};

use posebridge_link::{HostTimer, LinkError, LinkUrl, OpenError};
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use crate::picture_slot::{PictureSlot, StreamEnd};
use crate::{http_stream, recorded, webcam};

/// What the thread works with.
pub(crate) struct Capture {
    pub(crate) url: LinkUrl,
    pub(crate) timer: HostTimer,
    pub(crate) slot: Arc<PictureSlot>,
    pub(crate) stop: CancellationToken,
    /// Told once when pictures can be expected, with words for people.
    opened: Option<oneshot::Sender<Result<String, OpenError>>>,
}

/// A thread that takes pictures. It ends when this is dropped.
pub(crate) struct RunningCapture {
    pub(crate) slot: Arc<PictureSlot>,
    stop: CancellationToken,
}

/// Why no more pictures come.
#[derive(Debug)]
pub(crate) enum CaptureError {
    Open(OpenError),
    Lost(LinkError),
}

impl From<OpenError> for CaptureError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
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
        spawn("camera", what, move || capture.run())?;
        Ok((Self { slot, stop }, is_open))
    }
}

impl Drop for RunningCapture {
    fn drop(&mut self) {
        self.stop.cancel();
        self.slot.end(StreamEnd::Finished);
    }
}

impl Capture {
    /// The camera is open.
    pub(crate) fn report_open(&mut self, detail: String) {
        if let Some(opened) = self.opened.take() {
            // Nobody waits any more if the link was closed meanwhile.
            drop(opened.send(Ok(detail)));
        }
    }

    fn run(mut self) {
        let target = self.url.path().to_string_lossy().into_owned();
        let ended = if target.contains("://") {
            http_stream::receive(&mut self, &target)
        } else if is_device(self.url.path()) {
            webcam::receive(&mut self)
        } else {
            recorded::play(&mut self)
        };
        match (self.opened.take(), ended) {
            (Some(opened), Err(CaptureError::Open(error))) => drop(opened.send(Err(error))),
            (_, Err(CaptureError::Open(error))) => self.slot.end(StreamEnd::Lost(LinkError::Camera(error.to_string()))),
            (_, Err(CaptureError::Lost(error))) => self.slot.end(StreamEnd::Lost(error)),
            (_, Ok(())) => self.slot.end(StreamEnd::Finished),
        }
    }
}

impl Drop for Capture {
    /// Without an end the search would wait for ever, whatever became of this thread.
    fn drop(&mut self) {
        self.slot.end(StreamEnd::Lost(LinkError::Camera("the thread of its pictures died".to_owned())));
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
