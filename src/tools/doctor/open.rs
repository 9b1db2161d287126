//! Opens a link once, without waiting for it to come up later, and leaves a serial line as it was.

use posebridge_link::{
    ConnectRole, HostTimer, LineSettingsPolicy, Link, LinkEvent, LinkOpenConfig, LinkTuning, LinkUrl, OpenError,
};
use posebridge_telemetry::LinkId;

use super::check_result::CheckResult;

/// How an attempt to open a link ended.
pub(super) enum OpenOutcome {
    /// Bytes can flow; with what was opened, for people.
    Up(Box<Link>, String),
    /// It is not there, and may come.
    Unavailable(String),
    /// A person has to change something first.
    Rejected(OpenError),
}

/// Opens a link; takes at most the deadline of the transports, five seconds.
pub(super) async fn open(url: &LinkUrl, role: ConnectRole, timer: HostTimer) -> OpenOutcome {
    let config = LinkOpenConfig { id: LinkId(0), url: url.clone(), role };
    let tuning = LinkTuning { line_settings: LineSettingsPolicy::Restore, ..LinkTuning::default() };
    let mut port = Link::with_tuning(config, tuning, timer);
    if let Err(error) = port.try_open().await {
        return OpenOutcome::Rejected(error);
    }
    loop {
        match port.next_event().await {
            LinkEvent::Up { detail, .. } => return OpenOutcome::Up(Box::new(port), detail),
            LinkEvent::Down { reason, .. } => return OpenOutcome::Unavailable(reason),
            // Neither comes before the link is up.
            LinkEvent::Bytes { .. } | LinkEvent::Finished { .. } => {}
        }
    }
}

/// Runs what opens links. An attempt to open a device that hangs is left behind, so that it does not keep the program alive.
pub(super) fn run_in_runtime(look: impl Future<Output = Vec<CheckResult>>) -> Vec<CheckResult> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    match runtime {
        Ok(runtime) => {
            let verdicts = runtime.block_on(look);
            runtime.shutdown_background();
            verdicts
        }
        Err(error) => vec![CheckResult::skipped(format!("no link can be opened: {error}"))],
    }
}

/// The result for a link that may come up later.
pub(super) fn unavailable_result(link: &str, reason: &str) -> CheckResult {
    CheckResult::warning(
        format!("{link} is not there: {reason}"),
        "plug it in, switch it on or start what listens there; `posebridge run` waits for it",
    )
}

/// The result for a link that a person has to change. The errors say what is wrong and, behind a colon, what to do.
pub(super) fn rejected_result(link: &str, error: &OpenError) -> CheckResult {
    let message = error.to_string();
    let (what, advice) = message.split_once(": ").unwrap_or((&message, "docs/links.md says how a link is written"));
    CheckResult::problem(format!("{link} does not open: {what}"), advice)
}
