//! Sensor readings as the brick SDK sends them: whole numbers in the units of the wire.
//!
//! The simulated brick uses the SDK of real robots, so that each run of the simulator tests it. The station decodes
//! with `protocol`, which is an independent implementation.

use posebridge_brick::{Inertial, InertialParts, Sides, WheelTicks};

use crate::sensors::InertialReading;
use crate::wheels::PerWheel;

/// Unit of PB_INERTIAL.turn_rate, rad/s.
const TURN_RATE_UNIT_RAD_PER_S: f64 = 0.5e-3;
/// Unit of PB_INERTIAL.turn_urad.
const TURN_UNIT_RAD: f64 = 1e-6;
/// Unit of PB_INERTIAL.accel_left and accel_right, m/s².
const ACCELERATION_UNIT_M_PER_S2: f64 = 1e-3;

/// Total counts, read at `time_us`; they wrap.
pub(super) const fn wheel_ticks(time_us: u32, counts: PerWheel<i64>) -> WheelTicks {
    WheelTicks { time_us, left: counts.left as i32, right: counts.right as i32, valid: Sides::BOTH }
}

/// A reading that ends at `time_us`. Rates saturate, the total turn wraps.
pub(super) fn inertial(time_us: u32, reading: &InertialReading) -> Inertial {
    let acceleration = |m_per_s2: f64| (m_per_s2 / ACCELERATION_UNIT_M_PER_S2).round() as i16;
    Inertial {
        time_us,
        // Through 64 bits, so that the total wraps instead of saturating.
        turn_urad: (reading.turn_rad / TURN_UNIT_RAD).round() as i64 as i32,
        turn_rate: (reading.turn_rate_rad_per_s / TURN_RATE_UNIT_RAD_PER_S).round() as i16,
        accel_left: acceleration(reading.wheels_m_per_s2.left),
        accel_right: acceleration(reading.wheels_m_per_s2.right),
        valid: InertialParts::GYRO | InertialParts::ACCELERATIONS,
    }
}

#[cfg(test)]
mod tests {
    use posebridge_brick::Link;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message::{self, Message, WireStamp};
    use posebridge_telemetry::{Address, EncoderTicks, MetersPerSecondSquared, Radians, RadiansPerSecond};

    use super::*;

    /// The frame of the station's own encoder, and that of the SDK.
    fn both(message: &Message, write: impl FnOnce(&mut Link, &mut Vec<u8>)) -> [Vec<u8>; 2] {
        let mut ours = Vec::new();
        Encoder::new(WireVersion::V2).encode(Address::new(1, 1), message, &mut ours);
        let mut theirs = Vec::new();
        write(&mut Link::new(1, 1), &mut theirs);
        [ours, theirs]
    }

    #[test]
    fn counts_are_the_frames_that_the_station_would_make() {
        for (left, right) in [(0, 0), (360, -360), (1 << 31, -(1 << 31) - 1), (5, 1 << 40)] {
            let message = Message::WheelTicks(message::WheelTicks {
                stamp: WireStamp::Micros32(4_294_967_290),
                left: EncoderTicks(left),
                right: EncoderTicks(right),
            });
            let [ours, theirs] = both(&message, |link, out| {
                let ticks = wheel_ticks(4_294_967_290, PerWheel { left, right });
                link.wheel_ticks(&ticks, &mut |bytes: &[u8]| out.extend_from_slice(bytes));
            });
            assert_eq!(ours, theirs, "{left} {right}");
        }
    }

    #[test]
    fn readings_are_the_frames_that_the_station_would_make() {
        for (rate, turn, acceleration) in
            [(0.0, 0.0, 0.0), (0.123_456, -7.654_321, 0.981), (-20.0, 5_000.0, -40.0), (20.0, -5_000.0, 40.0)]
        {
            let reading = InertialReading {
                turn_rate_rad_per_s: rate,
                turn_rad: turn,
                wheels_m_per_s2: PerWheel { left: acceleration, right: -acceleration },
            };
            let message = Message::Inertial(message::Inertial {
                stamp: WireStamp::Micros32(77),
                turn_rate: Some(RadiansPerSecond(rate)),
                turn: Some(Radians(turn)),
                wheel_accelerations: Some((
                    MetersPerSecondSquared(acceleration),
                    MetersPerSecondSquared(-acceleration),
                )),
            });
            let [ours, theirs] = both(&message, |link, out| {
                let inertial = inertial(77, &reading);
                link.inertial(&inertial, &mut |bytes: &[u8]| out.extend_from_slice(bytes));
            });
            assert_eq!(ours, theirs, "{rate} {turn} {acceleration}");
        }
    }
}
