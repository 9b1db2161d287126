//! `posebridge camera detect`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use clap::Args;
use posebridge_camera::take_picture;
use posebridge_link::LinkUrl;
use posebridge_report::tables::{NO_VALUE, TextTable};
use posebridge_vision::{DetectedTag, FloorTagPose, GreyPicture, Tag36h11Detector, TagDetector};
use serde_json::{Value, json};

use crate::config::CameraFile;
use crate::console::print_result;
use crate::exit::{ExitStage, Failure};

/// Flags of `camera detect`.
#[derive(Args, Clone, Debug)]
pub struct DetectArgs {
    /// Pictures (JPEG, PNG or PGM), or cameras, of each of which one picture is taken: /dev/video0, or http://... of a phone.
    #[arg(required = true, value_name = "PICTURE|SOURCE")]
    pub pictures: Vec<PathBuf>,
    /// Write the picture that was taken here, for `camera calibrate`.
    #[arg(long, value_name = "FILE")]
    pub save: Option<PathBuf>,
    /// A calibrated camera: where the tags are is printed as well.
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Side of the black rims, mm.
    #[arg(long, value_name = "MM", default_value_t = 80.0, requires = "camera")]
    pub side_mm: f64,
    /// Height of the tags above the floor, mm.
    #[arg(long, value_name = "MM", default_value_t = 0.0, requires = "camera", allow_hyphen_values = true)]
    pub height_mm: f64,
    /// Print one JSON object instead, with all corners and their covariance.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn execute(args: &DetectArgs) -> Result<(), Failure> {
    let camera = args.camera.as_deref().map(CameraFile::read).transpose().before_start()?;
    let mut detector = Tag36h11Detector::default();
    let mut pictures = Vec::new();
    if args.save.is_some() && args.pictures.len() > 1 {
        return Err(anyhow!("--save writes one picture: give one")).before_start();
    }
    for path in &args.pictures {
        let bytes = read_picture(path).before_start()?;
        let (size, tags) = detect(path, &bytes, &mut detector).before_start()?;
        if let Some(save) = &args.save {
            fs::write(save, &bytes).with_context(|| format!("writing `{}`", save.display())).before_start()?;
        }
        let tags = tags.into_iter().map(|tag| Ok((tag, place_of(&tag, args, camera.as_ref(), size)?)));
        pictures.push((path.display().to_string(), tags.collect::<Result<Vec<PlacedTag>>>().before_start()?));
    }
    let text = if args.json {
        let rows: Vec<Value> =
            pictures.iter().map(|(name, tags)| json!({ "picture": name, "tags": rows(tags) })).collect();
        format!("{:#}\n", json!({ "pictures": rows }))
    } else {
        pictures.iter().map(|(name, tags)| table(name, tags)).collect()
    };
    print_result(&text).while_running()
}

/// A tag, and where it is if the camera is known and sees the floor there.
type PlacedTag = (DetectedTag, Option<FloorTagPose>);

fn place_of(
    tag: &DetectedTag,
    args: &DetectArgs,
    camera: Option<&CameraFile>,
    (width, height): (usize, usize),
) -> Result<Option<FloorTagPose>> {
    let Some(camera) = camera else {
        return Ok(None);
    };
    ensure!(
        (camera.width, camera.height) == (width, height),
        "the camera was calibrated with pictures of {} x {} pixels, this one has {width} x {height}",
        camera.width,
        camera.height
    );
    let (side_m, height_m) = (args.side_mm / 1e3, args.height_mm / 1e3);
    Ok(FloorTagPose::solve(&camera.view()?, &tag.corners, &tag.covariance, side_m, height_m))
}

/// A picture from a file, or by a camera.
pub(super) fn read_picture(path: &Path) -> Result<Vec<u8>> {
    let name = path.display();
    let is_camera = name.to_string().contains("://") || path.starts_with("/dev");
    if is_camera {
        let url = LinkUrl::parse(&format!("camera:{name}"))?;
        return take_picture(&url).map_err(|error| anyhow!(error));
    }
    fs::read(path).with_context(|| format!("reading the picture `{name}`"))
}

/// The size of a picture, and its tags in the order of their ids.
pub(super) fn detect(
    path: &Path,
    bytes: &[u8],
    detector: &mut Tag36h11Detector,
) -> Result<((usize, usize), Vec<DetectedTag>)> {
    let name = path.display();
    let mut picture = GreyPicture::default();
    picture.decode(bytes).with_context(|| format!("the picture `{name}`"))?;
    let image = picture.image().with_context(|| format!("the picture `{name}` is empty"))?;
    let mut tags = detector.detect(image);
    tags.sort_by_key(|tag| tag.id);
    Ok(((image.width(), image.height()), tags))
}

/// Mean of its sides, px.
fn side_px(tag: &DetectedTag) -> f64 {
    (0..4).map(|corner| (tag.corners[(corner + 1) % 4] - tag.corners[corner]).norm()).sum::<f64>() / 4.0
}

/// Root mean square of the standard deviations of its corners, px.
fn corner_sigma_px(tag: &DetectedTag) -> f64 {
    (tag.covariance.trace() / 8.0).sqrt()
}

fn table(name: &str, tags: &[PlacedTag]) -> String {
    if tags.is_empty() {
        return format!(
            "{name}: no tag of the family tag36h11. Its modules should be at least 2 pixels wide, with one white module around the black \
             rim; look for shadows, glare and blur.\n"
        );
    }
    let header = [
        "tag",
        "x px",
        "y px",
        "side px",
        "corners ± px",
        "margin",
        "x m",
        "y m",
        "± mm",
        "heading deg",
        "side given %",
    ];
    let mut table = TextTable::new(header);
    for (tag, place) in tags {
        let middle = tag.corners.iter().fold([0.0; 2], |[x, y], corner| [x + corner.x / 4.0, y + corner.y / 4.0]);
        let placed = |text: &dyn Fn(&FloorTagPose) -> String| place.as_ref().map_or_else(|| NO_VALUE.to_owned(), text);
        table.push([
            tag.id.to_string(),
            format!("{:.1}", middle[0]),
            format!("{:.1}", middle[1]),
            format!("{:.1}", side_px(tag)),
            format!("{:.3}", corner_sigma_px(tag)),
            format!("{:.0}", tag.margin),
            placed(&|place| format!("{:.4}", place.pose.translation.x)),
            placed(&|place| format!("{:.4}", place.pose.translation.y)),
            placed(&|place| format!("{:.2}", 1e3 * (place.covariance[(0, 0)] + place.covariance[(1, 1)]).sqrt())),
            placed(&|place| format!("{:.2}", place.pose.rotation.angle().to_degrees())),
            placed(&|place| format!("{:.1}", 1e2 * place.side_ratio)),
        ]);
    }
    format!("{name}\n{}", table.without_empty_columns().render())
}

fn rows(tags: &[PlacedTag]) -> Vec<Value> {
    let row = |(tag, place): &PlacedTag| {
        let covariance: Vec<&[f64]> = tag.covariance.as_slice().chunks(8).collect();
        let mut row = json!({
            "id": tag.id,
            "hamming": tag.hamming,
            "margin": tag.margin,
            "corners_px": tag.corners.map(|corner| [corner.x, corner.y]),
            "covariance_px2": covariance,
        });
        if let Some(place) = place {
            let covariance: Vec<&[f64]> = place.covariance.as_slice().chunks(3).collect();
            row["x_m"] = json!(place.pose.translation.x);
            row["y_m"] = json!(place.pose.translation.y);
            row["heading_rad"] = json!(place.pose.rotation.angle());
            row["pose_covariance"] = json!(covariance);
            row["misfit"] = json!(place.misfit);
            row["side_ratio"] = json!(place.side_ratio);
        }
        row
    };
    tags.iter().map(row).collect()
}
