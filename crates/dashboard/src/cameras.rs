//! Cameras whose pictures the page shows.

use std::sync::Arc;

use posebridge_telemetry::{HostClock, LinkId, TimeDelta, Timestamp};

use crate::model::{CameraPictureRow, CameraRow, SeenTagRow};

/// A camera of the station.
pub struct CameraSource {
    pub link: LinkId,
    pub name: String,
    /// Whether it is known where it stands.
    pub is_calibrated: bool,
    /// The first and the last tag of the floor sheet.
    pub floor_tags: [u16; 2],
    /// The last searched picture; `None` before the first one.
    pub latest: Box<dyn Fn() -> Option<CameraPicture> + Send + Sync>,
    /// The same as JPEG or PNG.
    pub bytes: Box<dyn Fn() -> Option<Arc<[u8]>> + Send + Sync>,
}

/// A searched picture of a camera.
#[derive(Clone, Debug)]
pub struct CameraPicture {
    pub width: usize,
    pub height: usize,
    pub tags: Vec<SeenTagRow>,
    /// When its search ended.
    pub at: Timestamp<HostClock>,
    /// From its reception, or its exposure where that is known, to the end of its search.
    pub latency: TimeDelta,
    /// Since the camera was opened: pictures that were searched, replaced by newer ones, and not decoded.
    pub searched: u64,
    pub dropped: u64,
    pub damaged: u64,
}

impl CameraSource {
    pub(crate) fn row(&self, now: Timestamp<HostClock>) -> CameraRow {
        let picture = (self.latest)().map(|picture| CameraPictureRow {
            number: picture.searched,
            dropped: picture.dropped,
            damaged: picture.damaged,
            width: picture.width,
            height: picture.height,
            age_s: (now - picture.at).as_secs_f64(),
            latency_s: picture.latency.as_secs_f64(),
            tags: picture.tags,
        });
        CameraRow {
            link: self.link.0,
            name: self.name.clone(),
            is_calibrated: self.is_calibrated,
            floor_tags: self.floor_tags,
            picture,
        }
    }
}

/// The media type of a picture.
pub(crate) const fn media_type(bytes: &[u8]) -> &'static str {
    match bytes {
        [0xFF, 0xD8, ..] => "image/jpeg",
        _ => "image/png",
    }
}
