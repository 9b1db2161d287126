//! What whoever asks takes and has: two lists of RFC 9110, read leniently.

use axum::http::header::{ACCEPT_ENCODING, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderName, HeaderValue};

/// Whether an answer may be packed with gzip (section 12.5.3): what is named goes before `*`, and a weight of 0 is a no.
pub(crate) fn takes_gzip(asked: &HeaderMap) -> bool {
    let codings = || elements(asked, ACCEPT_ENCODING).map(coding);
    let named = codings().find(|(name, _)| ["gzip", "x-gzip"].contains(&name.as_str()));
    let any = || codings().find(|(name, _)| name == "*");
    named.or_else(any).is_some_and(|(_, weight)| weight > 0.0)
}

/// Whether whoever asks has what bears this tag (section 13.1.2).
pub(crate) fn has_one(asked: &HeaderMap, tag: &HeaderValue) -> bool {
    let tag = tag.as_bytes();
    elements(asked, IF_NONE_MATCH).any(|one| {
        let strong = one.strip_prefix("W/").unwrap_or(one);
        one == "*" || strong.as_bytes() == tag
    })
}

/// The elements of a list, from all headers of its name.
fn elements(asked: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let lines = asked.get_all(name).into_iter();
    let lines = lines.filter_map(|line| line.to_str().ok());
    lines.flat_map(|line| line.split(',').map(str::trim))
}

/// A coding in lower case, and its weight; one that cannot be read is a no.
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
        let takes = |lines: &[&'static str]| takes_gzip(&asked(&ACCEPT_ENCODING, lines));
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
        let has = |lines: &[&'static str]| has_one(&asked(&IF_NONE_MATCH, lines), &tag);
        assert!(has(&["\"12ab\""]) && has(&["\"0\", W/\"12ab\""]) && has(&["*"]));
        assert!(!has(&["12ab"]) && !has(&["\"12AB\""]) && !has(&[]));
    }
}
