use super::*;

use axum::body::Body;

fn guard(token: Option<&AccessToken>) -> RequestGuard {
    let ip = if token.is_some() { "192.0.2.7" } else { "127.0.0.1" };
    RequestGuard::new(format!("{ip}:4680").parse().unwrap(), token.cloned())
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
        let headers =
            [("host", "localhost:4680"), ("sec-fetch-site", site), ("sec-fetch-mode", mode), ("sec-fetch-dest", dest)];
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
    let admitted = guard.check(&request(&by_query, &[host]));
    assert_eq!(admitted, Ok(RequestAdmission::WithCookie));
    let cookie = guard.cookie().unwrap();
    let cookie = cookie.to_str().unwrap();
    let (value, attributes) = cookie.split_once("; ").unwrap();
    assert_eq!(attributes, "Path=/; HttpOnly; SameSite=Strict");
    assert_eq!(with("cookie", value), None);
    // A foreign page has the browser's cookie, but its own origin.
    let foreign = [host, ("cookie", value), ("origin", "http://evil.example")];
    assert_eq!(refused(&guard, "/", &foreign), Some(ServerCounter::WrongOrigin));
}

#[test]
fn a_refusal_tells_what_to_do_and_repeats_no_control_characters() {
    let guard = guard(None);
    let denial = guard.wrong_host("a\u{7}b");
    assert_eq!(denial.why, "the Host `ab` is not this station; open http://127.0.0.1:4680/");
}
