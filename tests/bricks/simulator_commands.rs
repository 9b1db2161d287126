//! What people do to the simulated brick has its effect, is seen by the station, and is repeated by a replay, bit for bit.

use posebridge::config::Config;
use posebridge::virtual_station::{self, RunEvent, RunScript, VirtualRun};
use posebridge_sim::{Scenario, Steering, TruthSample};
use posebridge_station::{Station, StationConfig};
use posebridge_telemetry::simulator::ProfileName;
use posebridge_telemetry::{
    Command, Estimate, Event, FusionOutcome, FusionRecord, HostClock, Input, LinkState, Output, ReceiveError, SensorId,
    SensorSwitch, SimulatorCommand, SlippingWheel, SteeringSource, TimeDelta, Timestamp,
};

/// Everything of a run, in its order.
struct DrivenRun {
    virtual_run: VirtualRun,
    inputs: Vec<(Timestamp<HostClock>, Input)>,
    events: Vec<(Timestamp<HostClock>, Event)>,
}

impl DrivenRun {
    fn estimates(&self) -> impl Iterator<Item = (Timestamp<HostClock>, &Estimate)> {
        self.events.iter().filter_map(|(at, event)| match event {
            Event::EstimateUpdated { estimate, .. } => Some((*at, estimate)),
            _ => None,
        })
    }

    /// The last estimate by then.
    fn estimate_at(&self, secs: f64) -> &Estimate {
        let by = Timestamp::from_secs_f64(secs);
        let last = self.estimates().take_while(|(at, _)| *at <= by).last();
        last.unwrap().1
    }

    fn truth_at(&self, secs: f64) -> &TruthSample {
        let mut samples = self.virtual_run.simulation.truth().iter();
        samples.rfind(|one| one.sim_time.as_secs_f64() <= secs).unwrap()
    }

    /// How far the estimate was off, in metres.
    fn off_m(&self, secs: f64) -> f64 {
        let estimate = self.estimate_at(secs);
        let truth = self.truth_at(secs);
        estimate.pose.origin().distance(truth.pose.origin()).0
    }

    fn texts(&self) -> Vec<&str> {
        let texts = self.events.iter().filter_map(|(_, event)| match event {
            Event::Text { text, .. } => Some(text.as_str()),
            _ => None,
        });
        texts.collect()
    }

    fn records(&self) -> impl Iterator<Item = (f64, &FusionRecord)> {
        self.events.iter().filter_map(|(at, event)| match event {
            Event::ObservationFused { record, .. } => Some((at.as_secs_f64(), record)),
            _ => None,
        })
    }

    fn verdicts_of(&self, sensor: SensorId) -> impl Iterator<Item = (f64, FusionOutcome)> {
        self.records().filter(move |(_, record)| record.sensor == sensor).map(|(at_s, record)| (at_s, record.outcome))
    }
}

fn at(secs: f64, command: SimulatorCommand) -> (TimeDelta, Command) {
    (TimeDelta::from_secs_f64(secs), Command::Simulator(command))
}

fn station_config_of(scenario: &Scenario) -> StationConfig {
    Config::default().with_camera_of(scenario).station_config().unwrap()
}

/// The bundled scenario, driven without an end for so long.
fn driven(name: &str, commands: &[(TimeDelta, Command)], secs: f64) -> DrivenRun {
    let scenario = Scenario::bundled(name).unwrap().without_end();
    let config = station_config_of(&scenario);
    let (mut inputs, mut events) = (Vec::new(), Vec::new());
    let script = RunScript {
        commands,
        until: TimeDelta::from_secs_f64(secs),
        linger: TimeDelta::ZERO,
        observer: &mut |at, seen| match seen {
            RunEvent::Input(input) => inputs.push((at, input.clone())),
            RunEvent::Event(event) => events.push((at, event.clone())),
        },
    };
    let virtual_run = virtual_station::run_with(scenario, config, script).unwrap();
    DrivenRun { virtual_run, inputs, events }
}

#[test]
fn a_kidnapped_robot_is_found_again_and_the_jump_is_counted() {
    let kidnap = SimulatorCommand::Kidnap { forward_m: 0.3, left_m: -0.4, turn_rad: 1.0 };
    let refused = SimulatorCommand::Kidnap { forward_m: f64::INFINITY, left_m: 0.0, turn_rad: 0.0 };
    let run = driven("square", &[at(3.0, refused), at(8.0, kidnap)], 14.0);
    assert!(run.texts().contains(&"kidnap: forward_m inf not in -10..10"));
    let before = run.estimate_at(7.9);
    assert!(run.off_m(7.9) < 0.02, "{} m", run.off_m(7.9));
    let (from, to) = (run.truth_at(7.96).pose, run.truth_at(8.16).pose);
    let carried_m = from.origin().distance(to.origin()).0;
    assert!((carried_m - 0.5).abs() < 0.1, "{carried_m} m");
    // Two seconds after it was taken it is known where it is.
    let after = run.estimate_at(10.0);
    assert_ne!(after.reset_counter, before.reset_counter);
    assert!(run.off_m(10.0) < 0.05, "{} m", run.off_m(10.0));
    assert!(run.off_m(13.5) < 0.02, "{} m", run.off_m(13.5));
    assert!(run.texts().contains(&"kidnap: 0.30 m forward, -0.40 m left, 57 deg"));
    // It comes back to its path by itself.
    assert!(run.truth_at(13.9).cross_track_m < 0.1);
}

#[test]
fn a_slipping_wheel_is_called_slip_and_told_once() {
    let slip = |secs| {
        let wheel = SlippingWheel::Left;
        let duration = TimeDelta::from_millis(1_500);
        at(secs, SimulatorCommand::Slip { wheel, factor: 1.0, duration })
    };
    // Both on a side, which takes 4.5 s, and not in the turn at its end.
    let run = driven("square", &[slip(3.0), slip(15.0)], 18.0);
    let slips: Vec<f64> = run
        .verdicts_of(SensorId::WHEELS)
        .filter(|(_, verdict)| *verdict == FusionOutcome::Slip)
        .map(|(at_s, _)| at_s)
        .collect();
    let while_it_slips = |at_s: &&f64| (3.0..5.0).contains(*at_s) || (15.0..17.0).contains(*at_s);
    let seen = slips.iter().filter(while_it_slips).count();
    assert!(seen >= 4, "{slips:?}");
    // A window of the gyro may be taken for slip by chance, one in a thousand, or where the play of a wheel is crossed.
    assert!(slips.len() - seen <= 2, "{slips:?}");
    assert!((3.0..5.0).contains(&slips[0]), "{slips:?}");
    let lines = run.texts().iter().filter(|text| text.starts_with("wheels slip")).count();
    assert_eq!(lines, 2, "one for each time");
    // The encoders have counted what the body did not do, and the estimate has not believed them.
    let truth = run.truth_at(5.0);
    let odometry_m = truth.odometry.origin().distance(truth.pose.origin()).0;
    assert!(odometry_m > 3.0 * run.off_m(5.0), "{odometry_m} {}", run.off_m(5.0));
}

#[test]
fn a_step_of_the_gyros_bias_is_found_by_the_filter() {
    let step = SimulatorCommand::GyroBiasStep { rad_per_s: 0.05 };
    let run = driven("square", &[at(10.0, step)], 60.0);
    let (before, after) = (run.off_m(9.9), run.off_m(59.9));
    assert!(before < 0.02 && after < 0.03, "{before} {after}");
    let headings = run.truth_at(59.9).pose.heading - run.estimate_at(59.9).pose.heading;
    assert!(headings.0.abs() < 0.05, "{headings:?}");
}

#[test]
fn by_odometry_it_drifts_away_and_by_the_estimate_it_comes_back() {
    let steer = |secs, source| at(secs, SimulatorCommand::Steering(source));
    let commands = [steer(5.0, SteeringSource::Odometry), steer(60.0, SteeringSource::Estimate)];
    let run = driven("square", &commands, 90.0);
    assert_eq!(run.truth_at(4.9).steering, Steering::Estimate);
    assert_eq!(run.truth_at(59.9).steering, Steering::Odometry);
    assert_eq!(run.truth_at(61.0).steering, Steering::Estimate);
    let worst_m = |from: f64, to: f64| {
        let samples = run.virtual_run.simulation.truth().iter();
        let within = samples.filter(|one| (from..to).contains(&one.sim_time.as_secs_f64()));
        within.map(|one| one.cross_track_m).fold(0.0, f64::max)
    };
    let (drifted_m, back_m) = (worst_m(40.0, 60.0), worst_m(75.0, 90.0));
    assert!(drifted_m > 0.05 && back_m < 0.02, "{drifted_m} {back_m}");
}

#[test]
fn a_person_drives_for_half_a_second_a_time_and_lets_it_find_its_path_again() {
    let drive = |secs| at(secs, SimulatorCommand::Drive { forward_m_per_s: -0.2, turn_rad_per_s: 0.0 });
    let mut commands: Vec<_> = (0..5).map(|i| drive(5.0 + 0.4 * f64::from(i))).collect();
    commands.push(at(9.0, SimulatorCommand::Path));
    let run = driven("circle", &commands, 20.0);
    let speed = |secs| run.truth_at(secs).forward_speed.0;
    assert!(speed(4.9) > 0.1, "{}", speed(4.9));
    assert!(speed(6.5) < -0.1, "{}", speed(6.5));
    // Half a second after the last key, and the time that it takes to brake.
    assert!(speed(8.5).abs() < 0.01, "{}", speed(8.5));
    assert!(speed(12.0) > 0.1, "{}", speed(12.0));
    assert!(run.truth_at(19.9).cross_track_m < 0.03);
    let lines = run.texts();
    let of_keys = lines.iter().filter(|text| text.starts_with("drive: "));
    assert_eq!(of_keys.count(), 1, "one for a key that is held: {lines:?}");
}

#[test]
fn a_pulled_cable_is_a_link_that_goes_and_comes_back() {
    let duration = TimeDelta::from_millis(2_000);
    let run = driven("square", &[at(6.0, SimulatorCommand::PullCable { duration })], 12.0);
    let states: Vec<(f64, LinkState)> = run
        .events
        .iter()
        .filter_map(|(at, event)| match event {
            Event::Link { state, .. } => Some((at.as_secs_f64(), *state)),
            _ => None,
        })
        .collect();
    let expected = [LinkState::Up, LinkState::Down, LinkState::Up];
    assert_eq!(states.iter().map(|(_, state)| *state).collect::<Vec<_>>(), expected);
    assert!((states[2].0 - states[1].0 - 2.0).abs() < 0.01, "{states:?}");
    let silent = run.estimates().filter(|(at, _)| (6.1..7.9).contains(&at.as_secs_f64()));
    assert_eq!(silent.count(), 0);
    assert!(run.off_m(11.9) < 0.03, "{} m", run.off_m(11.9));
}

#[test]
fn a_link_profile_makes_the_link_worse_and_is_taken_away_again() {
    let profile = |secs, name: Option<&[u8]>| {
        let name = name.map(ProfileName::from_bytes);
        at(secs, SimulatorCommand::LinkProfile(name))
    };
    let commands = [profile(5.0, Some(b"harsh")), profile(15.0, None)];
    let run = driven("square", &commands, 20.0);
    let damaged = |from: f64, to: f64| {
        let defects =
            run.events.iter().filter(|(at, event)| (from..to).contains(&at.as_secs_f64()) && is_damage(event));
        defects.count()
    };
    assert_eq!(damaged(0.0, 5.0), 0);
    assert!(damaged(5.0, 15.0) > 5);
    assert_eq!(damaged(16.0, 20.0), 0);
}

#[test]
fn a_brick_without_an_end_drives_lap_after_lap_and_remembers_only_the_last_of_it() {
    for (name, laps) in [("square", 2), ("circle", 4), ("straight", 2), ("figure-eight", 2)] {
        // By odometry alone it would drift from one lap to the next.
        let steer = SimulatorCommand::Steering(SteeringSource::Estimate);
        let run = driven(name, &[at(0.1, steer)], 90.0);
        let simulation = &run.virtual_run.simulation;
        assert!(!simulation.is_finished(), "{name}");
        assert!(simulation.laps_done() >= laps, "{name}: {}", simulation.laps_done());
        assert!((0.0..=1.0).contains(&simulation.progress()), "{name}");
        let late = simulation.truth().iter().skip(400);
        let worst_m = late.map(|one| one.cross_track_m).fold(0.0, f64::max);
        assert!(worst_m < 0.03, "{name}: {worst_m} m beside its path");
    }
}

const fn is_damage(event: &Event) -> bool {
    matches!(
        event,
        Event::ReceiveError {
            defect: ReceiveError::Checksum { .. } | ReceiveError::UnframedBytes { .. } | ReceiveError::Timeout { .. },
            ..
        }
    )
}

/// A session in which everything is done to the brick that can be.
fn everything() -> Vec<(TimeDelta, Command)> {
    let wheel = SlippingWheel::Right;
    vec![
        at(3.0, SimulatorCommand::Steering(SteeringSource::Odometry)),
        at(4.0, SimulatorCommand::Slip { wheel, factor: 0.7, duration: TimeDelta::from_millis(800) }),
        at(5.0, SimulatorCommand::Steering(SteeringSource::Estimate)),
        at(5.5, SimulatorCommand::Camera(SensorSwitch::Off)),
        at(6.5, SimulatorCommand::Camera(SensorSwitch::On)),
        at(7.0, SimulatorCommand::CameraDelay { delay: TimeDelta::from_millis(400) }),
        at(8.0, SimulatorCommand::GyroBiasStep { rad_per_s: -0.02 }),
        at(9.0, SimulatorCommand::Kidnap { forward_m: -0.2, left_m: 0.2, turn_rad: -2.0 }),
        at(12.0, SimulatorCommand::LinkProfile(Some(ProfileName::from_bytes(b"bluetooth-spp")))),
        at(14.0, SimulatorCommand::LinkProfile(None)),
        at(15.0, SimulatorCommand::PullCable { duration: TimeDelta::from_millis(700) }),
        at(16.5, SimulatorCommand::Drive { forward_m_per_s: 0.1, turn_rad_per_s: 1.0 }),
        at(17.5, SimulatorCommand::Path),
    ]
}

#[test]
fn a_replay_of_everything_that_was_done_is_the_session_bit_for_bit() {
    let run = driven("square", &everything(), 20.0);
    let scenario = Scenario::bundled("square").unwrap();
    let mut station = Station::new(station_config_of(&scenario), Timestamp::ZERO).unwrap();
    let (mut events, mut asked) = (Vec::new(), 0);
    for (at, input) in &run.inputs {
        station.handle(*at, input);
        while let Some(output) = station.poll() {
            match output {
                Output::Event(event) => events.push((*at, event)),
                // Nobody carries it out: the inputs that it led to are there.
                Output::Request(_) => asked += 1,
                Output::Transmit { .. } => {}
            }
        }
    }
    assert_eq!(asked, everything().len());
    assert_eq!(events.len(), run.events.len());
    for (replayed, live) in events.iter().zip(&run.events) {
        // As text, so that what is not a number equals itself.
        assert_eq!(format!("{replayed:?}"), format!("{live:?}"));
    }
    let commands = run.inputs.iter().filter(|(_, input)| matches!(input, Input::Command(_)));
    assert_eq!(commands.count(), everything().len());
}
