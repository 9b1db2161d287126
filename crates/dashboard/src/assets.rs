//! The files of the page: embedded in the program, or from a folder during development.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use axum::body::{Body, Bytes};
use axum::http::header::{ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::Response;
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest as _, Sha256};

macro_rules! assets {
    ($($path:literal),+ $(,)?) => {
        /// Every file of the page. A new one needs a file in `web/` and a line here.
        const EMBEDDED: &[(&str, &[u8])] = &[
            $(($path, include_bytes!(concat!("../../../web/", $path)))),+
        ];
    };
}

assets![
    "index.html",
    "app.js",
    "favicon.svg",
    "fleet.js",
    "model/chi_square.js",
    "model/errors.js",
    "model/marks.js",
    "model/peaks.js",
    "model/quantity.js",
    "model/robot.js",
    "model/robot_list.js",
    "model/same_instant.js",
    "model/session.js",
    "model/silence.js",
    "model/slider.js",
    "model/time_axis.js",
    "model/track.js",
    "model/words.js",
    "panels/arena.js",
    "panels/calibration.js",
    "panels/cameras.js",
    "panels/comparison.js",
    "panels/error.js",
    "panels/fleet.js",
    "panels/index.js",
    "panels/innovations.js",
    "panels/links.js",
    "panels/log.js",
    "panels/parameters.js",
    "panels/quantities.js",
    "panels/recordings.js",
    "panels/robots.js",
    "panels/setup.js",
    "panels/simulator.js",
    "replay.js",
    "station.js",
    "stream.js",
    "style.css",
    "vendor/uPlot.LICENSE.txt",
    "vendor/uPlot.iife.min.js",
    "vendor/uPlot.min.css",
    "view/arena_scene.js",
    "view/camera.js",
    "view/chart.js",
    "view/dom.js",
    "view/driver.js",
    "view/fleet_robots.js",
    "view/format.js",
    "view/headline.js",
    "view/lens.js",
    "view/map_input.js",
    "view/other_robots.js",
    "view/palette.js",
    "view/pose_form.js",
    "view/pose_input.js",
    "view/theme.js",
    "view/time_bar.js",
];

const INDEX: &str = "index.html";

/// Content type by file extension. A file with another extension is not served.
const TYPES: &[(&str, &str)] = &[
    ("html", "text/html; charset=utf-8"),
    ("css", "text/css; charset=utf-8"),
    ("js", "text/javascript; charset=utf-8"),
    ("json", "application/json"),
    ("svg", "image/svg+xml"),
    ("png", "image/png"),
    ("txt", "text/plain; charset=utf-8"),
];

pub(crate) struct Asset {
    path: String,
    kind: &'static str,
    etag: HeaderValue,
    plain: Bytes,
    gzipped: Bytes,
}

pub(crate) enum Assets {
    /// Embedded in the program, compressed once at the start.
    Embedded(Vec<Asset>),
    /// Read again for each request.
    Folder(PathBuf),
}

impl Assets {
    pub(crate) fn new(folder: Option<PathBuf>) -> Self {
        folder.map_or_else(
            || {
                let assets = EMBEDDED.iter();
                let assets = assets.filter_map(|(path, plain)| Asset::new(path, Bytes::from_static(plain)));
                Self::Embedded(assets.collect())
            },
            Self::Folder,
        )
    }

    /// `None` if there is no file at this path.
    pub(crate) fn respond(&self, path: &str, headers: &HeaderMap) -> Option<Response> {
        let path = match path.trim_start_matches('/') {
            "" => INDEX,
            path => path,
        };
        match self {
            Self::Embedded(assets) => {
                let asset = assets.iter().find(|asset| asset.path == path)?;
                Some(asset.respond(headers))
            }
            Self::Folder(folder) => {
                let plain = read_below(folder, path)?;
                Some(Asset::new(path, plain)?.respond(headers))
            }
        }
    }
}

/// A file below a folder, never one outside it.
fn read_below(folder: &Path, path: &str) -> Option<Bytes> {
    let folder = folder.canonicalize().ok()?;
    let found = folder.join(path).canonicalize().ok()?;
    if !found.starts_with(&folder) {
        return None;
    }
    std::fs::read(found).ok().map(Bytes::from)
}

impl Asset {
    fn new(path: &str, plain: Bytes) -> Option<Self> {
        let ending = path.rsplit_once('.')?.1;
        let kind = TYPES.iter().find(|(known, _)| *known == ending)?.1;
        let hash = Sha256::digest(&plain);
        let start = hash.iter().take(8).map(|byte| format!("{byte:02x}"));
        let tag = format!("\"{}\"", start.collect::<String>());
        Some(Self {
            path: path.to_owned(),
            kind,
            etag: HeaderValue::from_str(&tag).ok()?,
            gzipped: compress(&plain)?,
            plain,
        })
    }

    fn respond(&self, headers: &HeaderMap) -> Response {
        let is_known = matches_etag(headers, &self.etag);
        let takes_packed = accepts_gzip(headers);
        let body = match (is_known, takes_packed) {
            (true, _) => Body::empty(),
            (false, true) => Body::from(self.gzipped.clone()),
            (false, false) => Body::from(self.plain.clone()),
        };
        let mut response = Response::new(body);
        if is_known {
            *response.status_mut() = StatusCode::NOT_MODIFIED;
        }
        let headers = response.headers_mut();
        headers.insert(CONTENT_TYPE, HeaderValue::from_static(self.kind));
        headers.insert(ETAG, self.etag.clone());
        // Revalidated each time: an updated station has other files at the same path.
        headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-cache"));
        headers.insert(VARY, HeaderValue::from_static("accept-encoding"));
        if takes_packed && !is_known {
            headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        response
    }
}

fn compress(plain: &[u8]) -> Option<Bytes> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(plain).ok()?;
    encoder.finish().ok().map(Bytes::from)
}

/// Whether a response may be compressed with gzip (RFC 9110, section 12.5.3): a named coding precedes `*`, and a weight of 0
/// forbids it.
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let codings = || elements(headers, ACCEPT_ENCODING).map(coding);
    let named = codings().find(|(name, _)| ["gzip", "x-gzip"].contains(&name.as_str()));
    let any = || codings().find(|(name, _)| name == "*");
    named.or_else(any).is_some_and(|(_, weight)| weight > 0.0)
}

/// Whether the client has the content with this entity tag (RFC 9110, section 13.1.2).
fn matches_etag(headers: &HeaderMap, tag: &HeaderValue) -> bool {
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

    /// Every file below a folder, as relative paths.
    fn files(folder: &Path, prefix: &str) -> Vec<String> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap();
            let name = format!("{prefix}{}", entry.file_name().to_str().unwrap());
            if entry.file_type().unwrap().is_dir() {
                found.extend(files(&entry.path(), &format!("{name}/")));
            } else {
                found.push(name);
            }
        }
        found
    }

    #[test]
    fn every_file_of_the_page_is_in_the_table() {
        let web = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../web");
        let is_served = |path: &String| {
            let ending = path.rsplit_once('.').map(|(_, ending)| ending);
            TYPES.iter().any(|(known, _)| Some(*known) == ending)
        };
        // Licences and notes beside them are not served.
        let mut there: Vec<String> = files(&web, "").into_iter().filter(is_served).collect();
        there.sort_unstable();
        let mut table: Vec<&str> = EMBEDDED.iter().map(|(path, _)| *path).collect();
        table.sort_unstable();
        assert_eq!(table, there, "web/ and the table in assets.rs differ");
        let Assets::Embedded(assets) = Assets::new(None) else {
            panic!("they are embedded");
        };
        assert_eq!(assets.len(), there.len());
    }

    #[test]
    fn a_file_is_packed_for_who_takes_that_and_not_sent_to_who_has_it() {
        let assets = Assets::new(None);
        let mut request_headers = HeaderMap::new();
        let plain = assets.respond("/", &request_headers).unwrap();
        assert_eq!(plain.headers()[CONTENT_TYPE], "text/html; charset=utf-8");
        assert!(!plain.headers().contains_key(CONTENT_ENCODING));
        request_headers.insert(ACCEPT_ENCODING, HeaderValue::from_static("br, gzip;q=0.8"));
        let packed = assets.respond("/index.html", &request_headers).unwrap();
        assert_eq!(packed.headers()[CONTENT_ENCODING], "gzip");
        request_headers.insert(IF_NONE_MATCH, packed.headers()[ETAG].clone());
        let known = assets.respond("/", &request_headers).unwrap();
        assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
        assert!(assets.respond("/../Cargo.toml", &request_headers).is_none());
    }

    #[test]
    fn a_folder_gives_what_is_below_it_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let web = folder.path().join("web");
        std::fs::create_dir_all(web.join("panels")).unwrap();
        std::fs::write(folder.path().join("secret.txt"), "secret").unwrap();
        std::fs::write(web.join("index.html"), "page").unwrap();
        std::fs::write(web.join("panels/map.js"), "map").unwrap();
        std::fs::write(web.join("notes"), "no ending").unwrap();
        std::os::unix::fs::symlink("../secret.txt", web.join("link.txt")).unwrap();
        let assets = Assets::new(Some(web));
        let is_there = |path: &str| assets.respond(path, &HeaderMap::new()).is_some();
        assert!(is_there("/") && is_there("/panels/map.js") && is_there("//index.html"));
        for path in ["/../secret.txt", "/panels/../../secret.txt", "/link.txt", "/notes", "/panels"] {
            assert!(!is_there(path), "{path}");
        }
    }

    fn headers_with(name: &HeaderName, lines: &[&'static str]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for line in lines {
            headers.append(name.clone(), HeaderValue::from_static(line));
        }
        headers
    }

    #[test]
    fn gzip_is_taken_by_whoever_says_so_in_any_spelling() {
        let takes = |lines: &[&'static str]| accepts_gzip(&headers_with(&ACCEPT_ENCODING, lines));
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
        let has = |lines: &[&'static str]| matches_etag(&headers_with(&IF_NONE_MATCH, lines), &tag);
        assert!(has(&["\"12ab\""]) && has(&["\"0\", W/\"12ab\""]) && has(&["*"]));
        assert!(!has(&["12ab"]) && !has(&["\"12AB\""]) && !has(&[]));
    }
}
