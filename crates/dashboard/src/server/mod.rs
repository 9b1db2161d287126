//! HTTP and WebSocket: who may come in, what is served, and how much of it.

mod accept;
mod guard;
mod hub_task;
mod rate;
mod rest;
mod seat;
mod stream;

pub(crate) use accept::serve;
pub(crate) use guard::Guard;
pub(crate) use hub_task::{Inlets, Question, run_hub};
pub(crate) use rate::Rate;

use std::path::Path;
use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post};
use posebridge_telemetry::{Command, HostClock, Stamp};
use tokio::sync::{Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

use crate::assets::Assets;
use crate::command::Known;
use crate::counts::Counts;
use crate::limits::MESSAGE_BYTES;
use crate::model::Frame;
use crate::recordings::Recordings;

/// Runs a recording through the engine and gives its trails, or says in a line why not.
pub(crate) type Replay = dyn Fn(&Path) -> Result<Frame, String> + Send + Sync;

/// The session's clock.
pub(crate) type Clock = dyn Fn() -> Stamp<HostClock> + Send + Sync;

/// What every request may need.
pub(crate) struct App {
    pub(crate) guard: Guard,
    pub(crate) counts: Arc<Counts>,
    pub(crate) questions: mpsc::Sender<Question>,
    pub(crate) commands: mpsc::Sender<Command>,
    /// How fast commands may come, from everybody together.
    pub(crate) command_rate: Rate,
    /// What commands may name.
    pub(crate) known: Known,
    pub(crate) clock: Arc<Clock>,
    pub(crate) recordings: Recordings,
    pub(crate) assets: Assets,
    pub(crate) replay: Box<Replay>,
    /// One replay at a time: it takes a core.
    pub(crate) replaying: Arc<Semaphore>,
    /// Places for readers of the stream.
    pub(crate) readers: Arc<Semaphore>,
    pub(crate) stop: CancellationToken,
}

/// All routes, behind the guard.
pub(crate) fn router(app: Arc<App>) -> Router {
    Router::new()
        .route("/v1/stream", get(stream::open))
        .route("/v1/state", get(rest::state))
        .route("/v1/robots", get(rest::robots))
        .route("/v1/sources", get(rest::sources))
        .route("/v1/parameters", get(rest::parameters))
        .route("/v1/recordings", get(rest::recordings))
        .route("/v1/recordings/{name}", get(rest::download))
        .route("/v1/recordings/{name}/replay", get(rest::replay))
        .route("/v1/commands", post(rest::command))
        .route("/v1/schema.json", get(rest::schema))
        .route("/metrics", get(rest::metrics))
        .fallback(rest::asset)
        .method_not_allowed_fallback(rest::wrong_method)
        .layer(DefaultBodyLimit::max(MESSAGE_BYTES))
        .layer(from_fn_with_state(Arc::clone(&app), guard::admit))
        .with_state(app)
}
