//! Every protocol that the simulated brick speaks, through one body: a square with a camera at 5 Hz, in virtual time.

use crate::support::{errors_mm, used};
use posebridge::config::{Config, Ev3Section, LinkSection, NxtSection, NxtSensorKind, NxtSensorSection, Place};
use posebridge::virtual_station::{self, VirtualLink, VirtualRun};
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::scenario::MissingSensor;
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_telemetry::{SensorId, TimeDelta};

/// A link that stands still for two seconds, each twenty seconds on average: an NXT sends 29 answers a second.
const STALLS: &str = "kind = \"stream\"\n[to_brick]\n[to_station]\nstalls = [{ probability = 0.0017, from_ms = 2000.0, to_ms = 2000.0 }]\n";

fn square(brick: &str, laps: u32, seed: u64) -> Scenario {
    let text = format!("[path.square]\nside_m = 1.0\n[camera]\nrate_hz = 5.0\n[brick]\npersonality = \"{brick}\"\n");
    Scenario::from_toml(&text).unwrap().with_laps(laps).with_seed(seed).with_steering(Steering::Estimate)
}

/// A station for the brick, and for its camera where that has a link of its own.
fn station(brick: &str, scenario: &Scenario) -> Config {
    let mut config = Config::default().with_camera_of(scenario);
    config.links = vec![LinkSection::new("pty:brick.tty")];
    if brick != "mavlink" {
        config.links[0].brick = Some(brick.to_owned());
        config.links.push(LinkSection::new("tcp://camera:5760"));
        config.robot.nxt = Some(NxtSection {
            sensors: vec![NxtSensorSection {
                port: 1,
                kind: NxtSensorKind::HtGyro,
                forward: "x".to_owned(),
                place: Place::Centre,
            }],
            ..NxtSection::default()
        });
    }
    config
}

fn driven(brick: &str, laps: u32, seed: u64, link: &VirtualLink) -> VirtualRun {
    let scenario = square(brick, laps, seed);
    let config = station(brick, &scenario);
    virtual_station::run_over_link(scenario, config.station_config().unwrap(), link).unwrap()
}

/// How many observations a sensor gave, per second.
fn rate_hz(run: &VirtualRun, sensor: SensorId) -> f64 {
    used(run, sensor) as f64 / run.simulation.elapsed().as_secs_f64()
}

#[test]
fn every_protocol_brings_the_robot_round_the_square() {
    for brick in ["mavlink", "nxt", "nxt-push", "ev3"] {
        let run = driven(brick, 1, 3, &VirtualLink::default());
        assert!(run.simulation.is_finished(), "{brick}");
        let [estimate_mm, odometry_mm] = errors_mm(&run);
        println!(
            "{brick}: estimate {estimate_mm:.1} mm, odometry {odometry_mm:.1} mm; wheels {:.1}/s, gyro {:.1}/s",
            rate_hz(&run, SensorId::WHEELS),
            rate_hz(&run, SensorId::GYRO)
        );
        assert!(estimate_mm < 6.0, "{brick}: {estimate_mm}");
        assert!(estimate_mm < 0.5 * odometry_mm, "{brick}");
    }
}

/// How many states a second an NXT tells that is asked for each part of them by a telegram of its own, on a link that delivers at once.
fn states_per_second(telegrams: &[Vec<u8>]) -> f64 {
    const SECONDS: f64 = 20.0;
    let mut simulation = Simulation::new(square("nxt", 1, 3));
    let mut states = 0;
    while simulation.elapsed() < TimeDelta::from_secs_f64(SECONDS) {
        for telegram in telegrams {
            let length = (telegram.len() as u16).to_le_bytes();
            simulation.receive(&[&length[..], telegram].concat());
            let answer = loop {
                simulation.step();
                if let Some(answer) = simulation.poll() {
                    break answer;
                }
            };
            assert_eq!(answer[2..5], [0x02, telegram[1], 0x00], "{telegram:02x?}");
        }
        states += 1;
    }
    f64::from(states) / SECONDS
}

/// READ IO MAP of the tick: no single command tells the clock.
const TICK: [u8; 10] = [0x01, 0x94, 0x01, 0x00, 0x01, 0x00, 0x14, 0x00, 0x04, 0x00];

fn output_states(ports: &[u8]) -> Vec<Vec<u8>> {
    ports.iter().map(|port| vec![0x00, 0x06, *port]).collect()
}

fn input_values(ports: &[u8]) -> Vec<Vec<u8>> {
    ports.iter().map(|port| vec![0x00, 0x07, *port]).collect()
}

#[test]
fn an_nxt_tells_its_whole_state_fourteen_times_a_second_and_three_times_as_often_as_by_single_commands() {
    let drive = |laps| driven("nxt", laps, 3, &VirtualLink::default());
    // What connecting costs drops out.
    let (one, three) = (drive(1), drive(3));
    let seconds = (three.simulation.elapsed() - one.simulation.elapsed()).as_secs_f64();
    let rates =
        [SensorId::WHEELS, SensorId::GYRO].map(|sensor| (used(&three, sensor) - used(&one, sensor)) as f64 / seconds);
    let by_maps = rates[0].min(rates[1]);
    let clock = || vec![TICK.to_vec()];
    // What the two maps hold, and the clock; and no more than this robot needs.
    let all = [clock(), output_states(&[0, 1, 2]), input_values(&[0, 1, 2, 3])].concat();
    let needed = [clock(), output_states(&[1, 2]), input_values(&[0])].concat();
    let (all, needed) = (states_per_second(&all), states_per_second(&needed));
    println!("states per second of a simulated NXT at a turn-around of 30 ms");
    println!("  IO maps          clock, 3 motors, 4 ports  {by_maps:5.2}");
    println!("  single commands  clock, 3 motors, 4 ports  {all:5.2}, {:.2} times fewer", by_maps / all);
    println!("  single commands  clock, 2 motors, 1 port   {needed:5.2}, {:.2} times fewer", by_maps / needed);
    assert!(by_maps >= 14.0, "{by_maps}");
    assert!(by_maps >= 3.0 * all, "{by_maps} {all}");
    assert!(by_maps >= 1.5 * needed, "{by_maps} {needed}");
}

/// Seeds over which stalls are looked at.
const SEEDS: u64 = 5;

#[test]
fn an_nxt_whose_link_stalls_is_followed_without_false_motion() {
    let profile = LinkProfile::from_toml(STALLS).unwrap();
    let (mut squares, mut calm) = (0.0, 0.0);
    for seed in 1..=SEEDS {
        let link = VirtualLink { profile: profile.clone(), seed, ..VirtualLink::default() };
        let run = driven("nxt", 2, seed, &link);
        let [estimate_mm, _] = errors_mm(&run);
        let [calm_mm, _] = errors_mm(&driven("nxt", 2, seed, &VirtualLink::default()));
        let stalls = run.delays_to_station.iter().filter(|delay| **delay > TimeDelta::from_millis(1_900)).count();
        println!("seed {seed}: {estimate_mm:.1} mm with {stalls} stalls, {calm_mm:.1} mm without");
        assert!(stalls > 0);
        squares += estimate_mm * estimate_mm / SEEDS as f64;
        calm += calm_mm * calm_mm / SEEDS as f64;
    }
    println!("rms {:.1} mm with stalls, {:.1} mm without", squares.sqrt(), calm.sqrt());
    assert!(squares.sqrt() <= 12.0, "{}", squares.sqrt());
    assert!(calm.sqrt() <= 6.0, "{}", calm.sqrt());
}

#[test]
fn an_ev3_that_waits_for_a_sensor_that_is_not_there_costs_its_wheels_three_seconds_once() {
    let mut scenario = square("ev3", 2, 3);
    scenario.brick.missing_sensor = MissingSensor::Awaited;
    let mut config = station("ev3", &scenario);
    config.robot.ev3 = Some(Ev3Section {
        // The gyro is at port 2.
        gyro_port: 1,
        ..Ev3Section::default()
    });
    let run =
        virtual_station::run_over_link(scenario, config.station_config().unwrap(), &VirtualLink::default()).unwrap();
    let full = driven("ev3", 2, 3, &VirtualLink::default());
    let missing_s =
        run.simulation.elapsed().as_secs_f64() - used(&run, SensorId::WHEELS) as f64 / rate_hz(&full, SensorId::WHEELS);
    println!("wheels are missing for {missing_s:.1} s of {:.1} s", run.simulation.elapsed().as_secs_f64());
    assert!((2.5..4.0).contains(&missing_s), "{missing_s}");
    assert_eq!(used(&run, SensorId::GYRO), 0);
}

/// A program that somebody stops and starts again every so many seconds; both zero the counters.
const PROGRAM_RESTART_S: f64 = 6.5;

#[test]
fn programs_that_begin_anew_are_no_motion_with_stalls_and_without() {
    let stalling = LinkProfile::from_toml(STALLS).unwrap();
    for brick in ["nxt", "ev3"] {
        for profile in [LinkProfile::default(), stalling.clone()] {
            let is_stalling = profile != LinkProfile::default();
            let mut worst_mm: f64 = 0.0;
            for seed in 1..=SEEDS {
                let mut scenario = square(brick, 2, seed);
                scenario.brick.program_restart_s = Some(PROGRAM_RESTART_S);
                let config = station(brick, &scenario);
                let link = VirtualLink { profile: profile.clone(), seed, ..VirtualLink::default() };
                let run = virtual_station::run_over_link(scenario, config.station_config().unwrap(), &link).unwrap();
                assert!(run.simulation.is_finished(), "{brick}");
                worst_mm = worst_mm.max(errors_mm(&run)[0]);
            }
            println!(
                "{brick}, stalls {is_stalling}: at most {worst_mm:.1} mm rms with a restart each {PROGRAM_RESTART_S} s"
            );
            let most_mm = if is_stalling { 25.0 } else { 10.0 };
            assert!(worst_mm <= most_mm, "{brick}: {worst_mm}");
        }
    }
}
