//! Pictures of a drive: their times, and the robot's pose in them.

use posebridge_sim::rendered_camera::{Exposure, FrameSchedule, LensState, RenderedCamera, RenderedFrame};
use posebridge_sim::scenario::RenderedCameraSettings;
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::{SensorSwitch, SimulatorCommand, TimeDelta};
use posebridge_vision::{FloorTagPose, GreyPicture, Tag36h11Detector, TagDetector};

use super::{floor_view, pose};

const CIRCLE: &str = "seed = 9\n[path.circle]\nradius_m = 0.4\n[start]\nx_m = 0.4\n[drive]\nrest_s = 0.2\nspeed_m_per_s = 0.3\n\
                      [brick]\ntelemetry_hz = 200\n[camera]\ntag_x_m = 0.03\n[camera.pictures]\n";

/// The frames that are due in each step of a drive.
fn frames(simulation: &mut Simulation, steps: usize) -> Vec<RenderedFrame> {
    let mut frames = Vec::new();
    for _ in 0..steps {
        simulation.step();
        let now = simulation.elapsed();
        for frame in simulation.take_due_frames().unwrap() {
            assert!((now - frame.due).as_nanos() < 1_000_000, "{now:?} {:?}", frame.due);
            frames.push(frame);
        }
    }
    frames
}

#[test]
fn a_picture_shows_the_robot_where_it_was_in_mid_exposure() {
    for shutter in ["", "line_time_us = 30\n"] {
        let scenario = Scenario::from_toml(&format!("{CIRCLE}{shutter}")).unwrap();
        let settings = scenario.camera.pictures.clone().unwrap();
        let view = floor_view(&settings);
        let mut simulation = Simulation::new(scenario);
        let frames = frames(&mut simulation, 3_000);
        let (mut detector, mut picture) = (Tag36h11Detector::default(), GreyPicture::default());
        let (mut worst_m, mut moved_m) = (0.0_f64, 0.0_f64);
        for frame in &frames {
            picture.decode_jpeg(&frame.jpeg).unwrap();
            let tags = detector.detect(picture.image().unwrap());
            let tag = tags.iter().find(|tag| tag.id == 0).unwrap();
            let robot = settings.robot_tag;
            let found = FloorTagPose::solve(&view, &tag.corners, &tag.covariance, robot.side_m, robot.height_m);
            let found = found.unwrap().pose.translation;
            // The row that shows the robot is exposed later than the middle one.
            let row = tag.corners.iter().map(|corner| corner.y).sum::<f64>() / 4.0 - 239.5;
            let exposed_s = frame.exposure_mid.as_secs_f64() + row * settings.line_time_us * 1e-6;
            let behind = simulation.truth().partition_point(|sample| sample.sim_time.as_secs_f64() < exposed_s);
            let (from, to) = (simulation.truth()[behind.saturating_sub(1)], simulation.truth()[behind]);
            let length_s = (to.sim_time - from.sim_time).as_secs_f64().max(1e-9);
            let share = ((exposed_s - from.sim_time.as_secs_f64()) / length_s).clamp(0.0, 1.0);
            let between = |from: f64, to: f64| from + share * (to - from);
            let heading_rad = from.pose.heading.rad() + share * (to.pose.heading - from.pose.heading).0;
            let (sin, cos) = heading_rad.sin_cos();
            let x_m = between(from.pose.x.0, to.pose.x.0) + 0.03 * cos;
            let y_m = between(from.pose.y.0, to.pose.y.0) + 0.03 * sin;
            worst_m = worst_m.max((found.x - x_m).hypot(found.y - y_m));
            moved_m = moved_m.max(simulation.truth()[0].pose.origin().distance(to.pose.origin()).0);
        }
        // 4.8 mm a pixel.
        assert!(moved_m > 0.5 && worst_m < 1e-3, "{worst_m} m after {moved_m} m");
    }
}

#[test]
fn frames_come_in_order_and_after_their_latency() {
    let text = "[camera]\nis_present = false\n[camera.pictures]\nrate_hz = 50\nlatency_ms = 40\njitter_ms = 30\nwidth_px = 64\n\
                height_px = 64\nfloor_tags = []\n";
    let mut simulation = Simulation::new(Scenario::from_toml(text).unwrap());
    assert_eq!(simulation.next_picture().unwrap().mid, TimeDelta::from_millis(4));
    let frames = frames(&mut simulation, 10_000);
    assert!(frames.is_sorted_by_key(|frame| frame.due));
    let mut latencies_ms: Vec<f64> = Vec::new();
    for (number, frame) in (0..).zip(&frames) {
        assert_eq!(frame.number, number);
        assert_eq!(frame.exposure_mid, TimeDelta::from_micros(20_000 * number as i64 + 4_000));
        latencies_ms.push((frame.due - frame.exposure_mid).as_millis_f64());
    }
    assert!(latencies_ms.iter().all(|latency| (10.0..=70.0).contains(latency)));
    let mean_ms = latencies_ms.iter().sum::<f64>() / latencies_ms.len() as f64;
    // A frame waits for a slow one before it.
    assert!((38.0..46.0).contains(&mean_ms), "{mean_ms}");
    assert!(simulation.camera_fixes().is_empty());
    // Without any latency a frame still waits for its last row.
    let text = "[camera.pictures]\nlatency_ms = 0\njitter_ms = 0\nline_time_us = 40\n";
    let first = Simulation::new(Scenario::from_toml(text).unwrap()).next_picture().unwrap();
    assert_eq!((first.due, first.end), (first.end, TimeDelta::from_micros(8_000 + 40 * 479)));
    assert_eq!(Simulation::new(Scenario::default()).next_picture(), None);
}

#[test]
fn commands_cover_the_lens_and_delay_the_frames() {
    let text = "[camera]\nblackouts = [{ from_s = 0.5, to_s = 1.0 }]\n[camera.pictures]\njitter_ms = 0\n";
    let mut simulation = Simulation::new(Scenario::from_toml(text).unwrap());
    let mut picture = GreyPicture::default();
    let mut is_dark = |frame: &RenderedFrame| {
        picture.decode_jpeg(&frame.jpeg).unwrap();
        picture.image().unwrap().row(100).iter().all(|pixel| *pixel < 30)
    };
    for frame in frames(&mut simulation, 1_200) {
        let exposed_s = frame.exposure_mid.as_secs_f64();
        assert_eq!(is_dark(&frame), (0.5..1.0).contains(&exposed_s), "{exposed_s}");
    }
    simulation.execute(&SimulatorCommand::Camera(SensorSwitch::Off));
    simulation.execute(&SimulatorCommand::CameraDelay { delay: TimeDelta::from_millis(200) });
    let late = frames(&mut simulation, 800).pop().unwrap();
    assert!(is_dark(&late));
    assert_eq!(late.due - late.exposure_mid, TimeDelta::from_millis(200));
}

#[test]
fn between_two_steps_a_tag_moves_evenly_and_turns_the_short_way() {
    let ms = TimeDelta::from_millis;
    let schedule = FrameSchedule::new(&RenderedCameraSettings::default(), 1);
    let track = vec![(ms(10), pose(1.0, 2.0, 3.1)), (ms(11), pose(1.2, 2.4, -3.1)), (ms(13), pose(1.2, 2.4, -3.1))];
    let exposure = Exposure::new(schedule.next_exposure(), LensState::Open, track).unwrap();
    for (micros, x_m, y_m, heading_rad) in [
        (9_000, 1.0, 2.0, 3.1_f64),
        (10_500, 1.1, 2.2, std::f64::consts::PI),
        (10_250, 1.05, 2.1, 3.120_8),
        (12_000, 1.2, 2.4, -3.1),
        (20_000, 1.2, 2.4, -3.1),
    ] {
        let found = exposure.tag_pose(TimeDelta::from_micros(micros));
        assert!((found.x.0 - x_m).hypot(found.y.0 - y_m) < 1e-9, "{micros}: {found:?}");
        assert!((found.heading.rad() - heading_rad).sin().abs() < 1e-4, "{micros}: {found:?}");
    }
    assert_eq!(Exposure::new(schedule.next_exposure(), LensState::Open, Vec::new()), None);
}

#[test]
fn an_exposure_can_be_rendered_elsewhere() {
    let scenario = Scenario::from_toml(CIRCLE).unwrap();
    let mut elsewhere = RenderedCamera::new(scenario.camera.pictures.as_ref().unwrap(), scenario.seed).unwrap();
    let (mut here, mut there) = (Simulation::new(scenario.clone()), Simulation::new(scenario));
    let here = frames(&mut here, 500);
    for _ in 0..500 {
        there.step();
    }
    let mut count = 0;
    while let Some(exposure) = there.take_exposure() {
        let frame = elsewhere.take_picture(&exposure);
        assert!(frame.due > there.elapsed() || here[count] == frame);
        count += 1;
    }
    assert!(count >= here.len() && here.len() > 4, "{count} {}", here.len());
    // A robot at rest stands at its place.
    let stands = pose(0.43, 0.0, 0.0);
    assert!(there.start_pose().origin().distance(stands.origin()).0 < 0.04);
}
