//! `posebridge doctor`: says why a robot cannot be heard, and what to do about it.
//!
//! Each check looks at one cause and gives verdicts; a new check is a file and a line in [`CHECKS`]. Checks look, they
//! change nothing: they send no byte, what they open they close, and a serial line gets its settings back. Where the system is
//! read from stands in [`SystemRoots`], so that tests look at a made-up computer. docs/getting-started.md is the manual.

pub mod bluetooth;
mod check_result;
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
use clap::Args;

pub use self::check_result::{CheckResult, DiagnosticContext, Finding, Status};
use crate::console::print_result;
use crate::exit::{ExitStage, Failure};
use crate::flags::positive;
pub use surroundings::{SystemRoots, UserGroup, UserPermissions};

/// Flags of `doctor`.
#[derive(Args, Clone, Debug)]
pub struct DoctorArgs {
    /// Listen on these links and name what is heard: serial, tcp or udp, e.g. serial:///dev/ttyUSB0.
    #[arg(value_name = "URL")]
    pub links: Vec<String>,
    /// Check this configuration file, and whether its links open.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Listen this long on each link, and at each speed of a serial port that is tried.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = up_to_an_hour)]
    pub listen_for: f64,
    /// Print one JSON object (docs/getting-started.md) instead of lines.
    #[arg(long)]
    pub json: bool,
}

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
    pub run: fn(&DiagnosticContext) -> Vec<CheckResult>,
}

impl Check {
    const fn new(name: &'static str, run: fn(&DiagnosticContext) -> Vec<CheckResult>) -> Self {
        Self { name, run }
    }
}

/// Runs the checks and prints their results.
///
/// # Errors
/// There is a problem, or the report cannot be printed: exit code 1.
pub fn execute(args: &DoctorArgs) -> Result<(), Failure> {
    let examination = DiagnosticContext {
        roots: SystemRoots::host(),
        user: UserPermissions::current(),
        config: args.config.clone(),
        links: args.links.clone(),
        listen_for_s: args.listen_for,
    };
    let findings = run_checks(&examination);
    let text = if args.json { report::json(&findings).while_running()? } else { report::text(&findings) };
    print_result(&text).while_running()?;
    match report::count(&findings, Status::Problem) {
        0 => Ok(()),
        1 => Err(Failure::Failed(anyhow!("the doctor found a problem"))),
        count => Err(Failure::Failed(anyhow!("the doctor found {count} problems"))),
    }
}

/// The verdicts of all checks, in the order of [`CHECKS`].
pub fn run_checks(examination: &DiagnosticContext) -> Vec<Finding> {
    let findings_of = |check: &Check| {
        let name = check.name;
        let verdicts = (check.run)(examination).into_iter();
        verdicts.map(move |verdict| Finding { name, result: verdict })
    };
    CHECKS.iter().flat_map(findings_of).collect()
}

/// A number of seconds of more than zero and up to an hour.
fn up_to_an_hour(text: &str) -> Result<f64, String> {
    match positive(text) {
        Ok(seconds) if seconds <= 3_600.0 => Ok(seconds),
        _ => Err("must be a number of seconds of more than zero, up to 3600".to_owned()),
    }
}
