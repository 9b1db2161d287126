//! What programs ask for now and then.

use std::future::{Ready, ready};
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::rejection::{BytesRejection, PathRejection};
use axum::extract::{Path, Request, State};
use axum::http::header::{ALLOW, CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse as _, Response};
use tokio::io::AsyncReadExt as _;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::oneshot;
use tokio_util::io::ReaderStream;

use super::App;
use super::guard::refusal;
use super::hub_task::{Question, Subject};
use crate::command;
use crate::counts::Count;
use crate::limits::COMMANDS_PER_S;
use crate::metrics::CONTENT_TYPE as METRICS_TYPE;
use crate::model::{Accepted, RecordingRow};

/// What everybody is handed.
type Shared = State<Arc<App>>;
/// The name in a path, which need not be text.
type Named = Result<Path<String>, PathRejection>;

const JSON: &str = "application/json";

pub(super) async fn state(State(app): Shared) -> Response {
    app.text(Subject::State, JSON).await
}

pub(super) async fn robots(State(app): Shared) -> Response {
    app.text(Subject::Robots, JSON).await
}

pub(super) async fn sources(State(app): Shared) -> Response {
    app.text(Subject::Sources, JSON).await
}

pub(super) async fn parameters(State(app): Shared) -> Response {
    app.text(Subject::Parameters, JSON).await
}

pub(super) async fn metrics(State(app): Shared) -> Response {
    app.text(Subject::Metrics, METRICS_TYPE).await
}

pub(super) fn schema() -> Ready<Response> {
    ready(typed(JSON, include_str!("../../schema/v1.json").into()))
}

pub(super) async fn recordings(State(app): Shared) -> Response {
    let rows = app.recording_rows().await;
    typed(JSON, serde_json::to_string(&rows).unwrap_or_default().into())
}

/// A whole recording; of the one that is being written, what is there.
pub(super) async fn download(State(app): Shared, name: Named) -> Response {
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
    let mut response = typed("application/octet-stream", Body::from_stream(ReaderStream::new(file.take(bytes))));
    let headers = response.headers_mut();
    headers.insert(CONTENT_LENGTH, bytes.into());
    // The name is one of the folder's; what does not fit into a header the browser makes up itself.
    if let Ok(value) = HeaderValue::from_str(&format!("attachment; filename=\"{name}\"")) {
        headers.insert(CONTENT_DISPOSITION, value);
    }
    response
}

/// The trails of a recording, made by the same engine.
pub(super) async fn replay(State(app): Shared, name: Named) -> Response {
    let name = match name {
        Ok(Path(name)) => name,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    let Some(path) = app.recording_path(&name).await else {
        return app.no_recording();
    };
    let Ok(permit) = Arc::clone(&app.replaying).try_acquire_owned() else {
        app.counts.one(Count::ReplayBusy);
        let why = "another recording is being replayed; try again when it is done".to_owned();
        return refusal(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    let worker = Arc::clone(&app);
    let replayed = tokio::task::spawn_blocking(move || {
        let history = (worker.replay)(&path);
        // Held until here, even if whoever asked has gone.
        drop(permit);
        serde_json::to_string(&history?).map_err(|error| error.to_string())
    });
    match replayed.await {
        Ok(Ok(text)) => typed(JSON, text.into()),
        Ok(Err(why)) => refusal(StatusCode::UNPROCESSABLE_ENTITY, why),
        Err(_died) => refusal(
            StatusCode::INTERNAL_SERVER_ERROR,
            format!("the replay of `{name}` died; `posebridge replay` says more"),
        ),
    }
}

/// Hands a command to the engine; what becomes of it stands in the log.
pub(super) async fn command(State(app): Shared, headers: HeaderMap, body: Result<Bytes, BytesRejection>) -> Response {
    if !is_json(&headers) {
        let why = "a command has the header Content-Type: application/json".to_owned();
        return app.bad_request(StatusCode::UNSUPPORTED_MEDIA_TYPE, why);
    }
    let body = match body {
        Ok(body) => body,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    match app.give(&body) {
        Ok(name) => {
            let accepted = Accepted { accepted: name.to_owned() };
            (StatusCode::ACCEPTED, axum::Json(accepted)).into_response()
        }
        Err((status, why)) => refusal(status, why),
    }
}

/// Whether a body says that it is JSON; the words of a media type have no case (RFC 9110, section 8.3.1).
fn is_json(headers: &HeaderMap) -> bool {
    let said = headers.get(CONTENT_TYPE);
    let said = said.and_then(|value| value.to_str().ok());
    let kind = said.and_then(|value| value.split(';').next());
    kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case(JSON))
}

/// A file of the page.
pub(super) fn asset(State(app): Shared, request: Request) -> Ready<Response> {
    let (head, _body) = request.into_parts();
    let is_read = matches!(head.method, Method::GET | Method::HEAD);
    let answered = app.assets.answer(head.uri.path(), &head.headers);
    ready(match answered {
        Some(file) if is_read => file,
        Some(_) => {
            let mut refused = app.wrong_method();
            let headers = refused.headers_mut();
            headers.insert(ALLOW, HeaderValue::from_static("GET,HEAD"));
            refused
        }
        None => app.missing(),
    })
}

pub(super) fn wrong_method(State(app): Shared) -> Ready<Response> {
    ready(app.wrong_method())
}

impl App {
    /// Gives a command to the shard; its name, or why not.
    pub(super) fn give(&self, text: &[u8]) -> Result<&'static str, (StatusCode, String)> {
        let read = command::read(text).and_then(|(name, command)| {
            self.known.check(name, &command)?;
            Ok((name, command))
        });
        let (name, command) = read.map_err(|error| {
            self.counts.one(Count::BadCommand);
            (StatusCode::BAD_REQUEST, error.to_string())
        })?;
        if !self.command_rate.admits((self.clock)()) {
            self.counts.one(Count::CommandRate);
            let why = format!("more than {COMMANDS_PER_S} commands a second come to this station; try again");
            return Err((StatusCode::SERVICE_UNAVAILABLE, why));
        }
        match self.commands.try_send(command) {
            Ok(()) => {
                self.counts.one(Count::Commands);
                Ok(name)
            }
            Err(TrySendError::Full(_)) => {
                self.counts.one(Count::CommandsFull);
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
        // Without the hub nothing is being recorded any more.
        drop(self.questions.send(Question::Recording(reply)).await);
        let current = answer.await.ok().flatten();
        let recordings = self.recordings.clone();
        let listed = tokio::task::spawn_blocking(move || recordings.list(current.as_deref()));
        listed.await.unwrap_or_default()
    }

    async fn recording_path(&self, name: &str) -> Option<std::path::PathBuf> {
        let (recordings, name) = (self.recordings.clone(), name.to_owned());
        let looked = tokio::task::spawn_blocking(move || recordings.path(&name));
        looked.await.ok().flatten()
    }

    async fn text(&self, subject: Subject, kind: &'static str) -> Response {
        let (reply, answer) = oneshot::channel();
        drop(self.questions.send(Question::Text(subject, reply)).await);
        answer.await.map_or_else(
            |_gone| refusal(StatusCode::SERVICE_UNAVAILABLE, "the station is ending".to_owned()),
            |text| typed(kind, text.into()),
        )
    }

    /// Refuses a request that cannot be understood.
    pub(super) fn bad_request(&self, status: StatusCode, why: String) -> Response {
        self.counts.one(Count::BadRequest);
        refusal(status, why)
    }

    fn wrong_method(&self) -> Response {
        let why = "wrong method: commands are posted to /v1/commands, everything else is got".to_owned();
        self.bad_request(StatusCode::METHOD_NOT_ALLOWED, why)
    }

    fn no_recording(&self) -> Response {
        self.counts.one(Count::NotFound);
        let why = "there is no such recording; /v1/recordings lists them".to_owned();
        refusal(StatusCode::NOT_FOUND, why)
    }

    fn missing(&self) -> Response {
        self.counts.one(Count::NotFound);
        let why = "there is nothing here; docs/dashboard.md lists what there is".to_owned();
        refusal(StatusCode::NOT_FOUND, why)
    }
}

fn typed(kind: &'static str, body: Body) -> Response {
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}
