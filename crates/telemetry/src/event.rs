//! Events: the station's output for people, recorders and dashboards, in the order in which they happen.

use crate::clock::{BrickClock, CameraClock, HostClock, TimeDelta, Timestamp};
use crate::estimate::{Estimate, ScalarEstimate};
use crate::fusion::{FusionOutcome, FusionRecord};
use crate::ids::{Address, ChannelName, LinkId, RobotId};
use crate::link_health::{LinkHealth, SourceHealth};
use crate::observation::{Observation, ObservationKind};
use crate::quantities::Celsius;
use crate::severity::{INFO, WARNING};

/// An entry of the station's log: what happened, for people, recorders and dashboards.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The first message of a robot, or its first one after `RobotLost`.
    RobotDetected {
        robot: RobotId,
    },
    /// A detected robot has a name in the configuration. Emitted once, and never for a robot without a name.
    RobotNamed {
        robot: RobotId,
        name: String,
    },
    /// No message of a robot within the heartbeat time-out.
    RobotLost {
        robot: RobotId,
        /// Time since its last message.
        silence: TimeDelta,
    },
    /// The brick's clock jumped: the brick was restarted; counters and clock are re-based.
    BrickRestarted {
        robot: RobotId,
    },
    /// An observation arrived and was aligned to the brick's clock.
    ObservationAligned {
        robot: RobotId,
        source: Address,
        /// When its last byte arrived.
        arrival: Timestamp<HostClock>,
        observation: Observation,
    },
    /// The filter tried to use an observation.
    ObservationFused {
        robot: RobotId,
        record: FusionRecord,
    },
    EstimateUpdated {
        robot: RobotId,
        estimate: Estimate,
    },
    /// A filter that runs beside the robot's own tried to use an observation.
    ObservationCompared {
        robot: RobotId,
        /// The filter's name.
        filter: &'static str,
        record: FusionRecord,
    },
    /// The estimate of a filter that runs beside the robot's own, at the instant of an `EstimateUpdated`.
    EstimateCompared {
        robot: RobotId,
        /// The filter's name.
        filter: &'static str,
        estimate: Estimate,
    },
    /// A new estimate of a robot whose filter knows one quantity: the distance to a wall of `range-kf`.
    QuantityUpdated {
        robot: RobotId,
        estimate: ScalarEstimate,
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
        verdict: FusionOutcome,
        /// The predicted final value; `None` before the first usable reading.
        settled: Option<ScalarEstimate>,
    },
    /// A new alignment of the brick's clock.
    BrickClockAligned {
        robot: RobotId,
        /// Brick time minus host time at `host`.
        offset: TimeDelta,
        /// Rate of the brick's clock against the host's, minus one.
        skew_ppm: f64,
        /// Half the width of the interval that bounds the offset.
        uncertainty: TimeDelta,
        /// Round-trip time of the exchange that led to it, if it was one.
        round_trip: Option<TimeDelta>,
        brick: Timestamp<BrickClock>,
        host: Timestamp<HostClock>,
    },
    /// A new alignment of the camera's clock.
    CameraClockAligned {
        camera: Address,
        /// Camera time minus host time at `host`.
        offset: TimeDelta,
        /// Half the width of the interval that bounds the offset.
        uncertainty: TimeDelta,
        stamp: Timestamp<CameraClock>,
        host: Timestamp<HostClock>,
    },
    Link {
        link: LinkId,
        state: LinkState,
    },
    /// The health of a link, once per second.
    Health {
        link: LinkId,
        health: LinkHealth,
        /// Per sender, in the order of addresses.
        sources: Vec<SourceHealth>,
    },
    /// Damaged input was skipped.
    ReceiveError {
        link: LinkId,
        defect: ReceiveError,
    },
    /// A peer sent a status text.
    Text {
        source: Address,
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        text: String,
    },
}

impl Event {
    /// Whether viewers show it beside the estimates, on a dashboard or in a recording. Of the observations they show fixes and the readings
    /// of a quantity; the fusion records cover the others. Receive errors are counted in the health of their link.
    pub const fn is_for_viewers(&self) -> bool {
        match self {
            Self::ObservationAligned { observation, .. } => {
                matches!(
                    observation.measurement,
                    ObservationKind::Fix(_) | ObservationKind::WallRange(_) | ObservationKind::Temperature(_)
                )
            }
            Self::ReceiveError { .. } => false,
            Self::RobotDetected { .. }
            | Self::RobotNamed { .. }
            | Self::RobotLost { .. }
            | Self::BrickRestarted { .. }
            | Self::ObservationFused { .. }
            | Self::EstimateUpdated { .. }
            | Self::ObservationCompared { .. }
            | Self::EstimateCompared { .. }
            | Self::QuantityUpdated { .. }
            | Self::Temperature { .. }
            | Self::BrickClockAligned { .. }
            | Self::CameraClockAligned { .. }
            | Self::Link { .. }
            | Self::Health { .. }
            | Self::Text { .. } => true,
        }
    }

    /// Adds the same to every instant of the host's clock: the event by another host clock.
    pub fn shift_host_times(&mut self, by: TimeDelta) {
        match self {
            Self::ObservationAligned { arrival, .. } | Self::Temperature { arrival, .. } => *arrival = *arrival + by,
            Self::BrickClockAligned { offset, host, .. } | Self::CameraClockAligned { offset, host, .. } => {
                *host = *host + by;
                *offset = *offset - by;
            }
            Self::RobotDetected { .. }
            | Self::RobotNamed { .. }
            | Self::RobotLost { .. }
            | Self::BrickRestarted { .. }
            | Self::ObservationFused { .. }
            | Self::EstimateUpdated { .. }
            | Self::ObservationCompared { .. }
            | Self::EstimateCompared { .. }
            | Self::QuantityUpdated { .. }
            | Self::Link { .. }
            | Self::Health { .. }
            | Self::ReceiveError { .. }
            | Self::Text { .. } => {}
        }
    }

    /// The event in words, with its MAVLink severity; `None` for measurements, estimates and counters.
    pub fn describe(&self) -> Option<(u8, String)> {
        let described = match self {
            Self::RobotDetected { robot } => (INFO, format!("robot {} detected", robot.path())),
            Self::RobotNamed { robot, name } => (INFO, format!("robot {} is {name}", robot.path())),
            Self::RobotLost { robot, silence } => (
                WARNING,
                format!(
                    "robot {} lost: silent for {:.1} s; look at its battery, its program and the link",
                    robot.path(),
                    silence.as_secs_f64()
                ),
            ),
            Self::BrickRestarted { robot } => {
                (WARNING, format!("robot {} restarted: its clock began anew, the pose is kept", robot.path()))
            }
            Self::Link { link, state: LinkState::Up } => (INFO, format!("link {link} is up")),
            Self::Link { link, state: LinkState::Down } => {
                (WARNING, format!("link {link} is down: look at plug and power; it is opened again by itself"))
            }
            Self::Text { source, severity, text } => (*severity, format!("{source}: {text}")),
            Self::ObservationAligned { .. }
            | Self::ObservationFused { .. }
            | Self::EstimateUpdated { .. }
            | Self::ObservationCompared { .. }
            | Self::EstimateCompared { .. }
            | Self::QuantityUpdated { .. }
            | Self::Temperature { .. }
            | Self::BrickClockAligned { .. }
            | Self::CameraClockAligned { .. }
            | Self::Health { .. }
            | Self::ReceiveError { .. } => return None,
        };
        Some(described)
    }
}

/// Whether bytes can flow on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkState {
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
        message_id: u32,
        found: u16,
        expected: u16,
    },
    UnframedBytes {
        bytes: u32,
    },
    /// A header announced a length or flags that its message cannot have.
    ImpossibleHeader {
        message_id: u32,
        length: u8,
    },
    /// The rest of a candidate frame did not arrive.
    Timeout {
        /// Bytes received before the time-out.
        bytes: u32,
    },
    /// A frame is complete, but its payload is invalid.
    Payload {
        message_id: u32,
    },
    /// Frames are missing before this one, by the sequence numbers and stamps of its sender.
    SequenceGap {
        source: Address,
        /// Missing frames since the last report.
        frames: u32,
    },
    SignatureRejected {
        /// The sender that the frame claims.
        source: Address,
        reason: SignatureError,
    },
    /// A frame carries the station's own address, but the station has not sent it: another participant has the same address, and
    /// both ignore each other's frames.
    AddressConflict {
        message_id: u32,
    },
    /// A message's timestamp was not used: its clock is not aligned yet, or the timestamp is from before a restart, or it contradicts the
    /// alignment so much that the alignment starts again.
    ClockNotAligned {
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

    const LOST: &str = "robot 0/1/25 lost: silent for 5.0 s; look at its battery, its program and the link";
    const RESTARTED: &str = "robot 0/1/25 restarted: its clock began anew, the pose is kept";
    const DOWN: &str = "link 3 is down: look at plug and power; it is opened again by itself";

    #[test]
    fn by_another_host_clock_an_event_says_the_same_of_the_clocks_of_robots_and_cameras() {
        let aligned = |host_ms, offset_ms| Event::CameraClockAligned {
            camera: Address::new(1, 100),
            offset: TimeDelta::from_millis(offset_ms),
            uncertainty: TimeDelta::from_millis(1),
            stamp: Timestamp::from_millis(host_ms + offset_ms),
            host: Timestamp::from_millis(host_ms),
        };
        let mut event = aligned(5_000, 70);
        event.shift_host_times(TimeDelta::from_millis(-3_000));
        assert_eq!(event, aligned(2_000, 3_070));
        let mut lost = Event::RobotLost { robot: RobotId::default(), silence: TimeDelta::from_millis(5_000) };
        let before = lost.clone();
        lost.shift_host_times(TimeDelta::from_millis(1));
        assert_eq!(lost, before);
    }

    #[test]
    fn an_event_text_has_the_severity_of_its_kind_and_a_status_text_that_of_its_sender() {
        let robot = RobotId { link: LinkId(0), address: Address::new(1, 25) };
        let silence = TimeDelta::from_millis(5_040);
        let cases = [
            (Event::RobotDetected { robot }, INFO, "robot 0/1/25 detected"),
            (Event::RobotNamed { robot, name: "ada".to_owned() }, INFO, "robot 0/1/25 is ada"),
            (Event::RobotLost { robot, silence }, WARNING, LOST),
            (Event::BrickRestarted { robot }, WARNING, RESTARTED),
            (Event::Link { link: LinkId(3), state: LinkState::Up }, INFO, "link 3 is up"),
            (Event::Link { link: LinkId(3), state: LinkState::Down }, WARNING, DOWN),
            (Event::Text { source: robot.address, severity: 2, text: "motor hot".to_owned() }, 2, "1/25: motor hot"),
        ];
        for (event, severity, text) in cases {
            assert_eq!(event.describe(), Some((severity, text.to_owned())));
        }
        let health = Event::Health { link: LinkId(0), health: LinkHealth::default(), sources: Vec::new() };
        assert_eq!(health.describe(), None);
    }
}
