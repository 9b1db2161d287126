//! The thread that looks for tags in the newest picture of a camera.

use std::sync::Arc;

use posebridge_link::{HostTimer, LinkError};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use posebridge_vision::{DetectedTag, GreyPicture, PictureError, Tag36h11Detector, TagSearch};
use tokio::sync::mpsc::Sender;
use tokio::sync::mpsc::error::TrySendError;

use crate::picture::EncodedPicture;
use crate::picture_slot::{PictureSlot, StreamEnd};
use crate::settings::CameraSettings;
use crate::sighting::{Sighting, TaggedPicture};
use crate::tag_tracker::TagTracker;
use crate::view::{CameraCounts, SeenPicture, SeenTag};

/// Every so many pictures are searched as a whole, so that a new tag is seen within half a second.
const WHOLE_EVERY: u32 = 10;
/// After so many pictures in a row that cannot be decoded the camera is lost, with the reason: it may begin anew.
const MAX_DAMAGED_IN_A_ROW: u32 = 60;
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
        still_tags: Vec::new(),
        damaged_in_a_row: 0,
        next_hello: timer.now(),
    };
    while let Some((picture, dropped)) = slot.take() {
        search.counts.dropped = dropped;
        let sighting = match search.next(picture, timer) {
            Ok(sighting) => sighting,
            Err(error) if search.damaged_in_a_row >= MAX_DAMAGED_IN_A_ROW => {
                let text = format!("{MAX_DAMAGED_IN_A_ROW} pictures in a row cannot be decoded: {error}");
                return slot.end(StreamEnd::Lost(LinkError::Camera(text)));
            }
            Err(_) => None,
        };
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
    /// Tags of the floor, for people, with the number of the picture in which each was seen last: windows leave them out.
    still_tags: Vec<(SeenTag, u64)>,
    damaged_in_a_row: u32,
    next_hello: Timestamp<HostClock>,
}

impl PictureSearch<'_> {
    fn next(&mut self, encoded: EncodedPicture, timer: HostTimer) -> Result<Option<Sighting>, PictureError> {
        if let Err(error) = self.picture.decode(&encoded.bytes) {
            self.counts.damaged += 1;
            self.damaged_in_a_row += 1;
            return Err(error);
        }
        self.damaged_in_a_row = 0;
        let Some(image) = self.picture.image() else { return Ok(None) };
        let picture_px = (image.width(), image.height());
        let windows = self.tracker.windows(image.width(), image.height());
        let tags = self.search.detect(&mut self.detector, image, &windows);
        self.tracker.update(tags.iter().filter(|tag| !self.settings.floor_tags.contains(&tag.id)));
        self.counts.searched += 1;
        let now = timer.now();
        self.counts.age = now - encoded.time.since();
        let bytes: Arc<[u8]> = encoded.bytes.into();
        if let Some(saver) = &self.settings.saver
            && !saver.save(encoded.time.since(), &bytes)
        {
            self.counts.unsaved += 1;
        }
        self.update_still_tags(&tags);
        let still =
            self.still_tags.iter().map(|(tag, _)| *tag).filter(|still| tags.iter().all(|tag| tag.id != still.id));
        self.settings.view.publish(|| SeenPicture {
            bytes,
            width: picture_px.0,
            height: picture_px.1,
            tags: tags.iter().map(SeenTag::from).chain(still).collect(),
            at: now,
            counts: self.counts,
        });
        if !tags.is_empty() {
            self.next_hello = now + HELLO_PERIOD;
            return Ok(Some(Sighting::Tags(TaggedPicture { tags, picture_px, time: encoded.time })));
        }
        if now < self.next_hello {
            return Ok(None);
        }
        self.next_hello = now + HELLO_PERIOD;
        Ok(Some(Sighting::Nothing))
    }

    fn update_still_tags(&mut self, tags: &[DetectedTag]) {
        let number = self.counts.searched;
        let is_seen = |still: &SeenTag| tags.iter().any(|tag| tag.id == still.id);
        self.still_tags.retain(|(still, seen)| seen + 2 * u64::from(WHOLE_EVERY) > number && !is_seen(still));
        let on_floor = tags.iter().filter(|tag| self.settings.floor_tags.contains(&tag.id));
        self.still_tags.extend(on_floor.map(|tag| (SeenTag::from(tag), number)));
    }
}

impl From<&DetectedTag> for SeenTag {
    fn from(tag: &DetectedTag) -> Self {
        Self { id: tag.id, corners: tag.corners, margin: tag.margin }
    }
}
