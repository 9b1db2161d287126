//! How long a robot is without estimates when its owner ends, freezes or loses it; and that it does not move for nothing.

use rand::RngExt;

use crate::network::{MAX_DELAY, Micros};
use crate::simulation::Simulation;

const SEEDS: u64 = 150;
const PERIODS: [Micros; 6] = [10_000, 20_000, 50_000, 100_000, 200_000, 500_000];

/// Three stations that know each other, and one robot for each period, heard by the first two.
fn settled_fleet(seed: u64) -> Simulation {
    let mut simulation = Simulation::new(seed, 3, &PERIODS);
    for robot in 0..PERIODS.len() {
        simulation.move_robot(robot, &[0, 1]);
    }
    let phase = simulation.rng.random_range(0..1_000_000);
    simulation.run_for(4_000_000 + phase);
    simulation
}

/// The longest time from an event until another station served a robot, and until the robot accepted its first estimate less its period.
fn longest_gaps(simulation: &Simulation, event: Micros, is_concerned: impl Fn(usize) -> bool) -> (Micros, Micros) {
    let mut longest = (0, 0);
    for (index, robot) in simulation.robots.iter().enumerate().filter(|(index, _)| is_concerned(*index)) {
        let start = robot.starts.last().map_or(0, |start| start.time);
        let accepted = robot.first_accepted_after.unwrap_or_else(|| panic!("robot {index} accepts nothing"));
        longest = (longest.0.max(start - event), longest.1.max(accepted - event - robot.period * 21 / 20));
    }
    longest
}

fn assert_sound(simulation: &Simulation, seed: u64) {
    assert!(simulation.violations.is_empty(), "seed {seed}: {}", simulation.violations[0]);
}

#[test]
fn after_a_kill_a_stand_by_serves_within_half_a_second() {
    for seed in 0..SEEDS {
        let mut simulation = settled_fleet(seed);
        let victim = simulation.owners(0)[0];
        let owned: Vec<bool> = (0..PERIODS.len()).map(|robot| simulation.owners(robot) == [victim]).collect();
        let event = simulation.now;
        simulation.kill(victim);
        simulation.watch_robots();
        simulation.run_for(2_000_000);
        let (started, accepted) = longest_gaps(&simulation, event, |robot| owned[robot]);
        assert!(started <= 500_000 && accepted <= 500_000, "seed {seed}: {started} us, {accepted} us");
        assert_sound(&simulation, seed);
    }
}

#[test]
fn after_a_freeze_a_stand_by_serves_within_two_and_a_half_seconds_and_the_owner_that_wakes_sends_nothing() {
    for seed in 0..SEEDS {
        let mut simulation = settled_fleet(seed);
        let victim = simulation.owners(0)[0];
        let owned: Vec<bool> = (0..PERIODS.len()).map(|robot| simulation.owners(robot) == [victim]).collect();
        let event = simulation.now;
        simulation.freeze(victim);
        simulation.watch_robots();
        simulation.run_for(3_500_000);
        let (started, accepted) = longest_gaps(&simulation, event, |robot| owned[robot]);
        assert!(started <= 2_500_000 && accepted <= 2_500_000, "seed {seed}: {started} us, {accepted} us");
        let dropped = |simulation: &Simulation| simulation.robots.iter().map(|robot| robot.dropped).sum::<u64>();
        let before = dropped(&simulation);
        simulation.wake(victim);
        simulation.run_for(3_000_000);
        simulation.check_agreement();
        assert_sound(&simulation, seed);
        assert_eq!(dropped(&simulation), before, "seed {seed}: stale estimates");
    }
}

#[test]
fn a_robot_that_moves_is_served_within_half_a_second_of_its_first_bytes() {
    for seed in 0..SEEDS {
        let mut simulation = settled_fleet(seed);
        for robot in 0..PERIODS.len() {
            let owner = simulation.owners(robot)[0];
            // Heard by the owner alone, then by nobody, then by the station that never heard it, or by the one that has forgotten it.
            simulation.move_robot(robot, &[owner]);
            simulation.run_for(3_000_000);
            let away = simulation.rng.random_range(0..3) * simulation.rng.random_range(0..400_000);
            simulation.move_robot(robot, &[]);
            simulation.run_for(away);
            let goal = if seed % 2 == 0 { 2 } else { 1 - owner };
            simulation.move_robot(robot, &[goal]);
            simulation.watch_robots();
            let arrival = simulation.robots[robot].next_message;
            simulation.run_for(1_500_000);
            let (started, accepted) = longest_gaps(&simulation, arrival, |index| index == robot);
            assert!(started <= 500_000 && accepted <= 500_000, "seed {seed}, {robot}: {started} us, {accepted} us");
            assert_eq!(simulation.owners(robot), [goal], "seed {seed}, {robot}");
            assert!(simulation.robots[robot].starts.last().is_some_and(|start| start.has_state), "seed {seed}");
            simulation.move_robot(robot, &[0, 1]);
        }
        assert_sound(&simulation, seed);
    }
}

#[test]
fn a_robot_that_leaves_the_owner_and_stays_with_the_stand_by_is_handed_over() {
    for seed in 0..SEEDS {
        let mut simulation = settled_fleet(seed);
        simulation.loses_states = false;
        let owners: Vec<usize> = (0..PERIODS.len()).map(|robot| simulation.owners(robot)[0]).collect();
        for (robot, owner) in owners.iter().enumerate() {
            simulation.move_robot(robot, &[1 - owner]);
            if seed % 2 == 0 {
                simulation.close_link(robot, *owner);
            }
        }
        let event = simulation.now;
        simulation.watch_robots();
        simulation.run_for(4_000_000);
        for robot in 0..PERIODS.len() {
            let (started, _) = longest_gaps(&simulation, event, |index| index == robot);
            let silence = if seed % 2 == 0 { 0 } else { (PERIODS[robot] * 9 / 2).max(300_000) };
            // The owner announces it, the stand-by asks, the owner answers.
            let limit = silence + 3 * MAX_DELAY + 1_000;
            assert!(started <= limit, "seed {seed}, robot {robot}: {started} us");
            assert_eq!(simulation.owners(robot), [1 - owners[robot]], "seed {seed}, robot {robot}");
        }
        assert_sound(&simulation, seed);
    }
}

#[test]
fn a_robot_that_two_stations_hear_keeps_its_owner_also_when_messages_are_lost() {
    for seed in 0..SEEDS / 10 {
        let mut simulation = Simulation::new(seed, 3, &PERIODS);
        for robot in 0..PERIODS.len() {
            simulation.robots[robot].loss_percent = u32::try_from(seed % 3 * 3).expect("small");
            simulation.move_robot(robot, &[0, 1]);
        }
        simulation.run_for(5_000_000);
        let starts: Vec<usize> = simulation.robots.iter().map(|robot| robot.starts.len()).collect();
        simulation.run_for(60_000_000);
        let later: Vec<usize> = simulation.robots.iter().map(|robot| robot.starts.len()).collect();
        assert_eq!(starts, later, "seed {seed}");
        assert_sound(&simulation, seed);
    }
}

#[test]
fn a_short_stall_of_the_owner_costs_a_moment_and_no_ownership() {
    for seed in 0..SEEDS {
        let mut simulation = settled_fleet(seed);
        let owners: Vec<_> = (0..PERIODS.len()).map(|robot| simulation.owners(robot)).collect();
        let victim = owners[0][0];
        simulation.freeze(victim);
        let stall = simulation.rng.random_range(255_000..400_000);
        simulation.run_for(stall);
        simulation.wake(victim);
        simulation.run_for(3 * MAX_DELAY);
        let after: Vec<_> = (0..PERIODS.len()).map(|robot| simulation.owners(robot)).collect();
        assert_eq!(owners, after, "seed {seed}");
        assert_sound(&simulation, seed);
    }
}

#[test]
fn a_station_without_its_cable_serves_on_and_both_sides_agree_after_the_rejoin() {
    for seed in 0..SEEDS {
        let mut simulation = settled_fleet(seed);
        simulation.partition(vec![0, 1, 2]);
        simulation.run_for(4_000_000);
        for robot in 0..PERIODS.len() {
            assert_eq!(simulation.owners(robot), [0, 1], "seed {seed}: both serve what they hear");
        }
        simulation.heal();
        simulation.run_for(4_200_000);
        simulation.check_agreement();
        assert_sound(&simulation, seed);
    }
}

#[test]
fn a_station_that_lost_its_memory_asks_the_others_for_state_and_epoch() {
    for seed in 0..SEEDS {
        let mut simulation = Simulation::new(seed, 3, &PERIODS);
        // Only the first station hears the robots.
        for robot in 0..PERIODS.len() {
            simulation.move_robot(robot, &[0]);
        }
        simulation.run_for(5_000_000);
        simulation.kill(0);
        simulation.run_for(700_000);
        simulation.restart(0);
        simulation.run_for(4_000_000);
        for robot in &simulation.robots {
            let [.., before, after] = &robot.starts[..] else { panic!("seed {seed}: not served again") };
            assert!(after.token.epoch > before.token.epoch, "seed {seed}");
            assert!(after.has_state, "seed {seed}");
        }
        assert_sound(&simulation, seed);
    }
}
