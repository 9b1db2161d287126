//! A camera as a connection of a link.

use std::sync::Arc;
use std::task::{Context, Poll, ready};

use posebridge_link::{
    Connection, HostTimer, LinkCounters, LinkError, LinkUrl, OpenFuture, Opener, OutgoingFrame, QueueStatus,
    ReceivedBytes,
};
use posebridge_telemetry::{HostClock, PeerId, Timestamp};
use tokio::sync::mpsc;

use crate::capture_thread::{RunningCapture, died, spawn};
use crate::picture_slot::StreamEnd;
use crate::settings::CameraSettings;
use crate::sighting::Sighting;
use crate::tag_lines::lines_of;
use crate::tag_search_thread::search_pictures;

/// Searched pictures that wait for the station. It takes each at once; while it stands still the next ones are dropped.
const WAITING_PICTURES: usize = 4;

/// Opens the camera of a `camera:` URL, again after each loss.
pub fn camera_opener(url: LinkUrl, settings: CameraSettings) -> Opener {
    Box::new(move |timer| open(url.clone(), settings.clone(), timer))
}

fn open(url: LinkUrl, settings: CameraSettings, timer: HostTimer) -> OpenFuture {
    Box::pin(async move {
        let what = url.to_string();
        let (capture, is_open) = RunningCapture::start(url, timer)?;
        let detail = is_open.await.unwrap_or_else(|_ended| Err(died(what.clone())))?;
        let (found, sightings) = mpsc::channel(WAITING_PICTURES);
        let (slot, name) = (Arc::clone(&capture.slot), settings.name.clone());
        spawn("tags", what, move || search_pictures(&settings, timer, &slot, &found))?;
        let connection: Box<dyn Connection> = Box::new(CameraConnection { name, detail, timer, capture, sightings });
        Ok(connection)
    })
}

struct CameraConnection {
    name: String,
    detail: String,
    timer: HostTimer,
    capture: RunningCapture,
    sightings: mpsc::Receiver<Sighting>,
}

impl Connection for CameraConnection {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    /// A camera is told nothing: its clock is this computer's.
    fn send(&mut self, _out: &OutgoingFrame<'_>, _counters: &mut LinkCounters) {}

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        _counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        let Some(sighting) = ready!(self.sightings.poll_recv(cx)) else {
            return Poll::Ready(match self.capture.slot.take_end() {
                Some(StreamEnd::Lost(error)) => Err(error),
                Some(StreamEnd::Finished) => Ok(None),
                None => Err(LinkError::Camera("the search for tags has stopped".to_owned())),
            });
        };
        let arrival = self.timer.now();
        let bytes = lines_of(&sighting, &self.name, arrival);
        Poll::Ready(Ok(Some(ReceivedBytes { peer: PeerId(0), arrival, bytes })))
    }

    fn queue_status(&self, _now: Timestamp<HostClock>) -> QueueStatus {
        QueueStatus::default()
    }
}
