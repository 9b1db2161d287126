//! What was found in a picture.

use posebridge_vision::DetectedTag;

use crate::picture::PictureTime;

/// The tags of one picture, on their way to the station.
#[derive(Debug)]
pub(crate) struct TaggedPicture {
    pub(crate) tags: Vec<DetectedTag>,
    pub(crate) picture_px: (usize, usize),
    pub(crate) time: PictureTime,
}

/// What the station's thread is handed.
#[derive(Debug)]
pub(crate) enum Sighting {
    Tags(TaggedPicture),
    /// Pictures come, and there is no tag in them.
    Nothing,
}
