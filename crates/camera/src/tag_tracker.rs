//! Where the tags of the last pictures should be in the next one.

use nalgebra::{Point2, Vector2};
use posebridge_vision::{DetectedTag, ImageWindow};

/// Largest acceleration of a tag that stays in its window, in sides per picture and picture.
const MARGIN_SIDES: f64 = 0.6;
/// Smallest margin around a tag, px: its white rim must be in the window.
const MIN_MARGIN_PX: f64 = 8.0;
/// Most tags that are followed; in a picture with more each search is of the whole.
const MAX_TRACKED: usize = 32;

/// The moving tags of the last picture.
#[derive(Debug, Default)]
pub(crate) struct TagTracker {
    tracks: Vec<Track>,
}

#[derive(Clone, Copy, Debug)]
struct Track {
    id: u16,
    middle: Point2<f64>,
    /// From the middle to the farthest corner in each direction, px.
    half_size: Vector2<f64>,
    /// Since the picture before, px.
    moved: Vector2<f64>,
}

impl TagTracker {
    /// Windows around the places where the tags should be, cut to the picture.
    pub(crate) fn windows(&self, width: usize, height: usize) -> Vec<ImageWindow> {
        self.tracks.iter().filter_map(|track| track.window(width, height)).collect()
    }

    /// Takes the tags of a picture, without those that lie still on the floor.
    pub(crate) fn update<'a>(&mut self, tags: impl Iterator<Item = &'a DetectedTag>) {
        let tracks = tags.take(MAX_TRACKED).map(|tag| {
            let middle = Point2::from(tag.corners.iter().map(|corner| corner.coords).sum::<Vector2<f64>>() / 4.0);
            let reach = |to: Vector2<f64>, corner: &Point2<f64>| to.sup(&(corner - middle).abs());
            let before = self.tracks.iter().find(|track| track.id == tag.id);
            Track {
                id: tag.id,
                middle,
                half_size: tag.corners.iter().fold(Vector2::zeros(), reach),
                moved: before.map_or_else(Vector2::zeros, |track| middle - track.middle),
            }
        });
        self.tracks = tracks.collect();
    }
}

impl Track {
    fn window(&self, width: usize, height: usize) -> Option<ImageWindow> {
        let margin = self.half_size.max() * 2.0 * MARGIN_SIDES;
        let half = self.half_size.add_scalar(margin.max(MIN_MARGIN_PX));
        let expected = self.middle + self.moved;
        let (left, right) = span(expected.x, half.x, width)?;
        let (top, bottom) = span(expected.y, half.y, height)?;
        Some(ImageWindow { left, top, width: right - left, height: bottom - top })
    }
}

/// The pixels within `half` of `middle`; `None` outside of the picture.
fn span(middle: f64, half: f64, size: usize) -> Option<(usize, usize)> {
    let (first, end) = ((middle - half).max(0.0) as usize, ((middle + half).max(0.0) as usize + 1).min(size));
    (first < end).then_some((first, end))
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;

    use super::*;

    fn tag(x: f64, y: f64) -> DetectedTag {
        let corners = [(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)];
        DetectedTag {
            id: 7,
            hamming: 0,
            margin: 50.0,
            corners: corners.map(|(right, down)| Point2::new(x + right, y + down)),
            covariance: SMatrix::identity(),
        }
    }

    #[test]
    fn a_window_follows_a_steady_motion_and_ends_at_the_picture() {
        let mut tracker = TagTracker::default();
        tracker.update([tag(100.0, 200.0)].iter());
        let first = ImageWindow { left: 56, top: 156, width: 89, height: 89 };
        assert_eq!(tracker.windows(640, 480), [first]);
        tracker.update([tag(130.0, 200.0)].iter());
        assert_eq!(tracker.windows(640, 480), [ImageWindow { left: 116, ..first }]);
        assert_eq!(tracker.windows(150, 480), [ImageWindow { left: 116, width: 34, ..first }]);
        assert_eq!(tracker.windows(100, 480), [], "it has left the picture");
        tracker.update([].iter());
        assert_eq!(tracker.windows(640, 480), []);
    }
}
