//! A frame of another participant on its way to other links.

use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Address, LinkId, Priority, Recipients};

#[derive(Debug)]
pub(crate) struct ForwardedFrame {
    pub(crate) message_id: u32,
    pub(crate) source: Address,
    pub(crate) sequence: u8,
    pub(crate) is_signed: bool,
    pub(crate) version: WireVersion,
    pub(crate) priority: Priority,
    pub(crate) from: Endpoint,
    pub(crate) to: Vec<(LinkId, Recipients)>,
    pub(crate) bytes: Vec<u8>,
}
