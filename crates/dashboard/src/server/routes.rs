//! The routes of the server: access control, the REST endpoints and the files of the page.

use std::future::{Ready, ready};
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::rejection::{BytesRejection, PathRejection};
use axum::extract::{DefaultBodyLimit, Path, Request, State};
use axum::http::header::{
    ACCEPT, ALLOW, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE, REFERRER_POLICY,
    SET_COOKIE, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{Html, IntoResponse as _, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Extension, Router};
use hyper::body::{Frame, SizeHint};
use tokio::io::AsyncReadExt as _;
use tokio::time::timeout;
use tokio_util::io::ReaderStream;

use super::app_state::{AppState, NO_FLEET, SubmittedCommand, refusal_response, with_content_type};
use super::connection_table::{ConnectionSlot, OpenRequest};
use super::guard::RequestAdmission;
use super::hub_task::{Topic, to_json};
use super::stream;
use crate::cameras::media_type;
use crate::counters::ServerCounter;
use crate::limits::{MAX_MESSAGE_BYTES, REPLAY_TIMEOUT, REQUEST_TIMEOUT};
use crate::metrics;
use crate::model::Accepted;

type SharedApp = State<Arc<AppState>>;
/// May be invalid UTF-8.
type RecordingName = Result<Path<String>, PathRejection>;

const JSON: &str = "application/json";
const NO_RECORDING: &str = "there is no such recording; /v1/recordings lists them";

/// Scripts, styles, images and connections of this station only, and no embedding in a frame.
const CONTENT_POLICY: &str = "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// For a browser without the token; the policy above permits no style of its own.
const NO_TOKEN_PAGE: &str = include_str!("no_token.html");

pub(crate) fn router(app: Arc<AppState>) -> Router {
    Router::new()
        .route("/v1/stream", get(stream::open))
        .route("/v1/state", text(|hub, counts| to_json(&hub.state(counts)), JSON))
        .route("/v1/robots", text(|hub, _| to_json(&hub.robots()), JSON))
        .route("/v1/sources", text(|hub, _| to_json(&hub.sources()), JSON))
        .route("/v1/parameters", text(|hub, _| to_json(&hub.parameters()), JSON))
        .route("/v1/cameras", get(cameras))
        .route("/v1/cameras/{link}/picture", get(picture))
        .route("/v1/fleet", get(fleet))
        .route("/v1/recordings", get(recordings))
        .route("/v1/recordings/{name}", get(download))
        .route("/v1/recordings/{name}/replay", get(replay))
        .route("/v1/commands", post(command))
        .route("/v1/schema.json", get(schema))
        .route("/metrics", get(metrics_page))
        .fallback(asset)
        .method_not_allowed_fallback(wrong_method)
        .layer(DefaultBodyLimit::max(MAX_MESSAGE_BYTES))
        .layer(from_fn_with_state(Arc::clone(&app), admit))
        .with_state(app)
}

fn text(topic: Topic, kind: &'static str) -> MethodRouter<Arc<AppState>> {
    get(move |State(app): SharedApp| async move { app.text(topic, kind, "").await })
}

/// Checks and routes a request; every response gets security headers for browsers.
async fn admit(State(app): State<Arc<AppState>>, mut request: Request, next: Next) -> Response {
    let admitted = app.guard.check(&request);
    let mut response = match admitted {
        Ok(admission) => {
            let connection = request.extensions().get::<Arc<ConnectionSlot>>();
            let open = connection.map(|connection| connection.begin_request(admission.grant));
            request.extensions_mut().insert(admission.clone());
            let limit = if request.uri().path().ends_with("/replay") { REPLAY_TIMEOUT } else { REQUEST_TIMEOUT };
            let answer = timeout(limit, next.run(request)).await;
            let mut response = answer.unwrap_or_else(|_too_slow| {
                app.counts.increment(ServerCounter::BadRequest);
                let why = "the request took too long".to_owned();
                refusal_response(StatusCode::REQUEST_TIMEOUT, why)
            });
            if let Some(cookie) = admission.cookie {
                response.headers_mut().insert(SET_COOKIE, cookie);
            }
            response.map(|body| Body::new(OpenBody { body, _open: open }))
        }
        Err(denial) => {
            app.counts.increment(denial.count);
            if denial.status == StatusCode::UNAUTHORIZED && accepts_page(request.headers()) {
                (denial.status, Html(NO_TOKEN_PAGE)).into_response()
            } else {
                refusal_response(denial.status, denial.why)
            }
        }
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, CONTENT_POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

/// A body whose connection is in use until it was sent.
struct OpenBody {
    body: Body,
    _open: Option<OpenRequest>,
}

impl HttpBody for OpenBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

fn accepts_page(headers: &HeaderMap) -> bool {
    let mut accepted = headers.get_all(ACCEPT).iter();
    accepted.any(|value| {
        let value = value.to_str().unwrap_or_default();
        value.to_ascii_lowercase().contains("text/html")
    })
}

fn schema() -> Ready<Response> {
    ready(with_content_type(JSON, include_str!("../../schema/v1.json").into()))
}

fn cameras(State(app): SharedApp) -> Ready<Response> {
    let now = (app.clock)();
    let rows: Vec<_> = app.cameras.iter().map(|camera| camera.row(now)).collect();
    ready(with_content_type(JSON, to_json(&rows).into()))
}

fn picture(State(app): SharedApp, link: Result<Path<u16>, PathRejection>) -> Ready<Response> {
    let camera = link.ok().and_then(|Path(link)| app.cameras.iter().find(|camera| camera.link.0 == link));
    ready(match camera.and_then(|camera| (camera.bytes)()) {
        Some(bytes) => with_content_type(media_type(&bytes), Bytes::from_owner(bytes).into()),
        None => app.not_found("there is no such picture; /v1/cameras lists the cameras"),
    })
}

fn fleet(State(app): SharedApp) -> Ready<Response> {
    ready(match &app.fleet {
        Some(fleet) => with_content_type(JSON, to_json(&(fleet.state)()).into()),
        None => app.not_found(NO_FLEET),
    })
}

async fn metrics_page(State(app): SharedApp) -> Response {
    let fleet = app.fleet.as_ref().map(|fleet| metrics::fleet_part(&(fleet.state)()));
    app.text(metrics::page, metrics::CONTENT_TYPE, &fleet.unwrap_or_default()).await
}

async fn recordings(State(app): SharedApp) -> Response {
    let rows = app.recording_rows().await;
    with_content_type(JSON, serde_json::to_string(&rows).unwrap_or_default().into())
}

/// The name and the path of a recording, or the status and reason of a refusal.
async fn recording(app: &AppState, name: RecordingName) -> Result<(String, PathBuf), (StatusCode, String)> {
    let Path(name) = name.map_err(|error| {
        app.counts.increment(ServerCounter::BadRequest);
        (error.status(), error.body_text())
    })?;
    let path = app.recording_path(&name).await.ok_or_else(|| {
        app.counts.increment(ServerCounter::NotFound);
        (StatusCode::NOT_FOUND, NO_RECORDING.to_owned())
    })?;
    Ok((name, path))
}

/// Of the current recording, the part written so far.
async fn download(State(app): SharedApp, name: RecordingName) -> Response {
    let (name, path) = match recording(&app, name).await {
        Ok(found) => found,
        Err((status, why)) => return refusal_response(status, why),
    };
    let opened = async {
        let file = tokio::fs::File::open(&path).await?;
        let bytes = file.metadata().await?.len();
        Ok::<_, std::io::Error>((file, bytes))
    };
    let Ok((file, bytes)) = opened.await else {
        return app.not_found(NO_RECORDING);
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

async fn replay(State(app): SharedApp, name: RecordingName) -> Response {
    let (name, path) = match recording(&app, name).await {
        Ok(found) => found,
        Err((status, why)) => return refusal_response(status, why),
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

/// The log shows the result; that of a command for a robot of another station is the answer.
async fn command(
    State(app): SharedApp,
    Extension(admission): Extension<RequestAdmission>,
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
    let submitted = match app.submit_command(admission.role, &body) {
        Ok(SubmittedCommand::Own(name)) => Ok(name),
        Ok(SubmittedCommand::Fleet(pending)) => pending.answer().await,
        Err(rejection) => Err(rejection),
    };
    match submitted {
        Ok(name) => {
            let accepted = Accepted { accepted: name.to_owned() };
            (StatusCode::ACCEPTED, axum::Json(accepted)).into_response()
        }
        Err((status, why)) => refusal_response(status, why),
    }
}

/// Whether the body's media type is JSON; media types are case-insensitive (RFC 9110, section 8.3.1).
fn is_json(headers: &HeaderMap) -> bool {
    let content_type = headers.get(CONTENT_TYPE);
    let content_type = content_type.and_then(|value| value.to_str().ok());
    let kind = content_type.and_then(|value| value.split(';').next());
    kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case(JSON))
}

fn asset(State(app): SharedApp, request: Request) -> Ready<Response> {
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
        None => app.not_found("there is nothing here; docs/dashboard.md lists what there is"),
    })
}

fn wrong_method(State(app): SharedApp) -> Ready<Response> {
    ready(app.wrong_method())
}
