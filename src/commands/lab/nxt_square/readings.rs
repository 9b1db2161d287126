//! Other ways to read the paper: what its robot, its sensors or its measure of error may have been.
//!
//! Nothing is tuned for one filter: each reading changes the world or what is compared, for all of them alike.

use posebridge_analysis::square::{
    Method, Metric, SensorTable, WheelMatrices, add_jitter, feel_in_its_interval, make_reference_late, printed, swapped,
};
use posebridge_sim::montecarlo::{Course, Laps, Scenario};

use super::drives::{Series, told};

/// One way to read it.
pub(super) struct Variation {
    pub(super) name: &'static str,
    pub(super) note: &'static str,
    pub(super) metric: Metric,
    alter: fn(&mut Scenario),
    adjust: fn(&mut SensorTable, u64),
    methods: fn() -> Vec<Method>,
}

const fn as_it_is(_scenario: &mut Scenario) {}

pub(super) const fn untouched(_table: &mut SensorTable, _seed: u64) {}

impl Variation {
    const fn of(name: &'static str, metric: Metric, note: &'static str) -> Self {
        Self { name, note, metric, alter: as_it_is, adjust: untouched, methods: printed }
    }

    const fn in_world(mut self, alter: fn(&mut Scenario)) -> Self {
        self.alter = alter;
        self
    }

    const fn on_table(mut self, adjust: fn(&mut SensorTable, u64)) -> Self {
        self.adjust = adjust;
        self
    }

    const fn with(mut self, methods: fn() -> Vec<Method>) -> Self {
        self.methods = methods;
        self
    }

    /// The drives of this reading.
    pub(super) fn series(&self, scenario: &Scenario) -> Series {
        let mut scenario = scenario.clone();
        (self.alter)(&mut scenario);
        Series { base: told(&scenario), scenario, methods: (self.methods)(), adjust: self.adjust }
    }
}

fn laps(scenario: &mut Scenario, change: fn(&mut Laps)) {
    if let Course::Laps(laps) = &mut scenario.path {
        change(laps);
    }
}

/// The spread of a LEGO robot that nobody calibrated, as in the other scenarios.
fn uncalibrated(scenario: &mut Scenario) {
    scenario.errors.radius_scale_sigma = 0.005;
    scenario.errors.radius_difference_sigma = 0.005;
    scenario.errors.track_scale_sigma = 0.03;
}

fn uncalibrated_and_long_rest(scenario: &mut Scenario) {
    uncalibrated(scenario);
    laps(scenario, |laps| laps.rest_s = 30.0);
}

/// A gyro of the MEMS class: 0.1 deg/s, no rounding, little walk.
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

fn good_inertial(scenario: &mut Scenario) {
    good_gyro(scenario);
    good_accelerometers(scenario);
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

/// Speeds that rise and fall over two seconds.
fn gentle(scenario: &mut Scenario) {
    laps(scenario, |laps| laps.ramp_steps = 40);
}

fn gentle_and_good_accelerometers(scenario: &mut Scenario) {
    gentle(scenario);
    good_accelerometers(scenario);
}

/// White noise of the variance that the paper's equation 19 gives the counters.
fn noisy_counters(table: &mut SensorTable, seed: u64) {
    add_jitter(table, WheelMatrices::PRINTED.variances, seed);
}

/// Rows of 0.05 s by which a camera is late whose delay nobody took out: 0.3 s, the upper end for a webcam with image processing.
const LATE_ROWS: usize = 6;

fn late_camera(table: &mut SensorTable, _seed: u64) {
    make_reference_late(table, LATE_ROWS);
}

fn in_its_interval(table: &mut SensorTable, _seed: u64) {
    feel_in_its_interval(table);
}

/// All that were tried.
pub(super) const VARIATIONS: &[Variation] = &[
    Variation::of("the end", Metric::End, "where the robot is after the lap, instead of the whole way"),
    Variation::of("heading", Metric::Heading, "the heading instead of the position"),
    Variation::of("forward speed", Metric::Forward, "figure 6 instead of figure 7"),
    Variation::of("turn rate", Metric::Turn, "figure 6 instead of figure 7"),
    Variation::of("Q swapped", Metric::Position, "the last two numbers of Q in the order of equation 24").with(swapped),
    Variation::of(
        "own interval",
        Metric::Position,
        "each acceleration acts in the interval in which it was felt, not in the next one as in equation 20",
    )
    .on_table(in_its_interval),
    Variation::of(
        "not calibrated",
        Metric::Position,
        "wheels 0.5 % and track 3 % off, as before the calibration of Michel and Rohrer",
    )
    .in_world(uncalibrated),
    Variation::of("not calibrated, long rest", Metric::Position, "the same, and the gyro zeroed over 30 s at rest")
        .in_world(uncalibrated_and_long_rest),
    Variation::of(
        "not calibrated, good gyro",
        Metric::Position,
        "the same with a gyro of 0.1 deg/s that does not round",
    )
    .in_world(|scenario| {
        uncalibrated(scenario);
        good_gyro(scenario);
    }),
    Variation::of("slippery floor", Metric::Position, "five times the slip").in_world(slippery),
    Variation::of("coarse counts", Metric::Position, "an exact robot without slip whose encoders count 10 degrees")
        .in_world(exact_and_coarse),
    Variation::of(
        "late camera",
        Metric::Position,
        "the camera that is the truth is 0.3 s late and nobody took that out",
    )
    .on_table(late_camera),
    Variation::of(
        "late camera, good gyro",
        Metric::Position,
        "the same with a gyro of 0.1 deg/s and accelerometers of 0.01 m/s^2",
    )
    .in_world(good_inertial)
    .on_table(late_camera),
    Variation::of(
        "noisy counters",
        Metric::Position,
        "counters as noisy as the paper's R says: 1.5 and 2.5 deg^2, white",
    )
    .on_table(noisy_counters),
    Variation::of("noisy counters, turn rate", Metric::Turn, "the same, figure 6 instead of figure 7")
        .on_table(noisy_counters),
    Variation::of(
        "noisy counters, turn rate, gentle",
        Metric::Turn,
        "the same, with speeds that rise and fall over 2 s instead of 0.3 s",
    )
    .in_world(gentle)
    .on_table(noisy_counters),
    Variation::of("noisy counters, forward speed", Metric::Forward, "noisy counters, figure 6 instead of figure 7")
        .on_table(noisy_counters),
    Variation::of(
        "noisy counters, forward speed, gentle",
        Metric::Forward,
        "the same, with speeds that rise and fall over 2 s, Q swapped and accelerometers of 0.01 m/s^2",
    )
    .in_world(gentle_and_good_accelerometers)
    .on_table(noisy_counters)
    .with(swapped),
];
