//! `[robot.noise]`: one table of keys, defaults and limits, from which the struct, its checks and its use follow.

use anyhow::{Result, ensure};
use posebridge_telemetry::SensorNoise;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Which standard deviations make sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LowerBound {
    /// The model may be exact.
    Zero,
    /// A sensor that is used alone cannot be exact: its update would divide by nothing.
    AboveZero,
}

impl LowerBound {
    fn check(self, key: &str, value: f64) -> Result<()> {
        let (is_good, wanted) = match self {
            Self::Zero => (value >= 0.0, "zero or more"),
            Self::AboveZero => (value > 0.0, "more than zero"),
        };
        ensure!(is_good && value.is_finite(), "`robot.noise.{key}` is {value}, must be {wanted}");
        Ok(())
    }
}

macro_rules! noise_table {
    ($($(#[$doc:meta])* $key:ident = $default:expr, $least:ident;)+) => {
        /// Noise, one standard deviation each.
        #[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
        #[serde(default, deny_unknown_fields)]
        pub struct RobotNoise {
            $($(#[$doc])* pub $key: f64,)+
        }

        impl Default for RobotNoise {
            /// A LEGO NXT with HiTechnic gyro under an overhead camera; sources in config/default.toml.
            fn default() -> Self {
                Self { $($key: $default,)+ }
            }
        }

        impl RobotNoise {
            /// In the vocabulary's type.
            ///
            /// # Errors
            /// A standard deviation is negative, not finite, or zero where it must not be; the message names its key.
            pub fn checked(&self) -> Result<SensorNoise> {
                $(LowerBound::$least.check(stringify!($key), self.$key)?;)+
                Ok(SensorNoise { $($key: self.$key,)+ })
            }
        }
    };
}

// A field that SensorNoise gains does not build until it has a line here.
noise_table! {
    /// Each wheel's travel, for itself.
    wheel_travel_m_per_sqrt_m = 0.001, Zero;
    /// Distance along the track, common to both wheels.
    travel_m_per_sqrt_m = 0.005, Zero;
    /// Heading, by turning.
    turn_rad_per_sqrt_rad = 0.02, Zero;
    /// Heading, by driving.
    heading_rad_per_sqrt_m = 0.03, Zero;
    /// Gyro, white, per sample.
    gyro_rad_per_s = DEGREE, Zero;
    /// Gyro's step; 0 if fine.
    gyro_resolution_rad_per_s = DEGREE, Zero;
    /// Gyro's bias at power-up.
    gyro_bias_rad_per_s = 2.0 * DEGREE, Zero;
    /// Random walk of the gyro's bias.
    gyro_bias_walk_rad_per_s_sqrt_s = 0.01 * DEGREE, Zero;
    /// A fix's position, each axis.
    fix_position_m = 0.005, AboveZero;
    /// A fix's heading.
    fix_heading_rad = DEGREE, AboveZero;
    /// An accelerometer at a wheel, per sample.
    accelerometer_m_per_s2 = 0.1, AboveZero;
    /// A compass heading.
    compass_rad = 5.0 * DEGREE, AboveZero;
    /// The range to a landmark.
    landmark_range_m = 0.1, AboveZero;
    /// The bearing of a landmark.
    landmark_bearing_rad = 2.0 * DEGREE, AboveZero;
    /// The range to a beacon.
    beacon_range_m = 0.1, AboveZero;
    /// The range to a wall.
    wall_range_m = 0.01, AboveZero;
    /// A thermometer.
    temperature_k = 0.1, AboveZero;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noise_that_makes_no_sense_is_named_with_its_key() {
        let refused = |noise: RobotNoise| noise.checked().unwrap_err().to_string();
        assert_eq!(
            refused(RobotNoise { beacon_range_m: 0.0, ..RobotNoise::default() }),
            "`robot.noise.beacon_range_m` is 0, must be more than zero"
        );
        assert_eq!(
            refused(RobotNoise { gyro_rad_per_s: -1.0, ..RobotNoise::default() }),
            "`robot.noise.gyro_rad_per_s` is -1, must be zero or more"
        );
        for value in [f64::NAN, f64::INFINITY] {
            let noise = RobotNoise { temperature_k: value, ..RobotNoise::default() };
            assert!(noise.checked().is_err(), "{value}");
        }
    }

    #[test]
    fn every_number_reaches_the_filter_under_its_own_name() {
        let noise = RobotNoise { landmark_range_m: 0.15, landmark_bearing_rad: 0.03, ..RobotNoise::default() };
        let checked = noise.checked().unwrap();
        assert_eq!((checked.landmark_range_m, checked.landmark_bearing_rad), (0.15, 0.03));
        assert_eq!(checked.gyro_bias_rad_per_s, 2.0 * DEGREE);
    }
}
