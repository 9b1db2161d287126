//! What `posebridge camera calibrate` prints.

use std::fmt::Write as _;

use posebridge_report::tables::{TextTable, wrapped};
use posebridge_vision::FloorCalibration;

use super::camera_evidence::CameraEvidence;
use super::recorded_drive::PictureDelay;
use crate::config::CameraFile;

/// Where the floor is known worse than this, the sheet should lie there, too, mm.
const MAX_SIGMA_MM: f64 = 3.0;

/// Zero of nothing.
pub(super) fn rms(numbers: &[f64]) -> f64 {
    (numbers.iter().map(|number| number * number).sum::<f64>() / numbers.len().max(1) as f64).sqrt()
}

pub(super) fn calibration_report(
    calibration: &FloorCalibration,
    file: &CameraFile,
    evidence: &CameraEvidence,
    delay: Option<PictureDelay>,
) -> String {
    let [x_m, y_m, z_m] = file.position_m;
    let mut text = format!(
        "camera     {} at x {x_m:.3}, y {y_m:.3}, {z_m:.3} m above the floor (± {:.0} mm)\nlens       focal length {:.0} px (± {:.1} %), \
         distortion {:+.3}, {:+.3}\n",
        file.name,
        1e3 * calibration.position_sigma_m.norm(),
        file.focal_px[0],
        1e2 * calibration.focal_sigma,
        file.radial[0],
        file.radial[1],
    );
    if !evidence.points.is_empty() {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "errors     {:.2} mm on the floor, {:.2} px (rms of {} corners)",
            1e3 * rms(&calibration.errors_m),
            calibration.rms_px,
            evidence.points.len()
        );
    }
    text += &drive_lines(calibration, evidence, delay);
    if !evidence.groups.is_empty() {
        let mut table = TextTable::new(["file", "what", "error mm"]).labels(2);
        let mut errors = calibration.errors_m.as_slice();
        for group in &evidence.groups {
            let (own, others) = errors.split_at(group.count);
            errors = others;
            table.push([group.file.clone(), group.name.clone(), format!("{:.2}", 1e3 * rms(own))]);
        }
        text = text + "\n" + &table.render();
    }
    text + &advice(calibration, evidence.size)
}

fn drive_lines(calibration: &FloorCalibration, evidence: &CameraEvidence, delay: Option<PictureDelay>) -> String {
    let Some(drive) = &evidence.drive else { return String::new() };
    let used: Vec<f64> = calibration.tag_errors_m.iter().flatten().copied().collect();
    let left_out = calibration.tag_errors_m.len() - used.len();
    let mut text = format!(
        "drive      {} pictures of tag {}, {left_out} left out; its corners are {:.2} mm from a square of its side\n",
        used.len(),
        evidence.robot_tag,
        1e3 * rms(&used)
    );
    if evidence.points.is_empty() {
        text +=
            &wrapped("arena      ", "counts from where the robot started: the drive shows no tag of the floor sheet");
    }
    let delay = match delay {
        _ if drive.is_exposure_known() => "known: the camera says when a picture was exposed".to_owned(),
        Some(PictureDelay { mean, sigma, spread }) => {
            let [mean, sigma, spread] = [mean, sigma, spread].map(|delta| 1e3 * delta.as_secs_f64());
            format!("{mean:.1} ms (± {sigma:.1} ms), of a single picture ± {spread:.1} ms")
        }
        None => {
            "not found: no robot was heard, or it drove without turns or changes of speed; `run` learns it".to_owned()
        }
    };
    text + &wrapped("delay      ", &delay)
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
        "the floor is known badly in these parts of the picture: {}; drive there, or lay the sheet there as well (another picture, and \
         another --sheet-at)",
        bad.join(", ")
    );
    format!("\n{}\n", wrapped("advice     ", &text))
}
