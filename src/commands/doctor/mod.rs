//! `posebridge doctor`: says why a robot cannot be heard, and what to do about it.
//!
//! Each check looks at one cause and gives verdicts; a new check is a file and a line in [`CHECKS`]. Checks look, they
//! change nothing: they send no byte, what they open they close, and a serial line gets its settings back. Where the system is read from stands in
//! [`Roots`], so that tests look at a made-up computer. docs/doctor.md is the manual.

pub mod bluetooth;
pub mod configuration;
mod hear;
pub mod holders;
pub mod listening;
pub mod modem_manager;
mod open;
pub mod permissions;
pub mod ports;
mod processes;
pub mod receive_buffer;
pub mod report;
pub mod surroundings;
pub mod time_sync;

use std::path::PathBuf;

use anyhow::anyhow;
use serde::Serialize;

use super::{Failure, Stage};
use crate::cli::DoctorArgs;
use crate::stdout;
pub use surroundings::{Group, Person, Roots};

/// Every check, in the order of the report. Adding one: a file here and a line there.
pub const CHECKS: &[Check] = &[
    Check::new("serial-ports", ports::check),
    Check::new("permissions", permissions::check),
    Check::new("port-holders", holders::check),
    Check::new("modem-manager", modem_manager::check),
    Check::new("bluetooth", bluetooth::check),
    Check::new("time-sync", time_sync::check),
    Check::new("receive-buffer", receive_buffer::check),
    Check::new("configuration", configuration::check),
    Check::new("listening", listening::check),
];

/// One check.
#[derive(Clone, Copy, Debug)]
pub struct Check {
    /// Its name in the report.
    pub name: &'static str,
    /// Looks, and gives at least one verdict.
    pub run: fn(&Examination) -> Vec<Verdict>,
}

impl Check {
    const fn new(name: &'static str, run: fn(&Examination) -> Vec<Verdict>) -> Self {
        Self { name, run }
    }
}

/// What is to be looked at.
#[derive(Clone, Debug)]
pub struct Examination {
    /// Where the system is read from.
    pub roots: Roots,
    /// Who asks.
    pub person: Person,
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
    #[must_use]
    pub const fn word(self) -> &'static str {
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
pub struct Verdict {
    /// How it came out.
    pub status: Status,
    /// What was found.
    pub what: String,
    /// What to do; empty where nothing needs to be done.
    pub advice: String,
}

impl Verdict {
    /// As it should be.
    #[must_use]
    pub fn ok(what: impl Into<String>) -> Self {
        Self::new(Status::Ok, what, "")
    }

    /// There was nothing to look at.
    #[must_use]
    pub fn skipped(what: impl Into<String>) -> Self {
        Self::new(Status::Skipped, what, "")
    }

    /// Something that may be a reason for trouble, with its cure.
    #[must_use]
    pub fn warning(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Warning, what, advice)
    }

    /// Something that does not work like this, with its cure.
    #[must_use]
    pub fn problem(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Problem, what, advice)
    }

    fn new(status: Status, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { status, what: what.into(), advice: advice.into() }
    }
}

/// Runs the checks and prints what they say.
///
/// # Errors
/// There is a problem, or the report cannot be printed: exit code 1.
pub fn execute(args: &DoctorArgs) -> Result<(), Failure> {
    let examination = Examination {
        roots: Roots::of_this_computer(),
        person: Person::who_runs_this(),
        config: args.config.clone(),
        links: args.links.clone(),
        listen_for_s: args.listen_for,
    };
    let findings = examine(&examination);
    let text = if args.json { report::json(&findings).while_running()? } else { report::text(&findings) };
    stdout::print(&text).while_running()?;
    match report::count(&findings, Status::Problem) {
        0 => Ok(()),
        1 => Err(Failure::Failed(anyhow!("the doctor found a problem"))),
        count => Err(Failure::Failed(anyhow!("the doctor found {count} problems"))),
    }
}

/// One verdict with the name of its check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The check's name.
    pub name: &'static str,
    /// What it says.
    pub verdict: Verdict,
}

/// The verdicts of all checks, in the order of [`CHECKS`].
#[must_use]
pub fn examine(examination: &Examination) -> Vec<Finding> {
    let findings_of = |check: &Check| {
        let name = check.name;
        let verdicts = (check.run)(examination).into_iter();
        verdicts.map(move |verdict| Finding { name, verdict })
    };
    CHECKS.iter().flat_map(findings_of).collect()
}
