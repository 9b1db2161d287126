//! Lengths of a configuration that can only be right in another unit.

use anyhow::{Result, ensure};

/// Limits of a length in metres. One below `least_m` is no mistake in itself, but nobody means it by a number of millimetres.
pub(super) struct LengthLimits {
    pub(super) least_m: f64,
    pub(super) most_m: f64,
}

pub(super) const WHEEL_RADIUS: LengthLimits = LengthLimits { least_m: 0.005, most_m: 1.0 };
pub(super) const TRACK_WIDTH: LengthLimits = LengthLimits { least_m: 0.02, most_m: 10.0 };
/// Larger than any arena.
pub(super) const POSITION_SIGMA: LengthLimits = LengthLimits { least_m: 0.0, most_m: 100.0 };

/// Refuses a length that must be in another unit, millimetres or else centimetres.
pub(super) fn check_length(key: &str, value_m: f64, limits: &LengthLimits) -> Result<()> {
    let LengthLimits { least_m, most_m } = limits;
    let per_m = if value_m / 1e3 >= *least_m { 1e3 } else { 1e2 };
    // No more digits than were given.
    let meant_m = (value_m * 1e6).round() / (per_m * 1e6);
    ensure!(value_m <= *most_m, "`{key}` is {value_m}, must be at most {most_m} m; did you mean {meant_m}?");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likely_unit_is_that_of_a_robot_one_can_hold() {
        let cases = [
            (28.0, WHEEL_RADIUS, "0.028"),
            (2.8, WHEEL_RADIUS, "0.028"),
            (200.0, TRACK_WIDTH, "0.2"),
            (11.2, TRACK_WIDTH, "0.112"),
            (200.0, POSITION_SIGMA, "0.2"),
        ];
        for (value_m, limits, expected) in cases {
            let text = check_length("robot.x", value_m, &limits).unwrap_err().to_string();
            assert!(text.ends_with(&format!("did you mean {expected}?")), "{text}");
        }
        assert!(check_length("robot.x", 0.028, &WHEEL_RADIUS).is_ok());
    }
}
