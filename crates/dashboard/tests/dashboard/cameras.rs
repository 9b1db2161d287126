//! Cameras on the page's interface.

use posebridge_dashboard::model::{CameraRow, SeenTagRow};
use posebridge_dashboard::{
    BoundListener, CameraPicture, CameraSource, Dashboard, DashboardInputs, ListenAddress, StationInfo,
};
use posebridge_telemetry::{LinkId, TimeDelta, Timestamp};

use crate::http::get;
use crate::played::{ManualClock, sources};

const JPEG: &[u8] = b"\xFF\xD8 a picture";

fn camera(link: u16, picture: Option<CameraPicture>) -> CameraSource {
    let bytes = picture.as_ref().map(|_| JPEG.into());
    CameraSource {
        link: LinkId(link),
        name: format!("camera {link}"),
        is_calibrated: link == 1,
        floor_tags: [580, 583],
        latest: Box::new(move || picture.clone()),
        bytes: Box::new(move || bytes.clone()),
    }
}

#[test]
fn cameras_are_listed_with_their_tags_and_their_last_pictures_are_shown() {
    let folder = tempfile::tempdir().unwrap();
    let tag = SeenTagRow { id: 7, corners: [[1.0, 2.0], [3.0, 2.0], [3.0, 4.5], [1.0, 4.5]], margin: 40.0 };
    let picture = CameraPicture {
        width: 640,
        height: 480,
        tags: vec![tag.clone()],
        at: Timestamp::from_millis(-2_000),
        latency: TimeDelta::from_millis(12),
        searched: 70,
        dropped: 3,
        damaged: 1,
    };
    let cameras = vec![camera(1, Some(picture)), camera(4, None)];
    let inputs = DashboardInputs { cameras, ..sources(folder.path(), &ManualClock::running()) };
    let bound = BoundListener::new(ListenAddress::Exact("127.0.0.1:0".parse().unwrap())).unwrap();
    let (dashboard, _feed, _commands) = Dashboard::start(Some(bound), StationInfo::default(), inputs).unwrap();
    let address = dashboard.address().unwrap();

    let rows: Vec<CameraRow> = serde_json::from_slice(&get(address, "/v1/cameras").body).unwrap();
    let [
        CameraRow { link: 1, name, is_calibrated: true, floor_tags: [580, 583], picture: Some(seen) },
        CameraRow { link: 4, is_calibrated: false, picture: None, .. },
    ] = &rows[..]
    else {
        panic!("{rows:?}");
    };
    assert_eq!((name.as_str(), seen.number, seen.dropped, seen.damaged), ("camera 1", 70, 3, 1));
    assert_eq!((seen.width, seen.height, seen.latency_s, &seen.tags[..]), (640, 480, 0.012, &[tag][..]));
    assert!(seen.age_s >= 2.0, "{seen:?}");

    let shown = get(address, "/v1/cameras/1/picture");
    assert_eq!((shown.status, &shown.body[..], shown.header("content-type")), (200, JPEG, Some("image/jpeg")));
    for path in ["/v1/cameras/4/picture", "/v1/cameras/2/picture", "/v1/cameras/x/picture"] {
        assert_eq!(get(address, path).status, 404, "{path}");
    }
}
