//! A smoothed path as CSV.

use std::path::Path;

use anyhow::{Context, Result};

use crate::tools::replay::SmoothedResult;

/// Writes a line for each pose, with the covariance of x, y and heading, and returns their number.
pub(super) fn write_path_csv(file: &Path, path: &SmoothedResult) -> Result<u64> {
    let mut table = csv::Writer::from_path(file).with_context(|| format!("creating `{}`", file.display()))?;
    table.write_record([
        "t_s",
        "x_m",
        "y_m",
        "heading_rad",
        "var_x_m2",
        "cov_x_y_m2",
        "cov_x_heading_m_rad",
        "var_y_m2",
        "cov_y_heading_m_rad",
        "var_heading_rad2",
    ])?;
    let mut lines = 0;
    for estimate in path.estimates() {
        let (pose, p) = (estimate.pose, &estimate.covariance);
        let numbers = [pose.x.0, pose.y.0, pose.heading.rad(), p[0][0], p[0][1], p[0][2], p[1][1], p[1][2], p[2][2]];
        let stamp = format!("{:.9}", estimate.stamp.as_secs_f64());
        table.write_record(std::iter::once(stamp).chain(numbers.map(|number| number.to_string())))?;
        lines += 1;
    }
    table.flush().with_context(|| format!("writing `{}`", file.display()))?;
    Ok(lines)
}
