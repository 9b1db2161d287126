//! The secret of a link: 32 bytes that never show in a print, an event or an error.

use std::fmt;
use std::fmt::Write as _;
use std::str::FromStr;

use sha2::{Digest, Sha256};

const LENGTH: usize = 32;
/// Prefix of the hashed key, so that the key's name is no part of any signature.
const NAME_PREFIX: &[u8] = b"posebridge key name:";

/// A secret that two ends of a link share. Printing one shows its [name](Self::name).
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; LENGTH]);

/// Why a text is not a key. Contains only the text's length and the position of the error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KeyError {
    #[error("a key has 64 hexadecimal digits, this has {found} characters")]
    Length { found: usize },
    #[error("a key has 64 hexadecimal digits, character {position} is none")]
    Digit {
        /// From 1.
        position: usize,
    },
}

impl Key {
    pub const fn from_bytes(bytes: [u8; LENGTH]) -> Self {
        Self(bytes)
    }

    /// The key of a passphrase: the SHA-256 of its UTF-8 bytes, which MAVProxy, Mission Planner and QGroundControl use, too.
    pub fn from_passphrase(passphrase: &str) -> Self {
        Self(Sha256::digest(passphrase.as_bytes()).into())
    }

    /// Eight hexadecimal digits that distinguish keys and reveal none: the first four bytes of a SHA-256 over a fixed
    /// text and the key.
    pub fn name(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(NAME_PREFIX);
        hash.update(self.0);
        let digest = hash.finalize();
        hex(digest.iter().take(4))
    }

    /// The secret itself, as a key file holds it: 64 hexadecimal digits.
    pub fn reveal_hex(&self) -> String {
        hex(self.0.iter())
    }

    pub(super) const fn bytes(&self) -> &[u8; LENGTH] {
        &self.0
    }
}

impl FromStr for Key {
    type Err = KeyError;

    /// Reads 64 hexadecimal digits of either case; blanks around them do not count.
    fn from_str(text: &str) -> Result<Self, KeyError> {
        let text = text.trim();
        let digit = |(index, character): (usize, char)| {
            let value = character.to_digit(16);
            value.ok_or(KeyError::Digit { position: index + 1 })
        };
        let found = text.chars().count();
        if found != 2 * LENGTH {
            return Err(KeyError::Length { found });
        }
        let digits: Vec<u32> = text.chars().enumerate().map(digit).collect::<Result<_, _>>()?;
        let mut bytes = [0; LENGTH];
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = pair.iter().fold(0, |high, low| (high << 4) | *low as u8);
        }
        Ok(Self(bytes))
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key({})", self.name())
    }
}

fn hex<'a>(bytes: impl Iterator<Item = &'a u8>) -> String {
    bytes.fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_print_and_no_error_shows_a_key() {
        let key = Key::from_bytes([0x5A; LENGTH]);
        let printed = format!("{key:?}");
        assert!(!printed.to_lowercase().contains("5a5a"), "{printed}");
        assert!(!printed.contains("90, 90"), "{printed}");
        let wrong = format!("{}g", "5a".repeat(32));
        let error = wrong[1..].parse::<Key>().unwrap_err().to_string();
        assert!(!error.contains("5a"), "{error}");
    }

    /// As `printf 'correct horse' | sha256sum` says.
    #[test]
    fn a_passphrase_gives_the_key_that_ground_stations_derive() {
        let key = Key::from_passphrase("correct horse");
        assert_eq!(key.reveal_hex(), "4104d36f8da2c254349f85836793ebe029e0c957063a34c91c2e9203187b5631");
    }

    #[test]
    fn keys_have_different_names() {
        // sha256sum of the prefix and 32 zero bytes begins so.
        assert_eq!(Key::from_bytes([0; LENGTH]).name(), "34b77e31");
        assert_ne!(Key::from_bytes([0; LENGTH]).name(), Key::from_bytes([1; LENGTH]).name());
    }
}
