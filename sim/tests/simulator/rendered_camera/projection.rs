//! Pixels of points in the arena, by OpenCV and by the detector's own camera model.

use nalgebra::{Point2, Point3};
use posebridge_sim::rendered_camera::Projection;
use posebridge_sim::scenario::RenderedCameraSettings;
use serde_json::Value;

use super::floor_view;

const PROJECTED: &str = include_str!("../../data/projected_points.json");

fn numbers<const COUNT: usize>(value: &Value) -> [f64; COUNT] {
    serde_json::from_value::<Vec<f64>>(value.clone()).unwrap().try_into().unwrap()
}

#[test]
fn points_are_where_opencv_projects_them() {
    let cases: Vec<Value> = serde_json::from_str(PROJECTED).unwrap();
    let mut points = 0;
    for case in &cases {
        let settings: RenderedCameraSettings = serde_json::from_value(case["camera"].clone()).unwrap();
        let projection = Projection::new(&settings);
        for (point, pixel) in case["points_m"].as_array().unwrap().iter().zip(case["pixels"].as_array().unwrap()) {
            let (point_m, expected) = (numbers::<3>(point), numbers::<2>(pixel));
            let found = projection.pixel_of(point_m).unwrap();
            let distance = (Point2::from(found) - Point2::from(expected)).norm();
            assert!(distance < 1e-5, "{point_m:?}: {found:?}, OpenCV {expected:?}");
            let back = projection.point_at_height(expected, point_m[2]).unwrap();
            assert!((back[0] - point_m[0]).hypot(back[1] - point_m[1]) < 1e-7, "{point_m:?}: {back:?}");
            points += 1;
        }
    }
    assert_eq!(points, 48);
}

#[test]
fn points_are_where_the_detector_expects_them() {
    let settings = RenderedCameraSettings { tilt_deg: 37.0, azimuth_deg: 61.0, ..Default::default() };
    let (projection, view) = (Projection::new(&settings), floor_view(&settings));
    for point_m in [[0.5, 0.3, 0.0], [0.2, 0.1, 0.085], [1.4, 0.4, 0.3]] {
        let found = Point2::from(projection.pixel_of(point_m).unwrap());
        assert!((found - view.pixel_of(Point3::from(point_m)).unwrap()).norm() < 1e-9, "{point_m:?}");
    }
}
