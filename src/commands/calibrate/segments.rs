//! Drives that were measured with a tape: wheel distances before and after each part, and where the robot then stood.

use std::path::Path;

use anyhow::{Result, ensure};
use posebridge_analysis::calibration::free_path::{FreePath, PathStart, Sight, Step};
use posebridge_estimator::models::differential_drive::WheelTravel;

use super::listing::{Listing, Row};

/// How well a person puts a robot onto its start line, in radians.
const PLACED_RAD: f64 = 0.03;
/// And onto its start point, in metres.
const PLACED_M: f64 = 0.01;

/// Reads a table of the columns `run`, `left_before_mm`, `left_after_mm`, `right_before_mm`, `right_after_mm`, `measured_x_mm` and
/// `measured_y_mm`: one row per part of a drive, in order. Every run begins at the origin and looks along x.
///
/// The parts take a second each, as good as any other time: only their order counts.
pub(super) fn read(path: &Path, sigma_m: f64) -> Result<Vec<FreePath>> {
    let listing = Listing::read(path)?;
    let mut paths: Vec<FreePath> = Vec::new();
    for row in listing.rows() {
        let run = row.text("run")?;
        if paths.last().is_none_or(|path| path.name != run) {
            ensure!(
                paths.iter().all(|path| path.name != run),
                "{}: run `{run}` begins again; its rows must stand together",
                row.place()
            );
            paths.push(begun(run, sigma_m));
        }
        let Some(path) = paths.last_mut() else {
            continue;
        };
        add(path, &row, sigma_m)?;
    }
    ensure!(!paths.is_empty(), "`{}` has a first line and no rows", path.display());
    Ok(paths)
}

fn begun(run: &str, sigma_m: f64) -> FreePath {
    FreePath {
        name: run.to_owned(),
        start: PathStart { pose: [0.0; 3], position_sigma_m: PLACED_M, heading_sigma_rad: PLACED_RAD },
        steps: Vec::new(),
        sights: vec![Sight { at_s: 0.0, place_m: [0.0; 2], sigma_m, tag_m: [0.0; 2] }],
    }
}

fn add(path: &mut FreePath, row: &Row<'_>, sigma_m: f64) -> Result<()> {
    let metres = |column: &str| row.number(column).map(|mm| mm * 1e-3);
    let from_s = path.steps.len() as f64;
    path.steps.push(Step {
        from_s,
        until_s: from_s + 1.0,
        travel: WheelTravel {
            left_m: metres("left_after_mm")? - metres("left_before_mm")?,
            right_m: metres("right_after_mm")? - metres("right_before_mm")?,
        },
    });
    path.sights.push(Sight {
        at_s: from_s + 1.0,
        place_m: [metres("measured_x_mm")?, metres("measured_y_mm")?],
        sigma_m,
        tag_m: [0.0; 2],
    });
    Ok(())
}
