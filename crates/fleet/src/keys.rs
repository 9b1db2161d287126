//! The keys of a fleet, below `pb/{fleet}/`, in one table.
//!
//! A chunk that begins with `@` is matched by no wildcard of Zenoh: a subscriber to `pb/{fleet}/**` gets data and no tokens.

use std::fmt::Write;

use thiserror::Error;

use crate::epoch::{Epoch, OwnershipToken};
use crate::names::{CameraName, FleetName, LinkName, NameError, RobotName, StationId};

/// The first chunk of every key.
const ROOT: &str = "pb";

/// What a key names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FleetKey {
    /// Bytes of a robot as a link received them, with their host time.
    Raw { robot: RobotName, link: LinkName },
    /// Estimates, see [`crate::FleetEstimate`].
    Estimate { robot: RobotName },
    /// Fixes of a camera.
    Fix { robot: RobotName, camera: CameraName },
    /// Commands for the robot's owner; answered.
    Command { robot: RobotName },
    /// States of the robot's filter: published by the owner, and answered by every station.
    State { robot: RobotName },
    /// A liveliness token: the station claims the robot.
    Ownership { robot: RobotName, token: OwnershipToken },
    /// A liveliness token: the station is there.
    Station(StationId),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Raw,
    Estimate,
    Fix,
    Command,
    State,
    Ownership,
    Station,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chunk {
    Literal(&'static str),
    Robot,
    Link,
    Camera,
    Epoch,
    Station,
}

/// What stands behind `pb/{fleet}/`, of each kind of key.
const TABLE: [(Kind, &[Chunk]); 7] = [
    (Kind::Raw, &[Chunk::Robot, Chunk::Literal("raw"), Chunk::Link]),
    (Kind::Estimate, &[Chunk::Robot, Chunk::Literal("est")]),
    (Kind::Fix, &[Chunk::Robot, Chunk::Literal("fix"), Chunk::Camera]),
    (Kind::Command, &[Chunk::Robot, Chunk::Literal("cmd")]),
    (Kind::State, &[Chunk::Robot, Chunk::Literal("state")]),
    (Kind::Ownership, &[Chunk::Literal("@own"), Chunk::Robot, Chunk::Epoch, Chunk::Station]),
    (Kind::Station, &[Chunk::Literal("@station"), Chunk::Station]),
];

/// Why a text is no key of the fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum KeyError {
    #[error("the key is not of this fleet")]
    OtherFleet,
    #[error("no such key")]
    Unknown,
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("the epoch is no decimal number from 1 to 4294967295 without leading zeros")]
    Epoch,
}

/// The fields of a key, each set where its pattern has it.
#[derive(Default)]
struct Fields {
    robot: Option<RobotName>,
    link: Option<LinkName>,
    camera: Option<CameraName>,
    epoch: Option<Epoch>,
    station: Option<StationId>,
}

/// Builds and parses the keys of one fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetKeys {
    fleet: FleetName,
}

impl FleetKeys {
    pub const fn new(fleet: FleetName) -> Self {
        Self { fleet }
    }

    pub fn build(&self, key: &FleetKey) -> String {
        let (kind, fields) = take_apart(key);
        self.write(kind, |chunk| match chunk {
            Chunk::Literal(text) => text.to_owned(),
            Chunk::Robot => fields.robot.as_ref().map(ToString::to_string).unwrap_or_default(),
            Chunk::Link => fields.link.as_ref().map(ToString::to_string).unwrap_or_default(),
            Chunk::Camera => fields.camera.as_ref().map(ToString::to_string).unwrap_or_default(),
            Chunk::Epoch => fields.epoch.map(|epoch| epoch.to_string()).unwrap_or_default(),
            Chunk::Station => fields.station.as_ref().map(ToString::to_string).unwrap_or_default(),
        })
    }

    pub fn parse(&self, text: &str) -> Result<FleetKey, KeyError> {
        let mut chunks = text.split('/');
        if chunks.next() != Some(ROOT) || chunks.next() != Some(self.fleet.as_str()) {
            return Err(KeyError::OtherFleet);
        }
        // One more than the longest pattern, so that a longer key fits none and costs nothing.
        let chunks: Vec<&str> = chunks.take(5).collect();
        let fits = |pattern: &[Chunk]| {
            pattern.len() == chunks.len()
                && pattern.iter().zip(&chunks).all(|(chunk, text)| match chunk {
                    Chunk::Literal(literal) => literal == text,
                    Chunk::Robot | Chunk::Link | Chunk::Camera | Chunk::Epoch | Chunk::Station => true,
                })
        };
        let (kind, pattern) = TABLE.iter().find(|(_, pattern)| fits(pattern)).ok_or(KeyError::Unknown)?;
        let mut fields = Fields::default();
        for (chunk, text) in pattern.iter().zip(&chunks) {
            match chunk {
                Chunk::Literal(_) => {}
                Chunk::Robot => fields.robot = Some(RobotName::new(text)?),
                Chunk::Link => fields.link = Some(LinkName::new(text)?),
                Chunk::Camera => fields.camera = Some(CameraName::new(text)?),
                Chunk::Epoch => fields.epoch = Some(parse_epoch(text).ok_or(KeyError::Epoch)?),
                Chunk::Station => fields.station = Some(text.parse()?),
            }
        }
        put_together(*kind, fields).ok_or(KeyError::Unknown)
    }

    /// Matches every [`FleetKey::Ownership`].
    pub fn all_tokens(&self) -> String {
        self.select(Kind::Ownership)
    }

    /// Matches every [`FleetKey::Station`].
    pub fn all_stations(&self) -> String {
        self.select(Kind::Station)
    }

    /// Matches every [`FleetKey::Estimate`].
    pub fn all_estimates(&self) -> String {
        self.select(Kind::Estimate)
    }

    /// Matches every [`FleetKey::Fix`].
    pub fn all_fixes(&self) -> String {
        self.select(Kind::Fix)
    }

    /// Matches every [`FleetKey::Command`].
    pub fn all_commands(&self) -> String {
        self.select(Kind::Command)
    }

    /// Matches every [`FleetKey::State`].
    pub fn all_states(&self) -> String {
        self.select(Kind::State)
    }

    fn select(&self, kind: Kind) -> String {
        self.write(kind, |chunk| match chunk {
            Chunk::Literal(text) => text.to_owned(),
            Chunk::Robot | Chunk::Link | Chunk::Camera | Chunk::Epoch | Chunk::Station => "*".to_owned(),
        })
    }

    fn write(&self, kind: Kind, text_of: impl Fn(Chunk) -> String) -> String {
        let mut key = format!("{ROOT}/{}", self.fleet);
        let pattern = TABLE.iter().find(|row| row.0 == kind).map(|row| row.1).unwrap_or_default();
        for chunk in pattern {
            // Into a string; it cannot fail.
            write!(key, "/{}", text_of(*chunk)).ok();
        }
        key
    }
}

fn parse_epoch(text: &str) -> Option<Epoch> {
    let is_canonical = text.bytes().all(|digit| digit.is_ascii_digit()) && !text.starts_with('0');
    is_canonical.then(|| text.parse().ok()).flatten().and_then(Epoch::new)
}

fn take_apart(key: &FleetKey) -> (Kind, Fields) {
    let of = |robot: &RobotName| Fields { robot: Some(robot.clone()), ..Fields::default() };
    match key {
        FleetKey::Raw { robot, link } => (Kind::Raw, Fields { link: Some(link.clone()), ..of(robot) }),
        FleetKey::Estimate { robot } => (Kind::Estimate, of(robot)),
        FleetKey::Fix { robot, camera } => (Kind::Fix, Fields { camera: Some(camera.clone()), ..of(robot) }),
        FleetKey::Command { robot } => (Kind::Command, of(robot)),
        FleetKey::State { robot } => (Kind::State, of(robot)),
        FleetKey::Ownership { robot, token: OwnershipToken { epoch, station } } => {
            (Kind::Ownership, Fields { epoch: Some(*epoch), station: Some(station.clone()), ..of(robot) })
        }
        FleetKey::Station(station) => (Kind::Station, Fields { station: Some(station.clone()), ..Fields::default() }),
    }
}

/// `None` if a field of the kind is missing.
fn put_together(kind: Kind, fields: Fields) -> Option<FleetKey> {
    let Fields { robot, link, camera, epoch, station } = fields;
    Some(match kind {
        Kind::Raw => FleetKey::Raw { robot: robot?, link: link? },
        Kind::Estimate => FleetKey::Estimate { robot: robot? },
        Kind::Fix => FleetKey::Fix { robot: robot?, camera: camera? },
        Kind::Command => FleetKey::Command { robot: robot? },
        Kind::State => FleetKey::State { robot: robot? },
        Kind::Ownership => {
            FleetKey::Ownership { robot: robot?, token: OwnershipToken { epoch: epoch?, station: station? } }
        }
        Kind::Station => FleetKey::Station(station?),
    })
}
