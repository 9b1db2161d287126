//! Whole drives, and what is done to a simulated robot: it happens to its body, its sensors and its camera as it would to a real one.

use crate::support::{bundled, driven, exact, last, run};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{ManualControl, Message, PositionTarget, Setpoint};
use posebridge_sim::scenario::Personality;
use posebridge_sim::{
    BUNDLED, CommandExecutor, HISTORY_DURATION, HISTORY_TRIM_BLOCK, Scenario, Simulation, Steering, TruthSample,
};
use posebridge_telemetry::{
    Address, Meters, MetersPerSecond, RadiansPerSecond, SensorSwitch, SimulatorCommand, SlippingWheel, SystemId,
    TimeDelta,
};

fn odometry_error_m(sample: &TruthSample) -> f64 {
    sample.odometry.origin().distance(sample.pose.origin()).0
}

#[test]
fn every_bundled_scenario_comes_to_its_end_on_odometry_alone() {
    for (name, _) in BUNDLED {
        let run = driven(bundled(name).with_steering(Steering::Odometry));
        assert!(run.is_finished() && (run.progress() - 1.0).abs() < 1e-9, "{name} still drives");
    }
}

#[test]
fn the_odometry_of_the_square_ends_decimetres_from_the_truth_after_half_a_minute() {
    let run = driven(bundled("square"));
    let secs = run.elapsed().as_secs_f64();
    assert!((25.0..40.0).contains(&secs), "{secs} s");
    let error_m = odometry_error_m(last(&run));
    assert!((0.05..0.6).contains(&error_m), "{error_m} m");
    // Steered by that odometry, the robot believes to be home and is not.
    let home_m = last(&run).pose.origin().distance(run.start_pose().origin()).0;
    assert!(home_m > 0.05, "{home_m} m");
}

#[test]
fn without_errors_the_robot_stays_on_the_path_and_odometry_ends_within_two_counts_of_the_truth() {
    for (name, bound_m) in [("square", 0.015), ("circle", 0.015), ("figure-eight", 0.015), ("straight", 0.02)] {
        let run = driven(exact(bundled(name)));
        let worst_m = run.truth().iter().map(|sample| sample.cross_track_m).fold(0.0, f64::max);
        assert!(worst_m < bound_m, "{name}: {worst_m} m");
        // One count is 0.49 mm of travel and, over the track, 0.25 degrees.
        let heading_deg = (last(&run).odometry.heading - last(&run).pose.heading).0.to_degrees();
        assert!(heading_deg.abs() <= 0.5, "{name}: {heading_deg} degrees");
        // The heading is off by a fraction of a count all along the way, so the position is off by that times the size.
        assert!(odometry_error_m(last(&run)) < 0.004, "{name}: {} m", odometry_error_m(last(&run)));
    }
}

#[test]
fn more_laps_take_more_time_and_the_path_stays_the_same() {
    let [one, two] = [1, 2].map(|laps| driven(exact(bundled("square")).with_laps(laps)));
    let ratio = two.elapsed().as_secs_f64() / one.elapsed().as_secs_f64();
    assert!((1.8..2.0).contains(&ratio), "{ratio}");
    assert_eq!(one.path(), two.path());
}

#[test]
fn truth_is_logged_every_telemetry_period_with_the_configured_clock() {
    let mut scenario = bundled("straight");
    scenario.brick.clock_start_micros = 12_000_000;
    scenario.brick.clock_skew_ppm = -2_021.0;
    let run = driven(scenario);
    assert_eq!(run.truth()[0].pose, run.start_pose());
    for (index, sample) in run.truth().iter().enumerate() {
        assert_eq!(sample.sim_time.as_nanos(), index as i64 * 50_000_000);
        let expected_s = 12.0 + sample.sim_time.as_secs_f64() * (1.0 - 2_021e-6);
        assert!((sample.brick_time.as_secs_f64() - expected_s).abs() < 1e-8);
    }
}

#[test]
fn a_world_without_history_drives_the_same_way_and_keeps_nothing() {
    let mut with = Simulation::new(bundled("square"));
    let mut without = Simulation::new(bundled("square")).without_history();
    assert_eq!(run(&mut with, 5_000), run(&mut without, 5_000));
    assert!(with.truth().len() > 90 && with.camera_fixes().len() > 30);
    // The instant at which it was made stands in the truth.
    assert_eq!((without.truth().len(), without.camera_fixes().len()), (1, 0));
}

#[test]
fn equal_seeds_and_commands_give_equal_bytes_and_other_seeds_do_not() {
    let sent = |personality, seed| {
        let scenario = Scenario::default().with_personality(personality).with_seed(seed).without_end();
        let mut simulation = Simulation::new(scenario);
        let mut sent = run(&mut simulation, 3_000);
        for command in [
            SimulatorCommand::Kidnap { forward_m: 0.1, left_m: 0.2, turn_rad: 1.0 },
            SimulatorCommand::Slip { wheel: SlippingWheel::Right, factor: 0.5, duration: TimeDelta::from_millis(300) },
            SimulatorCommand::GyroBiasStep { rad_per_s: 0.02 },
            SimulatorCommand::Drive { forward_m_per_s: 0.1, turn_rad_per_s: -0.5 },
            SimulatorCommand::Path,
        ] {
            simulation.execute(&command);
            // The Input module of the NXT, with its gyro; a MAVLink brick skips it as damage.
            simulation.receive(&[10, 0, 1, 0x94, 1, 0, 3, 0, 0, 0, 80, 0]);
            sent.extend(run(&mut simulation, 1_000));
        }
        sent
    };
    for personality in [Personality::Mavlink, Personality::Nxt] {
        let once = sent(personality, 1);
        assert!(once.len() >= 5);
        assert!(once == sent(personality, 1) && once != sent(personality, 2), "{personality:?}");
    }
}

/// A robot without errors that has driven along a straight way for three seconds.
fn driving_simulation() -> Simulation {
    let text = "[path.waypoints]\npoints_m = [[0, 0], [9, 0]]\n[drive]\nrest_s = 0.5\n";
    let mut simulation = Simulation::new(exact(Scenario::from_toml(text).unwrap()));
    run(&mut simulation, 3_000);
    simulation
}

#[test]
fn a_kidnapped_robot_is_where_it_was_put_and_its_odometry_knows_nothing_of_it() {
    let mut simulation = driving_simulation();
    let before = *last(&simulation);
    let kidnap = SimulatorCommand::Kidnap { forward_m: 0.0, left_m: 0.5, turn_rad: 0.0 };
    assert_eq!(simulation.execute(&kidnap), CommandExecutor::Simulation);
    run(&mut simulation, 100);
    let after = *last(&simulation);
    assert!((after.pose.y.0 - before.pose.y.0 - 0.5).abs() < 1e-9);
    assert!((after.pose.x.0 - before.pose.x.0).abs() < 1e-9, "wheels in the air move nothing");
    assert!((after.odometry.y.0 - before.odometry.y.0).abs() < 1e-6);
    // In the air they spin, and count: 0.22 m/s for 0.1 s.
    assert!(after.odometry.x.0 - before.odometry.x.0 > 0.015);
    run(&mut simulation, 1_000);
    assert!(last(&simulation).pose.x.0 > after.pose.x.0 + 0.1, "on the floor it drives on");
}

/// Messages as a ground station sends them; the same ones for another system change nothing.
#[test]
fn a_ground_station_drives_the_brick_by_stick_by_speed_and_to_a_point() {
    let brick = Address::new(1, 1);
    let send = |simulation: &mut Simulation, message: &Message| {
        let mut bytes = Vec::new();
        Encoder::new(WireVersion::V2).encode(Address::new(255, 190), message, &mut bytes);
        simulation.receive(&bytes);
    };
    let stick =
        |system| Message::ManualControl(ManualControl { system: SystemId(system), forward: Some(-0.5), turn: None });
    let setpoint = |target, setpoint| Message::PositionTarget(PositionTarget { target, setpoint });
    let mut simulation = driving_simulation();
    send(&mut simulation, &stick(7));
    send(&mut simulation, &setpoint(Address::new(7, 1), Setpoint::Position { x: Meters(0.0), y: Meters(0.0) }));
    run(&mut simulation, 1_000);
    let before = *last(&simulation);
    send(&mut simulation, &stick(1));
    run(&mut simulation, 2_000);
    let back = *last(&simulation);
    // Half a second backwards at half speed, braking included; the others' messages would have stopped it before.
    assert!((-0.15..0.3).contains(&(back.pose.x.0 - before.pose.x.0)), "{back:?}");
    let turning = Setpoint::BodyVelocity { forward: MetersPerSecond(0.0), turn: RadiansPerSecond(1.0) };
    send(&mut simulation, &setpoint(brick, turning));
    run(&mut simulation, 1_500);
    let turned = *last(&simulation);
    assert!((0.2..0.8).contains(&turned.pose.heading.rad()), "{turned:?}");
    send(&mut simulation, &setpoint(Address::new(1, 0), Setpoint::Position { x: Meters(0.3), y: Meters(-0.4) }));
    run(&mut simulation, 20_000);
    let there = last(&simulation).pose;
    assert!((there.x.0 - 0.3).hypot(there.y.0 + 0.4) < 0.04, "{there:?}");
}

#[test]
fn a_half_turn_may_go_either_way_round() {
    for turn_rad in [std::f64::consts::PI, -std::f64::consts::PI] {
        let mut simulation = Simulation::new(exact(Scenario::default()));
        simulation.execute(&SimulatorCommand::Kidnap { forward_m: 0.0, left_m: 0.0, turn_rad });
        run(&mut simulation, 50);
        let halfway = last(&simulation).pose.heading.rad();
        assert!((halfway - 0.5 * turn_rad).abs() < 0.1, "{halfway} of {turn_rad}");
    }
}

#[test]
fn wheels_without_grip_count_and_move_nothing_for_as_long_as_it_was_said() {
    let slip = |wheel, factor| SimulatorCommand::Slip { wheel, factor, duration: TimeDelta::from_millis(1_000) };
    for (factor, share) in [(1.0, 0.0), (0.4, 0.6)] {
        let mut simulation = driving_simulation();
        let before = *last(&simulation);
        simulation.execute(&slip(SlippingWheel::Both, factor));
        run(&mut simulation, 1_000);
        let after = *last(&simulation);
        let (counted_m, moved_m) = (after.odometry.x.0 - before.odometry.x.0, after.pose.x.0 - before.pose.x.0);
        assert!(counted_m > 0.15, "{counted_m}");
        assert!((moved_m - share * counted_m).abs() < 0.002, "{moved_m} of {counted_m}");
        run(&mut simulation, 1_000);
        assert!(last(&simulation).pose.x.0 - after.pose.x.0 > 0.15, "it grips again");
    }
    for (wheel, sign) in [(SlippingWheel::Left, 1.0), (SlippingWheel::Right, -1.0)] {
        let mut simulation = driving_simulation();
        simulation.execute(&slip(wheel, 1.0));
        run(&mut simulation, 400);
        let turned = last(&simulation);
        // 0.22 m/s of the other wheel over 0.112 m for 0.4 s.
        assert!((turned.pose.heading.rad() - sign * 0.22 * 0.4 / 0.112).abs() < 0.1, "{:?}", turned.pose);
        assert!(turned.odometry.heading.rad().abs() < 0.02, "the encoders say straight on");
    }
}

#[test]
fn a_covered_camera_sees_nothing_and_leaves_the_noise_of_the_others_as_it_was() {
    let sent = |commands: &[(u32, SensorSwitch)]| {
        let mut simulation = Simulation::new(Scenario::default());
        for (millis, to) in commands {
            run(&mut simulation, *millis);
            simulation.execute(&SimulatorCommand::Camera(*to));
        }
        run(&mut simulation, 3_000);
        simulation.camera_fixes().to_vec()
    };
    let mut expected = sent(&[(4_000, SensorSwitch::On)]);
    expected.retain(|fix| !(2_001..=4_001).contains(&(fix.exposed.as_nanos() / 1_000_000)));
    assert!(expected.len() > 20);
    assert_eq!(sent(&[(2_000, SensorSwitch::Off), (2_000, SensorSwitch::On)]), expected);
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
    assert!(simulation.camera_fixes().iter().rev().take(10).all(|fix| fix.sent - fix.exposed == delay));
}

#[test]
fn a_drive_without_an_end_remembers_ten_minutes_and_little_more() {
    let second = TimeDelta::from_millis(1_000);
    for telemetry_hz in [1.0, 200.0] {
        let mut scenario = Scenario::default().without_end();
        scenario.brick.telemetry_hz = telemetry_hz;
        let mut simulation = Simulation::new(scenario);
        let most = HISTORY_DURATION + HISTORY_TRIM_BLOCK + second;
        for _ in 0..25 {
            run(&mut simulation, 60_000);
            let kept = last(&simulation).sim_time - simulation.truth()[0].sim_time;
            let least = HISTORY_DURATION.min(simulation.elapsed()) - second;
            assert!(kept >= least && kept <= most, "{kept:?} of {:?}", simulation.elapsed());
        }
        let fixes = simulation.camera_fixes();
        let kept = fixes.last().unwrap().sent - fixes.first().unwrap().sent;
        assert!(kept <= most && kept >= HISTORY_DURATION - TimeDelta::from_millis(5_000), "{kept:?} of fixes");
        assert_eq!(simulation.truth_samples(), 25 * 60 * telemetry_hz as u64 + 1);
    }
}
