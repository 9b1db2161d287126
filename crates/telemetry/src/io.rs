//! The station's inputs and outputs.
//!
//! A recording is the sequence of [`Input`]s with their times, chunk boundaries included. The two types are in this crate
//! because the recorder uses them and does not depend on the station.

use std::net::IpAddr;

use crate::command::{Command, Request};
use crate::event::{Event, LinkState};
use crate::ids::{LinkId, PeerId, RobotId};
use crate::link_health::LinkCounts;
use crate::observation::Observation;
use crate::outside_fix::OutsideFix;
use crate::ownership::Ownership;

/// Everything that the station reacts to; with its arrival time, the content of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// Bytes from a link, as one read returned them.
    Bytes {
        link: LinkId,
        /// Each peer is a stream of its own.
        peer: PeerId,
        bytes: Vec<u8>,
    },
    Link {
        link: LinkId,
        state: LinkState,
    },
    /// The address of a peer, given before its first bytes where the transport knows one.
    PeerAddress {
        link: LinkId,
        peer: PeerId,
        host: IpAddr,
    },
    /// The counters of a link's transport, given now and then for the link's health.
    Port {
        link: LinkId,
        counts: LinkCounts,
    },
    /// An observation from a foreign recording, already in SI units and in brick time.
    Observation(Observation),
    /// A command from a person or a program: a pose applies to the first robot, calibration and sensors to all.
    Command(Command),
    /// A command for one robot. A command for the whole station (parameters, recordings) acts as in [`Self::Command`].
    RobotCommand {
        robot: RobotId,
        command: Command,
    },
    /// Which station of a fleet owns a robot, as the fleet has decided. Without it a robot is owned by every station that hears it.
    Ownership {
        robot: RobotId,
        ownership: Ownership,
    },
    /// A fix of a robot that did not come over a link.
    OutsideFix {
        robot: RobotId,
        fix: OutsideFix,
    },
    /// The result of work that the program does for the station: of an [`Output::Request`], or of its own files.
    Report {
        /// MAVLink severity, 0 emergency to 7 debug. Debug is a note in the recording, and nobody is told.
        severity: u8,
        text: String,
    },
    /// Time passed; given when the station's deadline is reached.
    Tick,
    /// In a merged recording: an input without a link, of another station than the first.
    OfStation {
        /// Its number in the order of the recording, from 1.
        station: u16,
        input: StationInput,
    },
}

/// An input that concerns a station and no link of it.
#[derive(Clone, Debug, PartialEq)]
pub enum StationInput {
    Command(Command),
    Report {
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        text: String,
    },
    Tick,
}

impl Input {
    /// The link that it concerns, itself or by the robot.
    pub const fn link(&self) -> Option<LinkId> {
        match self {
            Self::Bytes { link, .. }
            | Self::Link { link, .. }
            | Self::PeerAddress { link, .. }
            | Self::Port { link, .. } => Some(*link),
            Self::RobotCommand { robot, .. } | Self::Ownership { robot, .. } | Self::OutsideFix { robot, .. } => {
                Some(robot.link)
            }
            Self::Observation(_) | Self::Command(_) | Self::Report { .. } | Self::Tick | Self::OfStation { .. } => None,
        }
    }
}

/// Everything that the station requests of its program.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    Event(Event),
    Transmit {
        link: LinkId,
        to: Recipients,
        priority: Priority,
        /// One complete frame, ready for the wire.
        bytes: Vec<u8>,
    },
    Request(Request),
}

/// The recipients of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recipients {
    All,
    /// One peer; no recipient if it is no longer there.
    Peer(PeerId),
    /// Every peer but the one from which a forwarded frame came.
    AllExcept(PeerId),
}

impl Recipients {
    pub fn includes(self, peer: PeerId) -> bool {
        match self {
            Self::All => true,
            Self::Peer(only) => only == peer,
            Self::AllExcept(origin) => origin != peer,
        }
    }
}

/// The priority of a frame while a slow link backs up. Earlier variants are sent first, and more of them are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// A frame that is not sent again by itself. It goes first and is never displaced. It is dropped only when too many wait
    /// already, when the system refuses it, or when the connection breaks (docs/links.md).
    Command,
    /// Heartbeats and time requests: repeated soon.
    Session,
    Forwarded,
    /// An estimate; the next one of the same stream replaces it.
    Estimate {
        /// The stream: the message id.
        stream: u32,
    },
}
