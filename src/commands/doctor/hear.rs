//! Listens on an open link for a while.

use posebridge_link::{HostTimer, Port, PortEvent};
use posebridge_protocol::recognise::{Recognised, recognise};
use posebridge_telemetry::Span;

/// Frames with a checksum after which nothing more has to be heard.
const ENOUGH_FRAMES: usize = 5;
/// Most that is kept: more than a minute of a 115200 baud line would say nothing new.
const MOST_BYTES: usize = 1 << 20;
/// Bytes between two looks at what has come, so that a fast link is not looked at a thousand times over.
const LOOK_EVERY_BYTES: usize = 256;

/// What a link has brought.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Heard {
    /// The bytes, in the order in which they came.
    pub(super) bytes: Vec<u8>,
    /// Why the link was lost meanwhile, if it was.
    pub(super) lost: Option<String>,
}

impl Heard {
    /// What the bytes look like.
    pub(super) fn recognised(&self) -> Recognised {
        recognise(&self.bytes)
    }

    fn is_enough(&self) -> bool {
        let found = self.recognised();
        self.bytes.len() >= MOST_BYTES || (found.protocol.is_checked() && found.frames >= ENOUGH_FRAMES)
    }
}

/// Listens for this long, or until what is heard leaves no doubt.
pub(super) async fn hear(port: &mut Port, timer: HostTimer, listen_for: Span) -> Heard {
    let end = timer.now() + listen_for;
    let mut heard = Heard::default();
    let mut next_look = LOOK_EVERY_BYTES;
    loop {
        let event = tokio::select! {
            event = port.next() => event,
            () = timer.sleep_until(end) => return heard,
        };
        match event {
            PortEvent::Bytes { bytes, .. } => heard.bytes.extend_from_slice(&bytes),
            PortEvent::Down { reason, .. } => {
                heard.lost = Some(reason);
                return heard;
            }
            PortEvent::Finished { .. } => return heard,
            PortEvent::Up { .. } => {}
        }
        if heard.bytes.len() >= next_look {
            next_look = heard.bytes.len() + LOOK_EVERY_BYTES;
            if heard.is_enough() {
                return heard;
            }
        }
    }
}
