//! Monte-Carlo drives are what their files say: statistics of truth and sensors, the order of arrival, repeatability.
#![expect(clippy::unwrap_used, reason = "test code stops at the first surprise")]

mod camera;
mod course;
mod robot;
mod support;

use posebridge_sim::montecarlo::SCENARIOS;
use posebridge_telemetry::SensorId;
use support::bundled;

#[test]
fn every_bundled_scenario_reads_and_its_first_drive_is_finite_and_in_order() {
    for (name, _) in SCENARIOS {
        let drive = bundled(name).drive(0);
        assert!(drive.truth.len() > 300, "{name}: {}", drive.truth.len());
        for pose in &drive.truth {
            assert!(pose.x.0.is_finite() && pose.y.0.is_finite(), "{name}");
        }
        let steps: Vec<usize> = drive.arrivals.iter().map(|arrival| arrival.step).collect();
        assert!(steps.is_sorted(), "{name}");
        for arrival in &drive.arrivals {
            assert!(
                arrival.observation.stamp <= drive.time_at(arrival.step),
                "{name}: an observation arrives before it is made"
            );
        }
        let wheels = drive.arrivals.iter().filter(|arrival| arrival.observation.sensor == SensorId::WHEELS);
        assert_eq!(wheels.count(), drive.truth.len(), "{name}");
    }
}

#[test]
fn a_run_can_be_repeated_alone_and_differs_from_its_neighbours() {
    let scenario = bundled("kicks-camera-1hz");
    assert_eq!(scenario.drive(3), scenario.drive(3));
    assert_ne!(scenario.drive(3), scenario.drive(4));
    let other = scenario.clone().with_seed(2);
    assert_ne!(scenario.drive(3), other.drive(3));
}

#[test]
fn scenarios_with_the_same_seed_share_their_truth() {
    let clear = bundled("camera-10hz").drive(5);
    for name in ["outliers-3pct", "noise-x4", "blackout", "no-camera"] {
        assert_eq!(clear.truth, bundled(name).drive(5).truth, "{name}");
    }
}
