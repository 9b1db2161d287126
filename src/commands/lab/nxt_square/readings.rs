//! Other ways to read the paper: what its robot, its sensors or its measure of error may have been.
//!
//! Nothing is tuned for one filter: each reading changes the world or what is compared, for all of them alike.

use posebridge_analysis::square::*;
#[allow(unused)] use posebridge_analysis::square::{Method, Metric, SensorTable, printed, swapped};
use posebridge_sim::montecarlo::{Course, Scenario};

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

const fn untouched(_table: &mut SensorTable, _seed: u64) {}

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


fn late<const N: usize>(t: &mut SensorTable, _: u64) { make_reference_late(t, N); }
fn jitter(t: &mut SensorTable, seed: u64) { add_jitter(t, [1.5, 2.5], seed); }
fn jitter_interval(t: &mut SensorTable, seed: u64) { add_jitter(t, [1.5, 2.5], seed); feel_in_its_interval(t); }
fn ramps<const N: u32>(scenario: &mut Scenario) {
    laps(scenario, |laps| laps.ramp_steps = N);
}
fn ramps_felt<const N: u32>(scenario: &mut Scenario) {
    laps(scenario, |laps| laps.ramp_steps = N);
    if let Some(accelerometer) = &mut scenario.accelerometer {
        accelerometer.sigma_m_per_s2 = 0.01;
    }
}
fn felt(scenario: &mut Scenario) {
    if let Some(accelerometer) = &mut scenario.accelerometer {
        accelerometer.sigma_m_per_s2 = 0.01;
    }
}
fn good_gyro_felt(scenario: &mut Scenario) { good_gyro(scenario); felt(scenario);  scenario.errors.radius_difference_sigma = 0.001; scenario.errors.radius_scale_sigma=0.001; scenario.errors.track_scale_sigma=0.005;  }
fn exact_good(s: &mut Scenario) { good_gyro(s); exact_robot(s); }
fn exact_good_felt(s: &mut Scenario) { good_gyro(s); exact_robot(s); felt(s); }

/// All that were tried.
pub(super) const VARIATIONS: &[Variation] = &[
    Variation::of("late 1", "e").on_table(late::<1>),
    Variation::of("late 2", "e").on_table(late::<2>),
    Variation::of("late 3", "e").on_table(late::<3>),
    Variation::of("late 4", "e").on_table(late::<4>),
    Variation::of("late 6", "e").on_table(late::<6>),
    Variation::of("late 10", "e").on_table(late::<10>),
    Variation::of("late 3, good gyro uncal", "e").on_table(late::<3>).in_world(good_gyro),
    Variation::of("late 6, good gyro uncal", "e").on_table(late::<6>).in_world(good_gyro),
    Variation::of("late 4, good gyro felt", "e").on_table(late::<4>).in_world(good_gyro_felt),
    Variation::of("late 6, good gyro felt", "e").on_table(late::<6>).in_world(good_gyro_felt),
    Variation::of("late 10, good gyro felt", "e").on_table(late::<10>).in_world(good_gyro_felt),
    Variation::of("late 3, exact good", "e").on_table(late::<3>).in_world(exact_good),
    Variation::of("late 6, exact good", "e").on_table(late::<6>).in_world(exact_good),
    Variation::of("late 3, exact good felt", "e").on_table(late::<3>).in_world(exact_good_felt),
    Variation::of("late 6, exact good felt", "e").on_table(late::<6>).in_world(exact_good_felt),
    Variation::of("late 3, exact", "e").on_table(late::<3>).in_world(exact_robot),
    Variation::of("late 6, heading", "e").on_table(late::<6>).by(Metric::Heading),
    Variation::of("late 6, heading exact good", "e").on_table(late::<6>).by(Metric::Heading).in_world(exact_good),
    Variation::of("late 6, v", "e").on_table(late::<6>).by(Metric::Forward),
    Variation::of("late 6, w", "e").on_table(late::<6>).by(Metric::Turn),
    Variation::of("jitter", "e").on_table(jitter),
    Variation::of("jitter exact good", "e").on_table(jitter).in_world(exact_good),
    Variation::of("jitter exact good felt", "e").on_table(jitter).in_world(exact_good_felt),
    Variation::of("jitter heading exact good felt", "e").on_table(jitter).in_world(exact_good_felt).by(Metric::Heading),
    Variation::of("jitter v", "e").on_table(jitter).by(Metric::Forward),
    Variation::of("jitter w", "e").on_table(jitter).by(Metric::Turn),
    Variation::of("jitter 20 v", "e").on_table(jitter).by(Metric::Forward).in_world(ramps::<20>),
    Variation::of("jitter 40 v", "e").on_table(jitter).by(Metric::Forward).in_world(ramps::<40>),
    Variation::of("jitter 60 v", "e").on_table(jitter).by(Metric::Forward).in_world(ramps::<60>),
    Variation::of("jitter 60 w", "e").on_table(jitter).by(Metric::Turn).in_world(ramps::<60>),
    Variation::of("jitter felt 40 v sw", "e").on_table(jitter).by(Metric::Forward).in_world(ramps_felt::<40>).with(swapped),
    Variation::of("jitter felt 60 v sw", "e").on_table(jitter).by(Metric::Forward).in_world(ramps_felt::<60>).with(swapped),
    Variation::of("jitter felt 20 v sw", "e").on_table(jitter).by(Metric::Forward).in_world(ramps_felt::<20>).with(swapped),
    Variation::of("jitter int felt 40 v sw", "e").on_table(jitter_interval).by(Metric::Forward).in_world(ramps_felt::<40>).with(swapped),
    Variation::of("jitter felt 20 w", "e").on_table(jitter).by(Metric::Turn).in_world(ramps_felt::<20>),
    Variation::of("jitter felt 40 w", "e").on_table(jitter).by(Metric::Turn).in_world(ramps_felt::<40>),
    Variation::of("jitter felt 20 w sw", "e").on_table(jitter).by(Metric::Turn).in_world(ramps_felt::<20>).with(swapped),
    Variation::of("jitter felt 40 w sw", "e").on_table(jitter).by(Metric::Turn).in_world(ramps_felt::<40>).with(swapped),
];
