//! Detects the tags in raw grey pictures, one file per set, for `benches/tag_detectors.py` and `benches/tag_photographs.py`:
//! `detect_tags FOLDER SET...` prints a JSON list with the corners of each frame and the CPU milliseconds of its detection. Pictures
//! have 1280 x 720 pixels unless the set is given as `SET:WIDTHxHEIGHT`.
#![expect(clippy::print_stdout, reason = "its output is its result")]

use std::error::Error;

use nix::time::{ClockId, clock_gettime};
use posebridge_vision::{GreyImage, ImageWindow, Tag36h11Detector, TagDetector, TagSearch};
use serde_json::json;

const WIDTH: usize = 1280;
const HEIGHT: usize = 720;
/// Half the side of the window around the first tag of the frame before, px.
const REACH: usize = 96;

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
            // As if the prediction were exact: the time of a window with one tag.
            let mut search = TagSearch::new(u32::MAX);
            let windows: Vec<ImageWindow> =
                tags.first().map(|tag| around(tag.corners[0].x, tag.corners[0].y)).into_iter().collect();
            search.detect(&mut detector, image, &[]);
            let (_, window_ms) = timed(|| search.detect(&mut detector, image, &windows))?;
            let corners: Vec<_> =
                tags.iter().map(|tag| json!([tag.id, tag.corners.map(|corner| [corner.x, corner.y])])).collect();
            frames.push(json!({"set": set, "n": number, "ms": ms, "window_ms": window_ms, "d": corners}));
        }
    }
    println!("{}", serde_json::to_string(&frames)?);
    Ok(())
}

fn name_and_size(set: &str) -> Option<(&str, usize, usize)> {
    let Some((name, size)) = set.split_once(':') else {
        return Some((set, WIDTH, HEIGHT));
    };
    let (width, height) = size.split_once('x')?;
    Some((name, width.parse().ok()?, height.parse().ok()?))
}

fn around(x: f64, y: f64) -> ImageWindow {
    let (left, top) = ((x as usize).saturating_sub(REACH), (y as usize).saturating_sub(REACH));
    ImageWindow { left, top, width: 2 * REACH, height: 2 * REACH }
}

/// The result, and the CPU time of this thread, ms.
fn timed<T>(work: impl FnOnce() -> T) -> Result<(T, f64), nix::Error> {
    let now = || clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID);
    let ms = |time: nix::sys::time::TimeSpec| time.tv_sec() as f64 * 1e3 + time.tv_nsec() as f64 / 1e6;
    let begun = now()?;
    let result = work();
    Ok((result, ms(now()?) - ms(begun)))
}
