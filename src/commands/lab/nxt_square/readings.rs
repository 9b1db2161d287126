//! Other ways to read the paper: what its robot, its sensors or its measure of error may have been.
//!
//! Nothing is tuned for one filter: each reading changes the world or what is compared, for all of them alike.

use posebridge_analysis::square::{Method, Metric, SensorTable, printed, swapped};
use posebridge_sim::montecarlo::{Course, Scenario};

use super::drives::{Series, told};

/// One way to read it.
pub(super) struct Variation {
    pub(super) name: &'static str,
    pub(super) note: &'static str,
    pub(super) metric: Metric,
    alter: fn(&mut Scenario),
    adjust: fn(&mut SensorTable),
    methods: fn() -> Vec<Method>,
}

const fn as_it_is(_scenario: &mut Scenario) {}

const fn untouched(_table: &mut SensorTable) {}

impl Variation {
    const fn of(name: &'static str, note: &'static str) -> Self {
        Self {
            name,
            note,
            metric: Metric::Position,
            alter: as_it_is,
            adjust: untouched,
            methods: printed,
        }
    }

    const fn by(mut self, metric: Metric) -> Self {
        self.metric = metric;
        self
    }

    const fn in_world(mut self, alter: fn(&mut Scenario)) -> Self {
        self.alter = alter;
        self
    }

    const fn on_table(mut self, adjust: fn(&mut SensorTable)) -> Self {
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
        Series {
            base: told(&scenario),
            scenario,
            methods: (self.methods)(),
            adjust: self.adjust,
        }
    }
}

fn laps(scenario: &mut Scenario, change: fn(&mut posebridge_sim::montecarlo::Laps)) {
    if let Course::Laps(laps) = &mut scenario.path {
        change(laps);
    }
}

fn uncalibrated(scenario: &mut Scenario) {
    scenario.errors.radius_scale_sigma = 0.005;
    scenario.errors.radius_difference_sigma = 0.005;
    scenario.errors.track_scale_sigma = 0.03;
}

fn uncalibrated_and_long_rest(scenario: &mut Scenario) {
    uncalibrated(scenario);
    laps(scenario, |laps| laps.rest_s = 30.0);
}

fn exact_robot(scenario: &mut Scenario) {
    scenario.errors.radius_scale_sigma = 0.0;
    scenario.errors.radius_difference_sigma = 0.0;
    scenario.errors.track_scale_sigma = 0.0;
    scenario.motion.wheel_travel_m_per_sqrt_m = 0.0;
    scenario.motion.turn_rad_per_sqrt_rad = 0.0;
}

fn coarse_counts(scenario: &mut Scenario) {
    exact_robot(scenario);
    scenario.robot.tick_deg = 10.0;
}

fn slippery(scenario: &mut Scenario) {
    scenario.motion.wheel_travel_m_per_sqrt_m *= 5.0;
    scenario.motion.turn_rad_per_sqrt_rad *= 5.0;
}

fn gentle(scenario: &mut Scenario) {
    laps(scenario, |laps| laps.ramp_steps = 40);
}

fn gentle_and_felt(scenario: &mut Scenario) {
    gentle(scenario);
    if let Some(accelerometer) = &mut scenario.accelerometer {
        accelerometer.sigma_m_per_s2 = 0.01;
    }
}

fn good_gyro(scenario: &mut Scenario) {
    uncalibrated(scenario);
    scenario.gyro.resolution_deg_per_s = 0.0;
    scenario.gyro.sigma_deg_per_s = 0.1;
    scenario.gyro.bias_walk_deg_per_s_sqrt_s = 0.001;
}

/// An accelerometer tells the change of speed over the interval that ends with its reading; the paper's equation 20 uses the reading
/// of the row before. Here each row gets the reading of the next one.
fn in_its_interval(table: &mut SensorTable) {
    let mut next = None;
    for row in table.rows.iter_mut().rev() {
        next = std::mem::replace(&mut row.accelerations_m_per_s2, next);
    }
}

/// All that were tried.
pub(super) const VARIATIONS: &[Variation] = &[
    Variation::of("end", "e").by(Metric::End),
    Variation::of("heading", "e").by(Metric::Heading),
    Variation::of("v", "e").by(Metric::Forward),
    Variation::of("w", "e").by(Metric::Turn),
    Variation::of("swapped", "e").with(swapped),
    Variation::of("swapped v", "e").with(swapped).by(Metric::Forward),
    Variation::of("swapped w", "e").with(swapped).by(Metric::Turn),
    Variation::of("uncalibrated", "e").in_world(uncalibrated),
    Variation::of("uncalibrated rest", "e").in_world(uncalibrated_and_long_rest),
    Variation::of("uncalibrated, heading", "e").in_world(uncalibrated_and_long_rest).by(Metric::Heading),
    Variation::of("good gyro", "e").in_world(good_gyro),
    Variation::of("exact", "e").in_world(exact_robot),
    Variation::of("coarse", "e").in_world(coarse_counts),
    Variation::of("coarse w", "e").in_world(coarse_counts).by(Metric::Turn),
    Variation::of("coarse v", "e").in_world(coarse_counts).by(Metric::Forward),
    Variation::of("slippery", "e").in_world(slippery),
    Variation::of("gentle v", "e").in_world(gentle).by(Metric::Forward),
    Variation::of("gentle w", "e").in_world(gentle).by(Metric::Turn),
    Variation::of("gentle felt v", "e").in_world(gentle_and_felt).by(Metric::Forward),
    Variation::of("gentle felt w", "e").in_world(gentle_and_felt).by(Metric::Turn),
    Variation::of("gentle felt swapped v", "e").in_world(gentle_and_felt).by(Metric::Forward).with(swapped),
    Variation::of("gentle felt swapped w", "e").in_world(gentle_and_felt).by(Metric::Turn).with(swapped),
    Variation::of("interval v", "e").on_table(in_its_interval).by(Metric::Forward),
    Variation::of("interval w", "e").on_table(in_its_interval).by(Metric::Turn),
    Variation::of("interval gentle swapped v", "e").on_table(in_its_interval).in_world(gentle_and_felt).by(Metric::Forward).with(swapped),
    Variation::of("interval", "e").on_table(in_its_interval),
];
