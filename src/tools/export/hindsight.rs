//! The paths in hindsight of an export: those of `--smooth` and `--fixed-lag`.

use anyhow::{Context, Result};
use posebridge_estimator::FilterConfig;
use posebridge_report::TimedPose;
use posebridge_telemetry::{Observation, TimeDelta};

use super::{ExportArgs, Format, RobotPoses, print_written, with_unique_times, write_one};
use crate::console::print_line;
use crate::station::per_robot::file_parts;
use crate::tools::dataset::RobotRun;
use crate::tools::replay::{Hindsight, SmoothedResult};
use crate::tools::score::{PosePair, Scorer};

/// The paths in hindsight that were asked for, with the names of their files.
pub(super) fn hindsights(args: &ExportArgs) -> impl Iterator<Item = (&'static str, Hindsight)> {
    let lag = args.fixed_lag.map(|lag_s| ("fixed-lag", Hindsight::Lag(TimeDelta::from_secs_f64(lag_s))));
    args.smooth.then_some(("smooth", Hindsight::WholeRun)).into_iter().chain(lag)
}

/// A path in hindsight of one robot.
pub(super) struct HindsightPath {
    /// Of the files.
    name: &'static str,
    path: SmoothedResult,
    /// A descriptor's run at the instants of its truth or withheld fixes.
    pairs: Option<Vec<PosePair>>,
}

/// The paths that were asked for; says why there is none.
pub(super) fn hindsight_paths(
    args: &ExportArgs,
    label: &str,
    config: &FilterConfig,
    observations: &[Observation],
    data: Option<&RobotRun>,
) -> Result<Vec<HindsightPath>> {
    let mut paths = Vec::new();
    for (name, hindsight) in hindsights(args) {
        let path = SmoothedResult::new(config, observations, hindsight)
            .with_context(|| format!("{label}: there is no path to write"))?;
        if let Some(shortfall) = path.shortfall() {
            print_line(&format!("{label}: not converged: {shortfall}"));
        }
        let pairs = data.map(|data| {
            let mut scorer = Scorer::new(&data.run, &config.calibration);
            scorer.finish(&path);
            scorer.pairs
        });
        paths.push(HindsightPath { name, path, pairs });
    }
    Ok(paths)
}

/// Writes `NAME.tum`, where there is truth at the instants of that, and `NAME.csv`; with several robots `NAME-ROBOT.tum` each.
pub(super) fn write_hindsight(args: &ExportArgs, robots: &[RobotPoses]) -> Result<()> {
    let labels = robots.iter().map(|robot| robot.label.as_deref().unwrap_or_default());
    for (robot, part) in robots.iter().zip(file_parts(labels)) {
        let suffix = robot.label.as_ref().map_or_else(String::new, |_| format!("-{part}"));
        for HindsightPath { name, path, pairs } in &robot.hindsight {
            let name = format!("{name}{suffix}");
            if args.formats.contains(&Format::Csv) {
                write_hindsight_csv(args, &name, path)?;
            }
            if args.formats.contains(&Format::Tum) {
                let own = path.estimates().map(|estimate| TimedPose { time: estimate.stamp, pose: estimate.pose });
                let poses = match (pairs, &robot.truth) {
                    (Some(pairs), _) => {
                        pairs.iter().map(|pair| TimedPose { time: pair.time, pose: pair.estimated }).collect()
                    }
                    (None, Some(truth)) => own.filter(|at| truth.at(at.time).is_some()).collect::<Vec<_>>(),
                    (None, None) => own.collect(),
                };
                write_one(args, &name, &with_unique_times(poses.into_iter()))?;
            }
        }
    }
    Ok(())
}

/// The covariance is that of x, y and heading.
fn write_hindsight_csv(args: &ExportArgs, name: &str, path: &SmoothedResult) -> Result<()> {
    let file = args.out.join(format!("{name}.csv"));
    let mut table = csv::Writer::from_path(&file).with_context(|| format!("creating `{}`", file.display()))?;
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
    print_written(&file, lines, "lines");
    Ok(())
}
