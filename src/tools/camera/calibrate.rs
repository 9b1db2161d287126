//! `posebridge camera calibrate`: the place and the lens of a camera, from pictures of the floor sheet, a drive, or measured points.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use posebridge_camera::device_identity;
use posebridge_link::LinkUrl;
use posebridge_report::tables::wrapped;
use posebridge_vision::{FloorCalibration, LensKnowledge, SheetPlacement, floor_sheet};

use super::calibration_report::{calibration_report, rms};
use super::camera_evidence::{CameraEvidence, SUSPECT_RATIO};
use super::recorded_drive::{PictureDelay, RecordedDrive};
use crate::config::{CalibrationNote, CameraFile};
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// Flags of `camera calibrate`.
#[derive(Args, Clone, Debug)]
pub struct CalibrateCameraArgs {
    /// Pictures (JPEG, PNG or PGM) of the floor sheet by the camera at its place; `camera detect --save` takes them.
    #[arg(required_unless_present_any = ["drive", "points"], value_name = "PICTURE")]
    pub pictures: Vec<PathBuf>,
    /// A recording of the robot in the camera's sight, best with the floor sheet beside its path: the sides of its tag show how the
    /// lens draws where no sheet lay, and its wheels how long pictures take to come.
    #[arg(long, value_name = "RECORDING")]
    pub drive: Option<PathBuf>,
    /// The link of the camera in the recording, if there are several.
    #[arg(long, value_name = "NUMBER", requires = "drive")]
    pub link: Option<u16>,
    /// CSV table of marks on the floor with the columns u, v (pixel in the picture) and x_m, y_m (place in the arena).
    #[arg(long, value_name = "FILE.csv", requires = "picture_px")]
    pub points: Option<PathBuf>,
    /// Size of the picture in which the points were read.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = picture_size)]
    pub picture_px: Option<(usize, usize)>,
    /// Where the lower left corner of the sheet lies in the arena, and how its short side is turned from x: once for all, or once for each
    /// picture and then for the drive.
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
    /// Where `run` takes the camera's pictures from: /dev/v4l/by-id/..., or http://... of a phone. Default: as in the drive.
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

fn picture_size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    sides.filter(|(width, height)| *width > 0 && *height > 0).ok_or_else(|| "must be as 1280x720".to_owned())
}

/// A printer scales by less.
const RULER_BOUNDS_MM: std::ops::RangeInclusive<f64> = 80.0..=120.0;
pub(super) fn execute(args: &CalibrateCameraArgs) -> Result<(), Failure> {
    let evidence = collect_evidence(args).before_start()?;
    let lens = lens_of(args, evidence.size).before_start()?;
    let calibration = FloorCalibration::solve(&evidence.points, &evidence.tags, lens).before_start()?;
    let suspect = evidence.suspect_mark(lens, &calibration);
    let mut file = file_of(args, &evidence, &calibration);
    let mut delay = None;
    if let Some(drive) = evidence.drive.as_ref().filter(|drive| !drive.is_exposure_known()) {
        delay = drive.delay(&file).while_running()?;
    }
    if let Some(PictureDelay { mean, spread, .. }) = delay {
        let tenths = |seconds: f64| (1e4 * seconds).round() / 10.0;
        file.delay_ms = Some(tenths(mean.as_secs_f64()));
        file.delay_spread_ms = Some(tenths(2.0 * spread.as_secs_f64()).max(1.0));
    }
    let text = file.to_toml().before_start()?;
    std::fs::write(&args.out, text).with_context(|| format!("writing `{}`", args.out.display())).before_start()?;
    print_result(&calibration_report(&calibration, &file, &evidence, delay)).while_running()?;
    if let Some(mark) = suspect {
        print_result(&wrapped(
            "mistyped?  ",
            &format!("without {mark} the others fit {SUSPECT_RATIO:.0} times better or more: was it taken for another, or mistyped?"),
        ))
        .while_running()?;
    }
    print_line(&format!("`{}` holds the camera", args.out.display()));
    Ok(())
}

fn collect_evidence(args: &CalibrateCameraArgs) -> Result<CameraEvidence> {
    let sheet = floor_sheet(args.floor_from)
        .with_context(|| format!("--floor-from {}: there are fewer than four tags from there on", args.floor_from))?;
    let (places, sheets) = (args.sheet_at.len(), args.pictures.len() + usize::from(args.drive.is_some()));
    ensure!(
        places == 1 || places == sheets,
        "--sheet-at is given {places} times for {sheets} pictures: give it once, or once for each"
    );
    ensure!(
        RULER_BOUNDS_MM.contains(&args.ruler_mm),
        "--ruler-mm {}: the line of 100 mm is between {} and {} mm long on any printer",
        args.ruler_mm,
        RULER_BOUNDS_MM.start(),
        RULER_BOUNDS_MM.end()
    );
    let mut evidence = CameraEvidence::default();
    for (index, path) in args.pictures.iter().enumerate() {
        evidence.add_picture(path, &sheet, placement(args, index), args.floor_from)?;
    }
    if let Some(path) = &args.points {
        evidence.add_points(path, args.picture_px)?;
    }
    if let Some(path) = &args.drive {
        let drive = RecordedDrive::read(path, args.link)?;
        evidence.add_drive(drive, &sheet, placement(args, args.pictures.len()))?;
    }
    Ok(evidence)
}

/// Of the sheet in the picture with this number, or in the drive after the last one.
fn placement(args: &CalibrateCameraArgs, index: usize) -> SheetPlacement {
    let SheetPlace { origin_m, turned_deg } = args.sheet_at[index.min(args.sheet_at.len() - 1)];
    SheetPlacement { origin_m, turned_rad: turned_deg.to_radians(), scale: args.ruler_mm / 100.0 }
}

fn lens_of(args: &CalibrateCameraArgs, (width, height): (usize, usize)) -> Result<LensKnowledge> {
    let Some(path) = &args.lens else {
        return Ok(LensKnowledge::Unknown { width, height });
    };
    let file = CameraFile::read(path)?;
    ensure!(
        (file.width, file.height) == (width, height),
        "the camera `{}` has pictures of {} x {} pixels, these have {width} x {height}",
        path.display(),
        file.width,
        file.height
    );
    Ok(LensKnowledge::Known(file.view()?.camera))
}

fn file_of(args: &CalibrateCameraArgs, evidence: &CameraEvidence, calibration: &FloorCalibration) -> CameraFile {
    let note = CalibrationNote {
        points: evidence.points.len() + 4 * calibration.tag_errors_m.iter().flatten().count(),
        rms_px: calibration.rms_px,
        floor_rms_mm: 1e3 * rms(&calibration.errors_m),
    };
    let recorded = evidence.drive.as_ref().and_then(RecordedDrive::source);
    let source = args.source.clone().or(recorded);
    let url = source.as_ref().and_then(|source| LinkUrl::parse(&format!("camera:{source}")).ok());
    CameraFile {
        source,
        device: url.and_then(|url| device_identity(&url)),
        ..CameraFile::new(&args.name, evidence.size, &calibration.view, Some(note))
    }
}
