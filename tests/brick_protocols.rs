//! Every protocol that the simulated brick speaks, through one body: a square with a camera at 5 Hz, in virtual time.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

use posebridge::config::{Config, LinkSection, NxtSection, NxtSensorKind, NxtSensorSection, Place};
use posebridge::report::run::{Truth, errors};
use posebridge::virtual_run::{self, VirtualLink, VirtualRun};
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::{Scenario, Steering};
use posebridge_telemetry::{SensorId, Span};

/// A link that stands still for two seconds, each twenty seconds on average: an NXT sends 29 answers a second.
const STALLS: &str = "kind = \"stream\"\n[to_brick]\n[to_station]\nstalls = [{ probability = 0.0017, from_ms = 2000.0, to_ms = 2000.0 }]\n";

fn square(brick: &str, laps: u32, seed: u64) -> Scenario {
    let text = format!(
        "[path.square]\nside_m = 1.0\n[camera]\nrate_hz = 5.0\n[brick]\npersonality = \"{brick}\"\n"
    );
    Scenario::from_toml(&text)
        .unwrap()
        .with_laps(laps)
        .with_seed(seed)
        .with_steering(Steering::Estimate)
}

/// A station for the brick, and for its camera where that has a link of its own.
fn station(brick: &str, scenario: &Scenario) -> Config {
    let mut config = Config::default().with_tag_of(scenario);
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
    virtual_run::run_over(scenario, config.pipeline().unwrap(), link).unwrap()
}

/// The estimate's and the odometry's error, rms, in millimetres.
fn errors_mm(run: &VirtualRun) -> [f64; 2] {
    let (estimate, odometry) = errors(&run.collector, &Truth::of(&run.simulation));
    [estimate, odometry].map(|error| 1e3 * error.position_rms_m.unwrap())
}

/// How many observations of a sensor were used.
fn used(run: &VirtualRun, sensor: SensorId) -> f64 {
    let mut sources = run.collector.sources.iter();
    let tally = sources.find(|tally| tally.sensor == sensor);
    tally.map_or(0.0, |tally| tally.used as f64)
}

/// How many observations a sensor gave, per second.
fn rate_hz(run: &VirtualRun, sensor: SensorId) -> f64 {
    used(run, sensor) / run.simulation.elapsed().as_secs_f64()
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

#[test]
fn an_nxt_tells_its_whole_state_at_least_fourteen_times_a_second() {
    let drive = |laps| driven("nxt", laps, 3, &VirtualLink::default());
    // What connecting costs drops out.
    let (one, three) = (drive(1), drive(3));
    let seconds = (three.simulation.elapsed() - one.simulation.elapsed()).as_secs_f64();
    for sensor in [SensorId::WHEELS, SensorId::GYRO] {
        let rate = (used(&three, sensor) - used(&one, sensor)) / seconds;
        println!("{sensor:?}: {rate:.2} per second at a turn-around of 30 ms");
        assert!(rate >= 14.0, "{sensor:?}: {rate}");
    }
}

/// Worlds over which stalls are looked at.
const SEEDS: u64 = 5;

#[test]
fn an_nxt_whose_link_stalls_is_followed_without_false_motion() {
    let stalling = VirtualLink {
        profile: LinkProfile::from_toml(STALLS).unwrap(),
        seed: 1,
        ..VirtualLink::default()
    };
    let (mut squares, mut calm) = (0.0, 0.0);
    for seed in 1..=SEEDS {
        let link = VirtualLink {
            seed,
            ..stalling.clone()
        };
        let run = driven("nxt", 2, seed, &link);
        let [estimate_mm, _] = errors_mm(&run);
        let [calm_mm, _] = errors_mm(&driven("nxt", 2, seed, &VirtualLink::default()));
        let two_seconds = Span::from_millis(1_900);
        let late = run
            .delays_to_station
            .iter()
            .filter(|delay| **delay > two_seconds);
        let stalls = late.count();
        println!("seed {seed}: {estimate_mm:.1} mm with {stalls} stalls, {calm_mm:.1} mm without");
        assert!(stalls > 0);
        squares += estimate_mm * estimate_mm / SEEDS as f64;
        calm += calm_mm * calm_mm / SEEDS as f64;
    }
    println!(
        "rms {:.1} mm with stalls, {:.1} mm without",
        squares.sqrt(),
        calm.sqrt()
    );
    assert!(squares.sqrt() <= 12.0, "{}", squares.sqrt());
    assert!(calm.sqrt() <= 6.0, "{}", calm.sqrt());
}
