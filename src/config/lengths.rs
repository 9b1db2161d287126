//! Lengths of a configuration that can only be right in another unit.

use anyhow::{Result, ensure};

/// Larger than any arena.
pub(super) const MAX_POSITION_SIGMA_M: f64 = 100.0;

/// Refuses a length that must be in another unit.
pub(super) fn check_length(key: &str, value_m: f64, limit_m: f64) -> Result<()> {
    let in_m = value_m / 1_000.0;
    ensure!(value_m <= limit_m, "`{key}` is {value_m}, must be at most {limit_m} m; did you mean {in_m}?");
    Ok(())
}
