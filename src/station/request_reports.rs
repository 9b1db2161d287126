//! What became of a request, as a line for people that goes back into the station.

use anyhow::Result;
use posebridge_telemetry::Input;
use posebridge_telemetry::severity::{INFO, WARNING};

/// The outcome of a request as an input of the station.
pub(super) fn report_input(outcome: Result<String>) -> Input {
    match outcome {
        Ok(text) => Input::Report { severity: INFO, text },
        Err(error) => Input::Report { severity: WARNING, text: format!("{error:#}") },
    }
}
