//! The ratios between gyro, wheels and fixes name what is wired, counted or configured wrongly, on a drive without noise but for
//! the gyro's bias and the encoders' counts.

use posebridge_estimator::wiring::{DecidingObservation, RatioKind, WiringFault, WiringFinding, WiringMonitor};
use posebridge_telemetry::{
    Fix, Heading, Meters, Observation, ObservationKind, Point2, Radians, RadiansPerSecond, SensorId, TimeDelta,
    Timestamp,
};

use crate::support::robot::{DEGREE, GEOMETRY, RADIUS_M, TRACK_M, config};

/// 20 Hz.
const STEP_S: f64 = 0.05;
const SPEED_M_PER_S: f64 = 0.2;
const TURN_RAD_PER_S: f64 = 1.0;
/// Sides of half a metre, and turns of a quarter to the left.
const SIDE_STEPS: i64 = 50;
const TURN_STEPS: i64 = 31;
/// Two turns and four metres.
const STEPS: i64 = 8 * (SIDE_STEPS + TURN_STEPS);
const BIAS_RAD_PER_S: f64 = 0.01;

/// What a camera sees of the robot.
#[derive(Clone, Copy, PartialEq)]
enum CameraView {
    Nothing,
    Position,
    Pose,
}

/// What a fault does to a true reading: left and right wheel, gyro, position and heading.
type Falsify = fn(&mut [f64; 2], &mut f64, &mut [f64; 3]);

fn no_fault(_: &mut [f64; 2], _: &mut f64, _: &mut [f64; 3]) {}

fn observation(step: i64, sensor: SensorId, measurement: ObservationKind) -> Observation {
    let stamp = Timestamp::from_millis(50 * step);
    Observation { sensor, stamp, stamp_sigma: TimeDelta::ZERO, measurement }
}

/// Everything that is found on the drive.
fn drive(view: CameraView, geometry: posebridge_telemetry::DriveGeometry, falsify: Falsify) -> Vec<WiringFinding> {
    let mut monitor = WiringMonitor::new(&posebridge_estimator::FilterConfig { geometry, ..config() });
    let mut found = Vec::new();
    let (mut wheels_rad, mut pose) = ([0.0_f64; 2], [0.0_f64; 3]);
    for step in 1..=STEPS {
        let is_turning = step % (SIDE_STEPS + TURN_STEPS) >= SIDE_STEPS;
        let (forward, turn) = if is_turning { (0.0, TURN_RAD_PER_S) } else { (SPEED_M_PER_S, 0.0) };
        pose[0] += forward * STEP_S * pose[2].cos();
        pose[1] += forward * STEP_S * pose[2].sin();
        pose[2] += turn * STEP_S;
        wheels_rad[0] += (forward - 0.5 * TRACK_M * turn) * STEP_S / RADIUS_M;
        wheels_rad[1] += (forward + 0.5 * TRACK_M * turn) * STEP_S / RADIUS_M;
        let mut wheels = wheels_rad.map(|angle| (angle / DEGREE).floor() * DEGREE);
        let (mut gyro, mut seen) = (turn + BIAS_RAD_PER_S, pose);
        falsify(&mut wheels, &mut gyro, &mut seen);
        let [left, right] = wheels.map(Radians);
        let mut observations = vec![
            observation(step, SensorId::GYRO, ObservationKind::TurnRate(RadiansPerSecond(gyro))),
            observation(step, SensorId::WHEELS, ObservationKind::WheelAngles { left, right }),
        ];
        if view != CameraView::Nothing && step % 10 == 0 {
            let fix = Fix {
                position: Point2::new(Meters(seen[0]), Meters(seen[1])),
                heading: (view == CameraView::Pose).then(|| Heading::from_rad(seen[2])),
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            };
            observations.push(observation(step, SensorId::CAMERA, ObservationKind::Fix(fix)));
        }
        found.extend(observations.iter().filter_map(|one| monitor.observe(one)));
    }
    found
}

fn only(found: &[WiringFinding]) -> &WiringFinding {
    let [finding] = found else { panic!("one finding, not {found:?}") };
    finding
}

#[track_caller]
fn assert_found(view: CameraView, falsify: Falsify, fault: WiringFault, kind: RatioKind, expected: f64) {
    let found = drive(view, GEOMETRY, falsify);
    let finding = only(&found);
    assert_eq!(finding.fault(), Some(fault), "{finding}");
    let ratio = finding.ratio;
    assert_eq!(ratio.kind, kind, "{finding}");
    assert!((ratio.value / expected - 1.0).abs() < 0.05, "{finding}");
    assert!(ratio.sigma < 0.1 * expected.abs(), "{finding}");
}

#[test]
fn nothing_is_found_on_a_robot_without_a_fault() {
    for view in [CameraView::Nothing, CameraView::Position, CameraView::Pose] {
        assert_eq!(drive(view, GEOMETRY, no_fault), []);
    }
}

#[test]
fn a_gyro_in_degrees_turns_57_times_as_far_as_the_wheels() {
    for view in [CameraView::Nothing, CameraView::Position, CameraView::Pose] {
        assert_found(view, |_, gyro, _| *gyro /= DEGREE, WiringFault::GyroInDegrees, RatioKind::GyroTurn, 57.3);
    }
}

#[test]
fn millimetres_show_as_a_factor_of_a_thousand() {
    let falsify: Falsify = |_, _, seen| {
        seen[0] *= 1e3;
        seen[1] *= 1e3;
    };
    for view in [CameraView::Position, CameraView::Pose] {
        assert_found(view, falsify, WiringFault::CameraInMillimeters, RatioKind::FixDistance, 1e3);
    }
    let in_millimeters = |radius: f64, track: f64| posebridge_telemetry::DriveGeometry {
        left_wheel_radius: GEOMETRY.left_wheel_radius * radius,
        right_wheel_radius: GEOMETRY.right_wheel_radius * radius,
        track_width: GEOMETRY.track_width * track,
        ..GEOMETRY
    };
    let fault = |radius, track| only(&drive(CameraView::Pose, in_millimeters(radius, track), no_fault)).fault();
    assert_eq!(fault(1e3, 1.0), Some(WiringFault::RadiiInMillimeters));
    assert_eq!(fault(1.0, 1e3), Some(WiringFault::TrackInMillimeters));
    assert_eq!(fault(1e3, 1e3), Some(WiringFault::RadiiAndTrackInMillimeters));
}

#[test]
fn a_reversed_wheel_is_told_from_the_other_one() {
    for view in [CameraView::Nothing, CameraView::Position, CameraView::Pose] {
        let left = only(&drive(view, GEOMETRY, |wheels, _, _| wheels[0] = -wheels[0])).fault();
        assert_eq!(left, Some(WiringFault::LeftWheelReversed));
        let right = only(&drive(view, GEOMETRY, |wheels, _, _| wheels[1] = -wheels[1])).fault();
        assert_eq!(right, Some(WiringFault::RightWheelReversed));
    }
}

#[test]
fn ticks_are_told_from_the_track_by_the_distance_between_fixes() {
    for view in [CameraView::Position, CameraView::Pose] {
        let half = only(&drive(view, GEOMETRY, |wheels, _, _| *wheels = wheels.map(|angle| 0.5 * angle))).fault();
        assert_eq!(half, Some(WiringFault::WheelsReportHalf));
        let double = only(&drive(view, GEOMETRY, |wheels, _, _| *wheels = wheels.map(|angle| 2.0 * angle))).fault();
        assert_eq!(double, Some(WiringFault::WheelsReportDouble));
    }
    let found = drive(CameraView::Nothing, GEOMETRY, |wheels, _, _| *wheels = wheels.map(|angle| 0.5 * angle));
    assert_eq!(only(&found).candidates, [WiringFault::WheelsReportHalf, WiringFault::TrackTooWide]);
    assert_eq!(only(&found).missing, Some(DecidingObservation::Fixes));
}

#[test]
fn a_camera_whose_y_axis_points_down_turns_the_other_way_than_wheels_and_gyro() {
    for view in [CameraView::Position, CameraView::Pose] {
        let falsify: Falsify = |_, _, seen| {
            seen[1] = -seen[1];
            seen[2] = -seen[2];
        };
        assert_found(view, falsify, WiringFault::CameraYDown, RatioKind::FixTurn, -1.0);
    }
}

#[test]
fn swapped_wheels_both_reversed_and_a_reversed_gyro_are_told_apart_by_fixes_and_by_nothing_else() {
    let faults: [(WiringFault, Falsify); 3] = [
        (WiringFault::GyroReversed, |_, gyro, _| *gyro = -*gyro),
        (WiringFault::WheelsSwapped, |wheels, _, _| wheels.swap(0, 1)),
        (WiringFault::BothWheelsReversed, |wheels, _, _| *wheels = wheels.map(|angle| -angle)),
    ];
    for (fault, falsify) in faults {
        assert_eq!(only(&drive(CameraView::Pose, GEOMETRY, falsify)).fault(), Some(fault));
        let found = drive(CameraView::Nothing, GEOMETRY, falsify);
        assert_eq!(only(&found).candidates, faults.map(|(fault, _)| fault));
        assert_eq!(only(&found).missing, Some(DecidingObservation::Fixes));
    }
    // The direction of the path decides between the gyro and the wheels. Both wheels reversed drive the same path as two swapped ones,
    // the other way round.
    let gyro_and_swapped = [faults[0], faults[1]];
    let [gyro, swapped] = gyro_and_swapped.map(|(_, falsify)| drive(CameraView::Position, GEOMETRY, falsify));
    assert_eq!(only(&gyro).fault(), Some(WiringFault::GyroReversed));
    assert_eq!(only(&swapped).candidates, [WiringFault::WheelsSwapped, WiringFault::BothWheelsReversed]);
    assert_eq!(only(&swapped).missing, Some(DecidingObservation::FixesWithHeading));
}

#[test]
fn a_lifted_and_a_stuck_robot_have_no_fault() {
    // By hand: the gyro and the camera turn, the wheels do not. Against a wall: the wheels turn, nothing else does.
    let lifted: Falsify = |wheels, _, _| *wheels = [0.0; 2];
    let stuck: Falsify = |_, gyro, seen| {
        *gyro = BIAS_RAD_PER_S;
        *seen = [0.0; 3];
    };
    for view in [CameraView::Nothing, CameraView::Position, CameraView::Pose] {
        assert_eq!(drive(view, GEOMETRY, lifted), []);
        assert_eq!(drive(view, GEOMETRY, stuck), []);
    }
}
