//! Simulated drives as tables of sensor readings, and every method over them, on all cores.

use posebridge_estimator::{FilterConfig, Params};
use posebridge_lab::square::{
    MeasuredPose, Method, PathErrors, SensorRow, SensorTable, add_compass, path_errors, prepare_config,
};
use posebridge_sim::montecarlo::{Camera, CameraSees, Scenario, ScenarioError};
use posebridge_telemetry::Calibration;

use crate::lab::parallel::run_all;

/// The scenario of the paper's square.
const SCENARIO: &str = "paper-square";
/// The zenithal camera: it is the paper's truth, so it sees the robot at every sample. Its noise is that of a printed tag
/// under a webcam, as in the other scenarios.
const CAMERA: Camera = Camera {
    sees: CameraSees::Pose,
    every_steps: 1,
    delay_steps: 0,
    delay_spread_steps: 0,
    position_sigma_m: 0.005,
    heading_sigma_deg: 1.0,
    true_noise_factor: 1.0,
    outliers: None,
    blackout: None,
};
/// The sigma of the compass that filters get, in degrees: noise and deviation together, see docs/lab/square.md.
const COMPASS_SIGMA_DEG: f64 = 5.0;

/// The square of the paper, with its camera.
///
/// # Errors
/// Never: the scenario is bundled.
pub(super) fn scenario(seed: u64) -> Result<Scenario, ScenarioError> {
    let mut scenario = Scenario::bundled(SCENARIO)?.with_seed(seed);
    scenario.camera = Some(CAMERA);
    Ok(scenario)
}

/// The filter configuration for the robot of a scenario.
pub(super) fn filter_config(scenario: &Scenario) -> FilterConfig {
    let prior = scenario.drive(0).prior;
    let mut noise = prior.noise;
    noise.compass_rad = COMPASS_SIGMA_DEG.to_radians();
    FilterConfig {
        geometry: prior.geometry,
        noise,
        start: None,
        params: Params::default(),
        calibration: Calibration {
            gyro_bias_rad_per_s: Calibration::default().gyro_bias_rad_per_s,
            ..prior.calibration
        },
        arena_map: std::sync::Arc::default(),
    }
}

/// One drive as its brick would have logged it.
pub(super) fn table(scenario: &Scenario, run: u32) -> SensorTable {
    let drive = scenario.drive(run);
    let tick_rad = drive.prior.geometry.tick.0;
    let rows = drive.truth.iter().enumerate().map(|(step, truth)| SensorRow {
        truth: Some(MeasuredPose::from_pose(*truth)),
        ..SensorRow::empty(drive.time_at(step))
    });
    let mut table = SensorTable { rows: rows.collect(), ..SensorTable::default() };
    for arrival in &drive.arrivals {
        if let Some(row) = table.rows.get_mut(arrival.step) {
            row.record(&arrival.observation.measurement, tick_rad);
        }
    }
    add_compass(&mut table, seed_of(scenario, run));
    table
}

/// For what the drives themselves do not draw.
fn seed_of(scenario: &Scenario, run: u32) -> u64 {
    scenario.seed.wrapping_mul(0x9e37_79b9).wrapping_add(u64::from(run))
}

/// Methods over one table.
pub(super) fn errors_of(
    table: &SensorTable,
    base: &FilterConfig,
    methods: &[Method],
    camera_every: usize,
) -> Vec<PathErrors> {
    let config = prepare_config(table, base);
    methods.iter().map(|method| path_errors(table, &method.run(table, &config, camera_every), camera_every)).collect()
}

/// Drives of one kind, and what runs over them.
pub(super) struct MethodSeries {
    /// What is driven.
    pub(super) scenario: Scenario,
    /// What filters know of it.
    pub(super) base: FilterConfig,
    /// What runs.
    pub(super) methods: Vec<Method>,
    /// What is done to each table before.
    pub(super) adjust: fn(&mut SensorTable, u64),
}

/// The errors of every method over every drive of every series; `ended` is called after each drive.
pub(super) fn all_errors(
    series: &[MethodSeries],
    runs: u32,
    camera_every: usize,
    ended: impl FnMut(),
) -> Vec<Vec<Vec<PathErrors>>> {
    let jobs: Vec<(usize, u32)> = (0..series.len()).flat_map(|index| (0..runs).map(move |run| (index, run))).collect();
    let run = |&(index, run): &(usize, u32)| {
        let series = series.get(index)?;
        let mut table = table(&series.scenario, run);
        (series.adjust)(&mut table, seed_of(&series.scenario, run));
        Some(errors_of(&table, &series.base, &series.methods, camera_every))
    };
    let mut by_series: Vec<Vec<Vec<PathErrors>>> = series.iter().map(|_| Vec::new()).collect();
    for ((index, _), errors) in jobs.iter().zip(run_all(&jobs, run, ended)) {
        if let (Some(list), Some(errors)) = (by_series.get_mut(*index), errors) {
            list.push(errors);
        }
    }
    by_series
}
