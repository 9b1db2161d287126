//! When disturbances happen: evenly spaced, each up to a second later at random.

use super::plan::first_step_from;
use super::scenario::{MAX_STEPS, Scenario};
use crate::random::RandomStream;

/// Those of a drive that takes at most [`MAX_STEPS`]; steps count from 1.
pub(super) fn starts(first_s: f64, every_s: f64, scenario: &Scenario, stream: &mut RandomStream) -> Vec<usize> {
    let end_s = scenario.step_s * MAX_STEPS.min(1.5 * scenario.path.steps_estimate(scenario.step_s));
    let count = ((end_s - first_s) / every_s).ceil().max(0.0) as u32;
    let starts = (0..count).map(|index| {
        let at_s = first_s + f64::from(index) * every_s + stream.uniform(0.0, 1.0);
        first_step_from(at_s, scenario.step_s).max(1)
    });
    starts.collect()
}
