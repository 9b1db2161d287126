//! The one door into the pipeline and the one door out of it.
//!
//! A recording is the sequence of [`Input`]s with the instants at which they were given, chunk boundaries included.
//! That is why these two types stand in the vocabulary: the recorder must name them without naming the pipeline.

use crate::command::{Command, Request};
use crate::event::{Event, LinkState};
use crate::ids::{LinkId, PeerId};
use crate::link_health::PortCounts;
use crate::observation::Observation;
use crate::outbound::{Audience, Priority};

/// What can be given to the pipeline.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// Bytes as they came from a link; a chunk is whatever one read returned.
    Bytes {
        /// The link that they came from.
        link: LinkId,
        /// Who of its peers sent them; the bytes of different peers are different streams.
        peer: PeerId,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// A link came up or went down.
    Link {
        /// The link.
        link: LinkId,
        /// Its new state.
        state: LinkState,
    },
    /// What the port of a link has counted; given now and then, so that the link's health can tell of it.
    Port {
        /// The link.
        link: LinkId,
        /// Its counts.
        counts: PortCounts,
    },
    /// An observation from a foreign recording, already in SI units and in brick time.
    Observation(Observation),
    /// A request of a person or a program.
    Command(Command),
    /// What became of something that the program around the pipeline does: of an [`Output::Request`], of its own files.
    Report {
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        /// A line for people.
        text: String,
    },
    /// Time passed; given when the pipeline's deadline is reached.
    Tick,
}

/// What the pipeline gives back.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "an output is moved once, from the pipeline to its reader; a box would cost an allocation for each event"
)]
pub enum Output {
    /// Something happened.
    Event(Event),
    /// Bytes to send on a link.
    Transmit {
        /// The link.
        link: LinkId,
        /// For whom.
        to: Audience,
        /// What may happen to them on a slow link.
        priority: Priority,
        /// One whole frame, ready for the wire.
        bytes: Vec<u8>,
    },
    /// Something that only the program around the pipeline can do.
    Request(Request),
}
