//! Squares for UMBmark: ends that a person typed, recorded drives, or the simulated robot.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_estimator::{FilterConfig, StartPose};
use posebridge_lab::calibration::free_path::{FreePath, PositionFix, seconds};
use posebridge_lab::calibration::umbmark::{SquareDirection, SquareRun};
use posebridge_sim::montecarlo::{Course, Drive, Scenario};
use posebridge_telemetry::{ArenaMap, DriveGeometry, Observation};

use crate::config::{FilterSection, RobotFile, filter_config};
use crate::tools::csv_table::CsvTable;

/// The simulated squares; every number stands there with its meaning.
const SCENARIO: &str = include_str!("../../../config/calibrate/umbmark.toml");
/// Truth of the simulation, in metres: exact, but no sight may be.
const EXACT_M: f64 = 1e-4;

/// Ends of squares, measured minus odometry, from the columns `direction` (cw or ccw), `x_mm`, `y_mm` and, if the brick showed
/// something else than home, `odometry_x_mm`, `odometry_y_mm`.
pub(super) fn read_squares(path: &Path) -> Result<Vec<SquareRun>> {
    let listing = CsvTable::read(path)?;
    let has_odometry = listing.has("odometry_x_mm") || listing.has("odometry_y_mm");
    let runs = listing.rows().map(|row| {
        let direction = match row.text("direction")? {
            "cw" => SquareDirection::Clockwise,
            "ccw" => SquareDirection::CounterClockwise,
            other => bail!("{}: `{other}` in column `direction` is neither cw nor ccw", row.location()),
        };
        let off = |measured: &str, odometry: &str| -> Result<f64> {
            let shown = if has_odometry { row.number(odometry)? } else { 0.0 };
            Ok(1e-3 * (row.number(measured)? - shown))
        };
        Ok(SquareRun { direction, ahead_m: off("x_mm", "odometry_x_mm")?, left_m: off("y_mm", "odometry_y_mm")? })
    });
    runs.collect()
}

/// Squares that the simulated robot drove.
pub(super) struct SimulatedSquares {
    pub(super) robot: RobotFile,
    pub(super) config: FilterConfig,
    /// To calibrate by.
    pub(super) squares: Vec<FreePath>,
    /// To try the result on.
    pub(super) others: Vec<FreePath>,
    pub(super) true_geometry: DriveGeometry,
    pub(super) side_m: f64,
}

/// Drives `runs` squares in each direction, and four times as many for trying.
pub(super) fn simulate(runs: u32, seed: Option<u64>) -> Result<SimulatedSquares> {
    let mut scenario = Scenario::from_toml(SCENARIO).context("the bundled squares")?;
    let Course::Laps(laps) = &mut scenario.path else { bail!("the bundled squares are no laps") };
    laps.laps = 2 * runs * 5;
    let (laps, step_s) = (*laps, scenario.step_s);
    if let Some(seed) = seed {
        scenario = scenario.with_seed(seed);
    }
    let drive = scenario.drive(0);
    let prior = drive.prior;
    let robot = RobotFile {
        left_wheel_radius_m: prior.geometry.left_wheel_radius.0,
        right_wheel_radius_m: prior.geometry.right_wheel_radius.0,
        track_width_m: prior.geometry.track_width.0,
        ..RobotFile::default()
    };
    let config = filter_config(&robot, &FilterSection::default(), ArenaMap::default())?;
    let rest_steps = (laps.rest_s / step_s).round() as usize;
    let steps = drive.truth.len().saturating_sub(1 + rest_steps);
    let lap_steps = steps / laps.laps as usize;
    ensure!(lap_steps > 0 && lap_steps * laps.laps as usize == steps, "the simulated laps are not alike");
    let mut squares: Vec<FreePath> = (0..laps.laps as usize)
        .map(|lap| {
            let first = rest_steps + lap * lap_steps;
            cut_lap(&drive, &config, first, first + lap_steps)
        })
        .collect::<Result<_>>()?;
    let others = squares.split_off(2 * runs as usize);
    Ok(SimulatedSquares { robot, config, squares, others, true_geometry: drive.true_geometry, side_m: laps.side_m })
}

fn cut_lap(drive: &Drive, config: &FilterConfig, first: usize, last: usize) -> Result<FreePath> {
    let start = drive.truth.get(first).ok_or_else(|| anyhow!("a simulated lap begins after its drive"))?;
    let config = FilterConfig {
        start: Some(StartPose { pose: *start, position_sigma_m: EXACT_M, heading_sigma_rad: EXACT_M }),
        ..config.clone()
    };
    let observations: Vec<Observation> = drive
        .arrivals
        .iter()
        .filter(|arrival| (first..=last).contains(&arrival.step))
        .map(|arrival| arrival.observation)
        .collect();
    let sights = (first..=last).filter_map(|step| {
        let pose = drive.truth.get(step)?;
        Some(PositionFix {
            at_s: seconds(drive.time_at(step)),
            position_m: [pose.x.0, pose.y.0],
            sigma_m: EXACT_M,
            tag_m: [0.0; 2],
        })
    });
    let name = format!("steps {first} to {last}");
    Ok(FreePath::new(&name, &config, &observations, sights))
}
