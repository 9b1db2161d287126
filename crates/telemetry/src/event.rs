//! What happened, in the order in which it happened: the pipeline's output for people, recorders and dashboards.

use crate::clock::{BrickClock, CameraClock, HostClock, Span, Stamp};
use crate::estimate::{Estimate, ScalarEstimate};
use crate::fusion::{FusionRecord, Verdict};
use crate::ids::{Address, ChannelName, LinkId, RobotId};
use crate::link_health::{LinkHealth, SourceHealth};
use crate::observation::{Observation, Observed};
use crate::quantities::Celsius;

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A robot was heard for the first time, or again after it was lost.
    RobotSeen {
        /// The robot.
        robot: RobotId,
    },
    /// A robot has not been heard for the heartbeat time-out.
    RobotLost {
        /// The robot.
        robot: RobotId,
        /// Time since it was last heard.
        silence: Span,
    },
    /// The brick's clock fell or leapt: it was restarted; counters and clock are re-based.
    BrickRestarted {
        /// The robot.
        robot: RobotId,
    },
    /// An observation came in and was aligned to the brick's clock.
    Observed {
        /// The robot that it speaks of.
        robot: RobotId,
        /// Who sent it.
        source: Address,
        /// When its last byte arrived.
        arrival: Stamp<HostClock>,
        /// The observation.
        observation: Observation,
    },
    /// The filter tried to use an observation.
    Fused {
        /// The robot.
        robot: RobotId,
        /// What became of the observation.
        record: FusionRecord,
    },
    /// The filter's belief after an observation.
    Estimated {
        /// The robot.
        robot: RobotId,
        /// The belief.
        estimate: Estimate,
    },
    /// A thermometer was read: what it shows, and what it will show in the end. It has a filter of its own beside the robot's.
    Temperature {
        /// Who sent it, the robot or any other brick.
        brick: RobotId,
        /// Which of its thermometers.
        channel: ChannelName,
        /// When its last byte arrived.
        arrival: Stamp<HostClock>,
        /// When it was read, by the clock of that brick.
        stamp: Stamp<BrickClock>,
        /// What it shows.
        shown: Celsius,
        /// What became of it.
        verdict: Verdict,
        /// What it will show once it has settled; `None` before the first that could be used.
        settled: Option<ScalarEstimate>,
    },
    /// The clocks of host and brick were aligned anew.
    BrickClockAligned {
        /// The robot.
        robot: RobotId,
        /// Brick time minus host time at `host`.
        offset: Span,
        /// Rate of the brick's clock against the host's, minus one, in parts per million.
        skew_ppm: f64,
        /// Half the distance between the bounds.
        uncertainty: Span,
        /// Round-trip time of the exchange that led to it, if it was one.
        round_trip: Option<Span>,
        /// The brick instant at which it was evaluated.
        brick: Stamp<BrickClock>,
        /// The host instant at which it was evaluated.
        host: Stamp<HostClock>,
    },
    /// The clocks of host and camera were aligned anew.
    CameraClockAligned {
        /// Who the camera is.
        camera: Address,
        /// Camera time minus host time at `host`.
        offset: Span,
        /// Half the distance between the bounds.
        uncertainty: Span,
        /// The camera instant at which it was evaluated.
        stamp: Stamp<CameraClock>,
        /// The host instant at which it was evaluated.
        host: Stamp<HostClock>,
    },
    /// A link changed its state.
    Link {
        /// The link.
        link: LinkId,
        /// Its new state.
        state: LinkState,
    },
    /// The health of a link, once per second.
    Health {
        /// The link.
        link: LinkId,
        /// Its counters.
        health: LinkHealth,
        /// What each sender sent on it, in the order of their addresses.
        sources: Vec<SourceHealth>,
    },
    /// Damaged input was skipped.
    Defect {
        /// The link on which it came.
        link: LinkId,
        /// What was wrong.
        defect: Defect,
    },
    /// A peer sent a line for people.
    Text {
        /// Who sent it.
        source: Address,
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        /// The line.
        text: String,
    },
}

impl Event {
    /// Whether it is shown beside the estimates, by a dashboard or in a recording. Of observations only fixes are shown by themselves;
    /// what became of the others stands in their records. Each defect is counted in the health of its link.
    #[must_use]
    pub const fn is_for_viewers(&self) -> bool {
        match self {
            Self::Observed { observation, .. } => {
                matches!(observation.observed, Observed::Fix(_))
            }
            Self::Defect { .. } => false,
            Self::RobotSeen { .. }
            | Self::RobotLost { .. }
            | Self::BrickRestarted { .. }
            | Self::Fused { .. }
            | Self::Estimated { .. }
            | Self::Temperature { .. }
            | Self::BrickClockAligned { .. }
            | Self::CameraClockAligned { .. }
            | Self::Link { .. }
            | Self::Health { .. }
            | Self::Text { .. } => true,
        }
    }
}

/// The state of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkState {
    /// Bytes can flow.
    Up,
    /// The peer, the device or the network went away; reconnecting.
    Down,
}

/// Why a frame's signature was not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It has none, and this link wants one.
    Unsigned,
    /// It was not made with our key, or the frame was changed.
    WrongSignature,
    /// It was used before: its time is not later than that of the last frame of its stream.
    Replayed,
    /// Its stream is new, and its time lies more than a minute behind.
    Stale,
}

/// Damaged input: data, not an error; counted and never the end of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    /// A candidate frame's checksum did not match.
    Checksum {
        /// Message id that the candidate claimed.
        message_id: u32,
        /// The checksum that stood there.
        found: u16,
        /// The checksum of the bytes.
        expected: u16,
    },
    /// Bytes outside every frame.
    Garbage {
        /// How many.
        bytes: u32,
    },
    /// A header announced a length or flags that its message cannot have.
    ImpossibleHeader {
        /// Message id that the candidate claimed.
        message_id: u32,
        /// Length that it claimed.
        length: u8,
    },
    /// A candidate's bytes stopped coming.
    Stall {
        /// How many bytes had come.
        bytes: u32,
    },
    /// A frame was whole but its payload makes no sense.
    Payload {
        /// The message's id.
        message_id: u32,
    },
    /// Frames are missing before this one, by the sequence numbers and stamps of its sender.
    Lost {
        /// Who sent it.
        source: Address,
        /// How many more than was known before.
        frames: u32,
    },
    /// A frame was refused for its signature.
    Refused {
        /// Who seems to have sent it.
        source: Address,
        /// Why.
        reason: Refusal,
    },
    /// A frame bears the station's own address, but the station has not sent it: somebody else has the same one, and neither hears
    /// the other.
    Namesake {
        /// The message's id.
        message_id: u32,
    },
    /// The stamp of a message was refused, because its clock is not aligned yet or it is from before a restart; or it contradicts what
    /// was known of its clock so much that the alignment begins anew.
    Unaligned {
        /// Who sent it.
        source: Address,
    },
}
