//! The detector on the laboratory's drives: robots with one fault, and robots without one.

use posebridge_estimator::wiring::{DecidingObservation, WiringFault};
use posebridge_sim::montecarlo::{CameraSees, SCENARIOS};
use posebridge_telemetry::{Observation, ObservationKind};

use crate::drives::{FoundAt, detect, scenario, short_square};

/// Whether it was found within two turns or two metres.
fn is_soon(found: &FoundAt) -> bool {
    found.turns <= 2.0 || found.path_m <= 2.0
}

#[test]
fn each_fault_is_named_within_two_turns_or_two_metres() {
    for (number, fault) in (0..).zip(WiringFault::ALL) {
        for sees in [CameraSees::Pose, CameraSees::Position] {
            let drive = short_square(Some(sees)).drive(number);
            let found = detect(&drive, Some(fault), |one| Some(*one));
            let last = found.last().unwrap_or_else(|| panic!("{fault:?} is not found with {sees:?}"));
            // A path without headings looks the same when both wheels count backwards as when they are swapped.
            let is_path_alone = sees == CameraSees::Position
                && [WiringFault::WheelsSwapped, WiringFault::BothWheelsReversed].contains(&fault);
            if is_path_alone {
                assert_eq!(last.finding.candidates, [WiringFault::WheelsSwapped, WiringFault::BothWheelsReversed]);
                assert_eq!(last.finding.missing, Some(DecidingObservation::FixesWithHeading));
            } else {
                assert_eq!(last.finding.fault(), Some(fault), "{sees:?}: {}", last.finding);
            }
            assert!(is_soon(last), "{fault:?} {sees:?} {:.2} m {:.2} turns: {}", last.path_m, last.turns, last.finding);
            assert!(found.iter().all(|one| one.finding.candidates.contains(&fault)), "{found:?}");
        }
    }
}

#[test]
fn without_a_camera_a_fault_is_named_or_those_that_look_the_same() {
    let alike = |faults: &[WiringFault]| faults.to_vec();
    let mirrored = alike(&[WiringFault::GyroReversed, WiringFault::WheelsSwapped, WiringFault::BothWheelsReversed]);
    for (fault, expected) in [
        (WiringFault::GyroInDegrees, alike(&[WiringFault::GyroInDegrees])),
        (WiringFault::LeftWheelReversed, alike(&[WiringFault::LeftWheelReversed])),
        (WiringFault::RightWheelReversed, alike(&[WiringFault::RightWheelReversed])),
        (WiringFault::GyroReversed, mirrored.clone()),
        (WiringFault::WheelsSwapped, mirrored.clone()),
        (WiringFault::BothWheelsReversed, mirrored),
        (WiringFault::WheelsReportHalf, alike(&[WiringFault::WheelsReportHalf, WiringFault::TrackTooWide])),
    ] {
        let found = detect(&short_square(None).drive(5), Some(fault), |one| Some(*one));
        let [found] = found.as_slice() else { panic!("{fault:?}: {found:?}") };
        assert_eq!(found.finding.candidates, expected);
        assert!(is_soon(found), "{fault:?} {:.2} m {:.2} turns: {}", found.path_m, found.turns, found.finding);
    }
}

#[test]
fn a_late_and_rare_camera_without_a_gyro_tells_a_mirrored_picture_from_nothing_but_wheels() {
    let wheels_and_camera = |one: &Observation| {
        let is_kept = !matches!(one.measurement, ObservationKind::TurnRate(_));
        is_kept.then_some(*one)
    };
    let drive = short_square(Some(CameraSees::Pose)).drive(7);
    let found = detect(&drive, Some(WiringFault::CameraYDown), wheels_and_camera);
    let last = found.last().unwrap();
    assert_eq!(last.finding.candidates, [WiringFault::WheelsSwapped, WiringFault::CameraYDown]);
    assert_eq!(last.finding.missing, Some(DecidingObservation::Gyro));
}

/// Every kind of drive of the laboratory: with and without a camera, with kicks, slip, outliers, late fixes, kidnaps.
#[test]
fn nothing_is_found_on_any_drive_of_the_laboratory() {
    for (name, _) in SCENARIOS {
        for run in 0..2 {
            let found = detect(&scenario(name).drive(run), None, |one| Some(*one));
            assert!(found.is_empty(), "{name} {run}: {}", found[0].finding);
        }
    }
}

/// Twenty robots whose wheels, track and gyro are as far from what is configured as those of kits are.
#[test]
fn nothing_is_found_on_twenty_robots_of_a_wide_spread() {
    for run in 0..20 {
        let camera = [None, Some(CameraSees::Pose), Some(CameraSees::Position)][run as usize % 3];
        let mut scenario = short_square(camera);
        scenario.errors.radius_scale_sigma = 0.01;
        scenario.errors.radius_difference_sigma = 0.01;
        scenario.errors.track_scale_sigma = 0.05;
        scenario.gyro.scale_sigma = 0.01;
        scenario.gyro.bias_sigma_deg_per_s = 2.0;
        scenario.robot.backlash_deg = 5.0;
        if run % 2 == 0 {
            scenario.slip_bursts = self::scenario("slip-bursts-1hz").slip_bursts;
            scenario.kicks = self::scenario("kicks").kicks;
        }
        let found = detect(&scenario.drive(run), None, |one| Some(*one));
        assert!(found.is_empty(), "{run}: {}", found[0].finding);
    }
}
