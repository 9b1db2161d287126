//! The access token for other computers.

use std::fmt::{self, Write as _};
use std::hint::black_box;

/// 128 random bits.
const TOKEN_BYTES: usize = 16;

/// `Debug` does not show it.
#[derive(Clone, PartialEq, Eq)]
pub struct AccessToken(String);

impl AccessToken {
    /// From the operating system.
    pub fn random() -> Result<Self, getrandom::Error> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes)?;
        let mut text = String::with_capacity(2 * TOKEN_BYTES);
        for byte in bytes {
            // Writing to a String cannot fail.
            let _ = write!(text, "{byte:02x}");
        }
        Ok(Self(text))
    }

    /// For display; it is printed once.
    pub fn expose(&self) -> &str {
        &self.0
    }

    /// Compares in constant time, so that a token of the same length cannot be guessed digit by digit.
    pub(crate) fn matches(&self, candidate: &str) -> bool {
        let (own, candidate_bytes) = (self.0.as_bytes(), candidate.as_bytes());
        let differing = own.iter().zip(candidate_bytes).fold(0, |all, (a, b)| black_box(all | (a ^ b)));
        own.len() == candidate_bytes.len() && differing == 0
    }
}

impl fmt::Debug for AccessToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_itself_and_no_other_and_is_never_printed_by_accident() {
        let (one, other) = (AccessToken::random().unwrap(), AccessToken::random().unwrap());
        assert_eq!(one.expose().len(), 2 * TOKEN_BYTES);
        assert!(one.matches(one.expose()) && !one.matches(other.expose()));
        assert!(!one.matches("") && !one.matches(&one.expose()[1..]) && !one.matches(&format!("{}0", one.expose())));
        assert_eq!(format!("{one:?}"), "Token(..)");
    }
}
