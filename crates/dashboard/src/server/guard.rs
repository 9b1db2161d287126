//! Access control of requests.
//!
//! On loopback every local program has access, but not the page of a foreign origin that a browser has open: a request
//! must name this station as its Host, which stops DNS rebinding, and its Origin, if it has one, must be the same. From
//! other computers, and through a proxy, the station requires a token as well, which says what its owner may do.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr as _;
use std::sync::Arc;

use axum::extract::Request;
use axum::http::header::{AUTHORIZATION, COOKIE, HOST, ORIGIN};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};

use crate::counters::ServerCounter;
use crate::token::{AccessRole, GrantId, TokenTable};

/// Default of a Host header.
const HTTP_PORT: u16 = 80;

/// What proxies add to a request that they pass on.
const PROXY_HEADERS: [&str; 6] =
    ["forwarded", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip", "via"];

#[derive(Debug)]
pub(crate) struct RequestGuard {
    address: SocketAddr,
    /// Under which a proxy serves this station; with any port if there is none in a name.
    public_names: Vec<Authority>,
    /// `None` if everybody who can connect is an operator.
    tokens: Option<Arc<TokenTable>>,
}

#[derive(Debug, PartialEq, Eq)]
pub(super) struct RequestDenial {
    pub(super) count: ServerCounter,
    pub(super) status: StatusCode,
    pub(super) why: String,
}

/// What a request may do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct RequestAdmission {
    pub(super) role: AccessRole,
    /// Of the token that it showed.
    pub(super) grant: Option<GrantId>,
    /// To be set with the response: the token from the URL.
    pub(super) cookie: Option<HeaderValue>,
}

impl RequestGuard {
    /// `public_names` are hosts, each perhaps with a port; those that are none were refused with the configuration.
    pub(crate) fn new(address: SocketAddr, public_names: &[String], tokens: Option<Arc<TokenTable>>) -> Self {
        let public_names = public_names.iter().filter_map(|name| Authority::from_str(name).ok()).collect();
        Self { address, public_names, tokens }
    }

    pub(super) fn check(&self, request: &Request) -> Result<RequestAdmission, RequestDenial> {
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

    /// The only Host header, if it names this station.
    fn checked_host(&self, headers: &HeaderMap) -> Result<String, RequestDenial> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|host| host.to_str().ok());
        let (Some(host), None) = (host, hosts.next()) else {
            return Err(self.wrong_host("missing or there more than once"));
        };
        let is_right = Authority::from_str(host).is_ok_and(|named| self.is_own_host(&named));
        if is_right { Ok(host.to_ascii_lowercase()) } else { Err(self.wrong_host(host)) }
    }

    fn is_own_host(&self, named: &Authority) -> bool {
        if named.as_str().contains('@') {
            return false;
        }
        // From other computers this one may have any name; there the token decides.
        let is_port = named.port_u16().unwrap_or(HTTP_PORT) == self.address.port();
        !self.address.ip().is_loopback() || (is_port && is_loopback(named.host())) || self.is_public_name(named)
    }

    fn is_public_name(&self, named: &Authority) -> bool {
        let mut names = self.public_names.iter();
        names.any(|name| {
            name.host().eq_ignore_ascii_case(named.host())
                && name.port_u16().is_none_or(|port| named.port_u16() == Some(port))
        })
    }

    fn wrong_host(&self, found: &str) -> RequestDenial {
        let found: String = found.chars().filter(|c| !c.is_control()).take(80).collect();
        RequestDenial {
            count: ServerCounter::WrongHost,
            status: StatusCode::MISDIRECTED_REQUEST,
            why: if self.address.ip().is_unspecified() {
                format!("the Host `{found}` is not this station; open the address that it printed")
            } else {
                let address = self.address;
                format!("the Host `{found}` is not this station; open http://{address}/")
            },
        }
    }

    fn check_token(&self, request: &Request, host: &str) -> Result<RequestAdmission, RequestDenial> {
        let headers = request.headers();
        let Some(tokens) = &self.tokens else {
            if PROXY_HEADERS.iter().any(|name| headers.contains_key(*name)) {
                return Err(unknown_proxy_denial());
            }
            return Ok(RequestAdmission { role: AccessRole::Operator, grant: None, cookie: None });
        };
        let admitted = |(grant, role)| RequestAdmission { role, grant: Some(grant), cookie: None };
        let bearer = headers.get(AUTHORIZATION);
        let bearer = bearer.and_then(|value| value.to_str().ok()?.split_once(' '));
        // The name of a scheme is case-insensitive (RFC 9110, section 11.1).
        let bearer = bearer.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"));
        if let Some(found) = bearer.and_then(|(_, candidate)| tokens.find(candidate.trim())) {
            return Ok(admitted(found));
        }
        // Before the cookie: somebody may open an address with another role than the last one.
        let query = request.uri().query().unwrap_or_default();
        let mut pairs = query.split('&').filter_map(|pair| pair.split_once('='));
        let shown =
            pairs.find_map(|(key, candidate)| Some((candidate, tokens.find(candidate).filter(|_| key == "token")?)));
        if let Some((token, found)) = shown {
            return Ok(RequestAdmission { cookie: self.cookie(token, headers), ..admitted(found) });
        }
        let name = self.cookie_name();
        if let Some(found) = cookies(headers, &name).find_map(|candidate| tokens.find(candidate)) {
            return Ok(admitted(found));
        }
        Err(RequestDenial {
            count: ServerCounter::WrongToken,
            status: StatusCode::UNAUTHORIZED,
            why: format!(
                "this station wants a token, such as the one that it printed when it started: http://{host}/?token=TOKEN, or the \
                 header Authorization: Bearer TOKEN"
            ),
        })
    }

    /// Cookies are not separated by port, so the port is in the name: two stations on one computer have different
    /// cookies.
    fn cookie_name(&self) -> String {
        format!("posebridge_{}", self.address.port())
    }

    /// A cookie with a valid token. What came over TLS is not sent again without: a proxy tells, and who lies about it has a useless cookie.
    fn cookie(&self, token: &str, headers: &HeaderMap) -> Option<HeaderValue> {
        let name = self.cookie_name();
        let is_secure = headers.get("x-forwarded-proto").is_some_and(|value| value.as_bytes() == b"https");
        let secure = if is_secure { "; Secure" } else { "" };
        let cookie = format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict{secure}");
        HeaderValue::from_str(&cookie).ok()
    }
}

fn is_loopback(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    host.eq_ignore_ascii_case("localhost") || bare.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

/// An Origin header, if present, must name this station. Behind a proxy it may be https.
fn check_origin(headers: &HeaderMap, host: &str) -> Result<(), RequestDenial> {
    let own = [format!("http://{host}"), format!("https://{host}")];
    for origin in headers.get_all(ORIGIN) {
        let origin = origin.to_str().unwrap_or_default();
        if !own.iter().any(|own| own.eq_ignore_ascii_case(origin)) {
            return Err(foreign_origin_denial());
        }
    }
    Ok(())
}

/// A browser reports the site of the page that makes a request, even where there is no Origin, as for an image (Fetch
/// Metadata, W3C). A foreign page may link to the page of this station, and to nothing else: a replay takes a core for
/// seconds.
fn check_site(request: &Request) -> Result<(), RequestDenial> {
    let headers = request.headers();
    let header = |name: &str| headers.get(name).map(HeaderValue::as_bytes);
    let is_own = |site: &[u8]| [&b"same-origin"[..], b"none"].contains(&site);
    if header("sec-fetch-site").is_none_or(is_own) {
        return Ok(());
    }
    let is_value = |name: &str, word: &[u8]| header(name) == Some(word);
    let is_visit = is_value("sec-fetch-mode", b"navigate")
        && is_value("sec-fetch-dest", b"document")
        && request.method() == Method::GET
        && !request.uri().path().starts_with("/v1/");
    if is_visit { Ok(()) } else { Err(foreign_origin_denial()) }
}

fn unknown_proxy_denial() -> RequestDenial {
    RequestDenial {
        count: ServerCounter::UnknownProxy,
        status: StatusCode::FORBIDDEN,
        why: "a proxy passed this request on, and this station asks for no token: write the proxy's public name into \
              `dashboard.public_names` (docs/dashboard.md)"
            .to_owned(),
    }
}

fn foreign_origin_denial() -> RequestDenial {
    RequestDenial {
        count: ServerCounter::WrongOrigin,
        status: StatusCode::FORBIDDEN,
        why: "pages of another origin may not use this station".to_owned(),
    }
}

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
mod tests {
    use super::*;

    use axum::body::Body;

    use crate::token::{AccessToken, TokenGrant};

    fn guard(token: Option<&AccessToken>) -> RequestGuard {
        let ip = if token.is_some() { "192.0.2.7" } else { "127.0.0.1" };
        let grant = |token: &AccessToken| TokenGrant { token: token.clone(), role: AccessRole::Reader };
        let tokens = token.map(|token| Arc::new(TokenTable::new(vec![grant(token)])));
        RequestGuard::new(format!("{ip}:4680").parse().unwrap(), &[], tokens)
    }

    fn request(path: &str, headers: &[(&str, &str)]) -> Request {
        let mut request = Request::builder().uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        request.body(Body::empty()).unwrap()
    }

    fn refused(guard: &RequestGuard, path: &str, headers: &[(&str, &str)]) -> Option<ServerCounter> {
        guard.check(&request(path, headers)).err().map(|denial| denial.count)
    }

    #[test]
    fn only_a_host_of_this_computer_with_the_right_port_is_this_station() {
        let guard = guard(None);
        for host in ["127.0.0.1:4680", "localhost:4680", "LocalHost:4680", "[::1]:4680", "127.1.2.3:4680"] {
            assert_eq!(refused(&guard, "/", &[("host", host)]), None, "{host}");
        }
        for host in [
            "evil.example:4680",
            "localhost",
            "localhost:80",
            "localhost:4681",
            "127.0.0.1.evil.example:4680",
            "localhost.:4680",
            "192.0.2.7:4680",
            "user@localhost:4680",
            "",
            "localhost:4680/",
        ] {
            let refused = refused(&guard, "/", &[("host", host)]);
            assert_eq!(refused, Some(ServerCounter::WrongHost), "{host}");
        }
        assert_eq!(refused(&guard, "/", &[]), Some(ServerCounter::WrongHost));
        let twice = [("host", "localhost:4680"), ("host", "evil.example")];
        assert_eq!(refused(&guard, "/", &twice), Some(ServerCounter::WrongHost));
        let host = [("host", "localhost:4680")];
        assert_eq!(refused(&guard, "http://localhost:4680/", &host), None);
        let other = refused(&guard, "http://evil.example/", &host);
        assert_eq!(other, Some(ServerCounter::WrongHost));
    }

    #[test]
    fn an_origin_must_be_the_station_itself() {
        let guard = guard(None);
        let with = |origin: &str| {
            let headers = [("host", "localhost:4680"), ("origin", origin)];
            refused(&guard, "/v1/stream", &headers)
        };
        assert_eq!(with("http://localhost:4680"), None);
        for origin in [
            "http://evil.example",
            "null",
            "http://localhost:4681",
            "http://127.0.0.1:4680",
            "http://localhost:4680.evil.example",
            "",
        ] {
            assert_eq!(with(origin), Some(ServerCounter::WrongOrigin), "{origin}");
        }
    }

    #[test]
    fn a_foreign_page_may_lead_to_the_page_and_load_nothing() {
        let guard = guard(None);
        let with = |path: &str, site: &str, mode: &str, dest: &str| {
            let headers = [
                ("host", "localhost:4680"),
                ("sec-fetch-site", site),
                ("sec-fetch-mode", mode),
                ("sec-fetch-dest", dest),
            ];
            refused(&guard, path, &headers)
        };
        let replay = "/v1/recordings/recording.mcap/replay";
        for site in ["same-origin", "none"] {
            assert_eq!(with(replay, site, "cors", "empty"), None, "{site}");
        }
        for site in ["cross-site", "same-site", "of-tomorrow"] {
            assert_eq!(with("/", site, "navigate", "document"), None, "{site}");
            for (path, mode, dest) in [
                (replay, "no-cors", "image"),
                (replay, "navigate", "document"),
                ("/", "no-cors", "script"),
                ("/", "navigate", "iframe"),
            ] {
                let refused = with(path, site, mode, dest);
                assert_eq!(refused, Some(ServerCounter::WrongOrigin), "{site} {mode} {dest}");
            }
        }
    }

    #[test]
    fn from_elsewhere_the_token_is_needed_in_one_of_three_places() {
        let token = AccessToken::random().unwrap();
        let other = AccessToken::random().unwrap();
        let guard = guard(Some(&token));
        let host = ("host", "brick-station.lan:4680");
        assert_eq!(refused(&guard, "/", &[host]), Some(ServerCounter::WrongToken));
        let bearer = |token: &AccessToken| format!("Bearer {}", token.expose());
        let with = |name, value: &str| refused(&guard, "/", &[host, (name, value)]);
        assert_eq!(with("authorization", &bearer(&token)), None);
        assert_eq!(with("authorization", &bearer(&token).to_lowercase()), None);
        let basic = bearer(&token).replace("Bearer", "Basic");
        assert_eq!(with("authorization", &basic), Some(ServerCounter::WrongToken));
        assert_eq!(with("authorization", &bearer(&other)), Some(ServerCounter::WrongToken));
        assert_eq!(with("authorization", token.expose()), Some(ServerCounter::WrongToken));
        let cookie = |token: &AccessToken| format!("theme=dark; posebridge_4680={}", token.expose());
        assert_eq!(with("cookie", &cookie(&token)), None);
        assert_eq!(with("cookie", &cookie(&other)), Some(ServerCounter::WrongToken));
        let by_query = format!("/?theme=dark&token={}", token.expose());
        let admitted = guard.check(&request(&by_query, &[host])).unwrap();
        assert_eq!(admitted.role, AccessRole::Reader);
        let cookie = admitted.cookie.unwrap();
        let cookie = cookie.to_str().unwrap();
        let (value, attributes) = cookie.split_once("; ").unwrap();
        assert_eq!(attributes, "Path=/; HttpOnly; SameSite=Strict");
        assert_eq!(with("cookie", value), None);
        // A foreign page has the browser's cookie, but its own origin.
        let foreign = [host, ("cookie", value), ("origin", "http://evil.example")];
        assert_eq!(refused(&guard, "/", &foreign), Some(ServerCounter::WrongOrigin));
    }

    #[test]
    fn behind_a_proxy_the_public_name_is_this_station_and_cookies_stay_on_tls() {
        let token = AccessToken::random().unwrap();
        let grant = TokenGrant { token: token.clone(), role: AccessRole::Operator };
        let names = ["robots.example".to_owned(), "other.example:8443".to_owned()];
        let tokens = Some(Arc::new(TokenTable::new(vec![grant])));
        let guard = RequestGuard::new("127.0.0.1:4680".parse().unwrap(), &names, tokens);
        let path = format!("/?token={}", token.expose());
        for host in ["robots.example", "Robots.Example:8443", "other.example:8443", "127.0.0.1:4680"] {
            assert_eq!(refused(&guard, &path, &[("host", host)]), None, "{host}");
            assert_eq!(refused(&guard, "/", &[("host", host)]), Some(ServerCounter::WrongToken), "{host}");
        }
        for host in ["evil.example", "other.example", "robots.example.evil.example"] {
            assert_eq!(refused(&guard, &path, &[("host", host)]), Some(ServerCounter::WrongHost), "{host}");
        }
        let https = [("host", "robots.example"), ("origin", "https://robots.example"), ("x-forwarded-proto", "https")];
        let cookie = guard.check(&request(&path, &https)).unwrap().cookie.unwrap();
        assert!(cookie.to_str().unwrap().ends_with("; SameSite=Strict; Secure"));
    }

    #[test]
    fn a_proxy_in_front_of_a_station_without_tokens_opens_it_to_nobody() {
        let guard = guard(None);
        for header in PROXY_HEADERS {
            let headers = [("host", "localhost:4680"), (header, "192.0.2.9")];
            assert_eq!(refused(&guard, "/v1/state", &headers), Some(ServerCounter::UnknownProxy), "{header}");
        }
    }

    #[test]
    fn a_refusal_tells_what_to_do_and_repeats_no_control_characters() {
        let guard = guard(None);
        let denial = guard.wrong_host("a\u{7}b");
        assert_eq!(denial.why, "the Host `ab` is not this station; open http://127.0.0.1:4680/");
    }
}
