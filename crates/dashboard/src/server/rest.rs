//! The REST endpoints and the files of the page.

use std::future::{Ready, ready};
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::rejection::{BytesRejection, PathRejection};
use axum::extract::{Path, Request, State};
use axum::http::header::{ALLOW, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse as _, Response};
use tokio::io::AsyncReadExt as _;
use tokio_util::io::ReaderStream;

use super::app_state::{AppState, refusal_response, with_content_type};
use super::hub_task::TextTopic;
use crate::counters::ServerCounter;
use crate::metrics::CONTENT_TYPE as METRICS_TYPE;
use crate::model::Accepted;

type SharedApp = State<Arc<AppState>>;
/// The name in a path, which may be invalid UTF-8.
type RecordingName = Result<Path<String>, PathRejection>;

const JSON: &str = "application/json";

pub(super) async fn state(State(app): SharedApp) -> Response {
    app.text(TextTopic::State, JSON).await
}

pub(super) async fn robots(State(app): SharedApp) -> Response {
    app.text(TextTopic::Robots, JSON).await
}

pub(super) async fn sources(State(app): SharedApp) -> Response {
    app.text(TextTopic::Sources, JSON).await
}

pub(super) async fn parameters(State(app): SharedApp) -> Response {
    app.text(TextTopic::Parameters, JSON).await
}

pub(super) async fn metrics(State(app): SharedApp) -> Response {
    app.text(TextTopic::Metrics, METRICS_TYPE).await
}

pub(super) fn schema() -> Ready<Response> {
    ready(with_content_type(JSON, include_str!("../../schema/v1.json").into()))
}

pub(super) async fn recordings(State(app): SharedApp) -> Response {
    let rows = app.recording_rows().await;
    with_content_type(JSON, serde_json::to_string(&rows).unwrap_or_default().into())
}

/// A whole recording; of the current one the part written so far.
pub(super) async fn download(State(app): SharedApp, name: RecordingName) -> Response {
    let name = match name {
        Ok(Path(name)) => name,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    let Some(path) = app.recording_path(&name).await else {
        return app.no_recording();
    };
    let opened = async {
        let file = tokio::fs::File::open(&path).await?;
        let bytes = file.metadata().await?.len();
        Ok::<_, std::io::Error>((file, bytes))
    };
    let Ok((file, bytes)) = opened.await else {
        return app.no_recording();
    };
    let mut response =
        with_content_type("application/octet-stream", Body::from_stream(ReaderStream::new(file.take(bytes))));
    let headers = response.headers_mut();
    headers.insert(CONTENT_LENGTH, bytes.into());
    // The name is one of the folder's; the browser chooses a name if this one does not fit into a header.
    if let Ok(value) = HeaderValue::from_str(&format!("attachment; filename=\"{name}\"")) {
        headers.insert(CONTENT_DISPOSITION, value);
    }
    response
}

/// The trails of a recording, replayed by the station.
pub(super) async fn replay(State(app): SharedApp, name: RecordingName) -> Response {
    let name = match name {
        Ok(Path(name)) => name,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    let Some(path) = app.recording_path(&name).await else {
        return app.no_recording();
    };
    let Ok(permit) = Arc::clone(&app.replay_slot).try_acquire_owned() else {
        app.counts.increment(ServerCounter::ReplayBusy);
        let why = "another recording is being replayed; try again when it is done".to_owned();
        return refusal_response(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    let worker = Arc::clone(&app);
    let replayed = tokio::task::spawn_blocking(move || {
        let history = (worker.replay)(&path);
        // Held until the replay ends, even if the client has left.
        drop(permit);
        serde_json::to_string(&history?).map_err(|error| error.to_string())
    });
    match replayed.await {
        Ok(Ok(text)) => with_content_type(JSON, text.into()),
        Ok(Err(why)) => refusal_response(StatusCode::UNPROCESSABLE_ENTITY, why),
        Err(_died) => refusal_response(
            StatusCode::INTERNAL_SERVER_ERROR,
            format!("the replay of `{name}` died; `posebridge replay` says more"),
        ),
    }
}

/// Sends a command to the station; the log shows its result.
pub(super) async fn command(
    State(app): SharedApp,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Response {
    if !is_json(&headers) {
        let why = "a command has the header Content-Type: application/json".to_owned();
        return app.bad_request(StatusCode::UNSUPPORTED_MEDIA_TYPE, why);
    }
    let body = match body {
        Ok(body) => body,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    match app.submit_command(&body) {
        Ok(name) => {
            let accepted = Accepted { accepted: name.to_owned() };
            (StatusCode::ACCEPTED, axum::Json(accepted)).into_response()
        }
        Err((status, why)) => refusal_response(status, why),
    }
}

/// Whether the body's media type is JSON; media types are case-insensitive (RFC 9110, section 8.3.1).
fn is_json(headers: &HeaderMap) -> bool {
    let said = headers.get(CONTENT_TYPE);
    let said = said.and_then(|value| value.to_str().ok());
    let kind = said.and_then(|value| value.split(';').next());
    kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case(JSON))
}

/// A file of the page.
pub(super) fn asset(State(app): SharedApp, request: Request) -> Ready<Response> {
    let (head, _body) = request.into_parts();
    let is_read = matches!(head.method, Method::GET | Method::HEAD);
    let answered = app.assets.respond(head.uri.path(), &head.headers);
    ready(match answered {
        Some(file) if is_read => file,
        Some(_) => {
            let mut refused = app.wrong_method();
            let headers = refused.headers_mut();
            headers.insert(ALLOW, HeaderValue::from_static("GET,HEAD"));
            refused
        }
        None => app.not_found(),
    })
}

pub(super) fn wrong_method(State(app): SharedApp) -> Ready<Response> {
    ready(app.wrong_method())
}
