//! How long a step of a filter takes, as a multiple of what it cannot take less than.
//!
//! All rows of the five-state filter get the same 4096 inputs, end at the same belief to 1e-9, and take turns round by round;
//! the ratios are medians of what was seen within one round, so that neither clock boost nor a busy machine decides them. The
//! flagship's rows go through [`Filter::observe`] as the pipeline does. What the rows are and why: docs/lab/accuracy.md. Run with
//! `cargo bench -p posebridge-estimator`; the arguments of criterion apply to its part.

#![expect(clippy::print_stdout, reason = "a benchmark prints its figures")]

#[path = "../tests/support/filter_without_history.rs"]
mod filter_without_history;
#[path = "../tests/support/robot.rs"]
mod robot;
#[path = "../tests/support/speed/mod.rs"]
mod speed;
#[path = "../tests/support/steady.rs"]
mod steady;

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput};
use filter_without_history::{FilterWithoutHistory, learning};
use posebridge_estimator::{Filter, find_filter};
use posebridge_telemetry::FusionOutcome;
use speed::{AGREEMENT, IMPLEMENTATIONS, Input, STEPS, recorded};
use steady::{LATE_STEPS, fix, gyro, wheels};

/// Rounds of the comparison; odd, so that there is a middle.
const ROUNDS: usize = 301;
/// Steps of the flagship in each round: as many as of every other row, so that all of them begin a round equally cold.
const FLAGSHIP_STEPS: i64 = STEPS as i64;
/// Late fixes in each round, of each camera.
const LATE_FIXES: i64 = 20;
/// A minute at 20 Hz fills every history.
const WARM_UP: i64 = 1_200;
/// Predict and four gated scalar updates may take this many times as long as the floor.
const LIBRARY_BAR: f64 = 2.0;
/// A step of the flagship's state, with gyro window and calibration states, may take this many times as long as the floor.
const STATE_BAR: f64 = 6.0;
/// A fix that comes 300 ms late at 20 Hz may take this long, µs.
const LATE_FIX_BAR_US: f64 = 10.0;

fn main() {
    let inputs = recorded();
    assert_agreement(&inputs);
    run_criterion(&inputs);
    // Without `--bench` somebody only wants to know that it runs.
    let is_bench = std::env::args().any(|argument| argument == "--bench");
    compare(&inputs, if is_bench { ROUNDS } else { 1 });
}

/// What is compared must be the same thing.
fn assert_agreement(inputs: &[Input]) {
    let floor = (IMPLEMENTATIONS[0].run)(inputs);
    for implementation in &IMPLEMENTATIONS {
        let distance = (implementation.run)(inputs).distance(&floor);
        assert!(distance < AGREEMENT, "{}: {distance:e}", implementation.name);
    }
}

fn run_criterion(inputs: &[Input]) {
    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .sample_size(30)
        .configure_from_args();
    let mut group = criterion.benchmark_group("five states");
    group.throughput(Throughput::Elements(STEPS as u64));
    for implementation in &IMPLEMENTATIONS {
        group.bench_function(implementation.name, |bencher| {
            bencher.iter(|| (implementation.run)(black_box(inputs)));
        });
    }
    group.finish();
    criterion.final_summary();
}

/// The rounds of all rows, and what follows from them.
fn compare(inputs: &[Input], rounds: usize) {
    let mut timings: [Vec<f64>; IMPLEMENTATIONS.len()] = std::array::from_fn(|_| Vec::with_capacity(rounds));
    let mut step_ns = Vec::with_capacity(rounds);
    let mut fix_at_5_hz_us = Vec::new();
    let mut fix_at_20_hz_us = Vec::new();
    let mut state_ns = Vec::with_capacity(rounds);
    let mut bare = FilterWithoutHistory::new(&learning());
    for _ in 0..WARM_UP {
        bare.drive_on();
    }
    let mut plain = Flagship::new(Camera::Absent);
    let mut at_5_hz = Flagship::new(Camera::Every(4));
    let mut at_20_hz = Flagship::new(Camera::Every(1));
    for _ in 0..rounds {
        for (implementation, samples) in IMPLEMENTATIONS.iter().zip(&mut timings) {
            let elapsed = time(|| {
                black_box((implementation.run)(black_box(inputs)));
            });
            samples.push(nanos(elapsed) / STEPS as f64);
        }
        let elapsed = time(|| (0..FLAGSHIP_STEPS).for_each(|_| bare.drive_on()));
        state_ns.push(nanos(elapsed) / FLAGSHIP_STEPS as f64);
        step_ns.push(plain.nanos_per_step());
        at_5_hz.time_fixes(&mut fix_at_5_hz_us);
        at_20_hz.time_fixes(&mut fix_at_20_hz_us);
    }
    println!("\nmedians of {rounds} rounds of {STEPS} steps, all rows in turn; ratios within a round");
    let floor = &timings[0];
    for (implementation, samples) in IMPLEMENTATIONS.iter().zip(&timings) {
        print_row(implementation.name, samples, floor);
    }
    print_row("pose: its state, gyro + wheels", &state_ns, floor);
    print_row("pose: observe(gyro) + observe(wheels)", &step_ns, floor);
    for (name, samples) in [
        ("pose: a fix 300 ms late, camera at 5 Hz", &fix_at_5_hz_us),
        ("pose: a fix 300 ms late, camera at 20 Hz", &fix_at_20_hz_us),
    ] {
        println!("{name:42} {:8.2} us/fix", median(samples));
    }
    println!();
    println!("library / floor: {:.2} (bar {LIBRARY_BAR:.1})", ratio(&timings[1], floor));
    println!(
        "pose state / floor: {:.1} (bar {STATE_BAR:.1}); with history and records: {:.1}",
        ratio(&state_ns, floor),
        ratio(&step_ns, floor)
    );
    let late_us = median(&fix_at_20_hz_us);
    println!("late fix at 20 Hz: {late_us:.2} us (bar {LATE_FIX_BAR_US:.0} us)");
}

fn print_row(name: &str, samples: &[f64], floor: &[f64]) {
    let ns = median(samples);
    println!("{name:42} {ns:8.1} ns/step {:6.2} x floor", ratio(samples, floor));
}

/// The median of the ratios of two rows, round by round.
fn ratio(samples: &[f64], floor: &[f64]) -> f64 {
    let ratios: Vec<f64> = samples.iter().zip(floor).map(|(a, b)| a / b).collect();
    median(&ratios)
}

fn median(samples: &[f64]) -> f64 {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
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

/// Whether there are late fixes, and every how many steps.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Camera {
    Absent,
    Every(i64),
}

/// The flagship, its history full, that drives on and on.
struct Flagship {
    filter: Box<dyn Filter>,
    camera: Camera,
    step: i64,
}

impl Flagship {
    fn new(camera: Camera) -> Self {
        let Some(entry) = find_filter("pose") else { unreachable!("the flagship stands in the table") };
        let mut flagship = Self { filter: (entry.build)(&learning()), camera, step: 0 };
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

    fn nanos_per_step(&mut self) -> f64 {
        let elapsed = time(|| (0..FLAGSHIP_STEPS).for_each(|_| self.drive_on()));
        nanos(elapsed) / FLAGSHIP_STEPS as f64
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
