//! The middleware of every route: the guard, a timeout, and the headers that restrict a browser.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{ACCEPT, CONTENT_SECURITY_POLICY, REFERRER_POLICY, SET_COOKIE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{Html, IntoResponse as _, Response};
use tokio::time::timeout;

use super::app_state::{AppState, refusal_response};
use super::guard::RequestAdmission;
use crate::counters::ServerCounter;
use crate::limits::{REPLAY_TIMEOUT, REQUEST_TIMEOUT};

/// Scripts, styles, images and connections of this station only, and no embedding in a frame.
const CONTENT_POLICY: &str = "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The page for a browser without the token; the policy above allows it no style of its own.
const NO_TOKEN_PAGE: &str = include_str!("no_token.html");

/// Checks a request and runs or rejects it; every response gets the headers that restrict a browser.
pub(super) async fn admit(State(app): State<Arc<AppState>>, request: Request, next: Next) -> Response {
    let admitted = app.guard.check(&request);
    let mut response = match admitted {
        Ok(admission) => {
            let patience = if request.uri().path().ends_with("/replay") { REPLAY_TIMEOUT } else { REQUEST_TIMEOUT };
            let answer = timeout(patience, next.run(request)).await;
            let mut response = answer.unwrap_or_else(|_too_slow| {
                app.counts.increment(ServerCounter::BadRequest);
                let why = "the request took too long".to_owned();
                refusal_response(StatusCode::REQUEST_TIMEOUT, why)
            });
            if let (RequestAdmission::WithCookie, Some(cookie)) = (admission, app.guard.cookie()) {
                response.headers_mut().insert(SET_COOKIE, cookie);
            }
            response
        }
        Err(denial) => {
            app.counts.increment(denial.count);
            if denial.status == StatusCode::UNAUTHORIZED && wants_page(request.headers()) {
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

/// Whether the client is a browser that shows a page.
fn wants_page(headers: &HeaderMap) -> bool {
    let mut accepted = headers.get_all(ACCEPT).iter();
    accepted.any(|value| {
        let value = value.to_str().unwrap_or_default();
        value.to_ascii_lowercase().contains("text/html")
    })
}
