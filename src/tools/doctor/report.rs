//! The report: lines for people, or one JSON object (docs/getting-started.md).

use serde::Serialize;

use super::check_result::{Finding, Status};

/// The object of `doctor --json`.
#[derive(Serialize)]
struct DoctorReport<'a> {
    version: &'static str,
    problems: usize,
    warnings: usize,
    checks: Vec<CheckRow<'a>>,
}

#[derive(Serialize)]
struct CheckRow<'a> {
    name: &'a str,
    status: Status,
    what: &'a str,
    advice: Option<&'a str>,
}

/// How many findings came out so.
pub fn count(findings: &[Finding], status: Status) -> usize {
    findings.iter().filter(|finding| finding.result.status == status).count()
}

/// One object on one line.
///
/// # Errors
/// It cannot be written as JSON, which would be a fault of ours.
pub fn json(findings: &[Finding]) -> serde_json::Result<String> {
    let checks = findings.iter().map(CheckRow::from_finding).collect();
    let report = DoctorReport {
        version: env!("CARGO_PKG_VERSION"),
        problems: count(findings, Status::Problem),
        warnings: count(findings, Status::Warning),
        checks,
    };
    Ok(serde_json::to_string(&report)? + "\n")
}

impl<'a> CheckRow<'a> {
    fn from_finding(finding: &'a Finding) -> Self {
        let verdict = &finding.result;
        Self {
            name: finding.name,
            status: verdict.status,
            what: &verdict.message,
            advice: Some(verdict.advice.as_str()).filter(|advice| !advice.is_empty()),
        }
    }
}

/// A line per finding, the cure below it, and the sum.
pub fn text(findings: &[Finding]) -> String {
    let name_width = findings.iter().map(|finding| finding.name.len()).max().unwrap_or(0);
    let lines: Vec<_> = findings.iter().map(|finding| format_finding(finding, name_width)).collect();
    lines.concat() + &summary_line(findings)
}

fn format_finding(finding: &Finding, name_width: usize) -> String {
    let verdict = &finding.result;
    let (word, name) = (verdict.status.as_str(), finding.name);
    let head = format!("{word:STATUS_WIDTH$}  {name:name_width$}  ");
    // A message may have lines of its own, such as the line of a file that is wrong.
    let indent = " ".repeat(head.len());
    let what = verdict.message.replace('\n', &format!("\n{indent}"));
    if verdict.advice.is_empty() {
        format!("{head}{what}\n")
    } else {
        format!("{head}{what}\n{indent}cure: {}\n", verdict.advice)
    }
}

/// Width of the longest word for a status.
const STATUS_WIDTH: usize = "problem".len();

fn summary_line(findings: &[Finding]) -> String {
    let problems = count(findings, Status::Problem);
    let warnings = count(findings, Status::Warning);
    match (problems, warnings) {
        (0, 0) => "nothing is wrong\n".to_owned(),
        _ => format!("problems: {problems}, warnings: {warnings}\n"),
    }
}
