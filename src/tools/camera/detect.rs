//! `posebridge camera detect`.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use posebridge_report::tables::TextTable;
use posebridge_vision::{DetectedTag, GreyPicture, Tag36h11Detector, TagDetector};
use serde_json::{Value, json};

use crate::console::print_result;
use crate::exit::{ExitStage, Failure};

/// Flags of `camera detect`.
#[derive(Args, Clone, Debug)]
pub struct DetectArgs {
    /// JPEG pictures.
    #[arg(required = true, value_name = "PICTURE")]
    pub pictures: Vec<PathBuf>,
    /// Print one JSON object instead, with all corners and their covariance.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn execute(args: &DetectArgs) -> Result<(), Failure> {
    let mut detector = Tag36h11Detector::default();
    let mut found = Vec::new();
    for path in &args.pictures {
        found.push((path.display().to_string(), detect(path, &mut detector).before_start()?));
    }
    let text = if args.json {
        let pictures: Vec<Value> =
            found.iter().map(|(name, tags)| json!({ "picture": name, "tags": rows(tags) })).collect();
        format!("{:#}\n", json!({ "pictures": pictures }))
    } else {
        found.iter().map(|(name, tags)| table(name, tags)).collect()
    };
    print_result(&text).while_running()
}

fn detect(path: &PathBuf, detector: &mut Tag36h11Detector) -> Result<Vec<DetectedTag>> {
    let name = path.display();
    let bytes = fs::read(path).with_context(|| format!("reading the picture `{name}`"))?;
    let mut picture = GreyPicture::default();
    picture.decode_jpeg(&bytes).with_context(|| format!("`{name}`, which should be a JPEG picture"))?;
    let mut tags = picture.image().map(|image| detector.detect(image)).unwrap_or_default();
    tags.sort_by_key(|tag| tag.id);
    Ok(tags)
}

/// Mean of its sides, px.
fn side_px(tag: &DetectedTag) -> f64 {
    (0..4).map(|corner| (tag.corners[(corner + 1) % 4] - tag.corners[corner]).norm()).sum::<f64>() / 4.0
}

/// Root mean square of the standard deviations of its corners, px.
fn corner_sigma_px(tag: &DetectedTag) -> f64 {
    (tag.covariance.trace() / 8.0).sqrt()
}

fn table(name: &str, tags: &[DetectedTag]) -> String {
    if tags.is_empty() {
        return format!(
            "{name}: no tag of the family tag36h11. Its modules should be at least 2 pixels wide, with one white module around the black \
             rim; look for shadows, glare and blur.\n"
        );
    }
    let mut table = TextTable::new(["tag", "x px", "y px", "side px", "corners ± px", "margin"]);
    for tag in tags {
        let middle = tag.corners.iter().fold([0.0; 2], |[x, y], corner| [x + corner.x / 4.0, y + corner.y / 4.0]);
        table.push([
            tag.id.to_string(),
            format!("{:.1}", middle[0]),
            format!("{:.1}", middle[1]),
            format!("{:.1}", side_px(tag)),
            format!("{:.3}", corner_sigma_px(tag)),
            format!("{:.0}", tag.margin),
        ]);
    }
    format!("{name}\n{}", table.render())
}

fn rows(tags: &[DetectedTag]) -> Vec<Value> {
    let row = |tag: &DetectedTag| {
        let covariance: Vec<&[f64]> = tag.covariance.as_slice().chunks(8).collect();
        json!({
            "id": tag.id,
            "hamming": tag.hamming,
            "margin": tag.margin,
            "corners_px": tag.corners.map(|corner| [corner.x, corner.y]),
            "covariance_px2": covariance,
        })
    };
    tags.iter().map(row).collect()
}
