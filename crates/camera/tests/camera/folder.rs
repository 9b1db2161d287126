//! Folders of pictures.

use posebridge_camera::PictureSaver;
use posebridge_link::LinkEvent;

use crate::drawing::{corners, empty_picture, picture_with_tag};
use crate::support::{CameraLink, corners_of, distance};

const SIZE: (usize, usize) = (160, 120);

#[tokio::test]
async fn a_folder_is_played_in_the_order_of_its_names_and_then_ends() {
    let folder = tempfile::tempdir().unwrap();
    let places = [(20, 30), (24, 30), (28, 33), (32, 36)];
    for (number, place) in places.into_iter().enumerate() {
        std::fs::write(folder.path().join(format!("{number}.pgm")), picture_with_tag(SIZE, 7, place)).unwrap();
    }
    std::fs::write(folder.path().join("notes.txt"), "no picture").unwrap();
    let mut camera = CameraLink::new(&format!("{}?fps=100", folder.path().display()));
    for place in places {
        let line = camera.tag().await;
        assert_eq!((&line["camera"], &line["tag"]), (&"overhead".into(), &7.into()));
        assert_eq!(line["picture_px"], serde_json::json!([160, 120]));
        assert!(distance(corners_of(&line), corners(place)) < 0.1, "{line}");
        let ago: [u64; 2] = serde_json::from_value(line["exposed_ago_us"].clone()).unwrap();
        assert!(ago[0] == ago[1] && ago[0] < 10_000_000, "{line}");
        let covariance: Vec<f64> = serde_json::from_value(line["corners_cov_px2"].clone()).unwrap();
        assert!(covariance.len() == 36 && covariance[0] > 0.0, "{line}");
    }
    assert!(matches!(camera.link.next_event().await, LinkEvent::Finished { .. }));
}

#[tokio::test]
async fn kept_pictures_are_played_again() {
    let [played, kept] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let places = [(20, 30), (24, 30), (28, 33)];
    for (number, place) in places.into_iter().enumerate() {
        std::fs::write(played.path().join(format!("{number}.pgm")), picture_with_tag(SIZE, 7, place)).unwrap();
    }
    let (sender, failure) = std::sync::mpsc::sync_channel(1);
    let saver = PictureSaver::start(kept.path(), move |error| sender.send(error).unwrap()).unwrap();
    let mut camera = CameraLink::with_saver(&format!("{}?fps=100", played.path().display()), Some(saver));
    while !matches!(camera.link.next_event().await, LinkEvent::Finished { .. }) {}
    drop(camera);
    // The thread has ended when its end of the channel is gone: all is written.
    assert!(failure.recv().is_err());
    let table = std::fs::read_to_string(kept.path().join("times.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + places.len(), "{table}");
    let mut again = CameraLink::new(&kept.path().display().to_string());
    for place in places {
        assert!(distance(corners_of(&again.tag().await), corners(place)) < 0.1);
    }
}

#[tokio::test]
async fn a_camera_without_tags_says_that_it_is_there() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("1.pgm"), empty_picture(SIZE)).unwrap();
    let mut camera = CameraLink::new(&folder.path().display().to_string());
    assert!(matches!(camera.link.next_event().await, LinkEvent::Up { .. }));
    let LinkEvent::Bytes { bytes, .. } = camera.link.next_event().await else { panic!("it has a picture") };
    assert_eq!(bytes, b"{\"camera\":\"overhead\",\"takes_requests\":false}\n");
}

#[tokio::test]
async fn what_cannot_be_opened_says_what_to_write() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().display().to_string();
    for (source, words) in [
        (empty.as_str(), "no .jpg, .png or .pgm"),
        ("no/such/folder", "a folder of pictures"),
        ("/dev/video99", "plug the device in"),
        ("https://phone/video", "only http:// is read"),
    ] {
        let error = CameraLink::new(source).link.try_open().await;
        let error = match error {
            Err(error) => error.to_string(),
            // It may be plugged in later.
            Ok(()) => CameraLink::new(source).loss().await,
        };
        assert!(error.contains(words), "{source}: {error}");
    }
}
