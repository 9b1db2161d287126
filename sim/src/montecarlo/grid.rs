//! Instants on the grid of steps.

/// An instant within this distance of a step, in steps, is that step: decimal seconds are not exact in binary.
const SAME_STEP: f64 = 1e-6;

/// The first step at or after an instant.
pub(super) fn first_step_from(at_s: f64, step_s: f64) -> usize {
    (at_s / step_s - SAME_STEP).ceil() as usize
}

/// The last step at or before an instant.
pub(super) fn last_step_until(at_s: f64, step_s: f64) -> usize {
    (at_s / step_s + SAME_STEP).floor() as usize
}
