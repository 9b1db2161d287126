//! The tokens by which stations of a fleet accept the commands of each other's operators.

use std::path::Path;
use std::sync::Arc;

use crate::token::{AccessRole, AccessToken, TokenTable};
use crate::token_file::{self, TokenFileError};

/// The operators' tokens of the page, as they are at present. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct OperatorTokens {
    table: Option<Arc<TokenTable>>,
}

/// Why a station takes no command of another one's operator. The texts are shown at the station that sent it, and show no token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OperatorTokenError {
    #[error(
        "the robot's station has no operators' tokens: give it a page and `dashboard.token_file`, with the same file as this station"
    )]
    NotConfigured,
    #[error(
        "this station sent no operator's token: set `dashboard.token_file`, with the same file as at the robot's station"
    )]
    Missing,
    #[error(
        "the robot's station does not know the operator's token of this station: both need the same file as `dashboard.token_file`"
    )]
    Unknown,
}

impl OperatorTokens {
    pub(crate) const fn new(table: Option<Arc<TokenTable>>) -> Self {
        Self { table }
    }

    /// Those of a file of tokens; a missing one is created with one of each role.
    pub fn read_or_create(path: &Path) -> Result<Self, TokenFileError> {
        let grants = token_file::read_or_create(path)?;
        Ok(Self { table: Some(Arc::new(TokenTable::new(grants))) })
    }

    pub(crate) fn table(&self) -> Option<Arc<TokenTable>> {
        self.table.clone()
    }

    /// The first one, to be shown to another station.
    pub fn first(&self) -> Option<AccessToken> {
        self.table.as_ref()?.first(AccessRole::Operator)
    }

    /// Whether a token that another station has sent is one of an operator here.
    pub fn check(&self, candidate: Option<&str>) -> Result<(), OperatorTokenError> {
        let table = self.table.as_ref().ok_or(OperatorTokenError::NotConfigured)?;
        let candidate = candidate.ok_or(OperatorTokenError::Missing)?;
        match table.find(candidate) {
            Some((_, AccessRole::Operator)) => Ok(()),
            Some((_, AccessRole::Reader)) | None => Err(OperatorTokenError::Unknown),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::token::TokenGrant;

    #[test]
    fn only_an_operator_s_token_of_this_station_is_taken_and_the_others_say_what_to_configure() {
        let grant = |text: &str, role| TokenGrant { token: AccessToken::parse(text).unwrap(), role };
        let grants =
            vec![grant("student-student-1", AccessRole::Reader), grant("teacher-teacher-1", AccessRole::Operator)];
        let table = Arc::new(TokenTable::new(grants));
        let tokens = OperatorTokens::new(Some(Arc::clone(&table)));
        assert_eq!(tokens.first().unwrap().expose(), "teacher-teacher-1");
        assert_eq!(tokens.check(Some("teacher-teacher-1")), Ok(()));
        for wrong in ["student-student-1", "teacher-teacher-2", ""] {
            assert_eq!(tokens.check(Some(wrong)), Err(OperatorTokenError::Unknown), "{wrong}");
        }
        assert_eq!(tokens.check(None), Err(OperatorTokenError::Missing));
        let none = OperatorTokens::default();
        assert!(none.first().is_none());
        assert_eq!(none.check(Some("teacher-teacher-1")), Err(OperatorTokenError::NotConfigured));
        for error in [OperatorTokenError::NotConfigured, OperatorTokenError::Missing, OperatorTokenError::Unknown] {
            assert!(error.to_string().contains("`dashboard.token_file`"), "{error}");
        }
        // Revoked while the station runs.
        table.replace(Vec::new());
        assert_eq!(tokens.check(Some("teacher-teacher-1")), Err(OperatorTokenError::Unknown));
    }
}
