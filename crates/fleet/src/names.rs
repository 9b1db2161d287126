//! The names by which a fleet knows its robots, stations, links and cameras.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The longest name, in bytes.
const MAX_LEN: usize = 64;

/// Why a text is no name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum NameError {
    #[error("the name is empty")]
    Empty,
    #[error("the name is longer than {MAX_LEN} bytes")]
    TooLong,
    #[error("the name has {0:?}; letters and digits of ASCII, `-`, `_` and `.` are allowed")]
    Character(char),
    #[error("the id of a station ends in `-` and 16 lower-case hexadecimal digits")]
    Instance,
}

fn validate(text: &str) -> Result<(), NameError> {
    if text.is_empty() {
        return Err(NameError::Empty);
    }
    if text.len() > MAX_LEN {
        return Err(NameError::TooLong);
    }
    let is_allowed = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_' | '.');
    text.chars().find(|letter| !is_allowed(*letter)).map_or(Ok(()), |letter| Err(NameError::Character(letter)))
}

macro_rules! name {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        ///
        /// 1 to 64 letters and digits of ASCII, `-`, `_` and `.`, so that it is one chunk of a Zenoh key. A clone shares the text.
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(Arc<str>);

        impl $name {
            pub fn new(text: &str) -> Result<Self, NameError> {
                validate(text)?;
                Ok(Self(text.into()))
            }

            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl TryFrom<String> for $name {
            type Error = NameError;
            fn try_from(text: String) -> Result<Self, NameError> {
                Self::new(&text)
            }
        }

        impl From<$name> for String {
            fn from(name: $name) -> Self {
                name.as_str().to_owned()
            }
        }

        impl FromStr for $name {
            type Err = NameError;
            fn from_str(text: &str) -> Result<Self, NameError> {
                Self::new(text)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Debug::fmt(&self.0, f)
            }
        }
    };
}

name!(/// A set of stations that share robots.
    FleetName);
name!(/// A robot of the fleet. Unlike a MAVLink system id it is the same at every station.
    RobotName);
name!(/// A station, as its configuration names it.
    StationName);
name!(/// A link of a station.
    LinkName);
name!(/// A camera of the fleet.
    CameraName);

/// One run of a station. Written as `name-0123456789abcdef`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct StationId {
    pub name: StationName,
    /// Drawn at random when the program starts: a station that was restarted is another one, and knows nothing of what it owned.
    pub instance: u64,
}

impl StationId {
    const INSTANCE_DIGITS: usize = 16;
}

impl fmt::Display for StationId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{:016x}", self.name, self.instance)
    }
}

impl FromStr for StationId {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let (name, digits) = text.rsplit_once('-').ok_or(NameError::Instance)?;
        // The number's own parser accepts signs and capitals, and one id has one text.
        let is_canonical = digits.bytes().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
        if digits.len() != Self::INSTANCE_DIGITS || !is_canonical {
            return Err(NameError::Instance);
        }
        let instance = u64::from_str_radix(digits, 16).ok().ok_or(NameError::Instance)?;
        Ok(Self { name: StationName::new(name)?, instance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_chunk_of_a_key() {
        assert_eq!(RobotName::new("nxt_7.b-2").unwrap().as_str(), "nxt_7.b-2");
        assert_eq!(RobotName::new(&"r".repeat(64)).unwrap().as_str().len(), 64);
        assert_eq!(RobotName::new(""), Err(NameError::Empty));
        assert_eq!(RobotName::new(&"r".repeat(65)), Err(NameError::TooLong));
        for letter in "/*$?#@ äé\0~:%".chars() {
            assert_eq!(RobotName::new(&format!("a{letter}")), Err(NameError::Character(letter)));
        }
    }

    #[test]
    fn a_station_has_one_text_and_its_instance_counts_in_the_order() {
        let id = StationId { name: StationName::new("lab-1").unwrap(), instance: 0x1f };
        assert_eq!(id.to_string(), "lab-1-000000000000001f");
        assert_eq!("lab-1-000000000000001f".parse(), Ok(id.clone()));
        for text in ["lab", "lab-1f", "lab-000000000000001F", "lab-+00000000000001f", "lab-00000000000000001f"] {
            assert_eq!(text.parse::<StationId>(), Err(NameError::Instance), "{text}");
        }
        assert_eq!("-000000000000001f".parse::<StationId>(), Err(NameError::Empty));
        assert!(StationId { instance: 0x20, ..id.clone() } > id);
    }
}
