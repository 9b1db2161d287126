//! Sensors that are not there, or that have to be learnt first.

use posebridge_protocol::bricks::nxt::{NxtSensor, NxtSettings};
use posebridge_protocol::message::Message;

use super::bench::Bench;
use super::brick::{IoMapLimit, SimulatedNxt};
use super::session::{SECOND, equipped, equipped_brick, moving_brick};

/// A gyro at port 1, whose rest value has to be learnt.
fn gyro_alone() -> NxtSettings {
    let mut sensors = [NxtSensor::None; 4];
    sensors[0] = NxtSensor::HtGyro;
    NxtSettings { sensors, ..NxtSettings::default() }
}

#[test]
fn a_sensor_that_is_not_plugged_in_is_reported_once_and_the_others_go_on() {
    for maps in [IoMapLimit::UpTo(119), IoMapLimit::Unknown] {
        let mut brick = equipped_brick();
        brick.io_map_limit = maps;
        brick.ports[1].is_plugged = false;
        let bench = Bench::run(equipped(), brick, 60 * SECOND);
        let warnings: Vec<_> = bench.notes().into_iter().filter(|text| text.contains("plugged in")).collect();
        assert!((1..=2).contains(&warnings.len()), "{maps:?} {warnings:?}");
        assert!(warnings[0].starts_with("sensor port 2"), "{warnings:?}");
        assert!(bench.wheels().len() > 120);
        assert!(bench.messages().any(|message| matches!(message, Message::DistanceSensor { .. })));
    }
}

#[test]
fn a_missing_sensor_takes_no_turn_of_the_wheels_with_single_commands() {
    let wheels = |is_plugged| {
        let mut brick = equipped_brick();
        brick.io_map_limit = IoMapLimit::Unknown;
        brick.ports[1].is_plugged = is_plugged;
        let bench = Bench::run(equipped(), brick, 60 * SECOND);
        bench.wheels().len()
    };
    let (with, without) = (wheels(true), wheels(false));
    println!("wheels in 60 s by single commands: {with} with all sensors, {without} with one missing");
    assert!(10 * without >= 8 * with, "{without} of {with}");
}

#[test]
fn the_gyros_rest_is_learnt_before_the_robot_moves() {
    let mut brick = SimulatedNxt::new();
    brick.ports[0].raw = 597;
    brick.drive = |at| [0, (at.max(4_000_000) / 2_000 - 2_000) as i32, 0];
    let mut bench = Bench::run(gyro_alone(), brick, 4 * SECOND);
    bench.brick.ports[0].raw = 642;
    bench.run_to(6 * SECOND);
    assert!(bench.notes().contains(&"the gyro at port 1 reads 597.0 at rest"));
    let rates = bench.turn_rates_deg_per_s();
    assert!(rates.first().unwrap().abs() < 1e-9);
    assert!((rates.last().unwrap() - 45.0).abs() < 1e-9);
}

#[test]
fn an_unplugged_gyro_is_reported_and_turns_nothing() {
    let mut brick = SimulatedNxt::new();
    brick.ports[0].raw = 597;
    let mut bench = Bench::run(gyro_alone(), brick, 3 * SECOND);
    bench.brick.ports[0].raw = 1023;
    bench.run_to(6 * SECOND);
    assert!(bench.turn_rates_deg_per_s().iter().all(|rate| rate.abs() < 1e-7));
    let report_count = |bench: &Bench| bench.notes().iter().filter(|text| text.contains("reads as empty")).count();
    assert_eq!(report_count(&bench), 1);
    // Plugged in again and out again, it is reported again.
    bench.brick.ports[0].raw = 597;
    bench.run_to(7 * SECOND);
    bench.brick.ports[0].raw = 1023;
    bench.run_to(8 * SECOND);
    assert_eq!(report_count(&bench), 2);
}

#[test]
fn a_gyro_of_a_robot_that_never_stops_is_reported() {
    let mut brick = moving_brick();
    brick.ports[0].raw = 597;
    let mut bench = Bench::run(gyro_alone(), brick, 5 * SECOND);
    let is_reported = |bench: &Bench| bench.notes().iter().any(|text| text.contains("set gyro_rest"));
    assert!(!is_reported(&bench));
    bench.run_to(6 * SECOND);
    assert!(is_reported(&bench), "{:?}", bench.notes());
}
