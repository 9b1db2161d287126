//! Corners of tags in pictures as lines of JSON: to places on the floor as an independent projection has them, and what is refused.

use posebridge_protocol::bricks::camera_json::{CameraJsonSettings, FloorCamera};
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings};
use posebridge_protocol::framing::TransportKind;
use posebridge_protocol::message::{Message, VisionFix, WireStamp};
use posebridge_telemetry::{TimeDelta, Timestamp};
use posebridge_vision::{CameraModel, FloorView};
use serde_json::Value;

use crate::support::at;

/// Written by tests/data/camera_json/make_corners.py.
const LINES: &str = include_str!("../data/camera_json/corners.jsonl");
const POSES: &str = include_str!("../data/camera_json/corner_poses.json");

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list: Vec<f64> = value.as_array().expect("a list").iter().map(|one| one.as_f64().expect("a number")).collect();
    list.try_into().expect("its length")
}

fn floor_camera() -> FloorCamera {
    let camera: Value = serde_json::from_str(POSES).expect("JSON");
    let camera = &camera["camera"];
    let model = CameraModel {
        focal_px: numbers(&camera["focal_px"]).into(),
        centre_px: numbers(&camera["centre_px"]).into(),
        radial: numbers(&camera["radial"]),
    };
    let view = FloorView::new(model, numbers(&camera["position_m"]), numbers(&camera["rotation"]));
    FloorCamera {
        view: view.expect("it is above the floor"),
        picture_px: [1_280, 720],
        tag_side_m: 0.08,
        tag_height_m: 0.085,
        floor_tags: (580, 4),
    }
}

fn codec(floor: Option<FloorCamera>) -> Box<dyn BrickCodec> {
    let fixes = CameraJsonSettings {
        framing: TransportKind::Stream,
        delay: TimeDelta::from_millis(150),
        delay_spread: TimeDelta::from_millis(10),
        floor,
        ..CameraJsonSettings::default()
    };
    crate::support::codec("camera-json", &CodecSettings { fixes, ..CodecSettings::default() })
}

/// The fixes of `text`, which arrives after a second, and the texts for people.
fn decode(floor: Option<FloorCamera>, text: &str) -> (Vec<VisionFix>, Vec<String>) {
    let (mut fixes, mut texts) = (Vec::new(), Vec::new());
    codec(floor).push(at(1_000), text.as_bytes(), &mut |event| match event {
        CodecEvent::Message { message: Message::VisionPosition(fix), .. } => fixes.push(fix),
        CodecEvent::StatusText { text, .. } => texts.push(text),
        _ => {}
    });
    (fixes, texts)
}

#[test]
fn corners_become_the_places_that_they_were_projected_from() {
    let poses: Value = serde_json::from_str(POSES).unwrap();
    let poses: Vec<[f64; 3]> = poses["poses"].as_array().unwrap().iter().map(numbers).collect();
    let (fixes, _) = decode(Some(floor_camera()), LINES);
    assert_eq!(fixes.len(), poses.len());
    for (fix, [x, y, heading]) in fixes.iter().zip(poses) {
        assert!((fix.x.0 - x).hypot(fix.y.0 - y) < 2e-5, "{fix:?}");
        assert!((fix.heading.unwrap().rad() - heading).abs() < 2e-4, "{fix:?}");
        assert_eq!(fix.tag, Some(7));
        let sent = Timestamp::from_millis(998);
        assert_eq!(fix.stamp, WireStamp::HostInterval { sent, answered: Timestamp::from_millis(1_000) });
    }
    // 0.3 px at each corner, and some 3 mm of floor for a pixel: the four of them know the middle to half of that.
    let [xx, _, yy, _] = fixes[0].covariance.unwrap();
    let sigma_mm = [xx, yy].map(|square| 1e3 * square.sqrt());
    assert!(sigma_mm.iter().all(|sigma| (0.3..0.7).contains(sigma)), "{sigma_mm:?}");
}

#[test]
fn corners_that_fit_worse_than_they_claim_are_worth_less() {
    let first = LINES.lines().next().unwrap();
    let triangle: Vec<String> =
        (0..8).flat_map(|row| (0..=row).map(move |k| if k == row { "1e-4" } else { "0" }.to_owned())).collect();
    let sure = first.replace("\"tag\"", &format!("\"corners_cov_px2\": [{}], \"tag\"", triangle.join(",")));
    let moved = sure.replace("661.31109", "661.81109");
    let sigma = |line: &str| {
        let (fixes, texts) = decode(Some(floor_camera()), &format!("{line}\n"));
        fixes.first().unwrap_or_else(|| panic!("{texts:?}")).covariance.unwrap()[0].sqrt()
    };
    // Half a pixel of one corner where 0.05 px is the least that any has: a squared residual of 96 for its two coordinates, and five degrees
    // of freedom: a factor of 4.4 less what the pose can follow.
    let ratio = sigma(&moved) / sigma(&sure);
    assert!((2.5..4.4).contains(&ratio), "{ratio}");
}

#[test]
fn the_age_of_a_picture_is_that_of_the_line_or_of_the_settings_before_its_reception() {
    let first = LINES.lines().next().unwrap();
    let received = first.replace("\"exposed_ago_us\": [0, 2000]", "\"received_ago_us\": 30000");
    let (fixes, _) = decode(Some(floor_camera()), &format!("{received}\n"));
    let interval = |sent, answered| WireStamp::HostInterval {
        sent: Timestamp::from_millis(sent),
        answered: Timestamp::from_millis(answered),
    };
    assert_eq!(fixes[0].stamp, interval(1_000 - 30 - 160, 1_000 - 30 - 140));
}

#[test]
fn tags_on_the_floor_are_no_robots() {
    for (tag, count) in [(579, 1), (580, 0), (583, 0), (584, 1)] {
        let line = LINES.lines().next().unwrap().replace("\"tag\": 7", &format!("\"tag\": {tag}"));
        let (fixes, texts) = decode(Some(floor_camera()), &format!("{line}\n"));
        assert_eq!((fixes.len(), texts.len()), (count, 1), "{tag}: {texts:?}");
    }
}

#[test]
fn what_gives_no_place_is_refused_with_its_key() {
    let first = LINES.lines().next().unwrap();
    let larger = FloorCamera { tag_side_m: 0.1, ..floor_camera() };
    let level = FloorView::new(floor_camera().view.camera, [0.0, 0.0, 2.5], [0.5, -0.5, 0.5, -0.5]);
    let level = FloorCamera { view: level.unwrap(), ..floor_camera() };
    for (floor, from, to, words) in [
        (None, "", "", "`corners_px` has no place on the floor"),
        (Some(larger), "", "", "`corners_px` is a tag of 80 %"),
        (Some(level), "[640.60768, 384.61726]", "[640.60768, 2.0]", "horizon"),
        (Some(floor_camera()), "[1280, 720]", "[640, 480]", "is [640, 480], and the camera's file is for 1280, 720"),
        (Some(floor_camera()), "\"tag\": 7, ", "", "`tag` is missing beside `corners_px`"),
        (Some(floor_camera()), "\"tag\"", "\"y_m\": 1, \"tag\"", "`y_m` says the same as `corners_px`"),
        (Some(floor_camera()), ", [640.60768, 384.61726]", "", "`corners_px` must be four pairs"),
        (Some(floor_camera()), "661.31109", "1e9", "`corners_px` must be four pairs"),
        (
            Some(floor_camera()),
            "\"tag\"",
            "\"corners_cov_px2\": [1, 2], \"tag\"",
            "`corners_cov_px2` must be 36 numbers",
        ),
        (Some(floor_camera()), "[0, 2000]", "[2000, 0]", "`exposed_ago_us` must be the least and the most"),
        (Some(floor_camera()), "\"tag\"", "\"exposed_us\": 5, \"tag\"", "`exposed_ago_us` says the same"),
    ] {
        let line = first.replacen(from, to, usize::from(!from.is_empty()));
        let (fixes, texts) = decode(floor, &format!("{line}\n"));
        assert!(fixes.is_empty() && texts.iter().any(|text| text.contains(words)), "{line}: {texts:?}");
    }
    let ones = vec!["1"; 36].join(",");
    let line = first.replace("\"tag\"", &format!("\"corners_cov_px2\": [{ones}], \"tag\""));
    let (_, texts) = decode(Some(floor_camera()), &format!("{line}\n"));
    assert!(texts.iter().any(|text| text.contains("lower triangle of a covariance")), "{texts:?}");
}
