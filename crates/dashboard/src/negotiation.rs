//! Content negotiation: two lists of RFC 9110, parsed leniently.

use axum::http::header::{ACCEPT_ENCODING, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderName, HeaderValue};

/// Whether a response may be compressed with gzip (section 12.5.3): a named coding precedes `*`, and a weight of 0
/// forbids it.
pub(crate) fn accepts_gzip(headers: &HeaderMap) -> bool {
    let codings = || elements(headers, ACCEPT_ENCODING).map(coding);
    let named = codings().find(|(name, _)| ["gzip", "x-gzip"].contains(&name.as_str()));
    let any = || codings().find(|(name, _)| name == "*");
    named.or_else(any).is_some_and(|(_, weight)| weight > 0.0)
}

/// Whether the client has the content with this entity tag (section 13.1.2).
pub(crate) fn matches_etag(headers: &HeaderMap, tag: &HeaderValue) -> bool {
    let tag = tag.as_bytes();
    elements(headers, IF_NONE_MATCH).any(|one| {
        let strong = one.strip_prefix("W/").unwrap_or(one);
        one == "*" || strong.as_bytes() == tag
    })
}

/// The elements of a list header, over all its lines.
fn elements(headers: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let lines = headers.get_all(name).into_iter();
    let lines = lines.filter_map(|line| line.to_str().ok());
    lines.flat_map(|line| line.split(',').map(str::trim))
}

/// A coding in lower case and its weight; one that cannot be parsed gets weight 0.
fn coding(element: &str) -> (String, f64) {
    let mut parts = element.split(';').map(str::trim);
    let name = parts.next().unwrap_or_default().to_ascii_lowercase();
    let weight = parts.find_map(|part| {
        let (key, value) = part.split_once('=')?;
        let is_weight = key.trim().eq_ignore_ascii_case("q");
        is_weight.then(|| value.trim().parse().unwrap_or(0.0))
    });
    (name, weight.unwrap_or(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(name: &HeaderName, lines: &[&'static str]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for line in lines {
            headers.append(name.clone(), HeaderValue::from_static(line));
        }
        headers
    }

    #[test]
    fn gzip_is_taken_by_whoever_says_so_in_any_spelling() {
        let takes = |lines: &[&'static str]| accepts_gzip(&asked(&ACCEPT_ENCODING, lines));
        for lines in [&["gzip"][..], &["br, GZIP;q=0.8"], &["identity", "gzip ; Q=0.001"], &["*"], &["x-gzip, *;q=0"]] {
            assert!(takes(lines), "{lines:?}");
        }
        for lines in
            [&["gzip;q=0"][..], &[], &[""], &["gzip;q=0.000, *"], &["br, *;q=0"], &["gzipped"], &["gzip;q=much"]]
        {
            assert!(!takes(lines), "{lines:?}");
        }
    }

    #[test]
    fn a_tag_is_found_in_a_list_and_where_a_proxy_made_it_weak() {
        let tag = HeaderValue::from_static("\"12ab\"");
        let has = |lines: &[&'static str]| matches_etag(&asked(&IF_NONE_MATCH, lines), &tag);
        assert!(has(&["\"12ab\""]) && has(&["\"0\", W/\"12ab\""]) && has(&["*"]));
        assert!(!has(&["12ab"]) && !has(&["\"12AB\""]) && !has(&[]));
    }
}
