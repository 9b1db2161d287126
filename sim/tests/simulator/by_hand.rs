//! A robot that a person moves, and a board that prints.

use std::f64::consts::{PI, TAU};

use posebridge_sim::scenario::Personality;
use posebridge_sim::{Scenario, Simulation};

/// Everything that the board prints until the hand is done.
fn printed(settings: &str) -> (Simulation, String) {
    let text = format!(
        "seed = 8\n[camera]\nis_present = false\n{settings}\n[path.by-hand]\n[drive]\nrest_s = 1\npause_s = 1\n"
    );
    let mut simulation = Simulation::new(Scenario::from_toml(&text).unwrap().with_personality(Personality::Line));
    let mut printed = Vec::new();
    while !simulation.is_finished() {
        simulation.step();
        while let Some(bytes) = simulation.poll() {
            printed.extend(bytes);
        }
    }
    (simulation, String::from_utf8(printed).unwrap())
}

#[test]
fn a_hand_turns_the_left_wheel_then_rolls_a_metre_then_turns_on_the_spot() {
    let (simulation, text) = printed("");
    let rows: Vec<Vec<f64>> =
        text.lines().map(|line| line.split(',').map(|number| number.parse().unwrap()).collect()).collect();
    let [left_m, right_m, track_m] = simulation.true_geometry_m();
    // The counts at rest: before, and after each motion.
    let mut rests = vec![[0.0, 0.0]];
    for pair in rows.windows(10).filter(|rows| rows.iter().all(|row| row[1..3] == rows[0][1..3])) {
        let counts = [pair[0][1], pair[0][2]];
        if rests.last() != Some(&counts) {
            rests.push(counts);
        }
    }
    let [_, wheel, straight, turn] = rests[..] else { panic!("three motions: {rests:?}") };
    let expected = [
        [360.0, 0.0],
        [360.0 / TAU / left_m, 360.0 / TAU / right_m],
        [-PI * track_m * 360.0 / TAU / left_m, PI * track_m * 360.0 / TAU / right_m],
    ];
    let motions = [[wheel, rests[0]], [straight, wheel], [turn, straight]];
    for ([after, before], expected) in motions.into_iter().zip(expected) {
        for side in [0, 1] {
            let found = after[side] - before[side];
            // Four degrees of play, and how far a hand misses its mark.
            assert!(
                (found - expected[side]).abs() <= 7.0 + 0.01 * expected[side].abs(),
                "{found} for {}",
                expected[side]
            );
        }
    }
    let turned = rows.windows(2).map(|rows| rows[1][3] * (rows[1][0] - rows[0][0]) * 1e-3).sum::<f64>();
    assert!((turned - 360.0).abs() < 90.0, "the gyro with its bias: {turned}");
    let pose = simulation.truth().last().unwrap().pose;
    assert!((pose.x.0 - 1.0).abs() < 0.02 && pose.heading.rad().abs() < 0.2, "{pose:?}");
}

#[test]
fn a_board_prints_what_its_scenario_says() {
    let line = "[text_board]\nheader = \"ready\"\nline = \"t={time_s} L {-left_ticks} R {right_ticks}\"";
    let (_, text) = printed(line);
    let lines: Vec<&str> = text.split("\r\n").collect();
    assert_eq!(lines[..2], ["ready", "t=5.001 L 0 R 0"]);
    assert!(lines[lines.len() - 2].contains(" L -"), "{}", lines[lines.len() - 2]);
}
