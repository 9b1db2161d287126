//! A filter's step allocates nothing once its history has filled: no pause at a bad moment, and no slow growth over a day.

#[path = "support/arena.rs"]
mod arena;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/steady.rs"]
mod steady;
#[path = "support/unknown.rs"]
mod unknown;

use std::hint::black_box;

use allocation_counter::measure;
use arena::{furnished, others};
use posebridge_estimator::{FILTERS, Filter, FilterConfig, find_filter};
use posebridge_telemetry::{FusionOutcome, ObservationKind, UncertainValue};
use steady::{LATE_STEPS, fix, gyro, stamp, wheels};
use unknown::all_unknown;

/// A minute at 20 Hz: twenty times the history.
const WARM_UP: i64 = 1_200;
/// Half a minute more is measured.
const MEASURED: i64 = 600;
/// Two fixes each second.
const FIX_EVERY: i64 = 10;

/// What the filter is given at one step: gyro and wheels, now and then a late fix and a late reading of everything else.
fn step(filter: &mut dyn Filter, step: i64) {
    black_box(filter.observe(&gyro(step)));
    black_box(filter.observe(&wheels(step)));
    if step % FIX_EVERY == LATE_STEPS {
        black_box(filter.observe(&fix(step - LATE_STEPS)));
        for observation in others(step - LATE_STEPS / 2) {
            black_box(filter.observe(&observation));
        }
    }
    black_box(filter.estimate_at(stamp(step + 2)));
    black_box(filter.scalar_at(stamp(step)));
    black_box(filter.calibration());
}

#[test]
fn a_step_of_any_filter_allocates_nothing_once_its_history_is_full() {
    let mut guilty = Vec::new();
    for entry in FILTERS {
        let mut filter = (entry.build)(&furnished());
        (0..WARM_UP).for_each(|k| step(filter.as_mut(), k));
        let counted = measure(|| {
            (WARM_UP..WARM_UP + MEASURED).for_each(|k| step(filter.as_mut(), k));
        });
        if counted.count_total > 0 {
            guilty.push(format!("{}: {counted:?}", entry.name));
        }
    }
    assert!(guilty.is_empty(), "{guilty:#?}");
}

/// The flagship with every state, and with a heading that it never comes to know: the robot stands, and no fix tells it.
#[test]
fn the_flagship_with_every_state_allocates_nothing_even_while_it_seeks_its_heading() {
    let pose = find_filter("pose").unwrap();
    let mut config = FilterConfig { calibration: all_unknown(), ..furnished() };
    config.calibration.fix_delay_s = UncertainValue { value: 0.12, sigma: 0.1 };
    let mut filter = (pose.build)(&config);
    (0..WARM_UP).for_each(|k| step(filter.as_mut(), k));
    let counted = measure(|| {
        (WARM_UP..WARM_UP + MEASURED).for_each(|k| step(filter.as_mut(), k));
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");

    config.start = None;
    let mut lost = (pose.build)(&config);
    let mut look = |k: i64| {
        let mut seen = fix(0);
        seen.stamp = stamp(k);
        if let ObservationKind::Fix(fix) = &mut seen.measurement {
            fix.heading = None;
        }
        black_box(lost.observe(&seen)).outcome
    };
    (0..WARM_UP).for_each(|k| assert_ne!(look(k), FusionOutcome::Malformed));
    let counted = measure(|| {
        (WARM_UP..WARM_UP + MEASURED).for_each(|k| {
            look(k);
        });
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");
    let latest = lost.estimate_at(stamp(WARM_UP + MEASURED - 1)).unwrap();
    assert!(latest.validity.position && !latest.validity.heading);
}

#[test]
fn a_wheel_reading_out_of_order_allocates_nothing_either() {
    for entry in FILTERS {
        let mut filter = (entry.build)(&furnished());
        (0..WARM_UP).for_each(|k| step(filter.as_mut(), k));
        let counted = measure(|| {
            for k in (WARM_UP..WARM_UP + MEASURED).step_by(2) {
                black_box(filter.observe(&gyro(k)));
                black_box(filter.observe(&gyro(k + 1)));
                black_box(filter.observe(&wheels(k + 1)));
                black_box(filter.observe(&wheels(k)));
            }
        });
        assert_eq!(counted.count_total, 0, "{}: {counted:?}", entry.name);
    }
}

#[test]
fn the_counter_sees_an_allocation_and_the_flagship_uses_what_it_is_given() {
    let counted = measure(|| drop(black_box(vec![0_u8; 64])));
    assert_eq!(counted.count_total, 1);
    let pose = find_filter("pose").unwrap();
    let mut filter = (pose.build)(&furnished());
    (0..WARM_UP).for_each(|k| step(filter.as_mut(), k));
    assert_eq!(filter.observe(&gyro(WARM_UP)).outcome, FusionOutcome::Accepted);
    assert_eq!(filter.observe(&wheels(WARM_UP)).outcome, FusionOutcome::Accepted);
    let seen = fix(WARM_UP - LATE_STEPS + 1);
    assert_eq!(filter.observe(&seen).outcome, FusionOutcome::Accepted);
}
