//! The brick protocols, in one table: each converts a link's bytes to [`Message`](crate::message::Message)s and back. A
//! brick with a protocol of its own has a folder here with its specification and captured bytes.
//!
//! Some bricks only answer requests. Their codec makes the requests: [`BrickCodec::poll`] returns them, and
//! [`BrickCodec::deadline`] is the time of the next request or timeout.

mod battery;
pub mod camera_json;
mod codec;
mod counters;
pub mod ev3;
mod line_splitter;
mod mavlink;
pub mod nxt;
pub mod text_line;

pub use codec::{BrickCodec, CodecEvent, CodecEventSink, CodecSettings, DEFAULT_BRICK_ADDRESS};

/// Every brick protocol. To add one: a folder here and a row there.
pub const BRICK_PROTOCOLS: &[BrickProtocol] = &[
    BrickProtocol {
        name: "mavlink",
        summary: "MAVLink 2 with the common and the posebridge dialect",
        open: mavlink::open,
    },
    BrickProtocol {
        name: "nxt",
        summary: "LEGO NXT as it comes out of the box, asked by its own commands",
        open: nxt::open,
    },
    BrickProtocol {
        name: "nxt-push",
        summary: "LEGO NXT with a program that sends MAVLink frames of itself",
        open: nxt::open_push,
    },
    BrickProtocol { name: "ev3", summary: "LEGO EV3 as it is: direct commands by Bluetooth or WiFi", open: ev3::open },
    BrickProtocol {
        name: "line",
        summary: "lines of text from boards that print: key:value or CSV",
        open: text_line::open,
    },
    BrickProtocol {
        name: "columns",
        summary: "the numbers in lines of text, whatever stands between them",
        open: text_line::open_columns,
    },
    BrickProtocol {
        name: "camera-json",
        summary: "no brick but cameras that say in lines of JSON where the robot is",
        open: camera_json::open,
    },
];

/// One row of [`BRICK_PROTOCOLS`].
#[derive(Clone, Copy, Debug)]
pub struct BrickProtocol {
    /// The name in configurations, lower case.
    pub name: &'static str,
    pub summary: &'static str,
    pub open: fn(&CodecSettings) -> Box<dyn BrickCodec>,
}

pub fn brick_protocol(name: &str) -> Option<&'static BrickProtocol> {
    BRICK_PROTOCOLS.iter().find(|protocol| protocol.name == name)
}
