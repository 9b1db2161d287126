//! Bricks that speak no MAVLink: what their codecs hear, and what they ask.
//!
//! To the rest of the engine their words are messages like others. They pass by no router: nobody but the station understands them.

use posebridge_protocol::bricks::Heard;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{Occurrence, Way};
use posebridge_telemetry::{Address, Defect, Event, HostClock, LinkId, LinkState, Output, PeerId, Priority, Stamp};

use super::Pipeline;
use super::converse::Exchange;
use super::intake::{Arrival, Arrived};

/// What a codec has heard in one input, in its order.
#[derive(Default)]
pub(super) struct Noted(Vec<Note>);

enum Note {
    Message(Address, Message),
    Time { from: Address, sent: Stamp<HostClock>, peer_nanos: i64 },
    Text { from: Address, severity: u8, text: String },
    Defect(Defect),
}

impl Noted {
    pub(super) fn take(&mut self, heard: Heard<'_>) {
        self.0.push(match heard {
            Heard::Message { from, message } => Note::Message(from, message),
            Heard::Time { from, sent, peer_nanos } => Note::Time { from, sent, peer_nanos },
            Heard::Note { from, severity, text } => Note::Text { from, severity, text },
            // Frames of MAVLink inside another protocol that mean nothing here; there is nobody to pass them on to.
            Heard::Other(_) => return,
            Heard::Defect(defect) => Note::Defect(defect),
        });
    }
}

impl Pipeline {
    /// Lets a codec do what is due.
    pub(super) fn wake_brick(&mut self, now: Stamp<HostClock>, id: LinkId) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if link.codec_deadline().is_none_or(|due| due > now) {
            return;
        }
        let Some(codec) = &mut link.codec else {
            return;
        };
        let mut noted = Noted::default();
        codec.tick(now, &mut |heard| noted.take(heard));
        let peer = PeerId::default();
        let way = Way { link: id, peer };
        self.hear_brick(Arrival { way, at: now }, noted);
    }

    /// Acts on what a codec heard, then sends what it asks.
    pub(super) fn hear_brick(&mut self, arrival: Arrival, noted: Noted) {
        let link = arrival.way.link;
        for note in noted.0 {
            match note {
                Note::Message(source, message) => {
                    let arrived = Arrived { source, occurrence: Occurrence::First, message };
                    self.handle_message(arrival, &arrived);
                }
                Note::Time { from, sent, peer_nanos } => {
                    let exchange = Exchange { sent, answer: arrival, peer_nanos };
                    self.handle_exchange(from, exchange);
                }
                Note::Text { from: source, severity, text } => self.tell(Event::Text { source, severity, text }),
                Note::Defect(defect) => self.tell(Event::Defect { link, defect }),
            }
        }
        self.ask_brick(link);
    }

    /// Sends what a codec wants to send of itself.
    pub(super) fn ask_brick(&mut self, id: LinkId) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        while let Some((to, bytes)) = link.codec.as_mut().and_then(|codec| codec.poll_to()) {
            if link.state == LinkState::Down {
                continue;
            }
            link.health.bytes_out += bytes.len() as u64;
            link.health.frames_out += 1;
            self.outputs.push(Output::Transmit {
                link: id,
                to,
                // Nothing takes its place: the brick would wait for ever.
                priority: Priority::Command,
                bytes,
            });
        }
    }
}
