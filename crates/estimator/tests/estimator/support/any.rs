//! Observations of every kind, sound and damaged.

use std::f64::consts::PI;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{
    BeaconId, Calibration, Celsius, Fix, Heading, LandmarkId, Meters, MetersPerSecond, MetersPerSecondSquared,
    MountedSensor, Mounting, Mountings, Observation, ObservationKind, Point2, Pose, PositionCovariance, Radians,
    RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use super::robot::{config, learning_geometry, unknown};
use super::simulation::furnished;

/// What was observed, by name in messages.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AnyMeasurement(pub(crate) ObservationKind);

pub(crate) fn of(millis: i64, sensor: SensorId, observed: ObservationKind) -> Observation {
    Observation {
        sensor,
        stamp: Timestamp::from_millis(millis),
        stamp_sigma: TimeDelta::from_millis(1),
        measurement: observed,
    }
}

fn point<S>(x_m: f64, y_m: f64) -> Point2<S> {
    Point2::new(Meters(x_m), Meters(y_m))
}

/// A furnished room, sensors with noise, and constants that are taken as given.
pub(crate) fn without_learning() -> FilterConfig {
    furnished(&config())
}

/// The same with every constant to be learned.
pub(crate) fn learning_everything() -> FilterConfig {
    FilterConfig { calibration: all_unknown(), ..without_learning() }
}

/// Every constant, with the spread of a kit that was measured with a ruler.
pub(crate) fn all_unknown() -> Calibration {
    let mut mountings = Mountings::default();
    for sensor in MountedSensor::ALL.into_iter().filter(|sensor| *sensor != MountedSensor::Imu) {
        mountings[sensor] = Mounting { x_m: unknown(0.02), y_m: unknown(0.02), yaw_rad: unknown(0.05) };
    }
    Calibration {
        gyro_scale: unknown(0.01),
        backlash_rad: unknown(0.03),
        odometry_delay_s: unknown(0.1),
        fix_delay_s: unknown(0.1),
        tag_forward_m: unknown(0.02),
        tag_left_m: unknown(0.02),
        beacon_offset_m: unknown(0.3),
        beacon_scale: unknown(0.02),
        landmark_offset_m: unknown(0.1),
        landmark_scale: unknown(0.02),
        landmark_delay_s: unknown(0.1),
        beacon_delay_s: unknown(0.1),
        range_delay_s: unknown(0.1),
        compass_delay_s: unknown(0.1),
        mountings,
        ..learning_geometry().calibration
    }
}

fn fix(
    (x_m, y_m): (f64, f64),
    heading_rad: Option<f64>,
    covariance: Option<[f64; 4]>,
    lever_m: f64,
) -> ObservationKind {
    ObservationKind::Fix(Fix {
        position: point(x_m, y_m),
        heading: heading_rad.map(Heading::from_rad),
        covariance: covariance.map(|[xx_m2, share, yy_m2, heading_rad2]| PositionCovariance {
            xx_m2,
            xy_m2: share * (xx_m2 * yy_m2).sqrt(),
            yy_m2,
            heading_rad2,
        }),
        tag_in_body: point(lever_m, 0.1),
        reset_counter: 0,
    })
}

/// One observation of each kind, in the order of the vocabulary.
pub(crate) fn one_of_each() -> [ObservationKind; 11] {
    [
        wheels(1.0, 2.0),
        odometer(0.1, 0.2, 0.3),
        velocity(0.1, 0.2),
        ObservationKind::TurnRate(RadiansPerSecond(0.1)),
        accelerations(0.1, 0.2),
        fix((0.1, 0.2), Some(0.3), Some([1e-4, 0.1, 1e-4, 1e-3]), 0.05),
        landmark(1, 2.0, 0.3),
        beacon(11, 5.0),
        ObservationKind::WallRange(Meters(4.0)),
        ObservationKind::CompassHeading(Heading::from_rad(0.1)),
        ObservationKind::Temperature(Celsius(21.0)),
    ]
}

fn wheels(left_rad: f64, right_rad: f64) -> ObservationKind {
    ObservationKind::WheelAngles { left: Radians(left_rad), right: Radians(right_rad) }
}

fn odometer(x_m: f64, y_m: f64, heading_rad: f64) -> ObservationKind {
    let heading = Heading::from_rad(heading_rad);
    ObservationKind::OdometerPose(Pose::new(Meters(x_m), Meters(y_m), heading))
}

fn velocity(forward: f64, turn: f64) -> ObservationKind {
    ObservationKind::BodyVelocity { forward: MetersPerSecond(forward), turn: RadiansPerSecond(turn) }
}

fn accelerations(left: f64, right: f64) -> ObservationKind {
    ObservationKind::WheelAccelerations { left: MetersPerSecondSquared(left), right: MetersPerSecondSquared(right) }
}

fn landmark(id: u32, range_m: f64, bearing_rad: f64) -> ObservationKind {
    ObservationKind::Landmark { id: LandmarkId(id), range: Meters(range_m), bearing: Radians(bearing_rad) }
}

fn beacon(id: u32, range_m: f64) -> ObservationKind {
    ObservationKind::BeaconRange { id: BeaconId(id), range: Meters(range_m) }
}

fn any_fix() -> impl Strategy<Value = ObservationKind> {
    let covariance = (1e-8..4.0, -0.99..0.99, 1e-8..4.0, 1e-8..4.0)
        .prop_map(|(xx, share, yy, heading): (f64, f64, f64, f64)| [xx, share, yy, heading]);
    ((-5.0..5.0, -5.0..5.0), prop::option::of(-PI..PI), prop::option::of(covariance), -0.5..0.5)
        .prop_map(|(at, heading, covariance, lever)| fix(at, heading, covariance, lever))
}

/// Any measurement of a sensor; landmarks and beacons include unknown ones.
fn any_measurement() -> impl Strategy<Value = ObservationKind> {
    let small = || -1.0..1.0;
    prop_oneof![
        6 => (-40.0..40.0, -40.0..40.0).prop_map(|(left, right)| wheels(left, right)),
        1 => (-5.0..5.0, -5.0..5.0, -PI..PI).prop_map(|(x, y, th)| odometer(x, y, th)),
        1 => (small(), -9.0..9.0).prop_map(|(forward, turn)| velocity(forward, turn)),
        5 => (-9.0..9.0).prop_map(|rate| ObservationKind::TurnRate(RadiansPerSecond(rate))),
        3 => (small(), small()).prop_map(|(left, right)| accelerations(left, right)),
        4 => any_fix(),
        2 => (2..5_u32, 0.0..9.0, -PI..PI).prop_map(|(id, range, at)| landmark(id, range, at)),
        2 => (12..15_u32, 0.0..9.0).prop_map(|(id, range)| beacon(id, range)),
        2 => (0.0..9.0).prop_map(|range| ObservationKind::WallRange(Meters(range))),
        2 => (-PI..PI).prop_map(|rad| ObservationKind::CompassHeading(Heading::from_rad(rad))),
        1 => (-40.0..90.0).prop_map(|degrees| ObservationKind::Temperature(Celsius(degrees))),
    ]
}

/// Milliseconds since the observation before, at times none or backwards, its sensor, and its measurement.
pub(crate) fn any_observation() -> impl Strategy<Value = (i64, SensorId, AnyMeasurement)> {
    let step_ms = prop_oneof![8 => 0_i64..60, 2 => -500_i64..0, 1 => 0_i64..3_000, 1 => Just(-5_000)];
    (step_ms, 3..5_u8, any_measurement())
        .prop_map(|(step, sensor, measurement)| (step, SensorId(sensor), AnyMeasurement(measurement)))
}

const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e12];

/// The same observation with each of its numbers damaged in turn, and with stamps that cannot be.
pub(crate) fn damages(sound: &Observation) -> Vec<Observation> {
    let mut damaged: Vec<Observation> = BAD
        .into_iter()
        .flat_map(|bad| damaged_by(&sound.measurement, bad))
        .map(|observed| Observation { measurement: observed, ..*sound })
        .collect();
    damaged.push(Observation { stamp_sigma: TimeDelta::from_millis(-1), ..*sound });
    damaged
}

fn damaged_by(sound: &ObservationKind, bad: f64) -> Vec<ObservationKind> {
    match *sound {
        ObservationKind::WheelAngles { left, right } => vec![wheels(bad, right.0), wheels(left.0, bad)],
        ObservationKind::OdometerPose(pose) => {
            vec![odometer(bad, pose.y.0, 0.0), odometer(pose.x.0, bad, 0.0)]
        }
        ObservationKind::BodyVelocity { forward, turn } => {
            vec![velocity(bad, turn.0), velocity(forward.0, bad)]
        }
        ObservationKind::TurnRate(_) => vec![ObservationKind::TurnRate(RadiansPerSecond(bad))],
        ObservationKind::WheelAccelerations { left, right } => {
            vec![accelerations(bad, right.0), accelerations(left.0, bad)]
        }
        ObservationKind::Fix(sound) => damaged_fixes(&sound, bad),
        ObservationKind::Landmark { id, range, bearing } => {
            vec![landmark(id.0, bad, bearing.0), landmark(id.0, range.0, bad), landmark(id.0, -0.001, bearing.0)]
        }
        ObservationKind::BeaconRange { id, .. } => vec![beacon(id.0, bad), beacon(id.0, -0.001)],
        ObservationKind::WallRange(_) => [bad, -0.001].map(|m| ObservationKind::WallRange(Meters(m))).into(),
        ObservationKind::CompassHeading(_) => {
            [f64::NAN, f64::INFINITY].map(|rad| ObservationKind::CompassHeading(Heading::from_rad(rad))).into()
        }
        ObservationKind::Temperature(_) => vec![ObservationKind::Temperature(Celsius(bad))],
    }
}

fn damaged_fixes(sound: &Fix, bad: f64) -> Vec<ObservationKind> {
    let y_m = sound.position.y.0;
    let claim = |[xx_m2, xy_m2, yy_m2, heading_rad2]: [f64; 4]| Fix {
        covariance: Some(PositionCovariance { xx_m2, xy_m2, yy_m2, heading_rad2 }),
        ..*sound
    };
    let at = |position| Fix { position, ..*sound };
    let tag = |tag_in_body| Fix { tag_in_body, ..*sound };
    [
        at(point(bad, y_m)),
        at(point(0.0, bad)),
        tag(point(bad, 0.0)),
        tag(point(0.0, bad)),
        claim([bad, 0.0, 1e-4, 1e-4]),
        claim([1e-4, bad, 1e-4, 1e-4]),
        claim([1e-4, 0.0, bad, 1e-4]),
        claim([1e-4, 2e-4, 1e-4, 1e-4]),
        claim([0.0, 0.0, 1e-4, 1e-4]),
        claim([1e-200, 0.0, 1e-200, 1e-4]),
        // An infinite variance of the heading is no damage: it marks the heading as unknown.
        claim([1e-4, 0.0, 1e-4, -bad.abs()]),
        claim([1e-4, 0.0, 1e-4, 1e300]),
        claim([1e-4, 0.0, 1e-4, 0.0]),
    ]
    .map(ObservationKind::Fix)
    .into()
}

/// So many cases from a fixed seed.
pub(crate) fn cases(cases: u32, seed: u64) -> ProptestConfig {
    ProptestConfig { cases, rng_seed: RngSeed::Fixed(seed), failure_persistence: None, ..ProptestConfig::default() }
}
