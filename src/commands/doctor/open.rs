//! Opens a link once, without waiting for it to come up later, and leaves a serial line as it was.

use posebridge_link::{HostTimer, LineSettings, LinkUrl, OpenError, Port, PortConfig, PortEvent, PortTuning, Role};
use posebridge_telemetry::LinkId;

use super::Verdict;

/// How an attempt to open a link ended.
pub(super) enum Opened {
    /// Bytes can flow; with what was opened, for people.
    Up(Box<Port>, String),
    /// It is not there, and may come.
    Away(String),
    /// A person has to change something first.
    Refused(OpenError),
}

/// Opens a link; takes at most the deadline of the transports, five seconds.
pub(super) async fn open(url: &LinkUrl, role: Role, timer: HostTimer) -> Opened {
    let config = PortConfig { id: LinkId(0), url: url.clone(), role };
    let tuning = PortTuning { line_settings: LineSettings::PutBack, ..PortTuning::default() };
    let mut port = Port::tuned(config, tuning, timer);
    if let Err(error) = port.open_first().await {
        return Opened::Refused(error);
    }
    loop {
        match port.next().await {
            PortEvent::Up { detail, .. } => return Opened::Up(Box::new(port), detail),
            PortEvent::Down { reason, .. } => return Opened::Away(reason),
            // Neither comes before the link is up.
            PortEvent::Bytes { .. } | PortEvent::Finished { .. } => {}
        }
    }
}

/// Runs what opens links. An attempt to open a device that hangs is left behind, so that it does not keep the program alive.
pub(super) fn on_a_runtime(look: impl Future<Output = Vec<Verdict>>) -> Vec<Verdict> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    match runtime {
        Ok(runtime) => {
            let verdicts = runtime.block_on(look);
            runtime.shutdown_background();
            verdicts
        }
        Err(error) => vec![Verdict::skipped(format!("no link can be opened: {error}"))],
    }
}

/// What is said about a link that may come up later.
pub(super) fn away(link: &str, reason: &str) -> Verdict {
    Verdict::warning(
        format!("{link} is not there: {reason}"),
        "plug it in, switch it on or start what listens there; `posebridge run` waits for it",
    )
}

/// What is said about a link that a person has to change. The errors say what is wrong and, behind a colon, what to do.
pub(super) fn refused(link: &str, error: &OpenError) -> Verdict {
    let said = error.to_string();
    let (what, advice) = said.split_once(": ").unwrap_or((&said, "docs/links.md says how a link is written"));
    Verdict::problem(format!("{link} does not open: {what}"), advice)
}
