//! The thread that looks for tags in the newest picture of a camera.

use std::sync::Arc;

use posebridge_link::HostTimer;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use posebridge_vision::{DetectedTag, GreyPicture, Tag36h11Detector, TagSearch};
use tokio::sync::mpsc::Sender;
use tokio::sync::mpsc::error::TrySendError;

use crate::picture::EncodedPicture;
use crate::picture_slot::PictureSlot;
use crate::settings::CameraSettings;
use crate::sighting::{Sighting, TaggedPicture};
use crate::tag_tracker::TagTracker;
use crate::view::{CameraCounts, SeenPicture, SeenTag};

/// Every so many pictures are searched as a whole, so that a new tag is seen within half a second.
const WHOLE_EVERY: u32 = 10;
/// A camera without tags says that it is there so often.
const HELLO_PERIOD: TimeDelta = TimeDelta::from_millis(500);

/// Searches until there are no more pictures, or nobody wants the tags.
pub(crate) fn search_pictures(
    settings: &CameraSettings,
    timer: HostTimer,
    slot: &Arc<PictureSlot>,
    found: &Sender<Sighting>,
) {
    let mut search = PictureSearch {
        settings,
        picture: GreyPicture::default(),
        detector: Tag36h11Detector::default(),
        search: TagSearch::new(WHOLE_EVERY),
        tracker: TagTracker::default(),
        counts: CameraCounts::default(),
        next_hello: timer.now(),
    };
    while let Some((picture, dropped)) = slot.take() {
        search.counts.dropped = dropped;
        let sighting = search.next(picture, timer);
        match sighting.map_or(Ok(()), |sighting| found.try_send(sighting)) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => search.counts.late += 1,
            Err(TrySendError::Closed(_)) => return,
        }
    }
}

struct PictureSearch<'a> {
    settings: &'a CameraSettings,
    picture: GreyPicture,
    detector: Tag36h11Detector,
    search: TagSearch,
    tracker: TagTracker,
    counts: CameraCounts,
    next_hello: Timestamp<HostClock>,
}

impl PictureSearch<'_> {
    fn next(&mut self, encoded: EncodedPicture, timer: HostTimer) -> Option<Sighting> {
        let decoded = self.picture.decode(&encoded.bytes).ok().and_then(|()| self.picture.image());
        let Some(image) = decoded else {
            self.counts.damaged += 1;
            return None;
        };
        let picture_px = (image.width(), image.height());
        let windows = self.tracker.windows(image.width(), image.height());
        let tags = self.search.detect(&mut self.detector, image, &windows);
        self.tracker.update(tags.iter().filter(|tag| !self.settings.floor_tags.contains(&tag.id)));
        self.counts.searched += 1;
        let now = timer.now();
        self.counts.age = now - encoded.time.since();
        self.settings.view.publish(|| SeenPicture {
            bytes: encoded.bytes.into(),
            width: picture_px.0,
            height: picture_px.1,
            tags: tags.iter().map(SeenTag::from).collect(),
            at: now,
            counts: self.counts,
        });
        if !tags.is_empty() {
            self.next_hello = now + HELLO_PERIOD;
            return Some(Sighting::Tags(TaggedPicture { tags, picture_px, time: encoded.time }));
        }
        if now < self.next_hello {
            return None;
        }
        self.next_hello = now + HELLO_PERIOD;
        Some(Sighting::Nothing)
    }
}

impl From<&DetectedTag> for SeenTag {
    fn from(tag: &DetectedTag) -> Self {
        Self { id: tag.id, corners: tag.corners, margin: tag.margin }
    }
}
