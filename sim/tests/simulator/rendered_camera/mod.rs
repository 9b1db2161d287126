//! The rendered camera shows tags where they are, at the time of the exposure.

mod pictures;
mod projection;
mod stream;

use nalgebra::{Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector2};
use posebridge_sim::rendered_camera::{LensState, MovingTag, Projection, RenderedCamera};
use posebridge_sim::scenario::{RenderedCameraSettings, RobotTagSettings};
use posebridge_telemetry::{Arena, Heading, Meters, Pose, TimeDelta};
use posebridge_vision::{CameraModel, DetectedTag, FloorView, GreyImage, Tag36h11Detector, TagDetector};

fn without_noise() -> RenderedCameraSettings {
    RenderedCameraSettings { read_noise: 0.0, shot_noise: 0.0, ..Default::default() }
}

fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> Pose<Arena> {
    Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad))
}

/// A frame of the robot's tag.
fn render(
    camera: &mut RenderedCamera,
    number: u64,
    mid: TimeDelta,
    mut pose: impl FnMut(TimeDelta) -> Pose<Arena>,
) -> Vec<u8> {
    let tag = MovingTag { tag: camera.settings().robot_tag, pose: &mut pose };
    camera.render(number, mid, LensState::Open, &mut [tag]).to_vec()
}

fn detect(settings: &RenderedCameraSettings, pixels: &[u8]) -> Vec<DetectedTag> {
    let (width, height) = (usize::from(settings.width_px), usize::from(settings.height_px));
    Tag36h11Detector::default().detect(GreyImage::new(pixels, width, height, width).unwrap())
}

fn detect_robot(settings: &RenderedCameraSettings, pixels: &[u8]) -> [Point2<f64>; 4] {
    let tags = detect(settings, pixels);
    tags.iter().find(|tag| tag.id == settings.robot_tag.id).unwrap().corners
}

/// Where the corners of a tag are in the picture: the upper left one, then clockwise.
fn true_corners(projection: &Projection, tag: RobotTagSettings, pose: Pose<Arena>) -> [Point2<f64>; 4] {
    let half_m = tag.side_m / 2.0;
    let (sin, cos) = pose.heading.rad().sin_cos();
    [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(up, left)| {
        let (up_m, left_m) = (up * half_m, left * half_m);
        let (x_m, y_m) = (pose.x.0 + cos * up_m - sin * left_m, pose.y.0 + sin * up_m + cos * left_m);
        Point2::from(projection.pixel_of([x_m, y_m, tag.height_m]).unwrap())
    })
}

/// Where the diagonals meet: in any view the middle of the tag.
fn middle(corners: &[Point2<f64>; 4]) -> Point2<f64> {
    let [a, b, c, d] = *corners;
    let (one, other) = (c - a, d - b);
    a + one * ((b - a).perp(&other) / one.perp(&other))
}

fn errors(found: &[Point2<f64>; 4], truth: &[Point2<f64>; 4]) -> [Vector2<f64>; 4] {
    std::array::from_fn(|index| found[index] - truth[index])
}

fn rms(errors: &[Vector2<f64>]) -> f64 {
    (errors.iter().map(Vector2::norm_squared).sum::<f64>() / errors.len() as f64).sqrt()
}

/// The detector's own model of the same camera.
fn floor_view(settings: &RenderedCameraSettings) -> FloorView {
    let projection = Projection::new(settings);
    let camera = CameraModel {
        focal_px: Vector2::repeat(settings.focal_px),
        centre_px: Point2::from(settings.axis_px()),
        radial: settings.radial,
    };
    let axes = Matrix3::from_columns(&projection.axes().map(Into::into));
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    FloorView { camera, pose: Isometry3::from_parts(Translation3::from(projection.position_m()), rotation) }
}
