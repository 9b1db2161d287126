//! What a program sees that looks through the simulated camera: where the corners of the tag are in the image.
//!
//! That is what marker detectors give (OpenCV's ArUco, the AprilTag libraries), so that a program that turns corners into fixes can be run
//! without a camera. The image is from straight above, without distortion; noise, dropouts and outliers are those of the scenario's camera.
//!
//! # Model
//! ```text
//! u = 320 + x / 0.004      v = 240 - y / 0.004      pixels; 4 mm each, image y down
//! corners: of a square of 0.1 m about the tag, left rear, right rear, right front, left front, seen from the robot
//! ```

use std::fmt::Write as _;

use posebridge_telemetry::{Arena, Body, Heading, Meters, Point2, Pose};

/// The arena's origin in the image, pixels.
pub const ORIGIN_PX: [f64; 2] = [320.0, 240.0];
/// What a pixel covers.
pub const METERS_PER_PX: f64 = 0.004;
/// Half the side of the tag.
const HALF_M: f64 = 0.05;
/// The corners in the tag's space, in halves of its side: forward, left.
const CORNERS: [[f64; 2]; 4] = [[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]];

/// An image as a line of JSON, without its end: its number and the corners of the tag.
pub(crate) fn image(number: u64, tag: Point2<Arena>, heading: Heading) -> String {
    let tag = Pose::<Arena>::new(tag.x, tag.y, heading);
    let mut line = format!("{{\"image\": {number}, \"corners_px\": [");
    for (index, [forward, left]) in CORNERS.into_iter().enumerate() {
        let corner = Point2::<Body>::new(Meters(HALF_M * forward), Meters(HALF_M * left));
        let corner = tag * corner;
        let u_px = ORIGIN_PX[0] + corner.x.0 / METERS_PER_PX;
        let v_px = ORIGIN_PX[1] - corner.y.0 / METERS_PER_PX;
        let between = if index > 0 { ", " } else { "" };
        // Writing to a String cannot fail.
        let _ = write!(line, "{between}[{u_px:.3}, {v_px:.3}]");
    }
    line.push_str("]}");
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tag_that_looks_north_has_its_front_above() {
        let heading = Heading::from_rad(std::f64::consts::FRAC_PI_2);
        let line = image(7, Point2::new(Meters(0.4), Meters(0.2)), heading);
        assert_eq!(
            line,
            "{\"image\": 7, \"corners_px\": [[407.500, 202.500], [432.500, 202.500], \
             [432.500, 177.500], [407.500, 177.500]]}"
        );
    }
}
