//! The HTTP and WebSocket server: access control, routes and limits.

mod accept;
mod admit;
mod app_state;
mod connection_slot;
mod guard;
mod hub_task;
mod rate;
mod rest;
mod stream;

pub(crate) use accept::serve;
pub(crate) use app_state::AppState;
pub(crate) use guard::RequestGuard;
pub(crate) use hub_task::{HubInputs, run_hub};
pub(crate) use rate::RateLimiter;

use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post};

use crate::limits::MAX_MESSAGE_BYTES;

/// All routes, behind the guard.
pub(crate) fn router(app: Arc<AppState>) -> Router {
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
        .layer(DefaultBodyLimit::max(MAX_MESSAGE_BYTES))
        .layer(from_fn_with_state(Arc::clone(&app), admit::admit))
        .with_state(app)
}
