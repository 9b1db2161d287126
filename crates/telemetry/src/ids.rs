//! Ids of systems, components, links, sensors and objects in the arena.
//!
//! A robot is identified by its link as well as by its MAVLink address: two robots on different links may have the same
//! address.

use std::fmt;

use serde::{Deserialize, Serialize};

macro_rules! id {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub struct $name(pub $inner);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)
            }
        }
    };
}

id!(/// A MAVLink system: one robot, one station. 0 means "everybody".
    SystemId(u8));
id!(/// A MAVLink component within a system. 0 means "all components".
    ComponentId(u8));
id!(/// One link of this station, in the order in which the configuration names them.
    LinkId(u16));
id!(/// One peer of a link, numbered in the order of first contact. The only peer of a link is 0. A peer that was
    /// forgotten and comes back has a new number, so that no part of an old frame is joined to its bytes.
    PeerId(u32));
id!(/// One sensor of a robot, as its wire messages number it.
    SensorId(u8));
id!(/// A landmark at a known position in the arena.
    LandmarkId(u32));
id!(/// A radio beacon at a known position in the arena.
    BeaconId(u32));

impl SensorId {
    pub const WHEELS: Self = Self(0);
    pub const GYRO: Self = Self(1);
    pub const ACCELEROMETER: Self = Self(2);
    /// The overhead camera.
    pub const CAMERA: Self = Self(3);
    /// A foreign odometer that reports a pose or a velocity of its own.
    pub const ODOMETER: Self = Self(4);
    pub const RANGE: Self = Self(5);
    pub const THERMOMETER: Self = Self(6);
    /// A sensor of known landmarks, such as a camera on board.
    pub const LANDMARKS: Self = Self(7);
    /// Radio ranges to beacons.
    pub const BEACONS: Self = Self(8);
    pub const COMPASS: Self = Self(9);
    /// A receiver of satellites on board, whose fixes need the arena's place on the Earth.
    pub const GNSS: Self = Self(10);

    const SECOND_CAMERA: u8 = 32;
    const FURTHER_CAMERAS: [&'static str; 7] =
        ["camera 2", "camera 3", "camera 4", "camera 5", "camera 6", "camera 7", "camera 8"];

    /// The camera with this index, from 0, in the order of their first messages: [`Self::CAMERA`], then up to seven more. All
    /// further ones share the last id.
    pub const fn camera(index: usize) -> Self {
        match index {
            0 => Self::CAMERA,
            1..=7 => Self(Self::SECOND_CAMERA + index as u8 - 1),
            _ => Self(Self::SECOND_CAMERA + 6),
        }
    }

    const UNNAMED: &'static str = "sensor";

    /// Whether it is one of the ids above; live observations have no others.
    pub fn is_known(self) -> bool {
        self.name() != Self::UNNAMED
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::WHEELS => "wheels",
            Self::GYRO => "gyro",
            Self::ACCELEROMETER => "accelerometer",
            Self::CAMERA => "camera",
            Self::ODOMETER => "odometer",
            Self::RANGE => "range",
            Self::THERMOMETER => "thermometer",
            Self::LANDMARKS => "landmarks",
            Self::BEACONS => "beacons",
            Self::COMPASS => "compass",
            Self::GNSS => "gnss",
            Self(id) => id
                .checked_sub(Self::SECOND_CAMERA)
                .and_then(|index| Self::FURTHER_CAMERAS.get(usize::from(index)))
                .copied()
                .unwrap_or(Self::UNNAMED),
        }
    }
}

/// The name of one channel of a sender, as the configuration spells it: at most sixteen printable ASCII characters, stored
/// inline.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(from = "[u8; 16]", into = "[u8; 16]")]
pub struct ChannelName {
    /// Zeros after the name.
    bytes: [u8; Self::MAX_LEN],
}

impl ChannelName {
    /// The longest name, in bytes; MAVLink's own names have ten or sixteen.
    pub const MAX_LEN: usize = 16;

    /// The name in these bytes, up to the first zero or the longest length. Bytes that are not printable ASCII become question
    /// marks, because names are printed on terminals.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let mut name = Self::default();
        let text_bytes = bytes.iter().take_while(|byte| **byte != 0);
        for (slot, byte) in name.bytes.iter_mut().zip(text_bytes) {
            *slot = if byte.is_ascii_graphic() { *byte } else { b'?' };
        }
        name
    }

    pub fn as_str(&self) -> &str {
        let end = self.bytes.iter().position(|byte| *byte == 0);
        let text_bytes = self.bytes.get(..end.unwrap_or(Self::MAX_LEN));
        // Every byte is ASCII, by construction.
        text_bytes.and_then(|text_bytes| std::str::from_utf8(text_bytes).ok()).unwrap_or_default()
    }
}

impl From<[u8; 16]> for ChannelName {
    fn from(bytes: [u8; 16]) -> Self {
        Self::from_bytes(&bytes)
    }
}

impl From<ChannelName> for [u8; 16] {
    fn from(name: ChannelName) -> Self {
        name.bytes
    }
}

impl fmt::Display for ChannelName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Debug for ChannelName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// One MAVLink participant: a component of a system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Address {
    pub system: SystemId,
    pub component: ComponentId,
}

impl Address {
    pub const fn new(system: u8, component: u8) -> Self {
        Self { system: SystemId(system), component: ComponentId(component) }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.system, self.component)
    }
}

/// A robot; the address alone is not unique across links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RobotId {
    pub link: LinkId,
    pub address: Address,
}

impl RobotId {
    /// The robot as `link/system/component`.
    pub fn path(self) -> String {
        format!("{}/{}", self.link, self.address)
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "link {} {}", self.link, self.address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn further_cameras_have_ids_and_names_of_their_own() {
        let names: Vec<_> = (0..10).map(|index| SensorId::camera(index).name()).collect();
        assert_eq!(names[..3], ["camera", "camera 2", "camera 3"]);
        assert_eq!(names[7..], ["camera 8"; 3]);
        assert_eq!(SensorId(31).name(), "sensor");
        let known: Vec<u8> = (0..=u8::MAX).filter(|id| SensorId(*id).is_known()).collect();
        assert_eq!(known, (0..=10).chain(32..=38).collect::<Vec<u8>>());
    }

    #[test]
    fn a_name_ends_at_its_terminator_or_capacity_and_cannot_command_a_terminal() {
        let name = |bytes: &[u8]| ChannelName::from_bytes(bytes).to_string();
        assert_eq!(name(b"temp1\0left over"), "temp1");
        assert_eq!(name(b"temp_water"), "temp_water");
        assert_eq!(name(b"temp\x1b[2J\xff"), "temp?[2J?");
        assert_eq!(name(b"longer than sixteen"), "longer?than?sixt");
        assert_eq!(name(b""), "");
    }
}
