//! `posebridge doctor`: finds out why no data of a robot arrives, and suggests remedies. Each check tests one cause and changes
//! nothing: it sends no byte, closes what it opens, and restores the settings of a serial line. The system is read below a root folder,
//! so that tests can use a simulated computer.

mod context;
mod host;
pub(in crate::tools) mod links;
pub mod serial_ports;
mod setup;

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use posebridge_report::tables::wrapped;
use serde::Serialize;

use crate::console::print_result;
use crate::exit::{ExitStage, Failure};
use crate::flags::positive;

pub use self::context::{CheckResult, DiagnosticContext, Finding, Status, UserGroup, UserPermissions};

/// Flags of `doctor`.
#[derive(Args, Clone, Debug)]
pub struct DoctorArgs {
    /// Listen on these links and identify what arrives: serial, tcp or udp, e.g. serial:///dev/ttyUSB0.
    #[arg(value_name = "URL")]
    pub links: Vec<String>,
    /// Check this configuration file and try to open its links.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Run a station with this configuration, such as that of `posebridge init`, for at least 10 seconds, and go through the
    /// set-up of the robot: link, bytes, frames, wheels, clock, gyro, camera, estimate. URLs replace the links of the file.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// Time to listen on each link, and at each baud rate of a serial port, in seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = up_to_an_hour)]
    pub listen_for: f64,
    /// Print one JSON object instead of lines (docs/getting-started.md).
    #[arg(long)]
    pub json: bool,
}

/// In the order of the report. Adding one: a file here and a line there.
pub const CHECKS: &[Check] = &[
    Check { name: "serial-ports", run: serial_ports::check_ports },
    Check { name: "permissions", run: serial_ports::check_permissions },
    Check { name: "port-holders", run: serial_ports::check_holders },
    Check { name: "modem-manager", run: serial_ports::check_modem_manager },
    Check { name: "bluetooth", run: host::check_bluetooth },
    Check { name: "time-sync", run: host::check_time_sync },
    Check { name: "receive-buffer", run: host::check_receive_buffer },
    Check { name: "configuration", run: links::check_configuration },
    Check { name: "listening", run: links::check_listening },
    Check { name: "set-up", run: setup::check_setup },
];

#[derive(Clone, Copy, Debug)]
pub struct Check {
    pub name: &'static str,
    /// Returns at least one result.
    pub run: fn(&DiagnosticContext) -> Vec<CheckResult>,
}

/// Runs the checks and prints their results. Any problem gives exit code 1.
pub fn execute(args: &DoctorArgs) -> Result<(), Failure> {
    let context = DiagnosticContext {
        root: PathBuf::from("/"),
        user: UserPermissions::current(),
        config: args.config.clone(),
        links: args.links.clone(),
        robot: args.robot.clone(),
        listen_for_s: args.listen_for,
    };
    let findings = run_checks(&context);
    let text = if args.json { json_report(&findings).while_running()? } else { text_report(&findings) };
    print_result(&text).while_running()?;
    match count(&findings, Status::Problem) {
        0 => Ok(()),
        1 => Err(Failure::Failed(anyhow!("the doctor found a problem"))),
        count => Err(Failure::Failed(anyhow!("the doctor found {count} problems"))),
    }
}

pub fn run_checks(context: &DiagnosticContext) -> Vec<Finding> {
    let findings_of = |check: &Check| {
        let name = check.name;
        let verdicts = (check.run)(context).into_iter();
        verdicts.map(move |verdict| Finding { name, result: verdict })
    };
    CHECKS.iter().flat_map(findings_of).collect()
}

/// A number of seconds, positive and up to an hour.
fn up_to_an_hour(text: &str) -> Result<f64, String> {
    match positive(text) {
        Ok(seconds) if seconds <= 3_600.0 => Ok(seconds),
        _ => Err("must be a number of seconds of more than zero, up to 3600".to_owned()),
    }
}

/// The JSON object of `doctor --json`.
#[derive(Serialize)]
struct DoctorReport<'a> {
    version: &'static str,
    problems: usize,
    warnings: usize,
    checks: &'a [Finding],
}

fn count(findings: &[Finding], status: Status) -> usize {
    findings.iter().filter(|finding| finding.result.status == status).count()
}

fn json_report(findings: &[Finding]) -> serde_json::Result<String> {
    let report = DoctorReport {
        version: env!("CARGO_PKG_VERSION"),
        problems: count(findings, Status::Problem),
        warnings: count(findings, Status::Warning),
        checks: findings,
    };
    Ok(serde_json::to_string(&report)? + "\n")
}

/// One line per finding, its remedy below it, and totals.
fn text_report(findings: &[Finding]) -> String {
    let name_width = findings.iter().map(|finding| finding.name.len()).max().unwrap_or(0);
    let lines: Vec<_> = findings.iter().map(|finding| format_finding(finding, name_width)).collect();
    lines.concat() + &summary_line(findings)
}

fn format_finding(finding: &Finding, name_width: usize) -> String {
    let verdict = &finding.result;
    let (word, name) = (verdict.status.as_str(), finding.name);
    let head = format!("{word:STATUS_WIDTH$}  {name:name_width$}  ");
    let indent = " ".repeat(head.len());
    // A message may have lines of its own, such as the line of a file that is wrong.
    let labels = std::iter::once(head.as_str()).chain(std::iter::repeat(indent.as_str()));
    let mut text: String = labels.zip(verdict.message.lines()).map(|(label, line)| wrapped(label, line)).collect();
    if !verdict.advice.is_empty() {
        text += &wrapped(&format!("{indent}cure: "), &verdict.advice);
    }
    text
}

const STATUS_WIDTH: usize = "problem".len();

fn summary_line(findings: &[Finding]) -> String {
    let problems = count(findings, Status::Problem);
    let warnings = count(findings, Status::Warning);
    match (problems, warnings) {
        (0, 0) => "nothing is wrong\n".to_owned(),
        _ => format!("problems: {problems}, warnings: {warnings}\n"),
    }
}
