//! `[robot.calibration]`: what is known beforehand about systematic errors, and how well.
//!
//! Each entry is a value with one standard deviation. A sigma of zero takes the value as given; anything else lets a filter that
//! can learn it do so. One table of keys, defaults and limits; the struct, its checks and the reports follow from it.

use anyhow::{Result, ensure};
use posebridge_telemetry::{Calibration, UncertainValue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A number with one standard deviation.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, expecting = "a table { value, sigma }")]
pub struct CalibrationEntry {
    /// The number.
    pub value: f64,
    /// One standard deviation; 0 takes the number as given.
    pub sigma: f64,
}

impl CalibrationEntry {
    const fn unknown_by(sigma: f64) -> Self {
        Self { value: 0.0, sigma }
    }
}

impl From<UncertainValue> for CalibrationEntry {
    fn from(UncertainValue { value, sigma }: UncertainValue) -> Self {
        Self { value, sigma }
    }
}

/// Beyond this no entry makes sense: neither the value, on either side of zero, nor its sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
struct MaxMagnitude(f64);

impl MaxMagnitude {
    /// A relative error of half: what is further off is a wrong geometry, not a calibration.
    const RATIO: Self = Self(0.5);
    /// 57 degrees per second at rest: no gyro.
    const TURN_RATE: Self = Self(1.0);
    /// No camera is later, and the filter's longest history ends there.
    const DELAY: Self = Self(60.0);
    /// The longest lever arm that a filter takes, and more than any radio's offset.
    const LENGTH: Self = Self(1e3);

    fn check(self, key: &str, entry: CalibrationEntry) -> Result<UncertainValue> {
        let CalibrationEntry { value, sigma } = entry;
        let Self(limit) = self;
        ensure!(value.abs() <= limit, "`robot.calibration.{key}.value` is {value}, must lie in {} to {limit}", -limit);
        ensure!((0.0..=limit).contains(&sigma), "`robot.calibration.{key}.sigma` is {sigma}, must lie in 0 to {limit}");
        Ok(UncertainValue { value, sigma })
    }
}

/// One entry of a calibration, for reports.
pub struct CalibrationKey {
    /// Its key in files and in the JSON object.
    pub key: &'static str,
    /// Reads it.
    pub read: fn(&Calibration) -> UncertainValue,
}

macro_rules! calibration_table {
    ($($(#[$doc:meta])* $key:ident = $sigma:expr, $largest:ident;)+) => {
        /// Systematic errors of a robot and of the sensors that watch it.
        #[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
        #[serde(default, deny_unknown_fields)]
        pub struct RobotCalibration {
            $($(#[$doc])* pub $key: CalibrationEntry,)+
            /// Gyro bias; without it zero, known as well as `robot.noise.gyro_bias_rad_per_s` says.
            #[serde(skip_serializing_if = "Option::is_none")]
            pub gyro_bias_rad_per_s: Option<CalibrationEntry>,
        }

        impl Default for RobotCalibration {
            /// A LEGO robot whose builder has measured wheels and track with a ruler; sources in config/default.toml.
            fn default() -> Self {
                Self {
                    $($key: CalibrationEntry::unknown_by($sigma),)+
                    gyro_bias_rad_per_s: None,
                }
            }
        }

        impl RobotCalibration {
            /// In the vocabulary's type; `power_up_bias` is the sigma of a gyro's bias when nothing else is known about it, in rad/s.
            ///
            /// # Errors
            /// A value or a sigma is not finite or out of its range; the message names its key.
            pub fn checked(&self, power_up_bias: f64) -> Result<Calibration> {
                let gyro_bias_rad_per_s = match self.gyro_bias_rad_per_s {
                    Some(entry) => MaxMagnitude::TURN_RATE.check("gyro_bias_rad_per_s", entry)?,
                    None => UncertainValue { value: 0.0, sigma: power_up_bias },
                };
                Ok(Calibration {
                    $($key: MaxMagnitude::$largest.check(stringify!($key), self.$key)?,)+
                    gyro_bias_rad_per_s,
                })
            }
        }

        impl From<Calibration> for RobotCalibration {
            fn from(learned: Calibration) -> Self {
                Self {
                    $($key: learned.$key.into(),)+
                    gyro_bias_rad_per_s: Some(learned.gyro_bias_rad_per_s.into()),
                }
            }
        }

        /// Every entry of a calibration, in the order of reports.
        pub const CALIBRATION_KEYS: &[CalibrationKey] = &[
            $(CalibrationKey { key: stringify!($key), read: |learned| learned.$key },)+
            CalibrationKey { key: "gyro_bias_rad_per_s", read: |learned| learned.gyro_bias_rad_per_s },
        ];
    };
}

calibration_table! {
    /// Relative error of the mean wheel radius: a tyre under load rolls on less than its printed radius.
    radius_scale = 0.01, RATIO;
    /// Relative difference of the wheels' radii, right minus left: two tyres of one mould, unequally loaded.
    radius_difference = 0.005, RATIO;
    /// Relative error of the track width: a wide tyre touches the ground somewhere across its width.
    track_scale = 0.05, RATIO;
    /// How much earlier than its stamp a fix was true, in seconds.
    fix_delay_s = 0.0, DELAY;
    /// Where the tag is, forward of where the fix says, in metres.
    tag_forward_m = 0.0, LENGTH;
    /// Where the tag is, to the left of where the fix says, in metres.
    tag_left_m = 0.0, LENGTH;
    /// A beacon's range reads long by this, in metres.
    beacon_offset_m = 0.0, LENGTH;
    /// Relative error of a beacon's ranges.
    beacon_scale = 0.0, RATIO;
    /// The range to a landmark reads long by this, in metres.
    landmark_offset_m = 0.0, LENGTH;
    /// Relative error of the ranges to landmarks.
    landmark_scale = 0.0, RATIO;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_out_of_range_is_named_with_its_range() {
        let refused = |track_scale: CalibrationEntry| {
            let calibration = RobotCalibration { track_scale, ..RobotCalibration::default() };
            calibration.checked(0.03).unwrap_err().to_string()
        };
        let (value, sigma) = (0.0, -0.1);
        assert_eq!(
            refused(CalibrationEntry { value, sigma }),
            "`robot.calibration.track_scale.sigma` is -0.1, must lie in 0 to 0.5"
        );
        let (value, sigma) = (-0.6, 0.1);
        assert_eq!(
            refused(CalibrationEntry { value, sigma }),
            "`robot.calibration.track_scale.value` is -0.6, must lie in -0.5 to 0.5"
        );
        for broken in [f64::NAN, f64::INFINITY] {
            refused(CalibrationEntry { value: broken, sigma: 0.1 });
            refused(CalibrationEntry { value: 0.0, sigma: broken });
        }
    }

    #[test]
    fn the_gyro_s_bias_is_known_as_well_as_its_noise_says_unless_it_was_measured() {
        let bias = |given| {
            let calibration = RobotCalibration { gyro_bias_rad_per_s: given, ..RobotCalibration::default() };
            calibration.checked(0.03).unwrap().gyro_bias_rad_per_s
        };
        let (value, sigma) = (0.0, 0.03);
        assert_eq!(bias(None), UncertainValue { value, sigma });
        let (value, sigma) = (0.01, 0.002);
        let measured = Some(CalibrationEntry { value, sigma });
        assert_eq!(bias(measured), UncertainValue { value, sigma });
    }

    #[test]
    fn each_key_of_a_file_is_what_the_report_reads_under_that_key() {
        let value_of = |row: usize| 0.05 * (row + 1) as f64;
        let lines = CALIBRATION_KEYS.iter().enumerate().map(|(row, entry)| {
            let value = value_of(row);
            format!("{} = {{ value = {value}, sigma = 0.25 }}\n", entry.key)
        });
        let file: RobotCalibration = toml::from_str(&lines.collect::<String>()).unwrap();
        let calibration = file.checked(9.0).unwrap();
        for (row, entry) in CALIBRATION_KEYS.iter().enumerate() {
            let (value, sigma) = (value_of(row), 0.25);
            assert_eq!((entry.read)(&calibration), UncertainValue { value, sigma }, "{}", entry.key);
        }
        assert_eq!(RobotCalibration::from(calibration), file);
    }
}
