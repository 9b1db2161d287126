//! Simulated drives as tables of sensor readings, and every method over them, on all cores.

use anyhow::Result;
use posebridge_estimator::FilterConfig;
use posebridge_estimator::papers::paper1::WheelMatrices;
use posebridge_lab::square::{
    ErrorMetric, MeasuredPose, Method, MethodGroup, PathErrors, RecoveryTrial, SensorRow, SensorTable, TableSensor,
    add_compass, add_jitter, align_accelerations, delay_reference, outlook, path_errors, prepare_config, printed_chain,
    swapped_chain,
};
use posebridge_sim::montecarlo::{Camera, CameraSees, Course, Laps, Scenario, ScenarioError, StampErrors};
use posebridge_telemetry::{Calibration, Heading, Pose};

use crate::lab::drives;
use crate::lab::parallel::run_cases;

const SCENARIO: &str = "paper-square";
/// The overhead camera: it is the paper's ground truth, so it has a fix for every sample. Its noise is that of a printed tag under a
/// webcam, as in the other scenarios.
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
    bias_sigma_m: 0.0,
    patches: None,
    bursts: None,
    stamps: StampErrors::NONE,
};
/// The compass sigma in the filter's configuration: noise and deviation together, see docs/lab/square.md.
const COMPASS_SIGMA_DEG: f64 = 5.0;

pub(super) fn scenario(seed: u64) -> Result<Scenario, ScenarioError> {
    let mut scenario = Scenario::bundled(SCENARIO)?.with_seed(seed);
    scenario.camera = Some(CAMERA);
    Ok(scenario)
}

pub(super) fn filter_config(scenario: &Scenario) -> FilterConfig {
    let told = drives::drawn_config(&scenario.drive(0).prior);
    let mut noise = told.noise;
    noise.compass_rad = COMPASS_SIGMA_DEG.to_radians();
    let calibration =
        Calibration { gyro_bias_rad_per_s: Calibration::default().gyro_bias_rad_per_s, ..told.calibration };
    FilterConfig { noise, start: None, calibration, ..told }
}

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

/// Seed of the random numbers outside the drive itself.
fn seed_of(scenario: &Scenario, run: u32) -> u64 {
    scenario.seed.wrapping_mul(0x9e37_79b9).wrapping_add(u64::from(run))
}

pub(super) fn errors_of(
    table: &SensorTable,
    base: &FilterConfig,
    methods: &[Method],
    camera_every: usize,
) -> Vec<PathErrors> {
    let config = prepare_config(table, base);
    methods.iter().map(|method| path_errors(table, &method.run(table, &config, camera_every), camera_every)).collect()
}

pub(super) struct MethodSeries {
    pub(super) scenario: Scenario,
    pub(super) base: FilterConfig,
    pub(super) methods: Vec<Method>,
    pub(super) adjust: fn(&mut SensorTable, u64),
}

pub(super) fn all_errors(series: &[MethodSeries], runs: u32, camera_every: usize) -> Result<Vec<Vec<Vec<PathErrors>>>> {
    run_cases(
        series,
        |_| runs,
        "drives",
        |series, run| {
            let mut table = table(&series.scenario, run);
            (series.adjust)(&mut table, seed_of(&series.scenario, run));
            errors_of(&table, &series.base, &series.methods, camera_every)
        },
    )
}

// A start that is wrong.

/// Errors of the heading at the start, degrees.
const START_ERRORS_DEG: [f64; 3] = [0.0, 60.0, 150.0];
/// What the filters are told of that heading, rad.
const START_HEADING_SIGMA: f64 = 0.1;

/// The filters with a camera over the drives, whose images have no heading, with a wrong heading at the start.
pub(super) fn recoveries(scenario: &Scenario, runs: u32, camera_every: usize) -> Result<Vec<RecoveryTrial>> {
    let methods: Vec<Method> =
        outlook().methods.into_iter().filter(|method| method.sensors.contains(&TableSensor::Camera)).collect();
    let base = filter_config(scenario);
    let ends = |start_error_deg: &f64, run: u32| -> Vec<Option<f64>> {
        let mut table = table(scenario, run);
        for row in &mut table.rows {
            row.compass_deg = None;
            if let Some(camera) = &mut row.camera {
                camera.theta_deg = None;
            }
        }
        let mut config = prepare_config(&table, &base);
        if let Some(start) = &mut config.start {
            let heading_rad = start.pose.heading.rad() + start_error_deg.to_radians();
            start.pose = Pose::new(start.pose.x, start.pose.y, Heading::from_rad(heading_rad));
            start.heading_sigma_rad = START_HEADING_SIGMA;
        }
        let end_m =
            |method: &Method| path_errors(&table, &method.run(&table, &config, camera_every), camera_every).end_m;
        methods.iter().map(end_m).collect()
    };
    let found = run_cases(&START_ERRORS_DEG, |_| runs, "drives", ends)?;
    let trials = START_ERRORS_DEG.iter().zip(found).flat_map(|(start_error_deg, runs)| {
        let of_method = |(index, method): (usize, &Method)| {
            let ends_m: Vec<Option<f64>> = runs.iter().map(|run| run.get(index).copied().flatten()).collect();
            RecoveryTrial::new(method.name, *start_error_deg, &ends_m)
        };
        methods.iter().enumerate().map(of_method).collect::<Vec<_>>()
    });
    Ok(trials.collect())
}

// Other ways to read the paper: what its robot, its sensors or its measure of error may have been.
//
// Nothing is tuned for one filter: each reading changes the world or what is compared, for all of them alike.

pub(super) struct Variation {
    pub(super) name: &'static str,
    pub(super) note: &'static str,
    pub(super) metric: ErrorMetric,
    alter: fn(&mut Scenario),
    adjust: fn(&mut SensorTable, u64),
    chain: fn() -> MethodGroup,
}

const fn unchanged_scenario(_scenario: &mut Scenario) {}

pub(super) const fn unchanged_table(_table: &mut SensorTable, _seed: u64) {}

impl Variation {
    const fn new(name: &'static str, metric: ErrorMetric, note: &'static str) -> Self {
        Self { name, note, metric, alter: unchanged_scenario, adjust: unchanged_table, chain: printed_chain }
    }

    const fn with_scenario(mut self, alter: fn(&mut Scenario)) -> Self {
        self.alter = alter;
        self
    }

    const fn with_table(mut self, adjust: fn(&mut SensorTable, u64)) -> Self {
        self.adjust = adjust;
        self
    }

    const fn with_chain(mut self, chain: fn() -> MethodGroup) -> Self {
        self.chain = chain;
        self
    }

    pub(super) fn series(&self, scenario: &Scenario) -> MethodSeries {
        let mut scenario = scenario.clone();
        (self.alter)(&mut scenario);
        MethodSeries { base: filter_config(&scenario), scenario, methods: (self.chain)().methods, adjust: self.adjust }
    }
}

fn laps(scenario: &mut Scenario, change: fn(&mut Laps)) {
    if let Course::Laps(laps) = &mut scenario.path {
        change(laps);
    }
}

/// The spread of an uncalibrated LEGO robot, as in the other scenarios.
fn uncalibrated(scenario: &mut Scenario) {
    scenario.errors.radius_scale_sigma = 0.005;
    scenario.errors.radius_difference_sigma = 0.005;
    scenario.errors.track_scale_sigma = 0.03;
}

/// A MEMS gyro: 0.1 deg/s, no rounding, little walk.
fn good_gyro(scenario: &mut Scenario) {
    scenario.gyro.resolution_deg_per_s = 0.0;
    scenario.gyro.sigma_deg_per_s = 0.1;
    scenario.gyro.bias_walk_deg_per_s_sqrt_s = 0.001;
}

fn good_accelerometers(scenario: &mut Scenario) {
    if let Some(accelerometer) = &mut scenario.accelerometer {
        accelerometer.sigma_m_per_s2 = 0.01;
    }
}

fn exact_and_coarse(scenario: &mut Scenario) {
    scenario.errors.radius_scale_sigma = 0.0;
    scenario.errors.radius_difference_sigma = 0.0;
    scenario.errors.track_scale_sigma = 0.0;
    scenario.motion.wheel_travel_m_per_sqrt_m = 0.0;
    scenario.motion.turn_rad_per_sqrt_rad = 0.0;
    scenario.robot.tick_deg = 10.0;
}

fn slippery(scenario: &mut Scenario) {
    scenario.motion.wheel_travel_m_per_sqrt_m *= 5.0;
    scenario.motion.turn_rad_per_sqrt_rad *= 5.0;
}

/// Speed ramps of two seconds.
fn gentle(scenario: &mut Scenario) {
    laps(scenario, |laps| laps.ramp_steps = 40);
}

/// White noise of the counter variance in the paper's equation 19.
fn noisy_counters(table: &mut SensorTable, seed: u64) {
    add_jitter(table, WheelMatrices::AS_PRINTED.variances, seed);
}

/// Delay of an uncorrected camera in rows of 0.05 s: 0.3 s, the upper end for a webcam with image processing.
const LATE_ROWS: usize = 6;

fn late_camera(table: &mut SensorTable, _seed: u64) {
    delay_reference(table, LATE_ROWS);
}

fn in_its_interval(table: &mut SensorTable, _seed: u64) {
    align_accelerations(table);
}

pub(super) const VARIATIONS: &[Variation] = &[
    Variation::new("the end", ErrorMetric::End, "where the robot is after the lap, instead of the whole way"),
    Variation::new("heading", ErrorMetric::Heading, "the heading instead of the position"),
    Variation::new("forward speed", ErrorMetric::Forward, "figure 6 instead of figure 7"),
    Variation::new("turn rate", ErrorMetric::Turn, "figure 6 instead of figure 7"),
    Variation::new("Q swapped", ErrorMetric::Position, "the last two numbers of Q in the order of equation 24")
        .with_chain(swapped_chain),
    Variation::new(
        "own interval",
        ErrorMetric::Position,
        "each acceleration acts in the interval in which it was felt, not in the next one as in equation 20",
    )
    .with_table(in_its_interval),
    Variation::new(
        "not calibrated",
        ErrorMetric::Position,
        "wheels 0.5 % and track 3 % off, as before the calibration of Michel and Rohrer",
    )
    .with_scenario(uncalibrated),
    Variation::new(
        "not calibrated, long rest",
        ErrorMetric::Position,
        "the same, and the gyro zeroed over 30 s at rest",
    )
    .with_scenario(|scenario| {
        uncalibrated(scenario);
        laps(scenario, |laps| laps.rest_s = 30.0);
    }),
    Variation::new(
        "not calibrated, good gyro",
        ErrorMetric::Position,
        "the same with a gyro of 0.1 deg/s that does not round",
    )
    .with_scenario(|scenario| {
        uncalibrated(scenario);
        good_gyro(scenario);
    }),
    Variation::new("slippery floor", ErrorMetric::Position, "five times the slip").with_scenario(slippery),
    Variation::new(
        "coarse counts",
        ErrorMetric::Position,
        "an exact robot without slip whose encoders count 10 degrees",
    )
    .with_scenario(exact_and_coarse),
    Variation::new(
        "late camera",
        ErrorMetric::Position,
        "the camera that is the truth is 0.3 s late and nobody took that out",
    )
    .with_table(late_camera),
    Variation::new(
        "late camera, good gyro",
        ErrorMetric::Position,
        "the same with a gyro of 0.1 deg/s and accelerometers of 0.01 m/s^2",
    )
    .with_scenario(|scenario| {
        good_gyro(scenario);
        good_accelerometers(scenario);
    })
    .with_table(late_camera),
    Variation::new(
        "noisy counters",
        ErrorMetric::Position,
        "counters as noisy as the paper's R says: 1.5 and 2.5 deg^2, white",
    )
    .with_table(noisy_counters),
    Variation::new("noisy counters, turn rate", ErrorMetric::Turn, "the same, figure 6 instead of figure 7")
        .with_table(noisy_counters),
    Variation::new(
        "noisy counters, turn rate, gentle",
        ErrorMetric::Turn,
        "the same, with speeds that rise and fall over 2 s instead of 0.3 s",
    )
    .with_scenario(gentle)
    .with_table(noisy_counters),
    Variation::new(
        "noisy counters, forward speed",
        ErrorMetric::Forward,
        "noisy counters, figure 6 instead of figure 7",
    )
    .with_table(noisy_counters),
    Variation::new(
        "noisy counters, forward speed, gentle",
        ErrorMetric::Forward,
        "the same, with speeds that rise and fall over 2 s, Q swapped and accelerometers of 0.01 m/s^2",
    )
    .with_scenario(|scenario| {
        gentle(scenario);
        good_accelerometers(scenario);
    })
    .with_table(noisy_counters)
    .with_chain(swapped_chain),
];
