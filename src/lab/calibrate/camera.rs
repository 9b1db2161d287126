//! `posebridge calibrate camera`: from what the overhead camera sees to the floor.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use posebridge_lab::calibration::camera::{CalibrationPoint, CameraFit, Similarity, fit_homography, fit_similarity};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot, render_plot};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::TextTable;
use serde_json::{Value, json};

use super::listing::CsvTable;
use crate::exit::{ExitStage, Failure};
use crate::tools::experiment_output::{ExperimentOutcome, OutputArgs};

/// Leaving out one point improves the fit of the others by this factor: the point is probably mistyped.
const SUSPECT: f64 = 3.0;

/// Flags of `calibrate camera`.
#[derive(Args, Clone, Debug)]
pub struct CameraArgs {
    /// A CSV table of four or more points with the columns u, v (where the camera sees them) and x_m, y_m (where they are).
    pub points: PathBuf,
    /// The camera already measures in metres: look only for its turn, its shift and its scale; two points are enough.
    #[arg(long)]
    pub metric: bool,
    /// Write the numbers to this file.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Calibrates.
///
/// # Errors
/// The points cannot be read or do not suffice, or an output cannot be written.
pub(super) fn execute(args: &CameraArgs) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let points = read(&args.points).before_start()?;
    let name = args.points.display().to_string();
    let context = || format!("points `{name}`");
    let (outcome, numbers) = if args.metric {
        let found = fit_similarity(&points).with_context(context).while_running()?;
        (metric_outcome(&name, &found), metric_toml(&name, &found))
    } else {
        let found = fit_homography(&points).with_context(context).while_running()?;
        (outcome(&name, &points, &found), toml_of(&name, &points, &found))
    };
    if let Some(path) = &args.save {
        std::fs::write(path, numbers).with_context(|| format!("writing `{}`", path.display())).while_running()?;
    }
    args.output.write_outcome(&folder, &outcome)
}

fn read(path: &Path) -> Result<Vec<CalibrationPoint>> {
    let listing = CsvTable::read(path)?;
    let points = listing.rows().map(|row| {
        Ok(CalibrationPoint {
            measured: [row.number("u")?, row.number("v")?],
            floor_m: [row.number("x_m")?, row.number("y_m")?],
        })
    });
    points.collect()
}

/// The point without which the others fit much better, counted from 1.
fn suspect(found: &CameraFit) -> Option<usize> {
    let without = found.rms_without_m.iter().enumerate();
    let (index, rms_m) = without.min_by(|a, b| a.1.total_cmp(b.1))?;
    (rms_m * SUSPECT < found.rms_m).then_some(index + 1)
}

fn toml_of(name: &str, points: &[CalibrationPoint], found: &CameraFit) -> String {
    let mut text = format!(
        "# From the image to the floor by {} points of {name}: (x, y, 1) ~ rows * (u, v, 1), metres.\n# Residuals {:.2} mm rms.\n[camera]\nhomography = [\n",
        points.len(),
        1e3 * found.rms_m
    );
    for [a, b, c] in found.homography.rows {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "    [{a:?}, {b:?}, {c:?}],");
    }
    text + "]\n"
}

fn metric_toml(name: &str, found: &Similarity) -> String {
    format!(
        "# From the camera's metres to the arena by {name}. Residuals {:.2} mm rms.\n[camera]\norigin_x_m = {:?}\norigin_y_m = {:?}\nheading_rad = {:?}\nscale = {:?}\n",
        1e3 * found.rms_m,
        found.origin_m[0],
        found.origin_m[1],
        found.heading_rad,
        found.scale
    )
}

fn table(points: &[CalibrationPoint], found: &CameraFit) -> String {
    let mut table = TextTable::new(["point", "x m", "y m", "off x mm", "off y mm", "others mm"]);
    for (index, (point, residual)) in points.iter().zip(&found.residuals_m).enumerate() {
        let without = found.rms_without_m.get(index);
        table.push([
            (index + 1).to_string(),
            format!("{:.4}", point.floor_m[0]),
            format!("{:.4}", point.floor_m[1]),
            format!("{:+.2}", 1e3 * residual[0]),
            format!("{:+.2}", 1e3 * residual[1]),
            without.map_or_else(|| "-".to_owned(), |m| format!("{:.2}", 1e3 * m)),
        ]);
    }
    table.render()
}

fn outcome(name: &str, points: &[CalibrationPoint], found: &CameraFit) -> ExperimentOutcome {
    let table = table(points, found);
    let mut text = format!("camera by {name}\n\n{table}\nresiduals {:.2} mm rms\n", 1e3 * found.rms_m);
    if points.len() == 4 {
        text += "four points always fit: measure a fifth and a sixth to see how good they are\n";
    }
    if let Some(point) = suspect(found) {
        let _ = writeln!(
            text,
            "warning: without point {point} the others fit {SUSPECT:.0} times better or more: was it mistyped, or its cross taken for another?"
        );
    }
    for [a, b, c] in found.homography.rows {
        let _ = writeln!(text, "[{a:12.6e}, {b:12.6e}, {c:12.6e}]");
    }
    ExperimentOutcome {
        name: "calibrate-camera",
        page: ReportPage {
            title: format!("Camera by {name}"),
            blocks: vec![
                ReportBlock::PreformattedText(text.clone()),
                ReportBlock::Figure {
                    svg: picture(name, points, found),
                    caption: "Known points by tape and by camera.".to_owned(),
                },
            ],
        },
        json: json!({
            "points": points.len(),
            "homography": found.homography.rows,
            "rms_m": found.rms_m,
            "residuals_m": found.residuals_m,
            "rms_without_m": found.rms_without_m,
            "suspect": suspect(found),
        }),
        text,
    }
}

fn picture(name: &str, points: &[CalibrationPoint], found: &CameraFit) -> String {
    let floor = points.iter().map(|p| (p.floor_m[0], p.floor_m[1])).collect();
    let by_camera = points.iter().map(|p| {
        let [x, y] = found.homography.to_floor(p.measured);
        (x, y)
    });
    let curve = |name: &str, points: Vec<(f64, f64)>| Curve { name: name.to_owned(), shape: CurveShape::Dots(points) };
    render_plot(&Plot {
        title: format!("Camera by {name}"),
        key_figures: format!("residuals {:.2} mm rms", 1e3 * found.rms_m),
        axes: vec![Axes {
            x_name: "x [m]".to_owned(),
            y_name: "y [m]".to_owned(),
            height_px: 420.0,
            is_map: true,
            curves: vec![curve("by the tape", floor), curve("by the camera", by_camera.collect())],
        }],
    })
}

fn metric_outcome(name: &str, found: &Similarity) -> ExperimentOutcome {
    let text = format!(
        "camera by {name}\n\norigin ({:.4} m, {:.4} m), x axis at {:.3} degrees, scale {:.5}, residuals {:.2} mm rms\n",
        found.origin_m[0],
        found.origin_m[1],
        found.heading_rad.to_degrees(),
        found.scale,
        1e3 * found.rms_m
    );
    ExperimentOutcome {
        name: "calibrate-camera",
        page: ReportPage {
            title: format!("Camera by {name}"),
            blocks: vec![ReportBlock::PreformattedText(text.clone())],
        },
        json: metric_json(found),
        text,
    }
}

fn metric_json(found: &Similarity) -> Value {
    json!({
        "origin_m": found.origin_m,
        "heading_rad": found.heading_rad,
        "scale": found.scale,
        "rms_m": found.rms_m,
    })
}
