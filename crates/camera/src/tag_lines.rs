//! What is seen, as lines for the station (docs/protocols/camera-json.md).

use nalgebra::SMatrix;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use serde_json::{Value, json};

use crate::picture::PictureTime;
use crate::sighting::{Sighting, TaggedPicture};

/// Decimals of a pixel: far below the error of any corner.
const PIXEL_DECIMALS: i32 = 4;

/// The lines of a sighting that the station takes at `now`.
pub(crate) fn lines_of(sighting: &Sighting, camera: &str, now: Timestamp<HostClock>) -> Vec<u8> {
    match sighting {
        Sighting::Tags(seen) => tag_lines(camera, seen, now),
        Sighting::Nothing => hello_line(camera),
    }
}

/// A line for each tag of a picture.
fn tag_lines(camera: &str, seen: &TaggedPicture, now: Timestamp<HostClock>) -> Vec<u8> {
    let TaggedPicture { tags, picture_px, time } = seen;
    let mut lines = Vec::new();
    let micros = |since: Timestamp<HostClock>| (now - since).max(TimeDelta::ZERO).as_nanos() / 1_000;
    let (key, age) = match *time {
        PictureTime::Exposed { earliest, latest } => ("exposed_ago_us", json!([micros(latest), micros(earliest)])),
        PictureTime::Received(at) => ("received_ago_us", json!(micros(at))),
    };
    for tag in tags {
        let corners = tag.corners.map(|corner| [rounded(corner.x, PIXEL_DECIMALS), rounded(corner.y, PIXEL_DECIMALS)]);
        let line = json!({
            "camera": camera,
            "tag": tag.id,
            (key): age,
            "picture_px": [picture_px.0, picture_px.1],
            "corners_px": corners,
            "corners_cov_px2": lower_triangle(&tag.covariance),
        });
        push_line(&mut lines, &line);
    }
    lines
}

/// Says that the camera is there while it sees no tag.
fn hello_line(camera: &str) -> Vec<u8> {
    let mut line = Vec::new();
    push_line(&mut line, &json!({ "camera": camera, "takes_requests": false }));
    line
}

fn push_line(lines: &mut Vec<u8>, line: &Value) {
    lines.extend_from_slice(line.to_string().as_bytes());
    lines.push(b'\n');
}

/// Row by row, to six digits of each entry: with four a correlation near one could become one.
fn lower_triangle(covariance: &SMatrix<f64, 8, 8>) -> Vec<f64> {
    let entries = (0..8).flat_map(|row| (0..=row).map(move |column| covariance[(row, column)]));
    entries.map(|entry| rounded(entry, 5 - entry.abs().log10().floor().clamp(-12.0, 5.0) as i32)).collect()
}

fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    (value * scale).round() / scale
}
