//! A robot of which everything that can be learned is to be learned.

use posebridge_telemetry::{Calibration, UncertainValue};

/// Every constant but those of the ranges to landmarks, with the spread of a kit that was measured with a ruler.
pub(crate) fn all_unknown() -> Calibration {
    let unknown = |sigma| UncertainValue { value: 0.0, sigma };
    Calibration {
        radius_scale: unknown(0.005),
        radius_difference: unknown(0.005),
        track_scale: unknown(0.03),
        fix_delay_s: unknown(0.1),
        tag_forward_m: unknown(0.02),
        tag_left_m: unknown(0.02),
        beacon_offset_m: unknown(0.3),
        beacon_scale: unknown(0.02),
        ..Calibration::default()
    }
}
