//! Tags as a camera sees them, and their places on the floor by its calibration.

use nalgebra::{Point2, SMatrix};
use posebridge_telemetry::{Heading, Meters};
use posebridge_vision::{FloorTagPose, FloorView};

/// Corners of one tag in a picture, as `corners_px` gives them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagCorners {
    /// The tag's upper left corner first, clockwise; px, the centre of the first pixel is (0, 0).
    pub corners: [Point2<f64>; 4],
    /// Of x and y of each corner, in that order, px².
    pub covariance: SMatrix<f64, 8, 8>,
    /// Width and height of the picture, px.
    pub picture_px: Option<[usize; 2]>,
}

impl TagCorners {
    /// The covariance with the errors that no picture shows.
    pub fn full_covariance(&self) -> SMatrix<f64, 8, 8> {
        self.covariance + systematic_covariance()
    }
}

/// The camera of a link, and the tags that it sees.
#[derive(Clone, Debug, PartialEq)]
pub struct FloorCamera {
    pub view: FloorView,
    /// Width and height of the pictures that it was calibrated with, px.
    pub picture_px: [usize; 2],
    /// Of the black rim of robots' tags, m.
    pub tag_side_m: f64,
    /// Of robots' tags above the floor, m.
    pub tag_height_m: f64,
    /// Tags that lie on the floor: the first one, and their number. They are no robots.
    pub floor_tags: (u32, u32),
}

/// A robot's tag on the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TagFix {
    pub(super) x: Meters,
    pub(super) y: Meters,
    pub(super) heading: Heading,
    /// As in [`VisionFix::covariance`](crate::message::VisionFix::covariance).
    pub(super) covariance: [f64; 4],
}

/// Why corners are no place on the floor.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub(super) enum CornersError {
    #[error("is {seen:?}, and the camera's file is for {}, {}: calibrate it with this size", expected[0], expected[1])]
    PictureSize { seen: [usize; 2], expected: [usize; 2] },
    #[error("is near or above the horizon of the camera's file, or no tag: is this the camera that was calibrated?")]
    NoFloor,
    #[error(
        "is a tag of {percent:.0} % of its side: check `camera.tag_side_m` and `camera.tag_height_m`, or calibrate the camera again"
    )]
    Side { percent: f64 },
}

/// Sides further off than this, as a share, are of another tag, at another height, or of a camera that was moved.
const MAX_SIDE_ERROR: f64 = 0.15;
/// What no picture says of itself: errors of lens, paper and light that the corners of a tag share, and those of each. A tag that stands
/// still has them in every picture, so they must not vanish beside the noise of a pixel.
const SHARED_SIGMA_PX: f64 = 0.1;
const CORNER_SIGMA_PX: f64 = 0.05;
/// Degrees of freedom of the misfit of four corners.
const MISFIT_FREEDOM: f64 = 5.0;

impl FloorCamera {
    pub(super) const fn is_on_floor(&self, tag: u32) -> bool {
        let (first, count) = self.floor_tags;
        first <= tag && tag < first.saturating_add(count)
    }

    pub(super) fn solve(&self, seen: &TagCorners) -> Result<TagFix, CornersError> {
        if let Some(seen) = seen.picture_px.filter(|size| *size != self.picture_px) {
            return Err(CornersError::PictureSize { seen, expected: self.picture_px });
        }
        let covariance = seen.full_covariance();
        let solved = FloorTagPose::solve(&self.view, &seen.corners, &covariance, self.tag_side_m, self.tag_height_m);
        let solved = solved.ok_or(CornersError::NoFloor)?;
        if (solved.side_ratio - 1.0).abs() > MAX_SIDE_ERROR {
            return Err(CornersError::Side { percent: 100.0 * solved.side_ratio });
        }
        // Corners that fit worse than they claim are worth less: the calibration has errors of its own.
        let covariance = solved.covariance * (solved.misfit / MISFIT_FREEDOM).max(1.0);
        Ok(TagFix {
            x: Meters(solved.pose.translation.x),
            y: Meters(solved.pose.translation.y),
            heading: Heading::from_rad(solved.pose.rotation.angle()),
            covariance: [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)], covariance[(2, 2)]],
        })
    }
}

fn systematic_covariance() -> SMatrix<f64, 8, 8> {
    SMatrix::from_fn(|row, column| {
        let shared = if row % 2 == column % 2 { SHARED_SIGMA_PX.powi(2) } else { 0.0 };
        let own = if row == column { CORNER_SIGMA_PX.powi(2) } else { 0.0 };
        shared + own
    })
}
