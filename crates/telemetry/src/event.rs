//! Events: the station's output for people, recorders and dashboards, in the order in which they happen.

use crate::clock::{BrickClock, CameraClock, HostClock, TimeDelta, Timestamp};
use crate::estimate::{Estimate, ScalarEstimate};
use crate::fusion::{FusionOutcome, FusionRecord};
use crate::ids::{Address, ChannelName, LinkId, RobotId};
use crate::link_health::{LinkHealth, SourceHealth};
use crate::observation::{Observation, ObservationKind};
use crate::quantities::Celsius;
use crate::severity::{INFO, WARNING};

/// One event.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A robot was heard for the first time, or again after it was lost.
    RobotDetected {
        /// The robot.
        robot: RobotId,
    },
    /// A robot that appeared has a name in the configuration; said once, and not of robots without one.
    RobotNamed {
        /// The robot.
        robot: RobotId,
        /// What people call it.
        name: String,
    },
    /// A robot has not been heard for the heartbeat time-out.
    RobotLost {
        /// The robot.
        robot: RobotId,
        /// Time since it was last heard.
        silence: TimeDelta,
    },
    /// The brick's clock jumped: the brick was restarted; counters and clock are re-based.
    BrickRestarted {
        /// The robot.
        robot: RobotId,
    },
    /// An observation came in and was aligned to the brick's clock.
    ObservationAligned {
        /// The robot that was observed.
        robot: RobotId,
        /// Who sent it.
        source: Address,
        /// When its last byte arrived.
        arrival: Timestamp<HostClock>,
        /// The observation.
        observation: Observation,
    },
    /// The filter tried to use an observation.
    ObservationFused {
        /// The robot.
        robot: RobotId,
        /// The outcome.
        record: FusionRecord,
    },
    /// The filter's estimate after an observation.
    EstimateUpdated {
        /// The robot.
        robot: RobotId,
        /// The estimate.
        estimate: Estimate,
    },
    /// A thermometer's reading, and the final value that its own filter predicts.
    Temperature {
        /// The sender, the robot or any other brick.
        brick: RobotId,
        /// The name of the thermometer.
        channel: ChannelName,
        /// When its last byte arrived.
        arrival: Timestamp<HostClock>,
        /// When it was read, by the clock of that brick.
        stamp: Timestamp<BrickClock>,
        /// The reading.
        shown: Celsius,
        /// Whether the filter used it.
        verdict: FusionOutcome,
        /// The predicted final value; `None` before the first usable reading.
        settled: Option<ScalarEstimate>,
    },
    /// The clocks of host and brick were aligned anew.
    BrickClockAligned {
        /// The robot.
        robot: RobotId,
        /// Brick time minus host time at `host`.
        offset: TimeDelta,
        /// Rate of the brick's clock against the host's, minus one, in parts per million.
        skew_ppm: f64,
        /// Half the distance between the bounds.
        uncertainty: TimeDelta,
        /// Round-trip time of the exchange that led to it, if it was one.
        round_trip: Option<TimeDelta>,
        /// The brick instant at which it was evaluated.
        brick: Timestamp<BrickClock>,
        /// The host instant at which it was evaluated.
        host: Timestamp<HostClock>,
    },
    /// The clocks of host and camera were aligned anew.
    CameraClockAligned {
        /// The camera.
        camera: Address,
        /// Camera time minus host time at `host`.
        offset: TimeDelta,
        /// Half the distance between the bounds.
        uncertainty: TimeDelta,
        /// The camera instant at which it was evaluated.
        stamp: Timestamp<CameraClock>,
        /// The host instant at which it was evaluated.
        host: Timestamp<HostClock>,
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
    ReceiveError {
        /// The link on which it came.
        link: LinkId,
        /// The fault.
        defect: ReceiveError,
    },
    /// A peer sent a status text.
    Text {
        /// The sender.
        source: Address,
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        /// The line.
        text: String,
    },
}

impl Event {
    /// Whether viewers show it beside the estimates, on a dashboard or in a recording. Of the observations they show only fixes; the
    /// fusion records cover the others. Receive errors are counted in the health of their link.
    pub const fn is_for_viewers(&self) -> bool {
        match self {
            Self::ObservationAligned { observation, .. } => {
                matches!(observation.measurement, ObservationKind::Fix(_))
            }
            Self::ReceiveError { .. } => false,
            Self::RobotDetected { .. }
            | Self::RobotNamed { .. }
            | Self::RobotLost { .. }
            | Self::BrickRestarted { .. }
            | Self::ObservationFused { .. }
            | Self::EstimateUpdated { .. }
            | Self::Temperature { .. }
            | Self::BrickClockAligned { .. }
            | Self::CameraClockAligned { .. }
            | Self::Link { .. }
            | Self::Health { .. }
            | Self::Text { .. } => true,
        }
    }

    /// The event in words, with its MAVLink severity; `None` for measurements, estimates and counters.
    pub fn describe(&self) -> Option<(u8, String)> {
        let described = match self {
            Self::RobotDetected { robot } => (INFO, format!("robot {} detected", robot.path())),
            Self::RobotNamed { robot, name } => (INFO, format!("robot {} is {name}", robot.path())),
            Self::RobotLost { robot, silence } => {
                (WARNING, format!("robot {} lost: silent for {:.1} s", robot.path(), silence.as_secs_f64()))
            }
            Self::BrickRestarted { robot } => (WARNING, format!("robot {} restarted", robot.path())),
            Self::Link { link, state: LinkState::Up } => (INFO, format!("link {link} is up")),
            Self::Link { link, state: LinkState::Down } => (WARNING, format!("link {link} is down")),
            Self::Text { source, severity, text } => (*severity, format!("{source}: {text}")),
            Self::ObservationAligned { .. }
            | Self::ObservationFused { .. }
            | Self::EstimateUpdated { .. }
            | Self::Temperature { .. }
            | Self::BrickClockAligned { .. }
            | Self::CameraClockAligned { .. }
            | Self::Health { .. }
            | Self::ReceiveError { .. } => return None,
        };
        Some(described)
    }
}

/// The state of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkState {
    /// Bytes can flow.
    Up,
    /// The peer, the device or the network is lost; reconnecting.
    Down,
}

/// Why a frame's signature was not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SignatureError {
    /// It has none, and this link requires one.
    Unsigned,
    /// It was not made with our key, or the frame was changed.
    Invalid,
    /// It was used before: its time is not later than that of the last frame of its stream.
    Replayed,
    /// Its stream is new, and its time lies more than a minute behind.
    Stale,
}

impl SignatureError {
    /// The name in exports and event files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unsigned => "unsigned",
            Self::Invalid => "invalid",
            Self::Replayed => "replayed",
            Self::Stale => "stale",
        }
    }
}

/// A fault in received data; counted, and it never ends a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceiveError {
    /// A candidate frame's checksum did not match.
    Checksum {
        /// Message id that the candidate claimed.
        message_id: u32,
        /// The checksum in the frame.
        found: u16,
        /// The checksum computed from the bytes.
        expected: u16,
    },
    /// Bytes outside every frame.
    UnframedBytes {
        /// Their number.
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
    Timeout {
        /// The bytes received until then.
        bytes: u32,
    },
    /// A frame is whole, but its payload is invalid.
    Payload {
        /// The message's id.
        message_id: u32,
    },
    /// Frames are missing before this one, by the sequence numbers and stamps of its sender.
    SequenceGap {
        /// The sender.
        source: Address,
        /// Missing frames since the last report.
        frames: u32,
    },
    /// A frame's signature was not accepted.
    SignatureRejected {
        /// The sender that the frame claims.
        source: Address,
        /// The reason.
        reason: SignatureError,
    },
    /// A frame carries the station's own address, but the station has not sent it: another participant has the same address, and
    /// both ignore each other's frames.
    AddressConflict {
        /// The message's id.
        message_id: u32,
    },
    /// A message's timestamp was not used: its clock is not aligned yet, or the timestamp is from before a restart, or it contradicts the
    /// alignment so much that the alignment starts again.
    ClockNotAligned {
        /// The sender.
        source: Address,
    },
}

impl ReceiveError {
    /// The name in exports and event files.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Checksum { .. } => "checksum",
            Self::UnframedBytes { .. } => "unframed_bytes",
            Self::ImpossibleHeader { .. } => "impossible_header",
            Self::Timeout { .. } => "timeout",
            Self::Payload { .. } => "payload",
            Self::SequenceGap { .. } => "sequence_gap",
            Self::SignatureRejected { .. } => "signature_rejected",
            Self::AddressConflict { .. } => "address_conflict",
            Self::ClockNotAligned { .. } => "clock_not_aligned",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_in_words_has_the_severity_of_its_kind_and_a_text_that_of_its_sender() {
        let robot = RobotId { link: LinkId(0), address: Address::new(1, 25) };
        let silence = TimeDelta::from_millis(5_040);
        let cases = [
            (Event::RobotDetected { robot }, INFO, "robot 0/1/25 detected"),
            (Event::RobotNamed { robot, name: "ada".to_owned() }, INFO, "robot 0/1/25 is ada"),
            (Event::RobotLost { robot, silence }, WARNING, "robot 0/1/25 lost: silent for 5.0 s"),
            (Event::BrickRestarted { robot }, WARNING, "robot 0/1/25 restarted"),
            (Event::Link { link: LinkId(3), state: LinkState::Up }, INFO, "link 3 is up"),
            (Event::Link { link: LinkId(3), state: LinkState::Down }, WARNING, "link 3 is down"),
            (Event::Text { source: robot.address, severity: 2, text: "motor hot".to_owned() }, 2, "1/25: motor hot"),
        ];
        for (event, severity, text) in cases {
            assert_eq!(event.describe(), Some((severity, text.to_owned())));
        }
        let health = Event::Health { link: LinkId(0), health: LinkHealth::default(), sources: Vec::new() };
        assert_eq!(health.describe(), None);
    }
}
