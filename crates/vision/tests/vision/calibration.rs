//! Cameras are found from points that they show.

use nalgebra::{Isometry3, Matrix2, Point2, Point3, Rotation3, Translation3, Vector2, Vector3};
use posebridge_vision::{CalibrationError, CameraModel, FloorCalibration, FloorView, LensKnowledge, SeenPoint};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg32;

/// At 2.5 m, tilted by so many degrees from straight down, turned about the vertical.
fn view(tilt_deg: f64, radial: [f64; 2]) -> FloorView {
    let down = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0));
    let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), tilt_deg.to_radians());
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7);
    let camera = CameraModel { focal_px: Vector2::new(900.0, 900.0), centre_px: Point2::new(639.5, 359.5), radial };
    FloorView { camera, pose: Isometry3::from_parts(Translation3::new(0.4, -0.3, 2.5), (turn * tilt * down).into()) }
}

/// Points of a grid on the floor, and some above it, with noise of `sigma_px`.
fn points(view: &FloorView, sigma_px: f64, random: &mut Pcg32) -> Vec<SeenPoint> {
    let (middle, _) = view.point_at_height(view.camera.centre_px, 0.0).unwrap();
    let grid = (0..25).map(|index| {
        let offset = Vector2::new(f64::from(index % 5) - 2.0, f64::from(index / 5) - 2.0) * 0.3;
        let at = middle + offset;
        Point3::new(at.x, at.y, if index % 7 == 3 { 0.15 } else { 0.0 })
    });
    let mut noise = || -> f64 {
        sigma_px * {
            let unit: f64 = StandardNormal.sample(&mut *random);
            unit
        }
    };
    grid.map(|point| {
        let pixel = view.pixel_of(point).unwrap() + Vector2::new(noise(), noise());
        SeenPoint { point, pixel, covariance: Matrix2::identity() * sigma_px.max(0.01).powi(2) }
    })
    .collect()
}

#[test]
fn camera_and_lens_are_found_without_noise_and_to_their_sigma_with_it() {
    let mut random = Pcg32::seed_from_u64(6);
    let unknown = LensKnowledge::Unknown { width: 1280, height: 720 };
    for (tilt_deg, radial) in [(30.0, [-0.2, 0.05]), (55.0, [0.0, 0.0]), (20.0, [-0.3, 0.1])] {
        let view = view(tilt_deg, radial);
        let exact = FloorCalibration::solve(&points(&view, 0.0, &mut random), unknown).unwrap();
        assert!(exact.rms_px < 0.01, "{tilt_deg}: {}", exact.rms_px);
        let away = (exact.view.pose.translation.vector - view.pose.translation.vector).norm();
        assert!(away < 0.01, "{tilt_deg}: {away} m");
        let known = LensKnowledge::Known(view.camera);
        let with_lens = FloorCalibration::solve(&points(&view, 0.0, &mut random), known).unwrap();
        assert!((with_lens.view.pose.translation.vector - view.pose.translation.vector).norm() < 1e-6);
        // What it is for: points on the floor.
        let (mut worst_m, mut nees, mut middle_nees) = (0.0_f64, 0.0, 0.0);
        for _ in 0..20 {
            let noisy = FloorCalibration::solve(&points(&view, 0.2, &mut random), known).unwrap();
            for seen in points(&view, 0.0, &mut random) {
                let (at, _) = noisy.view.point_at_height(seen.pixel, seen.point.z).unwrap();
                worst_m = worst_m.max((at - seen.point.xy()).norm());
            }
            let sigma_m = noisy.floor_sigma_m(view.camera.centre_px).unwrap();
            let (at, _) = noisy.view.point_at_height(view.camera.centre_px, 0.0).unwrap();
            let (truly, _) = view.point_at_height(view.camera.centre_px, 0.0).unwrap();
            middle_nees += (at - truly).norm_squared() / (2.0 * sigma_m * sigma_m) / 20.0;
            assert!((0.15..0.4).contains(&noisy.rms_px), "{}", noisy.rms_px);
            let away = noisy.view.pose.translation.vector - view.pose.translation.vector;
            nees += away.component_div(&noisy.position_sigma_m).norm_squared() / 20.0;
        }
        assert!(worst_m < 0.002, "{tilt_deg}: {worst_m} m");
        assert!((1.2..5.4).contains(&nees), "{tilt_deg}: {nees}");
        // Along the worst direction; the other one may be known much better.
        assert!((0.2..1.7).contains(&middle_nees), "{tilt_deg}: {middle_nees}");
    }
}

#[test]
fn what_cannot_be_calibrated_is_said() {
    let mut random = Pcg32::seed_from_u64(7);
    let unknown = LensKnowledge::Unknown { width: 1280, height: 720 };
    let solve = |points: &[SeenPoint]| FloorCalibration::solve(points, unknown).map(|found| found.rms_px);
    let all = points(&view(30.0, [0.0; 2]), 0.0, &mut random);
    assert_eq!(solve(&all[..3]), Err(CalibrationError::TooFew(3)));
    let line: Vec<SeenPoint> = all.iter().copied().filter(|seen| seen.point.z == 0.0).take(5).collect();
    assert_eq!(solve(&line[..4]), Err(CalibrationError::Degenerate));
    // Straight down, a long lens far up shows the same floor as a wide one below.
    let flat: Vec<SeenPoint> =
        points(&view(0.0, [0.0; 2]), 0.0, &mut random).into_iter().filter(|seen| seen.point.z == 0.0).collect();
    assert_eq!(solve(&flat), Err(CalibrationError::NoFocalLength));
    let known = LensKnowledge::Known(view(0.0, [0.0; 2]).camera);
    assert!(FloorCalibration::solve(&flat, known).unwrap().rms_px < 1e-6);
}
