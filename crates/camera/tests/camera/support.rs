//! A link to a camera, and the lines that it gives.

use std::sync::Arc;

use posebridge_camera::{CameraSettings, CameraView, PictureSaver, camera_opener};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkUrl};
use posebridge_telemetry::{HostClock, LinkId, Timestamp};
use serde_json::Value;

/// A link that is up, down and greets so often without a tag finds none.
const MOST_EVENTS: usize = 30;

pub(crate) struct CameraLink {
    pub(crate) link: Link,
    pub(crate) view: CameraView,
    pub(crate) timer: HostTimer,
}

impl CameraLink {
    pub(crate) fn new(source: &str) -> Self {
        Self::with_saver(source, None)
    }

    pub(crate) fn with_saver(source: &str, saver: Option<PictureSaver>) -> Self {
        let url = LinkUrl::parse(&format!("camera:{source}")).expect("a URL");
        let view = CameraView::default();
        let (name, saver) = ("overhead".to_owned(), saver.map(Arc::new));
        let settings = CameraSettings { name, floor_tags: 580..584, view: view.clone(), saver };
        let open = LinkOpenConfig { id: LinkId(3), url: url.clone(), role: ConnectRole::Dial };
        let timer = HostTimer::start();
        Self { link: Link::with_opener(open, camera_opener(url, settings), timer), view, timer }
    }

    /// The next line that is no greeting.
    pub(crate) async fn tag(&mut self) -> Value {
        self.tag_at().await.1
    }

    /// With the time to which it refers.
    pub(crate) async fn tag_at(&mut self) -> (Timestamp<HostClock>, Value) {
        for _ in 0..MOST_EVENTS {
            if let LinkEvent::Bytes { arrival, bytes, .. } = self.link.next_event().await {
                let lines = String::from_utf8(bytes).expect("text");
                let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
                if let Some(line) = lines.into_iter().find(|line| line.get("tag").is_some()) {
                    return (arrival, line);
                }
            }
        }
        panic!("{MOST_EVENTS} events, and no tag");
    }

    /// The reason of the next loss.
    pub(crate) async fn loss(&mut self) -> String {
        loop {
            if let LinkEvent::Down { reason, .. } = self.link.next_event().await {
                return reason;
            }
        }
    }
}

pub(crate) fn corners_of(line: &Value) -> [[f64; 2]; 4] {
    serde_json::from_value(line["corners_px"].clone()).expect("four pairs")
}

/// The largest distance of two corners that belong together, px.
pub(crate) fn distance(found: [[f64; 2]; 4], expected: [[f64; 2]; 4]) -> f64 {
    let distances = found.iter().zip(expected).map(|(one, other)| (one[0] - other[0]).hypot(one[1] - other[1]));
    distances.fold(0.0, f64::max)
}
