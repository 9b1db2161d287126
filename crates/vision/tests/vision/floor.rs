//! From pixels to the floor and back.

use nalgebra::{Isometry3, Matrix2, Point2, Point3, Rotation3, SMatrix, SVector, Translation3, Vector2, Vector3};
use posebridge_vision::{CameraModel, FloorTagPose, FloorView};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg32;

/// A camera at 2.5 m above (1, -0.5), which looks down 60 degrees, towards y, with barrel distortion.
fn view() -> FloorView {
    let camera = CameraModel {
        focal_px: Vector2::new(820.0, 810.0),
        centre_px: Point2::new(640.5, 351.0),
        radial: [-0.3, 0.08],
    };
    let tilt = 30_f64.to_radians();
    // Right is x; ahead lies between y and down.
    let ahead = Vector3::new(0.0, tilt.sin(), -tilt.cos());
    let right = Vector3::x();
    let rotation =
        Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[right, ahead.cross(&right), ahead]));
    FloorView { camera, pose: Isometry3::from_parts(Translation3::new(1.0, -0.5, 2.5), rotation.into()) }
}

#[test]
fn a_point_has_the_pixel_that_shows_it_and_derivatives_are_those_of_differences() {
    let view = view();
    // Straight ahead: 2.5 m * tan 30 degrees along y.
    let (centre, _) = view.point_at_height(view.camera.centre_px, 0.0).unwrap();
    assert!((centre - Point2::new(1.0, -0.5 + 2.5 * 30_f64.to_radians().tan())).norm() < 1e-12);
    // What lies to the right is on the right, and what is farther away is higher up.
    let right = view.pixel_of(Point3::new(1.5, 1.0, 0.0)).unwrap();
    assert!(right.x > 700.0 && right.y < view.camera.centre_px.y + 1.0, "{right}");
    let mut random = Pcg32::seed_from_u64(1);
    for _ in 0..200 {
        let point =
            Point3::new(random.random_range(-0.2..2.2), random.random_range(0.0..2.0), random.random_range(0.0..0.3));
        let pixel = view.pixel_of(point).unwrap();
        let (back, derivative) = view.point_at_height(pixel, point.z).unwrap();
        assert!((back - point.xy()).norm() < 1e-9, "{point} {back}");
        let step = 1e-3;
        let moved = |dx: f64, dy: f64| view.point_at_height(pixel + Vector2::new(dx, dy), point.z).unwrap().0;
        let differences = Matrix2::from_columns(&[
            (moved(step, 0.0) - moved(-step, 0.0)) / (2.0 * step),
            (moved(0.0, step) - moved(0.0, -step)) / (2.0 * step),
        ]);
        assert!((derivative - differences).norm() < 1e-6 * derivative.norm(), "{derivative} {differences}");
    }
}

#[test]
fn what_a_camera_cannot_show_has_no_pixel_and_no_point() {
    let mut view = view();
    assert_eq!(view.pixel_of(Point3::new(1.0, -3.0, 2.5)), None, "behind it");
    assert_eq!(view.point_at_height(Point2::new(640.0, 351.0), 3.0), None, "above it");
    view.camera.radial = [-0.4, 0.0];
    assert!(view.point_at_height(Point2::new(1700.0, 351.0), 0.0).is_none(), "no direction is distorted so far");
    assert_eq!(view.camera.project(Vector2::new(1.2, 0.0)), None);
    view.pose.rotation = Rotation3::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2).into();
    assert!(view.point_at_height(view.camera.centre_px, 0.0).is_none(), "the horizon");
    assert!(view.point_at_height(view.camera.centre_px - Vector2::new(0.0, 50.0), 0.0).is_none(), "the sky");
    let below = |px: f64| view.point_at_height(view.camera.centre_px + Vector2::new(0.0, px), 0.0);
    assert!(below(30.0).is_none() && below(60.0).is_some(), "two and four degrees below the horizon");
}

/// The pixels of the corners of a tag: the middle, the way up, the side and the height.
fn pixels(view: &FloorView, at: Vector2<f64>, heading: f64, side_m: f64, height_m: f64) -> [Point2<f64>; 4] {
    let (sine, cosine) = heading.sin_cos();
    [(0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5)].map(|(ahead, left)| {
        let (ahead, left) = (ahead * side_m, left * side_m);
        let point = at + Vector2::new(cosine * ahead - sine * left, sine * ahead + cosine * left);
        view.pixel_of(Point3::new(point.x, point.y, height_m)).unwrap()
    })
}

#[test]
fn the_errors_of_a_tag_are_those_of_its_covariance_and_a_wrong_side_shows() {
    const TAGS: usize = 400;
    let view = view();
    let mut random = Pcg32::seed_from_u64(2);
    let covariance = SMatrix::<f64, 8, 8>::identity() * 0.04 + SMatrix::repeat(0.01);
    let factor = covariance.cholesky().unwrap().l();
    let (mut nees, mut misfit) = (0.0, 0.0);
    for _ in 0..TAGS {
        let at = Vector2::new(random.random_range(0.0..2.0), random.random_range(0.2..1.8));
        let heading = random.random_range(-3.1..3.1);
        let noise = factor * SVector::<f64, 8>::from_fn(|_, _| StandardNormal.sample(&mut random));
        let mut corners = pixels(&view, at, heading, 0.1, 0.08);
        for (index, corner) in corners.iter_mut().enumerate() {
            *corner += Vector2::new(noise[2 * index], noise[2 * index + 1]);
        }
        let found = FloorTagPose::solve(&view, &corners, &covariance, 0.1, 0.08).unwrap();
        let turned = found.pose.rotation.angle() - heading;
        let away = found.pose.translation.vector - at;
        let error = Vector3::new(away.x, away.y, turned.sin().atan2(turned.cos()));
        nees += (error.transpose() * found.covariance.cholesky().unwrap().solve(&error))[0] / TAGS as f64;
        misfit += found.misfit / TAGS as f64;
        let floor = FloorTagPose::solve(&view, &corners, &covariance, 0.1, 0.0).unwrap();
        let parallax = (floor.pose.translation.vector - at).norm();
        assert!(parallax > 0.005, "on the floor it would be {parallax} m away");
        assert!((floor.side_ratio - 2.5 / 2.42).abs() < 0.02, "{}", floor.side_ratio);
    }
    // 99 of 100 means of 400 times 3 and 5 degrees of freedom.
    assert!((2.68..3.32).contains(&nees) && (4.59..5.41).contains(&misfit), "{nees} {misfit}");
}
