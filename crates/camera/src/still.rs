//! One picture of a camera.

use posebridge_link::{HostTimer, LinkUrl};

use crate::capture_thread::{RunningCapture, died};
use crate::picture_slot::StreamEnd;

/// So many pictures are passed over: a webcam's automatic exposure begins in the dark.
const SKIPPED: usize = 10;

/// Takes a picture by the camera of a `camera:` URL: JPEG, PNG or PGM. The text of an error is for people.
pub fn take_picture(url: &LinkUrl) -> Result<Vec<u8>, String> {
    let (capture, is_open) =
        RunningCapture::start(url.clone(), HostTimer::start()).map_err(|error| error.to_string())?;
    let opened = is_open.blocking_recv().unwrap_or_else(|_ended| Err(died(url.to_string())));
    opened.map_err(|error| error.to_string())?;
    let mut last = None;
    for _ in 0..=SKIPPED {
        let Some((picture, _)) = capture.slot.take() else { break };
        last = Some(picture.bytes);
    }
    last.ok_or_else(|| match capture.slot.take_end() {
        Some(StreamEnd::Lost(error)) => error.to_string(),
        Some(StreamEnd::Finished) | None => format!("{url} gives no picture"),
    })
}
