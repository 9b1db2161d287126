//! The detector finds the tags of rendered pictures where they are.

use nalgebra::Vector2;
use posebridge_sim::rendered_camera::{LensState, RenderedCamera, encode_jpeg};
use posebridge_sim::scenario::{FloorTagSettings, RenderedCameraSettings, RobotTagSettings};
use posebridge_telemetry::{Arena, Pose, TimeDelta};
use posebridge_vision::GreyPicture;

use super::{detect, detect_robot, errors, middle, pose, render, rms, true_corners, without_noise};

const MID: TimeDelta = TimeDelta::from_millis(1_000);

/// Poses all over the floor that the default camera sees, in all directions.
fn poses(count: usize) -> impl Iterator<Item = Pose<Arena>> {
    (0..count).map(|index| {
        let turn = |step: f64| (index as f64 * step).fract();
        pose(-0.3 + 1.6 * turn(0.754_877_67), -0.15 + 1.3 * turn(0.569_840_29), 7.0 * turn(0.381_966))
    })
}

/// The errors of all corners in frames of a robot that stands, as the camera's receiver sees them with a JPEG quality.
fn corner_errors(settings: &RenderedCameraSettings, quality: Option<u8>, count: usize) -> Vec<Vector2<f64>> {
    let mut camera = RenderedCamera::new(settings, 3).unwrap();
    let projection = *camera.projection();
    let floor_tags = settings.floor_tags.iter().map(|tag| {
        let printed = RobotTagSettings { id: tag.id, side_m: tag.side_m, height_m: 0.0 };
        (printed, pose(tag.x_m, tag.y_m, tag.heading_deg.to_radians()))
    });
    let mut found = Vec::new();
    for (number, robot) in poses(count).enumerate() {
        let mut pixels = render(&mut camera, number as u64, MID, |_| robot);
        if let Some(quality) = quality {
            let jpeg = encode_jpeg(&pixels, settings.width_px, settings.height_px, quality).unwrap();
            let mut picture = GreyPicture::default();
            picture.decode_jpeg(&jpeg).unwrap();
            let image = picture.image().unwrap();
            pixels = (0..image.height()).flat_map(|row| image.row(row).to_vec()).collect();
        }
        let tags = detect(settings, &pixels);
        let mut expected: Vec<_> = floor_tags.clone().collect();
        expected.push((settings.robot_tag, robot));
        // Of tags that the robot may cover, none lies in its way often enough to matter.
        for (tag, pose) in expected {
            let Some(seen) = tags.iter().find(|seen| seen.id == tag.id) else {
                assert_ne!(tag.id, settings.robot_tag.id, "the robot at {pose:?} is not seen");
                continue;
            };
            found.extend(errors(&seen.corners, &true_corners(&projection, tag, pose)));
        }
    }
    assert!(found.len() > 4 * count * (settings.floor_tags.len() + 1) * 9 / 10, "{} corners", found.len());
    found
}

#[test]
fn corners_of_standing_tags_are_where_they_are() {
    let found = corner_errors(&without_noise(), None, 40);
    let (sigma, bias) = (rms(&found), found.iter().sum::<Vector2<f64>>() / found.len() as f64);
    assert!(sigma < 0.05 && bias.norm() < 0.01, "rms {sigma} px, bias {bias}");
    let large = RenderedCameraSettings { width_px: 1280, height_px: 720, focal_px: 1_000.0, ..without_noise() };
    let sigma = rms(&corner_errors(&large, None, 10));
    assert!(sigma < 0.05, "rms {sigma} px");
}

#[test]
fn noise_and_jpeg_leave_corners_where_they_are() {
    let found = corner_errors(&RenderedCameraSettings::default(), Some(80), 40);
    let (sigma, bias) = (rms(&found), found.iter().sum::<Vector2<f64>>() / found.len() as f64);
    assert!(sigma < 0.15 && bias.norm() < 0.02, "rms {sigma} px, bias {bias}");
}

/// A camera that looks straight down: 200 px a metre at the height of the robot's tag, the picture's upper edge along y.
fn from_above(settings: &RenderedCameraSettings) -> RenderedCameraSettings {
    RenderedCameraSettings {
        x_m: 0.0,
        y_m: 0.0,
        height_m: 3.0 + settings.robot_tag.height_m,
        tilt_deg: 0.0,
        radial: [0.0, 0.0],
        light_change: [0.0, 0.0],
        floor_tags: Vec::new(),
        ..settings.clone()
    }
}

#[test]
fn edges_along_rows_and_columns_are_where_they_are() {
    let settings = from_above(&RenderedCameraSettings { blur_px: 0.0, ..without_noise() });
    let mut camera = RenderedCamera::new(&settings, 3).unwrap();
    for step in 0..20 {
        let shift_m = 0.0005 * f64::from(step);
        let pixels = render(&mut camera, 0, MID, |_| pose(0.4 + shift_m, 0.3 + shift_m, 0.0));
        // The corner that lies at the upper right; the paper goes on for 2.5 px.
        let half_m = settings.robot_tag.side_m / 2.0;
        let (right, up) = (0.4 + shift_m + half_m, 0.3 + shift_m + half_m);
        let (column, row) = (319.5 + 200.0 * right, 239.5 - 200.0 * up);
        let at = |column: usize, row: usize| f64::from(pixels[row * 640 + column]);
        let (inner, outer) = ((column - 2.0) as usize, (column + 1.9) as usize);
        let (lower, upper) = ((row + 2.0) as usize, (row - 0.9) as usize);
        let (black, white) = (at(inner, lower), at(outer, lower));
        assert!(white - black > 150.0, "{white} {black}");
        let share = |level: f64| (level - black) / (white - black);
        // The white share of a row of pixels across the edge says where the edge is.
        let whites: f64 = (inner..=outer).map(|column| share(at(column, lower))).sum();
        let found_column = outer as f64 + 0.5 - whites;
        let whites: f64 = (upper..=lower).map(|row| share(at(inner, row))).sum();
        let found_row = upper as f64 - 0.5 + whites;
        // A grey level of 180 is worth 0.006 px.
        assert!((found_column - column).abs() < 0.009, "step {step}: {found_column}, not {column}");
        assert!((found_row - row).abs() < 0.009, "step {step}: {found_row}, not {row}");
    }
}

#[test]
fn the_middle_of_a_moving_tag_is_that_of_mid_exposure() {
    let settings = without_noise();
    let mut camera = RenderedCamera::new(&settings, 3).unwrap();
    let projection = *camera.projection();
    let mut found = Vec::new();
    for (number, at) in poses(40).enumerate() {
        let (sin, cos) = at.heading.rad().sin_cos();
        let moving = |time: TimeDelta| {
            let way_m = 0.3 * (time - MID).as_secs_f64();
            pose(at.x.0 + cos * way_m, at.y.0 + sin * way_m, at.heading.rad())
        };
        let corners = detect_robot(&settings, &render(&mut camera, number as u64, MID, moving));
        let error = middle(&corners) - middle(&true_corners(&projection, settings.robot_tag, at));
        // Along the way: an error of the time would show here.
        let before = middle(&true_corners(&projection, settings.robot_tag, moving(MID - TimeDelta::from_millis(10))));
        let way = middle(&true_corners(&projection, settings.robot_tag, at)) - before;
        found.push(Vector2::new(error.dot(&way.normalize()), error.perp(&way.normalize())));
    }
    let bias = found.iter().sum::<Vector2<f64>>() / found.len() as f64;
    let (sigma, worst) = (rms(&found), found.iter().map(Vector2::norm).fold(0.0, f64::max));
    assert!(bias.norm() < 0.01 && sigma < 0.05, "bias {bias}, rms {sigma} px, worst {worst} px");
}

#[test]
fn a_moving_tag_is_blurred_along_its_way() {
    let robot_tag = RobotTagSettings { side_m: 0.4, ..Default::default() };
    let settings =
        from_above(&RenderedCameraSettings { robot_tag, blur_px: 0.0, exposure_ms: 30.0, ..without_noise() });
    let mut camera = RenderedCamera::new(&settings, 3).unwrap();
    // 1 m/s: 6 px during the exposure. The front edge of the black rim lies 40 px right of the middle.
    let mut soft = |speed: f64| {
        let pixels = render(&mut camera, 0, MID, |time| pose(speed * (time - MID).as_secs_f64(), 0.0, 0.0));
        (354..366).filter(|column| (30..190).contains(&pixels[240 * 640 + column])).count()
    };
    assert_eq!([soft(0.0), soft(1.0)], [0, 6]);
}

#[test]
fn a_rolling_shutter_shifts_each_row_by_its_delay_times_the_speed() {
    let speed = 0.5;
    let rolling = from_above(&RenderedCameraSettings { line_time_us: 60.0, ..without_noise() });
    let mut camera = RenderedCamera::new(&rolling, 3).unwrap();
    let still = from_above(&without_noise());
    let mut still = RenderedCamera::new(&still, 3).unwrap();
    for y_m in [-1.0, -0.6, -0.2, 0.2, 0.6, 1.0] {
        let moving = |time: TimeDelta| pose(0.1 + speed * (time - MID).as_secs_f64(), y_m, 0.3);
        let shifted = middle(&detect_robot(&rolling, &render(&mut camera, 0, MID, moving)));
        let standing = middle(&detect_robot(&rolling, &render(&mut still, 0, MID, |_| moving(MID))));
        let row = standing.y - 239.5;
        let expected = 60e-6 * row * speed * 200.0;
        let shift = shifted - standing;
        assert!((shift.x - expected).abs() < 0.02 && shift.y.abs() < 0.02, "row {row}: {shift}, not {expected}");
        assert!(expected.abs() > 0.2 || y_m.abs() < 0.5, "{expected}");
    }
}

#[test]
fn paper_has_its_level_in_a_light_that_changes_over_the_picture_and_edges_their_blur() {
    // In the middle and near the right edge: paper of 80 px.
    let sheet = |id, x_m| FloorTagSettings { id, side_m: 0.3, x_m, y_m: 0.0, heading_deg: 0.0 };
    let settings = from_above(&RenderedCameraSettings { blur_px: 1.5, white_level: 180.0, ..without_noise() });
    let settings =
        RenderedCameraSettings { floor_tags: vec![sheet(1, 0.0), sheet(2, 1.2)], light_change: [0.4, 0.0], ..settings };
    let mut camera = RenderedCamera::new(&settings, 3).unwrap();
    let pixels = camera.render(0, MID, LensState::Open, &mut []).to_vec();
    // Right of the rim, in the middle of the white: 0.169 m from the middle of the tag, at 194.5 px a metre.
    let white = |x_m: f64| {
        let column = (319.5 + 600.0 / settings.height_m * (x_m + 0.169)).round();
        (f64::from(pixels[240 * 640 + column as usize]), 180.0 * (1.0 + 0.4 * ((column + 0.5) / 640.0 - 0.5)))
    };
    for (found, expected) in [white(0.0), white(1.2)] {
        assert!((found / expected - 1.0).abs() < 0.02, "{found}, not {expected}");
    }
    // From 10 % to 90 % of an edge: 2.56 sigma, and a little for the area of the pixels.
    let [black, level] = [16.0, 180.0];
    let soft = (342..354).filter(|column| {
        let share = (f64::from(pixels[240 * 640 + column]) - black) / (level - black);
        (0.1..0.9).contains(&share)
    });
    assert!((3..=5).contains(&soft.count()));
}

#[test]
fn a_seed_gives_its_own_noise_and_always_the_same() {
    let settings = RenderedCameraSettings::default();
    let frame = |seed, number| {
        let mut camera = RenderedCamera::new(&settings, seed).unwrap();
        // Nothing of it is left in the next frame, which draws the same place.
        render(&mut camera, 17, MID, |_| pose(0.47, 0.52, 0.3));
        render(&mut camera, number, MID, |_| pose(0.5, 0.5, 1.0))
    };
    let first = frame(1, 0);
    assert_eq!(first, frame(1, 0));
    assert_eq!(first, render(&mut RenderedCamera::new(&settings, 1).unwrap(), 0, MID, |_| pose(0.5, 0.5, 1.0)));
    let differences = |other: &[u8]| first.iter().zip(other).filter(|(one, other)| one != other).count();
    for other in [frame(2, 0), frame(1, 1)] {
        assert!(differences(&other) > first.len() / 2);
    }
}

#[test]
fn a_covered_lens_shows_nothing_and_a_tag_out_of_sight_neither() {
    let settings = RenderedCameraSettings::default();
    let mut camera = RenderedCamera::new(&settings, 1).unwrap();
    assert!(camera.render(0, MID, LensState::Covered, &mut []).iter().all(|pixel| *pixel < 20));
    let away = render(&mut camera, 1, MID, |_| pose(0.5, -30.0, 0.0));
    assert_eq!(away, camera.render(1, MID, LensState::Open, &mut []).to_vec());
    assert_eq!(detect(&settings, &away).len(), settings.floor_tags.len());
    // Half of it beyond the edge.
    render(&mut camera, 2, MID, |_| pose(-0.9, 0.5, 0.0));
}

#[test]
fn a_picture_that_is_no_picture_and_settings_that_contradict_each_other_are_refused() {
    assert_eq!(encode_jpeg(&[0; 63], 8, 8, 80), None);
    assert_eq!(encode_jpeg(&[], 0, 0, 80), None);
    let sheet = |id| FloorTagSettings { id, side_m: 0.1, x_m: 0.0, y_m: 0.0, heading_deg: 0.0 };
    let robot = RobotTagSettings { height_m: 2.5, ..Default::default() };
    let default = RenderedCameraSettings::default;
    for (settings, key) in [
        (RenderedCameraSettings { line_time_us: 200.0, ..default() }, "line_time_us"),
        (RenderedCameraSettings { robot_tag: robot, ..default() }, "robot_tag"),
        (RenderedCameraSettings { radial: [-0.9, 0.0], ..default() }, "radial"),
        (RenderedCameraSettings { floor_tags: vec![sheet(3), sheet(3)], ..default() }, "id 3"),
        (RenderedCameraSettings { floor_tags: vec![sheet(587)], ..default() }, "id 587"),
        (RenderedCameraSettings { floor_tags: (1..=65).map(sheet).collect(), ..default() }, "floor_tags"),
    ] {
        let message = RenderedCamera::new(&settings, 1).unwrap_err().to_string();
        assert!(message.contains(key), "{message}");
    }
}
