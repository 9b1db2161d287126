//! Where tags are looked for: around their expected places first, in the whole picture now and then.

use crate::grey_image::{GreyImage, ImageWindow};
use crate::tag_detector::{DetectedTag, TagDetector};

/// Looks for tags in a row of pictures.
#[derive(Debug)]
pub struct TagSearch {
    /// Of so many pictures one is searched as a whole.
    whole_every: u32,
    since_whole: u32,
}

impl TagSearch {
    /// One of `whole_every` pictures is searched as a whole, at least every one.
    pub fn new(whole_every: u32) -> Self {
        let whole_every = whole_every.max(1);
        Self { whole_every, since_whole: whole_every }
    }

    /// The tags in the next picture. `expected` are windows around the places where tags should be; if one of them holds none, the whole
    /// picture is searched, as it is without any.
    pub fn detect(
        &mut self,
        detector: &mut dyn TagDetector,
        image: GreyImage<'_>,
        expected: &[ImageWindow],
    ) -> Vec<DetectedTag> {
        self.since_whole = self.since_whole.saturating_add(1);
        if !expected.is_empty() && self.since_whole < self.whole_every {
            let found: Vec<_> = expected.iter().map(|window| detector.detect_in_window(image, *window)).collect();
            if found.iter().all(|tags| !tags.is_empty()) {
                let mut tags: Vec<DetectedTag> = Vec::new();
                for tag in found.into_iter().flatten() {
                    if tags.iter().all(|other| other.id != tag.id) {
                        tags.push(tag);
                    }
                }
                return tags;
            }
        }
        self.since_whole = 0;
        detector.detect(image)
    }
}
