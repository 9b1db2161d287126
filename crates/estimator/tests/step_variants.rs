//! The ways to write one filter that the benchmark compares must be one filter.

#[path = "support/speed/mod.rs"]
mod speed;

use speed::{AGREEMENT, IMPLEMENTATIONS, STEPS, recorded};

#[test]
fn every_way_to_write_the_filter_ends_at_the_same_belief() {
    let inputs = recorded();
    assert_eq!(inputs.len(), STEPS);
    let [floor, others @ ..] = &IMPLEMENTATIONS;
    let expected = (floor.run)(&inputs);
    for way in others {
        let distance = (way.run)(&inputs).distance(&expected);
        assert!(distance < AGREEMENT, "{}: {distance:e}", way.name);
    }
}

#[test]
fn the_filter_follows_the_drive_that_it_is_given() {
    let inputs = recorded();
    let belief = (IMPLEMENTATIONS[0].run)(&inputs);
    let last = inputs[STEPS - 1].observed;
    for (row, observed) in [(3, last[0]), (2, last[2]), (4, last[3])] {
        let error = belief.mean[row] - observed;
        assert!(error.abs() < 0.1, "row {row}: {error}");
    }
    assert!(belief.mean[2].abs() > 0.5, "it turned");
}
