//! `posebridge report --png`: every picture of a page as dots, too. Needs the feature `png`.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::path::Path;

use posebridge_sim::Scenario;
use posebridge_telemetry::Span;
use support::{posebridge, stdout_of};
use virtual_drive::record_drive_and_truth;

/// A short drive with a camera.
const SQUARE: &str = r#"
seed = 5
[path.square]
side_m = 0.5
direction = "left"
"#;

/// Width and height that a PNG file says of itself, dots (PNG specification, section 11.2.1).
fn dots(path: &Path) -> [u32; 2] {
    let png = std::fs::read(path).unwrap();
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"), "{}", path.display());
    let number = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    [number(16), number(20)]
}

/// Width and height that an SVG picture says of itself.
fn units(path: &Path) -> [f64; 2] {
    let svg = std::fs::read_to_string(path).unwrap();
    let of = |name: &str| {
        let value = svg.split_once(&format!("{name}=\"")).unwrap().1;
        value.split('"').next().unwrap().parse().unwrap()
    };
    [of(" width"), of(" height")]
}

#[test]
fn every_picture_of_a_report_is_there_as_png_with_two_dots_per_unit() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = Scenario::from_toml(SQUARE).unwrap();
    record_drive_and_truth(&folder.join("drive.mcap"), scenario, Span::ZERO);
    let report = ["report", "drive.mcap", "--out", "page", "--png"];
    stdout_of(posebridge(folder).args(report));
    let mut pictures = 0;
    for file in std::fs::read_dir(folder.join("page")).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "svg") {
            pictures += 1;
            let doubled = units(&path).map(|units| (2.0 * units).ceil() as u32);
            assert_eq!(
                dots(&path.with_extension("png")),
                doubled,
                "{}",
                path.display()
            );
        }
    }
    assert!(pictures >= 5, "{pictures}");
}
