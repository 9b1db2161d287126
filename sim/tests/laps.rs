//! Whole runs: a lap takes its time and ends, odometry goes as wrong as it should and no more, equal seeds give equal
//! bytes.
#![expect(clippy::unwrap_used, reason = "test code stops at the first surprise")]

use posebridge_sim::scenario::{ErrorSettings, Steering};
use posebridge_sim::{BUNDLED, Scenario, Simulation, TruthSample};
use posebridge_telemetry::{Arena, Pose};

#[test]
fn a_lap_of_the_square_takes_half_a_minute() {
    let run = driven(bundled("square"));
    let secs = run.elapsed().as_secs_f64();
    assert!((25.0..40.0).contains(&secs), "{secs} s");
    assert!((run.progress() - 1.0).abs() < 1e-9);
}

#[test]
fn every_bundled_scenario_comes_to_its_end_on_odometry_alone() {
    for (name, _) in BUNDLED {
        let run = driven(bundled(name).with_steering(Steering::Odometry));
        let secs = run.elapsed().as_secs_f64();
        assert!(run.is_finished(), "{name} still drives after {secs} s");
    }
}

#[test]
fn the_odometry_of_the_square_ends_decimetres_from_the_truth() {
    let run = driven(bundled("square"));
    let error_m = odometry_error_m(last(&run));
    assert!((0.05..0.6).contains(&error_m), "{error_m} m");
    // Steered by that odometry, the robot believes to be home and is not.
    let home = last(&run).pose.origin().distance(run.start_pose().origin()).0;
    assert!(home > 0.05, "{home} m");
}

#[test]
fn a_world_without_history_drives_the_same_way_and_keeps_nothing() {
    let mut with = Simulation::new(bundled("square"));
    let mut without = Simulation::new(bundled("square")).without_history();
    for _ in 0..5_000 {
        with.step();
        without.step();
        loop {
            let (one, other) = (with.poll(), without.poll());
            assert_eq!(one, other);
            if one.is_none() {
                break;
            }
        }
    }
    assert!(with.truth().len() > 90 && with.camera_fixes().len() > 30);
    // The instant at which it was made stands in the truth.
    assert_eq!((without.truth().len(), without.camera_fixes().len()), (1, 0));
}

#[test]
fn without_errors_odometry_ends_within_two_counts_of_the_truth() {
    for name in ["square", "circle", "figure-eight", "straight"] {
        let run = driven(exact(bundled(name)));
        let end = last(&run);
        // One count is 0.49 mm of travel and, over the track, 0.25 degrees.
        let heading_deg = (end.odometry.heading - end.pose.heading).0.to_degrees();
        assert!(heading_deg.abs() <= 0.5, "{name}: {heading_deg} degrees");
        // The heading is off by a fraction of a count all along the way, so the position is off by that times the size.
        assert!(odometry_error_m(end) < 0.004, "{name}: {} m", odometry_error_m(end));
    }
}

#[test]
fn without_errors_the_robot_stays_on_the_path() {
    for name in ["square", "circle", "figure-eight"] {
        let run = driven(exact(bundled(name)));
        let worst = run.truth().iter().map(|t| t.cross_track_m).fold(0.0, f64::max);
        assert!(worst < 0.015, "{name}: {worst} m");
    }
}

#[test]
fn equal_seeds_give_equal_bytes_and_other_seeds_do_not() {
    let first = bytes(&bundled("square"), 3_000);
    assert_eq!(bytes(&bundled("square"), 3_000), first);
    assert_ne!(bytes(&bundled("square").with_seed(99), 3_000), first);
}

#[test]
fn more_laps_take_more_time_and_the_path_stays_the_same() {
    let one = driven(exact(bundled("square")));
    let two = driven(exact(bundled("square")).with_laps(2));
    let ratio = two.elapsed().as_secs_f64() / one.elapsed().as_secs_f64();
    assert!((1.8..2.0).contains(&ratio), "{ratio}");
    assert_eq!(one.path(), two.path());
}

#[test]
fn truth_is_logged_every_telemetry_period_from_the_beginning() {
    let run = driven(bundled("straight"));
    let samples = run.truth();
    assert_eq!(samples[0].pose, run.start_pose());
    for (index, sample) in samples.iter().enumerate() {
        assert_eq!(sample.sim_time.as_nanos(), index as i64 * 50_000_000);
    }
}

#[test]
fn the_brick_clock_of_the_truth_starts_and_runs_as_configured() {
    let mut scenario = bundled("straight");
    scenario.brick.clock_start_micros = 12_000_000;
    scenario.brick.clock_skew_ppm = -2_021.0;
    let run = driven(scenario);
    for sample in run.truth() {
        let expected_s = 12.0 + sample.sim_time.as_secs_f64() * (1.0 - 2_021e-6);
        assert!((sample.brick_time.as_secs_f64() - expected_s).abs() < 1e-8);
    }
}

fn bundled(name: &str) -> Scenario {
    Scenario::bundled(name).unwrap()
}

/// The same scenario without errors, play or clock skew.
fn exact(mut scenario: Scenario) -> Scenario {
    scenario.errors = ErrorSettings::none();
    scenario.robot.backlash_deg = 0.0;
    scenario.brick.clock_skew_ppm = 0.0;
    scenario
}

/// Runs to the end; gives up after ten minutes of world time.
fn driven(scenario: Scenario) -> Simulation {
    let mut simulation = Simulation::new(scenario);
    while !simulation.is_finished() && simulation.elapsed().as_secs_f64() < 600.0 {
        simulation.step();
        while simulation.poll().is_some() {}
    }
    simulation
}

fn bytes(scenario: &Scenario, steps: u32) -> Vec<u8> {
    let mut simulation = Simulation::new(scenario.clone());
    let mut all = Vec::new();
    for _ in 0..steps {
        simulation.step();
        while let Some(chunk) = simulation.poll() {
            all.extend(chunk);
        }
    }
    all
}

fn last(simulation: &Simulation) -> &TruthSample {
    simulation.truth().last().unwrap()
}

fn odometry_error_m(sample: &TruthSample) -> f64 {
    let distance = |a: Pose<Arena>, b: Pose<Arena>| a.origin().distance(b.origin()).0;
    distance(sample.odometry, sample.pose)
}
