//! How long a step of a filter takes.
//!
//! All rows take turns round by round; the ratios are medians of what was seen within one round, so that neither clock boost nor a
//! busy machine decides them. The flagship's rows go through [`Filter::observe`] as the pipeline does. What the rows are:
//! docs/lab/accuracy.md. Run with `cargo bench -p posebridge-estimator`.

#![expect(clippy::print_stdout, reason = "a benchmark prints its figures")]

#[path = "../tests/estimator/support/robot.rs"]
mod robot;
#[path = "../tests/estimator/support/steady.rs"]
mod steady;

use std::hint::black_box;
use std::time::{Duration, Instant};

use nalgebra::{Matrix5, Vector5};
use posebridge_estimator::filters::pose::context::UpdateContext;
use posebridge_estimator::filters::pose::layout::{CORE_STATES, StateLayout};
use posebridge_estimator::filters::pose::motion_update;
use posebridge_estimator::filters::pose::state::PoseState;
use posebridge_estimator::models::planar_speeds::{Acceleration, PredictionStep};
use posebridge_estimator::motion::MotionReading;
use posebridge_estimator::numerics::statistics::quantile;
use posebridge_estimator::update::{ScalarMeasurement, use_scalar};
use posebridge_estimator::{EstimatedQuantity, FILTERS, Filter, FilterConfig, FilterEntry, find_filter};
use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{FusionOutcome, FusionRecord, Meters, ObservationKind, Point2, TimeDelta};
use robot::learning_geometry;
use steady::{LATE_STEPS, STEP, fix, gyro, stamp, wheels};

/// Rounds of the comparison; odd, so that there is a middle.
const ROUNDS: usize = 301;
/// Steps of every row in each round, so that all of them begin a round equally cold.
const STEPS: i64 = 4096;
/// Late fixes in each round, of each camera.
const LATE_FIXES: i64 = 20;
/// A minute at 20 Hz fills every history.
const WARM_UP: i64 = 1_200;
/// A step of the flagship's state, with gyro window and calibration states, may take this many times as long as one of five states.
const STATE_BAR: f64 = 3.5;
/// The same with history and records.
const STEP_BAR: f64 = 8.0;
/// The same with a fix that is compared with four poses, the believed one and three alternatives.
const BANK_BAR: f64 = 30.0;
/// A fix that comes 300 ms late at 20 Hz may take this long, µs.
const LATE_FIX_BAR_US: f64 = 5.0;
/// Where fixes are beside the robot that found alternatives to its pose, in turn; east and north, m.
const DISPUTED: [(f64, f64); 3] = [(0.5, 0.0), (0.0, 0.5), (0.5, 0.5)];
/// Between them is a fix that is right, so that the pose stays known.
const GOOD_FIX_EVERY: i64 = 64;

fn main() {
    // Without `--bench` it only has to run.
    let is_bench = std::env::args().any(|argument| argument == "--bench");
    compare(if is_bench { ROUNDS } else { 1 });
}

/// The rounds of all rows, and what follows from them.
fn compare(rounds: usize) {
    let (mut five_ns, mut state_ns, mut step_ns, mut bank_ns) = (vec![], vec![], vec![], vec![]);
    let (mut fix_at_5_hz_us, mut fix_at_20_hz_us) = (vec![], vec![]);
    let mut five = FiveStates::default();
    let mut bare = FilterWithoutHistory::new(&learning_geometry());
    for _ in 0..WARM_UP {
        bare.drive_on();
    }
    let mut plain = Flagship::new(Camera::Absent);
    let mut disputed = Flagship::new(Camera::Absent);
    let mut at_5_hz = Flagship::new(Camera::Every(4));
    let mut at_20_hz = Flagship::new(Camera::Every(1));
    let mut compared = ComparedFilter::of_every_pose();
    for _ in 0..rounds {
        five_ns.push(nanos_per_step(|| five.step()));
        state_ns.push(nanos_per_step(|| bare.drive_on()));
        step_ns.push(nanos_per_step(|| plain.drive_on()));
        bank_ns.push(nanos_per_step(|| disputed.drive_on_with_alternatives()));
        at_5_hz.time_fixes(&mut fix_at_5_hz_us);
        at_20_hz.time_fixes(&mut fix_at_20_hz_us);
        compared.iter_mut().for_each(ComparedFilter::time_steps);
    }
    println!("\nmedians of {rounds} rounds of {STEPS} steps, all rows in turn; ratios within a round");
    print_row("five states: predict + 4 gated scalars", &five_ns, &five_ns);
    print_row("pose: its state, gyro + wheels", &state_ns, &five_ns);
    print_row("pose: observe(gyro) + observe(wheels)", &step_ns, &five_ns);
    print_row("pose: the same, and a fix with a bank of 4", &bank_ns, &five_ns);
    for other in &compared {
        print_row(&format!("{}: observe(gyro) + observe(wheels)", other.name), &other.step_ns, &five_ns);
    }
    for (name, samples) in [
        ("pose: a fix 300 ms late, camera at 5 Hz", &fix_at_5_hz_us),
        ("pose: a fix 300 ms late, camera at 20 Hz", &fix_at_20_hz_us),
    ] {
        println!("{name:42} {:8.2} us/fix", median(samples));
    }
    println!();
    println!(
        "pose / five states: its state {:.1} (bar {STATE_BAR}), with history and records {:.1} (bar {STEP_BAR}), with a bank {:.1} (bar {BANK_BAR})",
        ratio(&state_ns, &five_ns),
        ratio(&step_ns, &five_ns),
        ratio(&bank_ns, &five_ns)
    );
    let late_us = median(&fix_at_20_hz_us);
    println!("late fix at 20 Hz: {late_us:.2} us (bar {LATE_FIX_BAR_US:.0} us)");
}

fn print_row(name: &str, samples: &[f64], five: &[f64]) {
    println!("{name:42} {:8.1} ns/step {:6.2} x five states", median(samples), ratio(samples, five));
}

/// The median of the ratios of two rows, round by round.
fn ratio(samples: &[f64], floor: &[f64]) -> f64 {
    let ratios: Vec<f64> = samples.iter().zip(floor).map(|(a, b)| a / b).collect();
    median(&ratios)
}

fn median(samples: &[f64]) -> f64 {
    quantile(samples, 0.5).unwrap_or(f64::NAN)
}

fn nanos(elapsed: Duration) -> f64 {
    elapsed.as_nanos() as f64
}

#[expect(clippy::disallowed_methods, reason = "a benchmark reads a clock")]
fn time(run: impl FnOnce()) -> Duration {
    let start = Instant::now();
    run();
    start.elapsed()
}

fn nanos_per_step(mut step: impl FnMut()) -> f64 {
    nanos(time(|| (0..STEPS).for_each(|_| step()))) / STEPS as f64
}

/// The five states of paper 1, equation 24, by the library's own parts: predict, then speed and heading by the encoders, heading and
/// turn rate by the gyro, each tested by a gate. The robot is at rest.
struct FiveStates {
    mean: Vector5<f64>,
    covariance: Matrix5<f64>,
}

impl Default for FiveStates {
    fn default() -> Self {
        Self { mean: Vector5::zeros(), covariance: Matrix5::identity() * 0.05 }
    }
}

impl FiveStates {
    fn step(&mut self) {
        const OBSERVED: [(usize, f64); 4] =
            [(row::FORWARD, 4e-4), (row::HEADING, 1e-4), (row::HEADING, 3.6e-5), (row::TURN, 4e-4)];
        let motion = PredictionStep { interval_s: STEP.as_secs_f64(), variances: [1e-6, 1e-6, 1e-6, 4e-4, 1e-3] };
        motion.predict(&mut self.mean, &mut self.covariance, black_box(Acceleration::default()));
        for (row, variance) in OBSERVED {
            let innovation = black_box(0.0) - self.mean[row];
            let scalar = ScalarMeasurement { innovation, rows: [row], jacobian: [1.0], variance };
            black_box(use_scalar(&mut self.mean, &mut self.covariance, &scalar, 36.0));
        }
    }
}

/// Whether there are late fixes, and every how many steps.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Camera {
    Absent,
    Every(i64),
}

fn flagship(config: &FilterConfig) -> Box<dyn Filter> {
    let Some(entry) = find_filter("pose") else { unreachable!("the flagship stands in the table") };
    (entry.build)(config)
}

/// The flagship, its history full, that drives on and on.
struct Flagship {
    filter: Box<dyn Filter>,
    camera: Camera,
    step: i64,
}

impl Flagship {
    fn new(camera: Camera) -> Self {
        let mut flagship = Self { filter: flagship(&learning_geometry()), camera, step: 0 };
        for _ in 0..WARM_UP {
            flagship.drive_on();
            if flagship.is_fix_due() {
                flagship.use_late_fix();
            }
        }
        flagship
    }

    fn drive_on(&mut self) {
        self.step += 1;
        black_box(self.filter.observe(black_box(&gyro(self.step))));
        black_box(self.filter.observe(black_box(&wheels(self.step))));
    }

    /// A step with a fix that one of three alternatives explains, which the others and the believed pose refuse.
    fn drive_on_with_alternatives(&mut self) {
        self.drive_on();
        let mut fix = fix(self.step);
        if self.step % GOOD_FIX_EVERY == 0 {
            black_box(self.filter.observe(&fix));
            return;
        }
        if let ObservationKind::Fix(seen) = &mut fix.measurement {
            let (east_m, north_m) = DISPUTED[self.step as usize % DISPUTED.len()];
            seen.position = Point2::new(Meters(seen.position.x.0 + east_m), Meters(seen.position.y.0 + north_m));
        }
        assert_eq!(self.filter.observe(black_box(&fix)).outcome, FusionOutcome::Gated, "step {}", self.step);
    }

    fn is_fix_due(&self) -> bool {
        match self.camera {
            Camera::Absent => false,
            Camera::Every(steps) => self.step > LATE_STEPS && self.step % steps == 0,
        }
    }

    /// Uses the fix of 300 ms ago and returns how long that took.
    fn use_late_fix(&mut self) -> Duration {
        let fix = fix(self.step - LATE_STEPS);
        let mut verdict = FusionOutcome::Unused;
        let elapsed = time(|| verdict = self.filter.observe(black_box(&fix)).outcome);
        assert_eq!(verdict, FusionOutcome::Accepted, "step {}", self.step);
        elapsed
    }

    fn time_fixes(&mut self, micros: &mut Vec<f64>) {
        for _ in 0..LATE_FIXES {
            self.drive_on();
            if self.is_fix_due() {
                micros.push(1e-3 * nanos(self.use_late_fix()));
            }
        }
    }
}

/// A filter of a pose beside the flagship, as `run --compare` runs it.
struct ComparedFilter {
    name: &'static str,
    filter: Box<dyn Filter>,
    step: i64,
    step_ns: Vec<f64>,
}

impl ComparedFilter {
    fn of_every_pose() -> Vec<Self> {
        let of_a_pose =
            FILTERS.iter().filter(|entry| entry.quantity == EstimatedQuantity::Pose && entry.name != "pose");
        let build = |entry: &FilterEntry| {
            let filter = (entry.build)(&learning_geometry());
            let mut compared = Self { name: entry.name, filter, step: 0, step_ns: vec![] };
            (0..WARM_UP).for_each(|_| compared.drive_on());
            compared
        };
        of_a_pose.map(build).collect()
    }

    fn drive_on(&mut self) {
        self.step += 1;
        black_box(self.filter.observe(black_box(&gyro(self.step))));
        black_box(self.filter.observe(black_box(&wheels(self.step))));
    }

    fn time_steps(&mut self) {
        let spent_ns = nanos_per_step(|| self.drive_on());
        self.step_ns.push(spent_ns);
    }
}

/// As much of the past as the filter keeps.
const HISTORY: TimeDelta = TimeDelta::from_millis(3_000);

/// A step of the flagship's state and of what is known of wheels and gyro, without history and records around it.
struct FilterWithoutHistory {
    context: UpdateContext,
    state: PoseState<CORE_STATES>,
    record: FusionRecord,
    step: i64,
}

impl FilterWithoutHistory {
    fn new(config: &FilterConfig) -> Self {
        Self {
            context: UpdateContext::new(config, CORE_STATES),
            state: PoseState::initial(config, &StateLayout::new(config, CORE_STATES)),
            record: flagship(config).observe(&wheels(0)),
            step: 0,
        }
    }

    /// One step: a gyro reading, then the wheels; the pose is carried on, and a gyro window closes every fourth time.
    fn drive_on(&mut self) {
        self.step += 1;
        let now = stamp(self.step);
        let (ObservationKind::TurnRate(rate), ObservationKind::WheelAngles { left, right }) =
            (gyro(self.step).measurement, wheels(self.step).measurement)
        else {
            return;
        };
        let context = &mut self.context;
        context.gyro.insert(now, rate.0);
        let reading = MotionReading::Wheels { left_rad: left.0, right_rad: right.0 };
        context.track.insert(now, &reading);
        self.state.predict_speeds_and_bias(now, context);
        motion_update::update_turn_rate(&mut self.state, rate.0, context);
        self.state.advance(now, context);
        motion_update::update_motion(&mut self.state, now, context, &mut self.record);
        context.track.discard_before(now - HISTORY);
        context.gyro.discard_before(now - HISTORY);
    }
}
