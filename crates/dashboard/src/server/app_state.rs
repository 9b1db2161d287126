//! The state that request handlers share, and their common responses.

use std::path::PathBuf;
use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use posebridge_telemetry::Input;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_util::sync::CancellationToken;

use super::guard::RequestGuard;
use super::hub_task::{HubQuery, TextTopic};
use super::rate::RateLimiter;
use crate::api::{HostClockSource, ReplayLoader};
use crate::assets::Assets;
use crate::command::{self, CommandContext};
use crate::counters::{ServerCounter, ServerCounters};
use crate::limits::COMMANDS_PER_S;
use crate::model::{RecordingRow, Refusal};
use crate::recordings::RecordingFolder;

/// The state that all request handlers share.
pub(crate) struct AppState {
    pub(crate) guard: RequestGuard,
    pub(crate) counts: Arc<ServerCounters>,
    pub(crate) queries: mpsc::Sender<HubQuery>,
    pub(crate) commands: mpsc::Sender<Input>,
    /// The rate limit of commands, for all clients together.
    pub(crate) command_rate: RateLimiter,
    /// The names that commands may use.
    pub(crate) command_context: CommandContext,
    pub(crate) clock: Arc<HostClockSource>,
    pub(crate) recordings: RecordingFolder,
    pub(crate) assets: Assets,
    pub(crate) replay: Box<ReplayLoader>,
    /// One replay at a time, because it takes a core.
    pub(crate) replay_slot: Arc<Semaphore>,
    /// Slots for readers of the stream.
    pub(crate) reader_slots: Arc<Semaphore>,
    pub(crate) stop: CancellationToken,
}

impl AppState {
    /// Sends a command to the station; returns its name, or the status and reason of a rejection.
    pub(super) fn submit_command(&self, text: &[u8]) -> Result<&'static str, (StatusCode, String)> {
        let read = command::parse(text).and_then(|parsed| {
            self.command_context.validate(parsed.name, &parsed.command)?;
            Ok(parsed)
        });
        let parsed = read.map_err(|error| {
            self.counts.increment(ServerCounter::BadCommand);
            (StatusCode::BAD_REQUEST, error.to_string())
        })?;
        if !self.command_rate.admits((self.clock)()) {
            self.counts.increment(ServerCounter::CommandRate);
            let why = format!("more than {COMMANDS_PER_S} commands a second come to this station; try again");
            return Err((StatusCode::SERVICE_UNAVAILABLE, why));
        }
        match self.commands.try_send(parsed.input()) {
            Ok(()) => {
                self.counts.increment(ServerCounter::Commands);
                Ok(parsed.name)
            }
            Err(TrySendError::Full(_)) => {
                self.counts.increment(ServerCounter::CommandsFull);
                let why = "too many commands wait; try again".to_owned();
                Err((StatusCode::SERVICE_UNAVAILABLE, why))
            }
            Err(TrySendError::Closed(_)) => {
                let why = "the station is ending".to_owned();
                Err((StatusCode::SERVICE_UNAVAILABLE, why))
            }
        }
    }

    /// The recordings of this run.
    pub(super) async fn recording_rows(&self) -> Vec<RecordingRow> {
        let (reply, answer) = oneshot::channel();
        // Without the hub nothing is being recorded.
        drop(self.queries.send(HubQuery::Recording(reply)).await);
        let current = answer.await.ok().flatten();
        let recordings = self.recordings.clone();
        let listed = tokio::task::spawn_blocking(move || recordings.list(current.as_deref()));
        listed.await.unwrap_or_default()
    }

    pub(super) async fn recording_path(&self, name: &str) -> Option<PathBuf> {
        let (recordings, name) = (self.recordings.clone(), name.to_owned());
        let looked = tokio::task::spawn_blocking(move || recordings.path(&name));
        looked.await.ok().flatten()
    }

    pub(super) async fn text(&self, subject: TextTopic, kind: &'static str) -> Response {
        let (reply, answer) = oneshot::channel();
        drop(self.queries.send(HubQuery::Text(subject, reply)).await);
        answer.await.map_or_else(
            |_gone| refusal_response(StatusCode::SERVICE_UNAVAILABLE, "the station is ending".to_owned()),
            |text| with_content_type(kind, text.into()),
        )
    }

    /// Rejects a malformed request.
    pub(super) fn bad_request(&self, status: StatusCode, why: String) -> Response {
        self.counts.increment(ServerCounter::BadRequest);
        refusal_response(status, why)
    }

    pub(super) fn wrong_method(&self) -> Response {
        let why = "wrong method: commands are posted to /v1/commands, everything else is got".to_owned();
        self.bad_request(StatusCode::METHOD_NOT_ALLOWED, why)
    }

    pub(super) fn no_recording(&self) -> Response {
        self.counts.increment(ServerCounter::NotFound);
        let why = "there is no such recording; /v1/recordings lists them".to_owned();
        refusal_response(StatusCode::NOT_FOUND, why)
    }

    pub(super) fn not_found(&self) -> Response {
        self.counts.increment(ServerCounter::NotFound);
        let why = "there is nothing here; docs/dashboard.md lists what there is".to_owned();
        refusal_response(StatusCode::NOT_FOUND, why)
    }
}

/// An error as JSON.
pub(super) fn refusal_response(status: StatusCode, error: String) -> Response {
    (status, Json(Refusal { error })).into_response()
}

pub(super) fn with_content_type(kind: &'static str, body: Body) -> Response {
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}
