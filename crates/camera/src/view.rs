//! What a camera shows people: its latest picture with the tags in it, and how it fares.

use std::sync::Arc;

use nalgebra::Point2;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use tokio::sync::watch;

/// A searched picture.
#[derive(Clone, Debug)]
pub struct SeenPicture {
    /// JPEG, PNG or PGM, as it came.
    pub bytes: Arc<[u8]>,
    pub width: usize,
    pub height: usize,
    pub tags: Vec<SeenTag>,
    /// When the search ended.
    pub at: Timestamp<HostClock>,
    pub counts: CameraCounts,
}

/// A tag in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenTag {
    pub id: u16,
    /// The tag's upper left corner first, clockwise, px.
    pub corners: [Point2<f64>; 4],
    /// Mean distance of the bits from the level between black and white, grey levels.
    pub margin: f64,
}

/// Counts of a camera since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CameraCounts {
    /// Pictures that were searched.
    pub searched: u64,
    /// Pictures that a newer one replaced before they were searched.
    pub dropped: u64,
    /// Pictures that could not be decoded.
    pub damaged: u64,
    /// Searched pictures that were not taken by the station in time.
    pub late: u64,
    /// Searched pictures that the disk was too slow to keep.
    pub unsaved: u64,
    /// Time between the reception of the last picture, or its exposure where that is known, and the end of its search.
    pub age: TimeDelta,
}

/// The newest picture of a camera, for the page; readers see the last one only.
#[derive(Clone, Debug)]
pub struct CameraView(watch::Sender<Option<SeenPicture>>);

impl Default for CameraView {
    fn default() -> Self {
        Self(watch::Sender::new(None))
    }
}

impl CameraView {
    pub fn subscribe(&self) -> watch::Receiver<Option<SeenPicture>> {
        self.0.subscribe()
    }

    /// Without a reader nothing is copied.
    pub(crate) fn publish(&self, picture: impl FnOnce() -> SeenPicture) {
        if self.0.receiver_count() > 0 {
            self.0.send_replace(Some(picture()));
        }
    }
}
