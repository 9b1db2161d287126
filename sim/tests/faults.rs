//! What is done to a simulated robot happens to its body, its sensors and its camera as it would to a real one.
#![expect(clippy::unwrap_used, reason = "a test stops where its set-up is broken")]

use posebridge_sim::scenario::ErrorSettings;
use posebridge_sim::{CommandExecutor, HISTORY_DURATION, HISTORY_TRIM_BLOCK, Scenario, Simulation};
use posebridge_telemetry::{SensorSwitch, SimulatorCommand, SlippingWheel, TimeDelta};

/// A robot without errors on a long straight way.
fn exact() -> Scenario {
    let text = "[path.waypoints]\npoints_m = [[0, 0], [9, 0]]\n[robot]\nbacklash_deg = 0.0\n[drive]\nrest_s = 0.5\n";
    let mut scenario = Scenario::from_toml(text).unwrap();
    scenario.errors = ErrorSettings::none();
    scenario
}

fn run(simulation: &mut Simulation, millis: u32) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    for _ in 0..millis {
        simulation.step();
        while let Some(bytes) = simulation.poll() {
            sent.push(bytes);
        }
    }
    sent
}

#[test]
fn a_kidnapped_robot_is_where_it_was_put_and_its_odometry_knows_nothing_of_it() {
    let mut simulation = Simulation::new(exact());
    run(&mut simulation, 3_000);
    let before = *simulation.truth().last().unwrap();
    let kidnap = SimulatorCommand::Kidnap { forward_m: 0.0, left_m: 0.5, turn_rad: 0.0 };
    assert_eq!(simulation.execute(&kidnap), CommandExecutor::Simulation);
    run(&mut simulation, 100);
    let after = *simulation.truth().last().unwrap();
    assert!((after.pose.y.0 - before.pose.y.0 - 0.5).abs() < 1e-9);
    assert!((after.pose.x.0 - before.pose.x.0).abs() < 1e-9, "wheels in the air move nothing");
    assert!((after.odometry.y.0 - before.odometry.y.0).abs() < 1e-6);
    // In the air they spin, and count: 0.22 m/s for 0.1 s.
    assert!(after.odometry.x.0 - before.odometry.x.0 > 0.015);
    run(&mut simulation, 1_000);
    let later = *simulation.truth().last().unwrap();
    assert!(later.pose.x.0 > after.pose.x.0 + 0.1, "on the floor it drives on");
}

#[test]
fn a_half_turn_may_go_either_way_round() {
    for turn_rad in [std::f64::consts::PI, -std::f64::consts::PI] {
        let mut simulation = Simulation::new(exact());
        simulation.execute(&SimulatorCommand::Kidnap { forward_m: 0.0, left_m: 0.0, turn_rad });
        run(&mut simulation, 50);
        let halfway = simulation.truth().last().unwrap().pose.heading.rad();
        assert!((halfway - 0.5 * turn_rad).abs() < 0.1, "{halfway} of {turn_rad}");
    }
}

#[test]
fn wheels_without_grip_count_and_move_nothing_for_as_long_as_it_was_said() {
    for (factor, share) in [(1.0, 0.0), (0.4, 0.6)] {
        let mut simulation = Simulation::new(exact());
        run(&mut simulation, 3_000);
        let before = *simulation.truth().last().unwrap();
        simulation.execute(&SimulatorCommand::Slip {
            wheel: SlippingWheel::Both,
            factor,
            duration: TimeDelta::from_millis(1_000),
        });
        run(&mut simulation, 1_000);
        let after = *simulation.truth().last().unwrap();
        let counted_m = after.odometry.x.0 - before.odometry.x.0;
        let moved_m = after.pose.x.0 - before.pose.x.0;
        assert!(counted_m > 0.15, "{counted_m}");
        assert!((moved_m - share * counted_m).abs() < 0.002, "{moved_m} of {counted_m}");
        run(&mut simulation, 1_000);
        let later = *simulation.truth().last().unwrap();
        assert!((later.pose.x.0 - after.pose.x.0) > 0.15, "it grips again");
    }
}

#[test]
fn one_wheel_without_grip_turns_the_robot_about_it() {
    let mut simulation = Simulation::new(exact());
    run(&mut simulation, 3_000);
    simulation.execute(&SimulatorCommand::Slip {
        wheel: SlippingWheel::Left,
        factor: 1.0,
        duration: TimeDelta::from_millis(500),
    });
    run(&mut simulation, 400);
    let turned = simulation.truth().last().unwrap();
    // 0.22 m/s of the right wheel over 0.112 m for 0.4 s.
    assert!((turned.pose.heading.rad() - 0.22 * 0.4 / 0.112).abs() < 0.1, "{:?}", turned.pose);
    assert!(turned.odometry.heading.rad().abs() < 0.02, "the encoders say straight on");
}

#[test]
fn a_covered_camera_sees_nothing_and_disturbs_nobody_elses_luck() {
    let sent = |commands: &[(u32, SensorSwitch)]| {
        let mut simulation = Simulation::new(Scenario::default());
        for (millis, to) in commands {
            run(&mut simulation, *millis);
            simulation.execute(&SimulatorCommand::Camera(*to));
        }
        run(&mut simulation, 3_000);
        simulation.camera_fixes().to_vec()
    };
    let (all, covered) =
        (sent(&[(4_000, SensorSwitch::On)]), sent(&[(2_000, SensorSwitch::Off), (2_000, SensorSwitch::On)]));
    let dark = |millis: i64| (2_000..=4_000).contains(&millis);
    let in_the_dark = covered.iter().filter(|fix| dark(fix.exposed.as_nanos() / 1_000_000 - 1));
    assert_eq!(in_the_dark.count(), 0);
    let others = all.iter().filter(|fix| !dark(fix.exposed.as_nanos() / 1_000_000 - 1));
    assert_eq!(covered, others.copied().collect::<Vec<_>>(), "the same noise");
    assert!(covered.len() > 20);
}

#[test]
fn a_later_camera_is_later_by_what_was_said() {
    let mut scenario = Scenario::default();
    scenario.camera.jitter_ms = 0.0;
    let mut simulation = Simulation::new(scenario);
    run(&mut simulation, 1_000);
    let delay = TimeDelta::from_millis(640);
    simulation.execute(&SimulatorCommand::CameraDelay { delay });
    run(&mut simulation, 3_000);
    let late = simulation.camera_fixes().iter().rev().take(10);
    for fix in late {
        assert_eq!(fix.sent - fix.exposed, delay);
    }
}

#[test]
fn the_links_commands_are_left_to_who_owns_the_link() {
    let mut simulation = Simulation::new(exact());
    let duration = TimeDelta::from_millis(100);
    for command in [SimulatorCommand::LinkProfile(None), SimulatorCommand::PullCable { duration }] {
        assert_eq!(simulation.execute(&command), CommandExecutor::Link);
    }
}

#[test]
fn the_same_commands_give_the_same_bytes() {
    let sent = || {
        let mut simulation = Simulation::new(Scenario::default().without_end());
        let mut sent = run(&mut simulation, 3_000);
        for command in [
            SimulatorCommand::Kidnap { forward_m: 0.1, left_m: 0.2, turn_rad: 1.0 },
            SimulatorCommand::Slip { wheel: SlippingWheel::Right, factor: 0.5, duration: TimeDelta::from_millis(300) },
            SimulatorCommand::GyroBiasStep { rad_per_s: 0.02 },
            SimulatorCommand::Drive { forward_m_per_s: 0.1, turn_rad_per_s: -0.5 },
            SimulatorCommand::Path,
        ] {
            simulation.execute(&command);
            sent.extend(run(&mut simulation, 1_000));
        }
        sent
    };
    let once = sent();
    assert!(once.len() > 100);
    assert_eq!(once, sent());
}

#[test]
fn a_drive_without_an_end_remembers_ten_minutes_and_little_more() {
    for telemetry_hz in [1.0, 200.0] {
        remembers_ten_minutes_at(telemetry_hz);
    }
}

fn remembers_ten_minutes_at(telemetry_hz: f64) {
    let mut scenario = Scenario::default().without_end();
    scenario.brick.telemetry_hz = telemetry_hz;
    let mut simulation = Simulation::new(scenario);
    let mut longest = TimeDelta::ZERO;
    for _ in 0..25 {
        run(&mut simulation, 60_000);
        let samples = simulation.truth();
        let kept = samples.last().unwrap().sim_time - samples.first().unwrap().sim_time;
        longest = longest.max(kept);
        let elapsed = simulation.elapsed();
        assert!(kept >= HISTORY_DURATION.min(elapsed) - TimeDelta::from_millis(1_000), "{kept:?} of {elapsed:?}");
    }
    let most = HISTORY_DURATION + HISTORY_TRIM_BLOCK + TimeDelta::from_millis(1_000);
    assert!(longest <= most, "{longest:?}");
    let fixes = simulation.camera_fixes();
    let kept = fixes.last().unwrap().sent - fixes.first().unwrap().sent;
    assert!(kept <= most, "{kept:?} of fixes");
    assert!(kept >= HISTORY_DURATION - TimeDelta::from_millis(5_000), "{kept:?} of fixes");
    assert_eq!(simulation.truth_samples(), 25 * 60 * telemetry_hz as u64 + 1);
}
