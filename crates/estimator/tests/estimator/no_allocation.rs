//! A filter's step allocates nothing once its history has filled: no pause at a bad moment, and no slow growth over a day.

use std::hint::black_box;

use allocation_counter::measure;
use posebridge_estimator::wiring::WiringMonitor;
use posebridge_estimator::{FILTERS, Filter, FilterConfig};
use posebridge_telemetry::{
    Arena, BeaconId, Celsius, FusionOutcome, LandmarkId, Meters, MetersPerSecond, MetersPerSecondSquared, Observation,
    ObservationKind, Point2, Pose, Radians, RadiansPerSecond, SensorId, UncertainValue, quantities::wrap_rad,
};

use crate::support::any::all_unknown;
use crate::support::filters::named;
use crate::support::robot::config;
use crate::support::simulation::furnished;
use crate::support::steady::{FORWARD_M_PER_S, LATE_STEPS, TURN_RAD_PER_S, at, fix, gyro, pose, stamp, wheels};

/// A minute at 20 Hz: twenty times the history.
const WARM_UP: i64 = 1_200;
/// Half a minute more is measured.
const MEASURED: i64 = 600;
/// Two fixes each second.
const FIX_EVERY: i64 = 10;

/// A landmark of the furnished arena, where there is a beacon as well.
const LANDMARK: Point2<Arena> = Point2::new(Meters(-1.0), Meters(-1.2));

/// Every other observation that a sensor may make at the end of a step. The ranges are what they would be.
fn others(step: i64) -> [Observation; 8] {
    let pose = pose(step);
    let (dx_m, dy_m) = (LANDMARK.x.0 - pose.x.0, LANDMARK.y.0 - pose.y.0);
    let range = Meters(dx_m.hypot(dy_m));
    let bearing = Radians(wrap_rad(dy_m.atan2(dx_m) - pose.heading.rad()));
    let (id, beacon) = (LandmarkId(0), BeaconId(10));
    let rest = MetersPerSecondSquared(0.0);
    [
        at(step, SensorId::ACCELEROMETER, ObservationKind::WheelAccelerations { left: rest, right: rest }),
        at(step, SensorId::LANDMARKS, ObservationKind::Landmark { id, range, bearing }),
        at(step, SensorId::BEACONS, ObservationKind::BeaconRange { id: beacon, range }),
        at(step, SensorId::RANGE, ObservationKind::WallRange(Meters(1.0))),
        at(step, SensorId::COMPASS, ObservationKind::CompassHeading(pose.heading)),
        at(step, SensorId::THERMOMETER, ObservationKind::Temperature(Celsius(20.0))),
        at(
            step,
            SensorId::ODOMETER,
            ObservationKind::BodyVelocity {
                forward: MetersPerSecond(FORWARD_M_PER_S),
                turn: RadiansPerSecond(TURN_RAD_PER_S),
            },
        ),
        // A foreign odometer's pose is in a space of its own; here the two coincide.
        at(step, SensorId::ODOMETER, ObservationKind::OdometerPose(Pose::new(pose.x, pose.y, pose.heading))),
    ]
}

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

/// A filter whose history is full.
fn warm(name: &str, config: &FilterConfig) -> Box<dyn Filter> {
    let mut filter = named(name, config);
    (0..WARM_UP).for_each(|k| step(filter.as_mut(), k));
    filter
}

#[test]
fn a_step_of_any_filter_allocates_nothing_once_its_history_is_full() {
    let mut guilty = Vec::new();
    for entry in FILTERS {
        let mut filter = warm(entry.name, &furnished(&config()));
        let counted = measure(|| {
            (WARM_UP..WARM_UP + MEASURED).for_each(|k| step(filter.as_mut(), k));
            // Wheel readings out of order.
            for k in (WARM_UP + MEASURED..WARM_UP + 2 * MEASURED).step_by(2) {
                black_box(filter.observe(&gyro(k)));
                black_box(filter.observe(&gyro(k + 1)));
                black_box(filter.observe(&wheels(k + 1)));
                black_box(filter.observe(&wheels(k)));
            }
        });
        if counted.count_total > 0 {
            guilty.push(format!("{}: {counted:?}", entry.name));
        }
    }
    assert!(guilty.is_empty(), "{guilty:#?}");
}

/// The flagship with every state, and with a heading that stays unknown: the robot is at rest, and no fix has one.
#[test]
fn the_flagship_with_every_state_allocates_nothing_even_while_it_seeks_its_heading() {
    let mut config = FilterConfig { calibration: all_unknown(), ..furnished(&config()) };
    config.calibration.fix_delay_s = UncertainValue { value: 0.12, sigma: 0.1 };
    let mut filter = warm("pose", &config);
    let counted = measure(|| {
        (WARM_UP..WARM_UP + MEASURED).for_each(|k| step(filter.as_mut(), k));
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");

    config.start = None;
    let mut lost = named("pose", &config);
    let mut observe_fix = |k: i64| {
        let mut observation = fix(0);
        observation.stamp = stamp(k);
        if let ObservationKind::Fix(fix) = &mut observation.measurement {
            fix.heading = None;
        }
        black_box(lost.observe(&observation)).outcome
    };
    (0..WARM_UP).for_each(|k| assert_ne!(observe_fix(k), FusionOutcome::Malformed));
    let counted = measure(|| {
        (WARM_UP..WARM_UP + MEASURED).for_each(|k| {
            observe_fix(k);
        });
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");
    let latest = lost.estimate_at(stamp(WARM_UP + MEASURED - 1)).unwrap();
    assert!(latest.validity.position && !latest.validity.heading);
}

#[test]
fn the_detector_of_wiring_faults_allocates_nothing() {
    let mut monitor = WiringMonitor::new(&config());
    let counted = measure(|| {
        for k in 0..MEASURED {
            black_box(monitor.observe(&gyro(k)));
            black_box(monitor.observe(&wheels(k)));
            if k >= LATE_STEPS {
                black_box(monitor.observe(&fix(k - LATE_STEPS)));
            }
        }
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");
}

#[test]
fn the_counter_detects_an_allocation_and_the_flagship_uses_its_input() {
    let counted = measure(|| drop(black_box(vec![0_u8; 64])));
    assert_eq!(counted.count_total, 1);
    let mut filter = warm("pose", &furnished(&config()));
    assert_eq!(filter.observe(&gyro(WARM_UP)).outcome, FusionOutcome::Accepted);
    assert_eq!(filter.observe(&wheels(WARM_UP)).outcome, FusionOutcome::Accepted);
    let late_fix = fix(WARM_UP - LATE_STEPS + 1);
    assert_eq!(filter.observe(&late_fix).outcome, FusionOutcome::Accepted);
}
