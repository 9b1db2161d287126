//! Cameras are found from points that they show.

use nalgebra::{Isometry3, Matrix2, Point2, Point3, Rotation2, Rotation3, SMatrix, Translation3, Vector2, Vector3};
use posebridge_vision::{
    CalibrationError, CameraModel, FlatTag, FloorCalibration, FloorView, LensKnowledge, SeenPoint, SheetTag,
    floor_sheet,
};
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
        let exact = FloorCalibration::solve(&points(&view, 0.0, &mut random), &[], unknown).unwrap();
        assert!(exact.rms_px < 0.01, "{tilt_deg}: {}", exact.rms_px);
        let away = (exact.view.pose.translation.vector - view.pose.translation.vector).norm();
        assert!(away < 0.01, "{tilt_deg}: {away} m");
        let known = LensKnowledge::Known(view.camera);
        let with_lens = FloorCalibration::solve(&points(&view, 0.0, &mut random), &[], known).unwrap();
        assert!((with_lens.view.pose.translation.vector - view.pose.translation.vector).norm() < 1e-6);
        // What it is for: points on the floor.
        let (mut worst_m, mut nees, mut middle_nees) = (0.0_f64, 0.0, 0.0);
        for _ in 0..20 {
            let noisy = FloorCalibration::solve(&points(&view, 0.2, &mut random), &[], known).unwrap();
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
    let solve = |points: &[SeenPoint]| FloorCalibration::solve(points, &[], unknown).map(|found| found.rms_px);
    let all = points(&view(30.0, [0.0; 2]), 0.0, &mut random);
    assert_eq!(solve(&all[..3]), Err(CalibrationError::TooFew(3)));
    let line: Vec<SeenPoint> = all.iter().copied().filter(|seen| seen.point.z == 0.0).take(5).collect();
    assert_eq!(solve(&line[..4]), Err(CalibrationError::Degenerate));
    // Straight down, a long lens far up shows the same floor as a wide one below.
    let flat: Vec<SeenPoint> =
        points(&view(0.0, [0.0; 2]), 0.0, &mut random).into_iter().filter(|seen| seen.point.z == 0.0).collect();
    assert_eq!(solve(&flat), Err(CalibrationError::NoFocalLength));
    let known = LensKnowledge::Known(view(0.0, [0.0; 2]).camera);
    assert!(FloorCalibration::solve(&flat, &[], known).unwrap().rms_px < 1e-6);
}

/// A robot's tag of 80 mm, 85 mm above the floor, on a circle about the middle of the picture; each corner with noise.
fn drive(view: &FloorView, sigma_px: f64, random: &mut Pcg32) -> Vec<FlatTag> {
    let (middle, _) = view.point_at_height(view.camera.centre_px, 0.0).unwrap();
    let pictures = (0..240).map(|picture| {
        let turn = f64::from(picture) * 0.1;
        let radius_m = 0.2 + 0.6 * f64::from(picture % 80) / 80.0;
        let at = middle + Vector2::new(turn.cos(), turn.sin()) * radius_m;
        Vector3::new(at.x, at.y, turn + 1.6)
    });
    let mut noise = || -> f64 {
        let unit: f64 = StandardNormal.sample(&mut *random);
        sigma_px * unit
    };
    let tag = |pose: Vector3<f64>| {
        let half_m = 0.04;
        let corners = [(half_m, half_m), (half_m, -half_m), (-half_m, -half_m), (-half_m, half_m)];
        let corners = corners.map(|(ahead, left)| {
            let at = pose.xy() + Rotation2::new(pose.z) * Vector2::new(ahead, left);
            view.pixel_of(Point3::new(at.x, at.y, 0.085)).unwrap() + Vector2::new(noise(), noise())
        });
        let covariance = SMatrix::identity() * sigma_px * sigma_px;
        FlatTag { corners, covariance, side_m: 0.08, height_m: 0.085, rough_pose: pose, is_held: false }
    };
    pictures.map(tag).collect()
}

/// Mean distance, where the robot drove, between the floor that a camera is believed to see and the one that it does, m.
fn floor_error_m(found: &FloorView, truly: &FloorView) -> f64 {
    let pixels = (0..25).map(|index| {
        let offset = Vector2::new(f64::from(index % 5) - 2.0, f64::from(index / 5) - 2.0) * 90.0;
        truly.camera.centre_px + offset
    });
    let errors = pixels.map(|pixel| {
        let at = |view: &FloorView| view.point_at_height(pixel, 0.0).unwrap().0;
        (at(found) - at(truly)).norm()
    });
    errors.sum::<f64>() / 25.0
}

#[test]
fn one_sheet_and_a_drive_calibrate_what_the_sheet_alone_does_not() {
    let mut random = Pcg32::seed_from_u64(8);
    let unknown = LensKnowledge::Unknown { width: 1280, height: 720 };
    for tilt_deg in [30.0, 0.0] {
        let view = view(tilt_deg, [-0.2, 0.05]);
        let (middle, _) = view.point_at_height(view.camera.centre_px, 0.0).unwrap();
        let mut noise = || -> f64 { 0.1 * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random) };
        let mut sheet = Vec::new();
        for corner in floor_sheet(580).unwrap().iter().flat_map(SheetTag::corners_m) {
            let point = Point3::new(middle.x - 0.4 + corner.x, middle.y - 0.3 + corner.y, 0.0);
            let pixel = view.pixel_of(point).unwrap() + Vector2::new(noise(), noise());
            sheet.push(SeenPoint { point, pixel, covariance: Matrix2::identity() * 0.01 });
        }
        let mut tags = drive(&view, 0.1, &mut random);
        // Lifted: twice as large as a tag on the robot can be.
        let middle_px = tags[7].corners.iter().map(|corner| corner.coords).sum::<Vector2<f64>>() / 4.0;
        tags[7].corners = tags[7].corners.map(|corner| Point2::from(middle_px + 1.3 * (corner.coords - middle_px)));
        let found = FloorCalibration::solve(&sheet, &tags, unknown).unwrap();
        let error_m = floor_error_m(&found.view, &view);
        assert!(error_m < 0.0015, "{tilt_deg}: {error_m} m");
        assert!(found.tag_errors_m[7].is_none() && found.tag_errors_m[8].unwrap() < 0.001);
        if tilt_deg > 0.0 {
            let alone = FloorCalibration::solve(&sheet, &[], unknown).unwrap();
            assert!(floor_error_m(&alone.view, &view) > 3.0 * error_m);
        }
    }
}

#[test]
fn a_drive_alone_calibrates_from_where_it_started() {
    let mut random = Pcg32::seed_from_u64(9);
    let view = view(30.0, [-0.2, 0.05]);
    let mut tags = drive(&view, 0.1, &mut random);
    tags[0].is_held = true;
    for tag in &mut tags[1..] {
        // Dead reckoning that is off by some centimetres.
        tag.rough_pose += Vector3::new(0.03, -0.02, 0.04);
    }
    let found = FloorCalibration::solve(&[], &tags, LensKnowledge::Unknown { width: 1280, height: 720 }).unwrap();
    // The arena is turned as the one held tag was seen: 0.1 px of 30.
    let (middle, _) = view.point_at_height(view.camera.centre_px, 0.0).unwrap();
    let distance_m = |view: &FloorView| {
        let at = |x: f64| view.point_at_height(Point2::new(x, 300.0), 0.0).unwrap().0;
        (at(400.0) - at(880.0)).norm()
    };
    assert!((distance_m(&found.view) - distance_m(&view)).abs() < 0.002, "{}", distance_m(&found.view));
    let (near, _) = found.view.point_at_height(view.camera.centre_px, 0.0).unwrap();
    assert!((near - middle).norm() < 0.005, "{near} {middle}");
}
