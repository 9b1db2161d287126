//! What a calibration begins with: points of the arena with their pixels, what is known of the lens, and why it may fail.

use nalgebra::{Matrix2, Point2, Point3};

use crate::camera_model::CameraModel;

/// Fewest points: corners of one tag, or four marks.
pub(crate) const MIN_POINTS: usize = 4;

/// A point of the arena and the pixel that shows it.
#[derive(Clone, Copy, Debug)]
pub struct SeenPoint {
    pub point: Point3<f64>,
    pub pixel: Point2<f64>,
    /// Of the pixel, px².
    pub covariance: Matrix2<f64>,
}

impl SeenPoint {
    /// A mark on the floor; `sigma_px` is how well each coordinate of its pixel is known.
    pub fn on_floor([x_m, y_m]: [f64; 2], pixel: [f64; 2], sigma_px: f64) -> Self {
        let covariance = Matrix2::identity() * sigma_px.powi(2);
        Self { point: Point3::new(x_m, y_m, 0.0), pixel: pixel.into(), covariance }
    }
}

/// What is to be found besides the camera's place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LensKnowledge {
    /// The lens is known.
    Known(CameraModel),
    /// Square pixels, axis in the middle of a picture of this size; focal length and distortion are to be found.
    Unknown { width: usize, height: usize },
}

/// Why a camera could not be calibrated, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    #[error("{0} points are known; a calibration needs {MIN_POINTS} or more that are not on one line")]
    TooFew(usize),
    #[error("the points lie on one line, or their pixels are mixed up: spread them over the picture")]
    Degenerate,
    #[error("these points show nothing of the focal length: tilt the camera, or state its lens")]
    NoFocalLength,
}
