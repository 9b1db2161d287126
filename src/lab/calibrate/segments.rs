//! Drives that were measured with a tape: wheel distances before and after each part, and where the robot then stood.

use std::path::Path;

use anyhow::{Result, ensure};
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_lab::calibration::free_path::{FreePath, PathStart, PositionFix, TravelStep};

use crate::tools::csv_table::{CsvRow, CsvTable};

/// How well a person puts a robot onto its start line, in radians.
const START_HEADING_SIGMA_RAD: f64 = 0.03;
/// And onto its start point, in metres.
const START_POSITION_SIGMA_M: f64 = 0.01;

/// Reads a table of the columns `run`, `left_before_mm`, `left_after_mm`, `right_before_mm`, `right_after_mm`, `measured_x_mm` and
/// `measured_y_mm`: one row per part of a drive, in order. Every run begins at the origin and looks along x.
///
/// The parts take a second each, as good as any other time: only their order counts.
pub(super) fn read(path: &Path, sigma_m: f64) -> Result<Vec<FreePath>> {
    let listing = CsvTable::read(path)?;
    let mut paths: Vec<FreePath> = Vec::new();
    for row in listing.rows() {
        let run = row.text("run")?;
        if paths.last().is_none_or(|path| path.name != run) {
            ensure!(
                paths.iter().all(|path| path.name != run),
                "{}: run `{run}` begins again; its rows must stand together",
                row.location()
            );
            paths.push(new_path(run, sigma_m));
        }
        let Some(path) = paths.last_mut() else {
            continue;
        };
        add_segment(path, &row, sigma_m)?;
    }
    ensure!(!paths.is_empty(), "`{}` has a first line and no rows", path.display());
    Ok(paths)
}

fn new_path(run: &str, sigma_m: f64) -> FreePath {
    FreePath {
        name: run.to_owned(),
        start: PathStart {
            pose: [0.0; 3],
            position_sigma_m: START_POSITION_SIGMA_M,
            heading_sigma_rad: START_HEADING_SIGMA_RAD,
        },
        steps: Vec::new(),
        fixes: vec![PositionFix { at_s: 0.0, position_m: [0.0; 2], sigma_m, tag_m: [0.0; 2] }],
    }
}

fn add_segment(path: &mut FreePath, row: &CsvRow<'_>, sigma_m: f64) -> Result<()> {
    let metres = |column: &str| row.number(column).map(|mm| mm * 1e-3);
    let from_s = path.steps.len() as f64;
    path.steps.push(TravelStep {
        from_s,
        until_s: from_s + 1.0,
        travel: WheelTravel {
            left_m: metres("left_after_mm")? - metres("left_before_mm")?,
            right_m: metres("right_after_mm")? - metres("right_before_mm")?,
        },
    });
    path.fixes.push(PositionFix {
        at_s: from_s + 1.0,
        position_m: [metres("measured_x_mm")?, metres("measured_y_mm")?],
        sigma_m,
        tag_m: [0.0; 2],
    });
    Ok(())
}
