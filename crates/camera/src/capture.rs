//! What a thread that takes the pictures of a camera works with.

use std::sync::Arc;

use posebridge_link::{HostTimer, LinkError, LinkUrl, OpenError};
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use crate::picture_slot::{PictureSlot, StreamEnd};

pub(crate) struct Capture {
    pub(crate) url: LinkUrl,
    pub(crate) timer: HostTimer,
    pub(crate) slot: Arc<PictureSlot>,
    pub(crate) stop: CancellationToken,
    /// Told once when pictures can be expected, with words for people.
    pub(crate) opened: Option<oneshot::Sender<Result<String, OpenError>>>,
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

impl Capture {
    /// The camera is open.
    pub(crate) fn report_open(&mut self, detail: String) {
        if let Some(opened) = self.opened.take() {
            // Nobody waits any more if the link was closed meanwhile.
            drop(opened.send(Ok(detail)));
        }
    }
}

impl Drop for Capture {
    /// Without an end the search would wait for ever, whatever became of this thread.
    fn drop(&mut self) {
        self.slot.end(StreamEnd::Lost(LinkError::Camera("the thread of its pictures died".to_owned())));
    }
}
