//! Access tokens and what they permit.

use std::fmt::{self, Write as _};
use std::hint::black_box;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// 128 random bits.
const TOKEN_BYTES: usize = 16;
/// Of a token that a person chose: with random letters and digits more than 90 bits.
pub(crate) const MIN_TOKEN_CHARS: usize = 16;
pub(crate) const MAX_TOKEN_CHARS: usize = 128;

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

    /// `None` if it is too short to be safe, too long, or would need escaping in a URL or a cookie.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
        let is_valid = (MIN_TOKEN_CHARS..=MAX_TOKEN_CHARS).contains(&text.len()) && text.bytes().all(is_plain);
        is_valid.then(|| Self(text.to_owned()))
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

/// What the owner of a token may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AccessRole {
    /// See everything.
    Reader,
    /// Give commands as well.
    Operator,
}

/// Names one grant of a token for as long as it is valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct GrantId(u64);

/// A token and its role.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TokenGrant {
    pub(crate) token: AccessToken,
    pub(crate) role: AccessRole,
}

/// The valid tokens; they change while the station runs.
#[derive(Debug)]
pub(crate) struct TokenTable {
    rows: Mutex<TokenRows>,
}

#[derive(Debug, Default)]
struct TokenRows {
    grants: Vec<(GrantId, TokenGrant)>,
    next_id: u64,
}

impl TokenTable {
    pub(crate) fn new(grants: Vec<TokenGrant>) -> Self {
        let table = Self { rows: Mutex::default() };
        table.replace(grants);
        table
    }

    fn rows(&self) -> MutexGuard<'_, TokenRows> {
        self.rows.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The grant of a token.
    pub(crate) fn find(&self, candidate: &str) -> Option<(GrantId, AccessRole)> {
        let rows = self.rows();
        let found = rows.grants.iter().find(|(_, grant)| grant.token.matches(candidate));
        found.map(|(id, grant)| (*id, grant.role))
    }

    /// The first token of a role.
    pub(crate) fn first(&self, role: AccessRole) -> Option<AccessToken> {
        let rows = self.rows();
        let found = rows.grants.iter().find(|(_, grant)| grant.role == role);
        found.map(|(_, grant)| grant.token.clone())
    }

    /// Makes these the valid ones; returns the grants that are revoked.
    pub(crate) fn replace(&self, grants: Vec<TokenGrant>) -> Vec<GrantId> {
        let mut rows = self.rows();
        let mut revoked = std::mem::take(&mut rows.grants);
        for grant in grants {
            let known = revoked.iter().position(|(_, old)| *old == grant);
            let id = known.map_or(GrantId(rows.next_id), |index| revoked.swap_remove(index).0);
            rows.next_id += u64::from(known.is_none());
            rows.grants.push((id, grant));
        }
        revoked.into_iter().map(|(id, _)| id).collect()
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
    #[test]
    fn a_token_of_a_person_is_long_and_needs_no_escaping() {
        for text in ["0123456789abcdef", "-._~-._~-._~ABCz", &"a".repeat(128)] {
            assert_eq!(AccessToken::parse(text).unwrap().expose(), text);
        }
        for text in
            ["", "0123456789abcde", &"a".repeat(129), "0123456789abcdef ", "0123456789abcde;", "0123456789abcd\u{e4}e"]
        {
            assert_eq!(AccessToken::parse(text), None, "{text}");
        }
    }

    #[test]
    fn a_grant_that_stays_keeps_its_number_and_another_role_is_another_grant() {
        let grant = |text: &str, role| TokenGrant { token: AccessToken::parse(text).unwrap(), role };
        let (teacher, class) = ("teacher-teacher-teacher", "class-class-class-class");
        let first = vec![grant(teacher, AccessRole::Operator), grant(class, AccessRole::Operator)];
        let table = TokenTable::new(first);
        let (teacher_id, _) = table.find(teacher).unwrap();
        let (class_id, _) = table.find(class).unwrap();
        let revoked = table.replace(vec![grant(class, AccessRole::Reader), grant(teacher, AccessRole::Operator)]);
        assert_eq!(revoked, [class_id]);
        assert_eq!(table.find(teacher), Some((teacher_id, AccessRole::Operator)));
        let (new_id, role) = table.find(class).unwrap();
        assert!(new_id != class_id && role == AccessRole::Reader);
        assert_eq!(table.first(AccessRole::Reader).unwrap().expose(), class);
        assert_eq!(table.replace(Vec::new()), [new_id, teacher_id]);
        assert_eq!(table.find(teacher), None);
    }
}
