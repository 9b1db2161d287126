//! Listens on an open link for a while.

use posebridge_link::{HostTimer, Link, LinkEvent};
use posebridge_protocol::detect::{ProtocolDetection, recognise};
use posebridge_telemetry::TimeDelta;

/// Frames with a checksum after which nothing more has to be heard.
const ENOUGH_FRAMES: usize = 5;
/// Most that is kept: more than a minute of a 115200 baud line would say nothing new.
const MAX_BYTES: usize = 1 << 20;
/// Bytes between two looks at what has come, so that a fast link is not looked at a thousand times over.
const DETECT_INTERVAL_BYTES: usize = 256;

/// What a link has brought.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct ListenResult {
    /// The bytes, in the order in which they came.
    pub(super) bytes: Vec<u8>,
    /// Why the link was lost meanwhile, if it was.
    pub(super) lost_reason: Option<String>,
}

impl ListenResult {
    /// What the bytes look like.
    pub(super) fn detect(&self) -> ProtocolDetection {
        recognise(&self.bytes)
    }

    fn is_enough(&self) -> bool {
        let found = self.detect();
        self.bytes.len() >= MAX_BYTES || (found.protocol.is_checked() && found.frames >= ENOUGH_FRAMES)
    }
}

/// Listens for this long, or until what is heard leaves no doubt.
pub(super) async fn listen(port: &mut Link, timer: HostTimer, listen_for: TimeDelta) -> ListenResult {
    let end = timer.now() + listen_for;
    let mut heard = ListenResult::default();
    let mut next_look = DETECT_INTERVAL_BYTES;
    loop {
        let event = tokio::select! {
            event = port.next_event() => event,
            () = timer.sleep_until(end) => return heard,
        };
        match event {
            LinkEvent::Bytes { bytes, .. } => heard.bytes.extend_from_slice(&bytes),
            LinkEvent::Down { reason, .. } => {
                heard.lost_reason = Some(reason);
                return heard;
            }
            LinkEvent::Finished { .. } => return heard,
            LinkEvent::Up { .. } => {}
        }
        if heard.bytes.len() >= next_look {
            next_look = heard.bytes.len() + DETECT_INTERVAL_BYTES;
            if heard.is_enough() {
                return heard;
            }
        }
    }
}
