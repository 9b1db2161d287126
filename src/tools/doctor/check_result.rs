//! What a check examines, and its result.

use std::path::PathBuf;

use serde::Serialize;

use super::surroundings::{SystemRoots, UserPermissions};

/// What is to be looked at.
#[derive(Clone, Debug)]
pub struct DiagnosticContext {
    /// Where the system is read from.
    pub roots: SystemRoots,
    /// Who asks.
    pub user: UserPermissions,
    /// The configuration file; without it the embedded default is checked, and no link is opened.
    pub config: Option<PathBuf>,
    /// The links to listen on, as they were given.
    pub links: Vec<String>,
    /// How long to listen on each, and at each speed, in seconds.
    pub listen_for_s: f64,
}

/// How a check came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// There was nothing to look at.
    Skipped,
    /// As it should be.
    Ok,
    /// It may be a reason for trouble.
    Warning,
    /// It will not work like this.
    Problem,
}

impl Status {
    /// The word in the report.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Skipped => "skipped",
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Problem => "problem",
        }
    }
}

/// What one check says about one thing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckResult {
    /// How it came out.
    pub status: Status,
    /// What was found.
    pub message: String,
    /// What to do; empty where nothing needs to be done.
    pub advice: String,
}

impl CheckResult {
    /// As it should be.
    pub fn ok(what: impl Into<String>) -> Self {
        Self::new(Status::Ok, what, "")
    }

    /// There was nothing to look at.
    pub fn skipped(what: impl Into<String>) -> Self {
        Self::new(Status::Skipped, what, "")
    }

    /// Something that may be a reason for trouble, with its cure.
    pub fn warning(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Warning, what, advice)
    }

    /// Something that does not work like this, with its cure.
    pub fn problem(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Problem, what, advice)
    }

    fn new(status: Status, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { status, message: what.into(), advice: advice.into() }
    }
}

/// One verdict with the name of its check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The check's name.
    pub name: &'static str,
    /// Its result.
    pub result: CheckResult,
}
