//! Who may come in.
//!
//! On loopback everybody on this computer may, but not the page of a foreign origin that a browser has open: a request must name this
//! station as its Host (so that a foreign name that was made to point here is refused), and its Origin, if it has one, must be the
//! same. Reached from other computers the station asks for its token as well.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr as _;
use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::header::{
    ACCEPT, AUTHORIZATION, CONTENT_SECURITY_POLICY, COOKIE, HOST, ORIGIN, REFERRER_POLICY, SET_COOKIE,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{Html, IntoResponse as _, Response};
use tokio::time::timeout;

use super::App;
use crate::counts::Count;
use crate::limits::{REPLAY_TIMEOUT, REQUEST_TIMEOUT};
use crate::model::Refusal;
use crate::token::Token;

/// Scripts, styles, images and connections of this station only, and nobody may put the page into a frame.
const POLICY: &str = "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The port of a Host that names none.
const HTTP_PORT: u16 = 80;

/// What a browser without the token shows; the policy above lets it have no style of its own.
const NO_TOKEN_PAGE: &str = include_str!("no_token.html");

/// What is asked of whoever comes.
#[derive(Debug)]
pub(crate) struct Guard {
    address: SocketAddr,
    token: Option<Token>,
}

/// Why somebody was refused.
#[derive(Debug, PartialEq, Eq)]
struct Denial {
    count: Count,
    status: StatusCode,
    why: String,
}

/// What an admitted request leads to.
#[derive(Debug, PartialEq, Eq)]
enum Admission {
    /// The answer.
    Plain,
    /// The answer, and a cookie with the token that stood in the address.
    WithCookie,
}

/// Lets a request through or refuses it; every answer gets the headers that keep a browser careful.
pub(super) async fn admit(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let admitted = app.guard.check(&request);
    let mut response = match admitted {
        Ok(admission) => {
            let patience = if request.uri().path().ends_with("/replay") { REPLAY_TIMEOUT } else { REQUEST_TIMEOUT };
            let answer = timeout(patience, next.run(request)).await;
            let mut response = answer.unwrap_or_else(|_too_slow| {
                app.counts.one(Count::BadRequest);
                let why = "the request took too long".to_owned();
                refusal(StatusCode::REQUEST_TIMEOUT, why)
            });
            if let (Admission::WithCookie, Some(cookie)) = (admission, app.guard.cookie()) {
                response.headers_mut().insert(SET_COOKIE, cookie);
            }
            response
        }
        Err(denial) => {
            app.counts.one(denial.count);
            if denial.status == StatusCode::UNAUTHORIZED && wants_page(request.headers()) {
                (denial.status, Html(NO_TOKEN_PAGE)).into_response()
            } else {
                refusal(denial.status, denial.why)
            }
        }
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

/// Whether somebody looks at the answer in a browser.
fn wants_page(headers: &HeaderMap) -> bool {
    let mut accepted = headers.get_all(ACCEPT).iter();
    accepted.any(|value| {
        let value = value.to_str().unwrap_or_default();
        value.to_ascii_lowercase().contains("text/html")
    })
}

/// A refusal as JSON.
pub(super) fn refusal(status: StatusCode, error: String) -> Response {
    (status, Json(Refusal { error })).into_response()
}

impl Guard {
    pub(crate) const fn new(address: SocketAddr, token: Option<Token>) -> Self {
        Self { address, token }
    }

    fn check(&self, request: &Request) -> Result<Admission, Denial> {
        let headers = request.headers();
        let host = self.checked_host(headers)?;
        let authority = request.uri().authority();
        if authority.is_some_and(|named| !named.as_str().eq_ignore_ascii_case(&host)) {
            return Err(self.wrong_host(request.uri().to_string().as_str()));
        }
        check_origin(headers, &host)?;
        check_site(request)?;
        self.check_token(request, &host)
    }

    /// The one Host of a request, if it is this station.
    fn checked_host(&self, headers: &HeaderMap) -> Result<String, Denial> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|host| host.to_str().ok());
        let (Some(host), None) = (host, hosts.next()) else {
            return Err(self.wrong_host("missing or there more than once"));
        };
        let is_right = Authority::from_str(host).is_ok_and(|named| self.is_here(&named));
        if is_right { Ok(host.to_ascii_lowercase()) } else { Err(self.wrong_host(host)) }
    }

    fn is_here(&self, named: &Authority) -> bool {
        if named.as_str().contains('@') {
            return false;
        }
        // From elsewhere this computer may have any name; there the token decides.
        let is_port = named.port_u16().unwrap_or(HTTP_PORT) == self.address.port();
        !self.address.ip().is_loopback() || (is_port && is_loopback(named.host()))
    }

    fn wrong_host(&self, found: &str) -> Denial {
        let found: String = found.chars().filter(|c| !c.is_control()).take(80).collect();
        Denial {
            count: Count::WrongHost,
            status: StatusCode::MISDIRECTED_REQUEST,
            why: if self.address.ip().is_unspecified() {
                format!("the Host `{found}` is not this station; open the address that it printed")
            } else {
                let address = self.address;
                format!("the Host `{found}` is not this station; open http://{address}/")
            },
        }
    }

    fn check_token(&self, request: &Request, host: &str) -> Result<Admission, Denial> {
        let Some(token) = &self.token else {
            return Ok(Admission::Plain);
        };
        let headers = request.headers();
        let bearer = headers.get(AUTHORIZATION);
        let bearer = bearer.and_then(|value| value.to_str().ok()?.split_once(' '));
        // The name of a scheme has no case (RFC 9110, section 11.1).
        if bearer.is_some_and(|(scheme, said)| scheme.eq_ignore_ascii_case("bearer") && token.is(said.trim())) {
            return Ok(Admission::Plain);
        }
        let name = self.cookie_name();
        if cookies(headers, &name).any(|said| token.is(said)) {
            return Ok(Admission::Plain);
        }
        let query = request.uri().query().unwrap_or_default();
        let mut pairs = query.split('&').filter_map(|pair| pair.split_once('='));
        if pairs.any(|(key, said)| key == "token" && token.is(said)) {
            return Ok(Admission::WithCookie);
        }
        Err(Denial {
            count: Count::WrongToken,
            status: StatusCode::UNAUTHORIZED,
            why: format!(
                "this station wants the token that it printed when it started: http://{host}/?token=TOKEN, or the header \
                 Authorization: Bearer TOKEN"
            ),
        })
    }

    /// Cookies know no port, so the name has it: two stations of one computer have one each.
    fn cookie_name(&self) -> String {
        format!("posebridge_{}", self.address.port())
    }

    fn cookie(&self) -> Option<HeaderValue> {
        let token = self.token.as_ref()?.expose();
        let name = self.cookie_name();
        let cookie = format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict");
        HeaderValue::from_str(&cookie).ok()
    }
}

fn is_loopback(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    host.eq_ignore_ascii_case("localhost") || bare.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

/// An Origin, if there is one, is this station's own. Behind a proxy it may be https.
fn check_origin(headers: &HeaderMap, host: &str) -> Result<(), Denial> {
    let own = [format!("http://{host}"), format!("https://{host}")];
    for origin in headers.get_all(ORIGIN) {
        let origin = origin.to_str().unwrap_or_default();
        if !own.iter().any(|own| own.eq_ignore_ascii_case(origin)) {
            return Err(foreign());
        }
    }
    Ok(())
}

/// A browser says whose page a request comes from even where it names no Origin, as for an image (Fetch Metadata, W3C). A foreign page may
/// lead somebody to the page of this station, and to nothing else of it: a replay takes a core for seconds.
fn check_site(request: &Request) -> Result<(), Denial> {
    let headers = request.headers();
    let said = |name: &str| headers.get(name).map(HeaderValue::as_bytes);
    let is_own = |site: &[u8]| [&b"same-origin"[..], b"none"].contains(&site);
    if said("sec-fetch-site").is_none_or(is_own) {
        return Ok(());
    }
    let says = |name: &str, word: &[u8]| said(name) == Some(word);
    let is_visit = says("sec-fetch-mode", b"navigate")
        && says("sec-fetch-dest", b"document")
        && request.method() == Method::GET
        && !request.uri().path().starts_with("/v1/");
    if is_visit { Ok(()) } else { Err(foreign()) }
}

fn foreign() -> Denial {
    Denial {
        count: Count::WrongOrigin,
        status: StatusCode::FORBIDDEN,
        why: "pages of another origin may not use this station".to_owned(),
    }
}

/// The values of all cookies of this name.
fn cookies<'a>(headers: &'a HeaderMap, name: &'a str) -> impl Iterator<Item = &'a str> {
    let lines = headers.get_all(COOKIE).iter();
    let lines = lines.filter_map(|line| line.to_str().ok());
    let pairs = lines.flat_map(|line| line.split(';'));
    pairs.filter_map(move |pair| {
        let (key, value) = pair.trim().split_once('=')?;
        (key == name).then_some(value)
    })
}

#[cfg(test)]
mod tests;
