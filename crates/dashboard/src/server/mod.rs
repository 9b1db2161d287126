//! The HTTP and WebSocket server: access control, routes and limits.

mod accept;
mod app_state;
mod connection_table;
mod guard;
mod hub_task;
mod routes;
mod stream;

pub(crate) use accept::serve;
pub(crate) use app_state::{AppState, RateLimiter};
pub(crate) use connection_table::ConnectionTable;
pub(crate) use guard::RequestGuard;
pub(crate) use hub_task::{HubInputs, run_hub};
pub(crate) use routes::router;
