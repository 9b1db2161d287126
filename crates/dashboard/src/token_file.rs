//! The file of tokens: for its owner alone, one token a line with its role.
//!
//! It is outside of the configuration, because that is copied into every recording. It is read again while the station runs, so that a token
//! can be revoked. A file that cannot be read or has an error changes nothing, so that a slip of the pen locks nobody out.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use crate::token::{AccessRole, AccessToken, MAX_TOKEN_CHARS, MIN_TOKEN_CHARS, TokenGrant};

const OWNER_ONLY: u32 = 0o600;
const ANYBODY_ELSE: u32 = 0o077;
/// Room for every token with a comment; small enough to read whatever the path refers to.
const MAX_FILE_BYTES: u64 = 64 * 1024;
/// A class with a token each.
const MAX_TOKENS: usize = 64;

/// Why a file of tokens cannot be used. No error shows a token.
#[derive(Debug, thiserror::Error)]
pub enum TokenFileError {
    #[error("cannot read the tokens `{}`", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot create the file of tokens `{}`", path.display())]
    Create { path: PathBuf, source: io::Error },
    #[error("no random bytes for a token")]
    Random { source: getrandom::Error },
    #[error("`{}` is no file and holds no tokens", path.display())]
    NoFile { path: PathBuf },
    #[error(
        "others than its owner have access to the tokens `{}` (mode {mode:04o}): run `chmod 600 {}`; if somebody may have read \
         them, write new ones", path.display(), path.display()
    )]
    OpenToOthers { path: PathBuf, mode: u32 },
    #[error("`{}` is longer than {MAX_FILE_BYTES} bytes", path.display())]
    TooLong { path: PathBuf },
    #[error("`{}` has more than {MAX_TOKENS} tokens", path.display())]
    TooMany { path: PathBuf },
    #[error("`{}`, line {line}: {problem}", path.display())]
    Line { path: PathBuf, line: usize, problem: LineProblem },
}

/// What is wrong with a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineProblem {
    #[error("begin it with the word `operator` or `reader`, or with # for a comment")]
    Role,
    #[error(
        "behind the role there must be a token of {MIN_TOKEN_CHARS} to {MAX_TOKEN_CHARS} letters, digits or -._~ (`openssl rand -hex 16` \
         makes one)"
    )]
    Token,
    #[error("this token stands in an earlier line")]
    Twice,
}

/// Reads the tokens; a missing file is created with one of each role.
pub(crate) fn read_or_create(path: &Path) -> Result<Vec<TokenGrant>, TokenFileError> {
    match read(path) {
        Err(TokenFileError::Read { source, .. }) if source.kind() == ErrorKind::NotFound => create(path),
        result => result,
    }
}

/// The tokens in a file. It must be for its owner alone.
pub(crate) fn read(path: &Path) -> Result<Vec<TokenGrant>, TokenFileError> {
    let failed = |source| TokenFileError::Read { path: path.to_owned(), source };
    // Without waiting for the other end of a pipe.
    let file = OpenOptions::new().read(true).custom_flags(nix::libc::O_NONBLOCK).open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return Err(TokenFileError::NoFile { path: path.to_owned() });
    }
    let mode = metadata.permissions().mode() & 0o777;
    if mode & ANYBODY_ELSE != 0 {
        return Err(TokenFileError::OpenToOthers { path: path.to_owned(), mode });
    }
    let mut text = String::new();
    file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text).map_err(failed)?;
    if text.len() as u64 > MAX_FILE_BYTES {
        return Err(TokenFileError::TooLong { path: path.to_owned() });
    }
    parse(path, &text)
}

fn parse(path: &Path, text: &str) -> Result<Vec<TokenGrant>, TokenFileError> {
    let mut grants: Vec<TokenGrant> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if line.trim().is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        let parsed = parse_line(line).and_then(|grant| {
            let is_known = grants.iter().any(|known| known.token == grant.token);
            if is_known { Err(LineProblem::Twice) } else { Ok(grant) }
        });
        let wrong = |problem| TokenFileError::Line { path: path.to_owned(), line: index + 1, problem };
        grants.push(parsed.map_err(wrong)?);
        if grants.len() > MAX_TOKENS {
            return Err(TokenFileError::TooMany { path: path.to_owned() });
        }
    }
    Ok(grants)
}

/// Role, token, and anything else for people.
fn parse_line(line: &str) -> Result<TokenGrant, LineProblem> {
    let mut words = line.split_whitespace();
    let role = match words.next().unwrap_or_default() {
        "operator" => AccessRole::Operator,
        "reader" => AccessRole::Reader,
        _ => return Err(LineProblem::Role),
    };
    let token = words.next().and_then(AccessToken::parse).ok_or(LineProblem::Token)?;
    Ok(TokenGrant { token, role })
}

fn create(path: &Path) -> Result<Vec<TokenGrant>, TokenFileError> {
    let grants = random_grants().map_err(|source| TokenFileError::Random { source })?;
    let write = |mut file: File| {
        writeln!(file, "# Who may use the page: a role (operator or reader), a token, and whatever helps people.")?;
        writeln!(file, "# It is read again while the station runs: a token that is taken away ends its sessions.")?;
        for grant in &grants {
            let role = match grant.role {
                AccessRole::Operator => "operator",
                AccessRole::Reader => "reader",
            };
            writeln!(file, "{role} {}", grant.token.expose())?;
        }
        file.sync_all()
    };
    let opened = OpenOptions::new().write(true).create_new(true).mode(OWNER_ONLY).open(path);
    opened.and_then(write).map_err(|source| TokenFileError::Create { path: path.to_owned(), source })?;
    Ok(grants)
}

/// A token for those who give commands, and one for those who only look.
pub(crate) fn random_grants() -> Result<Vec<TokenGrant>, getrandom::Error> {
    let grant = |role| Ok(TokenGrant { token: AccessToken::random()?, role });
    Ok(vec![grant(AccessRole::Operator)?, grant(AccessRole::Reader)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::fs::Permissions;

    fn written(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens");
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, Permissions::from_mode(OWNER_ONLY)).unwrap();
        (folder, path)
    }

    #[test]
    fn a_missing_file_is_made_for_its_owner_with_a_token_of_each_role_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens");
        let made = read_or_create(&path).unwrap();
        let roles: Vec<AccessRole> = made.iter().map(|grant| grant.role).collect();
        assert_eq!(roles, [AccessRole::Operator, AccessRole::Reader]);
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, OWNER_ONLY);
        assert_eq!(read_or_create(&path).unwrap(), made);
    }

    #[test]
    fn a_line_is_a_role_and_a_token_and_the_rest_is_for_people() {
        let (_folder, path) =
            written("# class 7b\n\n  reader\t0123456789abcdef  Ada, until summer\noperator fedcba9876543210");
        let roles: Vec<AccessRole> = read(&path).unwrap().iter().map(|grant| grant.role).collect();
        assert_eq!(roles, [AccessRole::Reader, AccessRole::Operator]);
    }

    #[test]
    fn an_error_names_the_line_and_what_to_do_and_no_token() {
        for (text, why) in [
            (
                "admin 0123456789abcdef",
                "line 1: begin it with the word `operator` or `reader`, or with # for a comment",
            ),
            ("\nreader 0123", "line 2: behind the role there must be a token of 16 to 128 letters, digits or -._~"),
            ("reader 0123456789abcdef\noperator 0123456789abcdef", "line 2: this token stands in an earlier line"),
        ] {
            let (_folder, path) = written(text);
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(why) && !error.contains("0123"), "{error}");
        }
        let many = (0..65).map(|index| format!("reader token-number-{index:06}")).collect::<Vec<_>>().join("\n");
        for (text, why) in [(many, "has more than 64 tokens"), ("#".repeat(70_000), "is longer than 65536 bytes")] {
            let (_folder, path) = written(&text);
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }

    #[test]
    fn a_file_that_others_can_read_and_what_is_no_file_are_refused() {
        let (folder, path) = written("reader 0123456789abcdef");
        std::fs::set_permissions(&path, Permissions::from_mode(0o640)).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("(mode 0640): run `chmod 600"), "{error}");
        assert!(matches!(read(folder.path()), Err(TokenFileError::NoFile { .. })));
    }
}
