//! Detects the tags in raw grey pictures, one file per set, for `benches/tag_detectors.py` and `benches/tag_photographs.py`:
//! `detect_tags FOLDER SET...` prints a JSON list with the corners of each frame and the CPU milliseconds of its detection. Pictures
//! have 1280 x 720 pixels unless the set is given as `SET:WIDTHxHEIGHT`.
#![expect(clippy::print_stdout, reason = "its output is its result")]

use std::error::Error;

use nix::time::{ClockId, clock_gettime};
use posebridge_vision::{DetectedTag, GreyImage, ImageWindow, Tag36h11Detector, TagDetector, TagSearch};
use serde_json::json;

const WIDTH: usize = 1280;
const HEIGHT: usize = 720;
/// Half the side of the window around a tag, px, and how far inside of it the tag must be, with the white around.
const REACH: f64 = 96.0;
const MARGIN: f64 = 16.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, sets) = arguments.split_first().ok_or("usage: detect_tags FOLDER SET...")?;
    let mut frames = Vec::new();
    for set in sets {
        let (set, width, height) = name_and_size(set).ok_or("a set is SET or SET:WIDTHxHEIGHT")?;
        let bytes = std::fs::read(format!("{folder}/{set}.raw"))?;
        let mut detector = Tag36h11Detector::default();
        for (number, pixels) in bytes.chunks_exact(width * height).enumerate() {
            let image = GreyImage::new(pixels, width, height, width).ok_or("the picture is incomplete")?;
            let (tags, ms) = timed(|| detector.detect(image))?;
            // As if the prediction were exact: the time of a window with one tag. Without a tag that fits, there is none.
            let mut window_ms = None;
            if let Some(window) = tags.iter().find_map(window_around) {
                let mut search = TagSearch::new(u32::MAX);
                search.detect(&mut detector, image, &[]);
                let (_, ms) = timed(|| search.detect(&mut detector, image, &[window]))?;
                window_ms = Some(ms);
            }
            let corners: Vec<_> =
                tags.iter().map(|tag| json!([tag.id, tag.corners.map(|corner| [corner.x, corner.y])])).collect();
            frames.push(json!({"set": set, "n": number, "ms": ms, "window_ms": window_ms, "d": corners}));
        }
    }
    println!("{}", serde_json::to_string(&frames)?);
    Ok(())
}

/// The window around the middle of a tag, if it is all within: else the search would find nothing there and go on in the whole picture.
fn window_around(tag: &DetectedTag) -> Option<ImageWindow> {
    let middle = tag.corners.iter().fold([0.0, 0.0], |[x, y], corner| [x + corner.x / 4.0, y + corner.y / 4.0]);
    let is_within = |of: f64, middle: f64| (of - middle).abs() < REACH - MARGIN;
    let fits = tag.corners.iter().all(|corner| is_within(corner.x, middle[0]) && is_within(corner.y, middle[1]));
    let [left, top] = middle.map(|of| (of - REACH).max(0.0) as usize);
    let side = 2 * REACH as usize;
    fits.then_some(ImageWindow { left, top, width: side, height: side })
}

fn name_and_size(set: &str) -> Option<(&str, usize, usize)> {
    let Some((name, size)) = set.split_once(':') else {
        return Some((set, WIDTH, HEIGHT));
    };
    let (width, height) = size.split_once('x')?;
    Some((name, width.parse().ok()?, height.parse().ok()?))
}

/// The result, and the CPU time of this thread, ms.
fn timed<T>(work: impl FnOnce() -> T) -> Result<(T, f64), nix::Error> {
    let now = || clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID);
    let ms = |time: nix::sys::time::TimeSpec| time.tv_sec() as f64 * 1e3 + time.tv_nsec() as f64 / 1e6;
    let begun = now()?;
    let result = work();
    Ok((result, ms(now()?) - ms(begun)))
}
