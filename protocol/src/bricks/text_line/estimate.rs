//! The estimate as a line of whole numbers, which a board of 2 KB reads without floating point.
//!
//! # Model
//! ```text
//! E,<tick_ms>,<x_mm>,<y_mm>,<heading_mrad>,<sigma_mm>,<flags>*hh\n
//! ```
//! `tick_ms` is of the board's own clock; `hh` the exclusive or of all characters before the `*`.

use posebridge_telemetry::TimeDelta;

use super::row::{BoardTime, exclusive_or};
use crate::message::{PlanarPose, PoseFlags, WireStamp};

/// Numbers on a board have 32 bits.
const MAX_NUMBER: f64 = i32::MAX as f64;

/// The line of an estimate; `None` if a number of it is not finite. `last` is the time of the board's last line.
pub(super) fn encode_line(pose: &PlanarPose, last: Option<BoardTime>) -> Option<String> {
    let origin = pose.pose.origin();
    let [xx_m2, _, _, yy_m2, ..] = pose.covariance;
    let x_mm = to_i32(origin.x.0 * 1_000.0)?;
    let y_mm = to_i32(origin.y.0 * 1_000.0)?;
    let heading_mrad = to_i32(pose.pose.heading.rad() * 1_000.0)?;
    // Rounded up, so that no sigma of a real estimate is zero.
    let sigma_mm = to_i32((xx_m2.max(yy_m2).sqrt() * 1_000.0).ceil())?;
    let tick_ms = tick_ms(pose.stamp, last);
    let flags = flags(pose.flags);
    let text = format!("E,{tick_ms},{x_mm},{y_mm},{heading_mrad},{sigma_mm},{flags}");
    let sum = exclusive_or(text.as_bytes());
    Some(format!("{text}*{sum:02X}\n"))
}

/// The instant in milliseconds as the board counts them. The stamp holds microseconds modulo 2^32, which a counter of milliseconds
/// outlives: what is missing is known from the board's last line.
fn tick_ms(stamp: WireStamp, last: Option<BoardTime>) -> u32 {
    let micros = stamp.as_micros();
    let Some(BoardTime::Millis(last_ms)) = last else {
        return (micros / 1_000) as u32;
    };
    let last_micros = (u64::from(last_ms) * 1_000) as u32;
    let since_micros = (micros as u32).wrapping_sub(last_micros) as i32;
    let since_ms = TimeDelta::from_micros(i64::from(since_micros)).as_nanos() / 1_000_000;
    last_ms.wrapping_add_signed(since_ms as i32)
}

fn to_i32(value: f64) -> Option<i32> {
    let is_number = value.is_finite();
    is_number.then_some(value.round().clamp(-MAX_NUMBER, MAX_NUMBER) as i32)
}

/// Bit 0: the position is valid; bit 1: the heading is.
const fn flags(flags: PoseFlags) -> u8 {
    flags.position_valid as u8 | (flags.heading_valid as u8) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tick_is_the_boards_own_after_the_microseconds_have_wrapped() {
        // 100 minutes on the board: 6 000 000 ms, and 6e9 µs modulo 2^32.
        let stamp = WireStamp::Micros32((6_000_000_000_u64 % (1 << 32)) as u32);
        assert_eq!(tick_ms(stamp, Some(BoardTime::Millis(6_000_040))), 6_000_000);
        assert_eq!(tick_ms(stamp, Some(BoardTime::Millis(5_999_980))), 6_000_000);
        let micros = Some(BoardTime::Micros(7));
        assert_eq!(tick_ms(WireStamp::Micros32(123_999), micros), 123);
    }
}
