//! Random schedules of everything that goes wrong, and the rules that hold all the same.

use std::collections::BTreeMap;

use rand::RngExt;

use crate::network::Micros;
use crate::simulation::Simulation;

const SCHEDULES: u64 = 2_000;

/// One schedule; the first rule that was broken, if any.
fn run_schedule(seed: u64) -> Simulation {
    let mut simulation = random_fleet(seed);
    simulation.run_for(1_500_000);
    let action_count = simulation.rng.random_range(3..12);
    for _ in 0..action_count {
        act(&mut simulation);
        let longest = if simulation.rng.random_range(0..3) == 0 { 3_000_000 } else { 400_000 };
        let pause = simulation.rng.random_range(0..longest);
        simulation.run_for(pause);
        if !simulation.violations.is_empty() {
            return simulation;
        }
    }
    for station in 0..simulation.stations.len() {
        simulation.wake(station);
    }
    simulation.heal();
    simulation.loses_states = false;
    for _ in 0..200 {
        simulation.run_for(20_000);
        if simulation.is_whole() {
            break;
        }
    }
    assert!(simulation.is_whole(), "seed {seed}: the network does not come back");
    simulation.run_for(3_000_000);
    simulation.check_agreement();
    simulation.run_for(1_500_000);
    simulation.check_service();
    simulation
}

fn random_fleet(seed: u64) -> Simulation {
    // The size of the fleet comes from the seed, too.
    let station_count = 3 + usize::try_from(seed % 3).expect("small");
    let robot_count = if seed.is_multiple_of(10) { 30 } else { 1 + usize::try_from(seed / 3 % 8).expect("small") };
    let periods: [Micros; 5] = if robot_count > 8 {
        [500_000, 200_000, 100_000, 200_000, 100_000]
    } else {
        [500_000, 200_000, 100_000, 50_000, 20_000]
    };
    let periods: Vec<Micros> = (0..robot_count).map(|robot| periods[(robot + seed as usize) % 5]).collect();
    let mut simulation = Simulation::new(seed, station_count, &periods);
    for robot in 0..robot_count {
        move_anywhere(&mut simulation, robot);
    }
    simulation
}

/// To no station, to one, or to several.
fn move_anywhere(simulation: &mut Simulation, robot: usize) {
    let station_count = simulation.stations.len();
    let hearers = simulation.rng.random_range(0..6).clamp(0, station_count).min(4);
    let first = simulation.rng.random_range(0..station_count);
    let heard_by: Vec<usize> = (0..hearers).map(|offset| (first + offset) % station_count).collect();
    let before = simulation.robots[robot].heard_by.clone();
    simulation.move_robot(robot, &heard_by);
    if simulation.rng.random_range(0..3) == 0 {
        for station in before.into_iter().filter(|station| !heard_by.contains(station)) {
            simulation.close_link(robot, station);
        }
    }
}

fn act(simulation: &mut Simulation) {
    let station = simulation.rng.random_range(0..simulation.stations.len());
    let is_alive = simulation.stations[station].is_alive;
    let is_frozen = simulation.stations[station].frozen_since.is_some();
    let alive = simulation.stations.iter().filter(|station| station.is_alive).count();
    match simulation.rng.random_range(0..10) {
        0 if is_alive && alive > 1 => simulation.kill(station),
        0 | 1 if !is_alive => simulation.restart(station),
        1 if is_alive && alive > 1 => {
            simulation.kill(station);
            let pause = simulation.rng.random_range(0..400_000);
            simulation.run_for(pause);
            simulation.restart(station);
        }
        2 | 3 if is_frozen => simulation.wake(station),
        2 | 3 if is_alive => simulation.freeze(station),
        4 | 5 => {
            let sides = simulation.rng.random_range(2..4);
            let group_of = (0..simulation.stations.len()).map(|_| simulation.rng.random_range(0..sides)).collect();
            simulation.partition(group_of);
        }
        6 => simulation.heal(),
        _ => {
            for robot in 0..simulation.robots.len() {
                if simulation.rng.random_range(0..2) == 0 {
                    move_anywhere(simulation, robot);
                }
            }
        }
    }
}

#[test]
fn whatever_happens_there_is_one_owner_in_the_end_and_never_two_that_know_of_each_other() {
    let mut counts: BTreeMap<&str, u64> = BTreeMap::new();
    for seed in 0..SCHEDULES {
        let simulation = run_schedule(seed);
        assert!(simulation.violations.is_empty(), "seed {seed}: {}", simulation.violations[0]);
        for (kind, count) in simulation.event_counts {
            *counts.entry(kind).or_default() += count;
        }
        for robot in simulation.robots {
            *counts.entry("estimate accepted").or_default() += robot.accepted;
            *counts.entry("estimate dropped").or_default() += robot.dropped;
        }
    }
    // Each way to gain and to lose a robot was taken often.
    let kinds = [
        "claimed: unowned",
        "claimed: handed over",
        "claimed: owner vanished",
        "claimed: owner unresponsive",
        "stopped: replaced",
        "stopped: handed over",
        "stopped: frozen",
        "resumed",
        "estimate dropped",
    ];
    for kind in kinds {
        assert!(counts.get(kind).is_some_and(|count| *count >= 300), "{kind}: {counts:?}");
    }
}
