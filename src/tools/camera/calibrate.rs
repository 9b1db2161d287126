//! `posebridge camera calibrate`: the place and the lens of a camera, from pictures of the floor sheet.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use posebridge_report::tables::{TextTable, wrapped};
use posebridge_vision::{
    DetectedTag, FloorCalibration, LensKnowledge, SeenPoint, SheetTag, Tag36h11Detector, floor_sheet, sheet_points,
};

use super::detect::{detect, read_picture};
use crate::config::{CalibrationNote, CameraFile};
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// Flags of `camera calibrate`.
#[derive(Args, Clone, Debug)]
pub struct CalibrateCameraArgs {
    /// Pictures (JPEG, PNG or PGM) of the floor sheet by the camera at its place; `camera detect --save` takes them.
    #[arg(required = true, value_name = "PICTURE")]
    pub pictures: Vec<PathBuf>,
    /// Where the lower left corner of the sheet lies in the arena, and how its short side is turned from x: once for all pictures, or
    /// once for each.
    #[arg(long, value_name = "X_M,Y_M,DEG", default_value = "0,0,0", value_parser = sheet_place, allow_hyphen_values = true)]
    pub sheet_at: Vec<SheetPlace>,
    /// Number of the first tag of the sheet.
    #[arg(long, value_name = "ID", default_value_t = 580)]
    pub floor_from: u16,
    /// Measured length of the sheet's line of 100 mm.
    #[arg(long, value_name = "MM", default_value_t = 100.0)]
    pub ruler_mm: f64,
    /// A calibrated camera whose lens is kept: only its place is found.
    #[arg(long, value_name = "FILE")]
    pub lens: Option<PathBuf>,
    /// Where `run` takes the camera's pictures from: /dev/v4l/by-id/..., or http://... of a phone.
    #[arg(long, value_name = "SOURCE")]
    pub source: Option<String>,
    /// Name of the camera.
    #[arg(long, default_value = "overhead")]
    pub name: String,
    /// File to write.
    #[arg(long, value_name = "FILE", default_value = "camera.toml")]
    pub out: PathBuf,
}

/// Where a sheet lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetPlace {
    origin_m: [f64; 2],
    turned_deg: f64,
}

fn sheet_place(text: &str) -> Result<SheetPlace, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .filter_map(|number| number.trim().parse().ok())
        .filter(|number: &f64| number.is_finite())
        .collect();
    let [x_m, y_m, turned_deg] = numbers.as_slice() else {
        return Err("three numbers are needed: x in metres, y in metres, degrees".to_owned());
    };
    Ok(SheetPlace { origin_m: [*x_m, *y_m], turned_deg: *turned_deg })
}

/// A printer scales by less.
const RULER_BOUNDS_MM: std::ops::RangeInclusive<f64> = 80.0..=120.0;
/// Where the floor is known worse than this, the sheet should lie there, too, mm.
const MAX_SIGMA_MM: f64 = 3.0;

pub(super) fn execute(args: &CalibrateCameraArgs) -> Result<(), Failure> {
    let sheet = floor_sheet(args.floor_from)
        .with_context(|| format!("--floor-from {}: there are fewer than six tags from there on", args.floor_from))
        .before_start()?;
    let seen = see(args, &sheet).before_start()?;
    let (calibration, file) = calibrate(args, &seen).before_start()?;
    let text = file.to_toml().before_start()?;
    std::fs::write(&args.out, text).with_context(|| format!("writing `{}`", args.out.display())).before_start()?;
    print_result(&report(&calibration, &file, &seen)).while_running()?;
    print_line(&format!("`{}` holds the camera", args.out.display()));
    Ok(())
}

/// What the pictures show of the sheet.
struct SeenSheets {
    size: (usize, usize),
    points: Vec<SeenPoint>,
    /// Picture and tag of each four points.
    labels: Vec<(String, u16)>,
}

fn see(args: &CalibrateCameraArgs, sheet: &[SheetTag]) -> Result<SeenSheets> {
    let places = args.sheet_at.len();
    ensure!(
        places == 1 || places == args.pictures.len(),
        "--sheet-at is given {places} times for {} pictures: give it once, or once for each",
        args.pictures.len()
    );
    ensure!(
        RULER_BOUNDS_MM.contains(&args.ruler_mm),
        "--ruler-mm {}: the line of 100 mm is between {} and {} mm long on any printer",
        args.ruler_mm,
        RULER_BOUNDS_MM.start(),
        RULER_BOUNDS_MM.end()
    );
    let mut detector = Tag36h11Detector::default();
    let mut seen: Option<SeenSheets> = None;
    for (index, path) in args.pictures.iter().enumerate() {
        let name = path.display().to_string();
        let (size, tags) = detect(path, &read_picture(path)?, &mut detector)?;
        let seen = seen.get_or_insert(SeenSheets { size, points: Vec::new(), labels: Vec::new() });
        ensure!(
            seen.size == size,
            "`{name}` has {} x {} pixels, the picture before it {} x {}: calibrate each size by itself",
            size.0,
            size.1,
            seen.size.0,
            seen.size.1
        );
        let place = args.sheet_at[index.min(places - 1)];
        let scale = args.ruler_mm / 100.0;
        let on_sheet: Vec<DetectedTag> =
            tags.into_iter().filter(|tag| sheet.iter().any(|printed| printed.id == tag.id)).collect();
        ensure!(
            !on_sheet.is_empty(),
            "`{name}` shows no tag of the floor sheet ({} to {}): `posebridge camera detect` says what it shows",
            args.floor_from,
            usize::from(args.floor_from) + sheet.len() - 1
        );
        seen.labels.extend(on_sheet.iter().map(|tag| (name.clone(), tag.id)));
        seen.points.extend(sheet_points(sheet, &on_sheet, place.origin_m, place.turned_deg.to_radians(), scale));
    }
    seen.context("there is no picture")
}

fn calibrate(args: &CalibrateCameraArgs, seen: &SeenSheets) -> Result<(FloorCalibration, CameraFile)> {
    let (width, height) = seen.size;
    let lens = match &args.lens {
        None => LensKnowledge::Unknown { width, height },
        Some(path) => {
            let file = CameraFile::read(path)?;
            ensure!(
                (file.width, file.height) == seen.size,
                "the camera `{}` has pictures of {} x {} pixels, these have {width} x {height}",
                path.display(),
                file.width,
                file.height
            );
            LensKnowledge::Known(file.view()?.camera)
        }
    };
    let calibration = FloorCalibration::solve(&seen.points, lens)?;
    let note = CalibrationNote {
        points: seen.points.len(),
        rms_px: calibration.rms_px,
        floor_rms_mm: 1e3 * rms(&calibration.errors_m),
    };
    let file = CameraFile {
        source: args.source.clone(),
        ..CameraFile::new(&args.name, seen.size, &calibration.view, Some(note))
    };
    Ok((calibration, file))
}

fn rms(numbers: &[f64]) -> f64 {
    (numbers.iter().map(|number| number * number).sum::<f64>() / numbers.len().max(1) as f64).sqrt()
}

fn report(calibration: &FloorCalibration, file: &CameraFile, seen: &SeenSheets) -> String {
    let [x_m, y_m, z_m] = file.position_m;
    let note = file.calibration.map_or(0.0, |note| note.floor_rms_mm);
    let mut text = format!(
        "camera     {} at x {x_m:.3}, y {y_m:.3}, {z_m:.3} m above the floor (± {:.0} mm)\nlens       focal length {:.0} px (± {:.1} %), \
         distortion {:+.3}, {:+.3}\nerrors     {note:.2} mm on the floor, {:.2} px (rms of {} corners)\n\n",
        file.name,
        1e3 * calibration.position_sigma_m.norm(),
        file.focal_px[0],
        1e2 * calibration.focal_sigma,
        file.radial[0],
        file.radial[1],
        calibration.rms_px,
        seen.points.len()
    );
    let mut table = TextTable::new(["picture", "tag", "error mm"]).labels(2);
    let mut tags: BTreeMap<&(String, u16), f64> = BTreeMap::new();
    for (label, errors) in seen.labels.iter().zip(calibration.errors_m.chunks(4)) {
        tags.insert(label, 1e3 * rms(errors));
    }
    for ((picture, tag), error) in tags {
        table.push([picture.clone(), tag.to_string(), format!("{error:.2}")]);
    }
    text.push_str(&table.render());
    text + &advice(calibration, seen.size)
}

/// Where the floor is known badly, and what to do.
fn advice(calibration: &FloorCalibration, (width, height): (usize, usize)) -> String {
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let places = [
        ("upper left", 0.0, 0.0),
        ("upper right", right, 0.0),
        ("lower right", right, bottom),
        ("lower left", 0.0, bottom),
        ("middle", right / 2.0, bottom / 2.0),
    ];
    let bad: Vec<String> = places
        .into_iter()
        .filter_map(|(name, x, y)| {
            let sigma_mm = 1e3 * calibration.floor_sigma_m([x, y].into())?;
            (sigma_mm > MAX_SIGMA_MM).then(|| format!("{name} ± {sigma_mm:.0} mm"))
        })
        .collect();
    if bad.is_empty() {
        return String::new();
    }
    let text = format!(
        "the floor is known badly in these parts of the picture: {}; lay the sheet there as well (another picture, and another --sheet-at)",
        bad.join(", ")
    );
    format!("\n{}\n", wrapped("advice     ", &text))
}
