//! `posebridge calibrate camera`: calibrates an overhead camera to the floor.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use posebridge_lab::calibration::camera::{CalibrationPoint, CameraFit, Similarity, fit_homography, fit_similarity};
use posebridge_report::chart::{Axes, Curve, Plot};
use posebridge_report::quantity::{Format, Quantity, Unit};
use posebridge_report::report::{Report, Table};
use serde_json::json;

use crate::exit::{ExitStage, Failure};
use crate::tools::csv_table::CsvTable;
use crate::tools::experiment_output::OutputArgs;

/// Improvement of the fit without one point that makes the point suspect.
const SUSPECT: f64 = 3.0;

const RESIDUAL: Format = Format::new(Unit::Millimetres, 2);

/// Flags of `calibrate camera`.
#[derive(Args, Clone, Debug)]
pub struct CameraArgs {
    /// CSV table of at least four points with the columns u, v (position in the image) and x_m, y_m (position on the floor).
    pub points: PathBuf,
    /// The camera measures in metres: estimate only rotation, translation and scale. Two points are enough.
    #[arg(long)]
    pub metric: bool,
    /// Write the result to this file.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub(super) fn execute(args: &CameraArgs) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let points = read(&args.points).before_start()?;
    let name = args.points.display().to_string();
    let context = || format!("points `{name}`");
    let (report, numbers) = if args.metric {
        let found = fit_similarity(&points).with_context(context).while_running()?;
        (metric_report(&name, &found), metric_toml(&name, &found))
    } else {
        let found = fit_homography(&points).with_context(context).while_running()?;
        (report(&name, &points, &found), toml_of(&name, &points, &found))
    };
    if let Some(path) = &args.save {
        std::fs::write(path, numbers).with_context(|| format!("writing `{}`", path.display())).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
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

fn report(name: &str, points: &[CalibrationPoint], found: &CameraFit) -> Report {
    let mut report = Report::new("calibrate-camera", format!("Camera by {name}"));
    report.values([Quantity::new("rms_m", "residuals rms", found.rms_m, RESIDUAL)]);
    if points.len() == 4 {
        report.warning("four points always fit: measure a fifth and a sixth to see how good they are");
    }
    if let Some(point) = suspect(found) {
        report.warning(format!(
            "without point {point} the others fit {SUSPECT:.0} times better or more: was it mistyped, or its cross taken for another?"
        ));
    }
    let rows: Vec<_> = points.iter().zip(&found.residuals_m).enumerate().collect();
    let metres = Format::new(Unit::Named("m"), 4);
    let table = Table::of(&rows)
        .count("", "point", |(index, _)| index + 1)
        .number("", "x", metres, |(_, (point, _))| Some(point.floor_m[0]))
        .number("", "y", metres, |(_, (point, _))| Some(point.floor_m[1]))
        .number("", "off x", RESIDUAL.signed(), |(_, (_, residual))| Some(residual[0]))
        .number("", "off y", RESIDUAL.signed(), |(_, (_, residual))| Some(residual[1]))
        .number("", "others", RESIDUAL, |(index, _)| found.rms_without_m.get(*index).copied());
    report.table("", &table);
    let rows = found.homography.rows.map(|[a, b, c]| format!("[{a:12.6e}, {b:12.6e}, {c:12.6e}]"));
    report.code(rows.join("\n"));
    report.chart(&plot(name, points, found), "Known points by tape and by camera.");
    report.data("points", json!(points.len()));
    report.data("homography", json!(found.homography.rows));
    report.data("residuals_m", json!(found.residuals_m));
    report.data("rms_without_m", json!(found.rms_without_m));
    report.data("suspect", json!(suspect(found)));
    report
}

fn plot(name: &str, points: &[CalibrationPoint], found: &CameraFit) -> Plot {
    let floor = points.iter().map(|p| (p.floor_m[0], p.floor_m[1]));
    let by_camera = points.iter().map(|p| {
        let [x, y] = found.homography.to_floor(p.measured);
        (x, y)
    });
    Plot::new(
        format!("Camera by {name}"),
        format!("residuals {:.2} mm rms", 1e3 * found.rms_m),
        vec![
            Axes::new(
                "x [m]",
                "y [m]",
                420.0,
                [Curve::dots("by the tape", floor), Curve::dots("by the camera", by_camera)],
            )
            .with_equal_scales(),
        ],
    )
}

fn metric_report(name: &str, found: &Similarity) -> Report {
    let [x_m, y_m] = found.origin_m;
    let metres = Format::new(Unit::Named("m"), 4);
    let mut report = Report::new("calibrate-camera", format!("Camera by {name}"));
    report.values([
        Quantity::new("", "origin x", x_m, metres),
        Quantity::new("", "origin y", y_m, metres),
        Quantity::new("heading_rad", "direction of the x axis", found.heading_rad, Format::new(Unit::Degrees, 3)),
        Quantity::new("scale", "scale", found.scale, Format::new(Unit::None, 5)),
        Quantity::new("rms_m", "residuals rms", found.rms_m, RESIDUAL),
    ]);
    report.data("origin_m", json!(found.origin_m));
    report
}
