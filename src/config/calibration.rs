//! `[robot.noise]` and `[robot.calibration]`: tables that generate the structs, their validation and their use. A calibration entry is
//! a value with one standard deviation. A sigma of zero fixes the value; any other lets an adaptive filter estimate it.

use anyhow::{Result, ensure};
use posebridge_telemetry::{Calibration, MountedSensor, Mountings, SensorNoise, UncertainValue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lengths::{POSITION_SIGMA, check_length};
use super::mounting::in_degrees;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LowerBound {
    Zero,
    /// A sensor that is used alone cannot be exact: its update would divide by zero.
    AboveZero,
}

impl LowerBound {
    fn check(self, key: &str, value: f64) -> Result<()> {
        let (is_good, requirement) = match self {
            Self::Zero => (value >= 0.0, "zero or more"),
            Self::AboveZero => (value > 0.0, "more than zero"),
        };
        ensure!(is_good && value.is_finite(), "`robot.noise.{key}` is {value}, must be {requirement}");
        Ok(())
    }
}

/// The keys that are a position's standard deviation, and those that are an angle's.
const POSITION_SIGMAS: [&str; 4] = ["fix_position_m", "fix_persistent_m", "landmark_range_m", "wall_range_m"];
const ANGLE_SIGMAS: [&str; 3] = ["fix_heading_rad", "compass_rad", "landmark_bearing_rad"];
const MAX_ANGLE_SIGMA_RAD: f64 = std::f64::consts::PI;

/// Refuses noise that must be in another unit: larger than the arena, or than half a turn.
fn check_magnitude(key: &str, value: f64) -> Result<()> {
    if POSITION_SIGMAS.contains(&key) {
        check_length(&format!("robot.noise.{key}"), value, &POSITION_SIGMA)?;
    }
    ensure!(
        !ANGLE_SIGMAS.contains(&key) || value <= MAX_ANGLE_SIGMA_RAD,
        "`robot.noise.{key}` is {value}, must be at most {MAX_ANGLE_SIGMA_RAD:.4} rad; did you mean {:.4}, which is {value} degrees?",
        value.to_radians()
    );
    Ok(())
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
            pub fn checked(&self) -> Result<SensorNoise> {
                $(LowerBound::$least.check(stringify!($key), self.$key)?;)+
                $(check_magnitude(stringify!($key), self.$key)?;)+
                self.check_ranges()?;
                Ok(SensorNoise { $($key: self.$key,)+ })
            }
        }

        impl From<SensorNoise> for RobotNoise {
            fn from(noise: SensorNoise) -> Self {
                Self { $($key: noise.$key,)+ }
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
    /// Distance along the track, for each second in which the wheels turn.
    travel_m_per_sqrt_s = 0.0, Zero;
    /// Heading, for each second in which the wheels turn.
    heading_rad_per_sqrt_s = 0.0, Zero;
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
    /// An error that all fixes of one source share, each axis; 0 for none.
    fix_persistent_m = 0.0, Zero;
    /// The path after which the correlation of that error has fallen to 1/e.
    fix_persistence_m = 1.0, AboveZero;
    /// An accelerometer at a wheel, per sample.
    accelerometer_m_per_s2 = 0.1, AboveZero;
    /// A compass heading.
    compass_rad = 5.0 * DEGREE, AboveZero;
    /// The range to a landmark.
    landmark_range_m = 0.1, Zero;
    /// The part of it that is proportional to the range.
    landmark_range_share = 0.0, Zero;
    /// The bearing of a landmark.
    landmark_bearing_rad = 2.0 * DEGREE, AboveZero;
    /// A landmark's position in the map, each axis; 0 takes the map as exact.
    landmark_place_m = 0.0, Zero;
    /// The range to a beacon.
    beacon_range_m = 0.1, Zero;
    /// The part of it that is proportional to the range.
    beacon_range_share = 0.0, Zero;
    /// The range to a wall.
    wall_range_m = 0.01, AboveZero;
    /// A thermometer.
    temperature_k = 0.1, AboveZero;
}

impl RobotNoise {
    /// A range needs a constant part of its noise or one that is proportional to it.
    fn check_ranges(&self) -> Result<()> {
        for (key, constant_m, share) in [
            ("landmark_range", self.landmark_range_m, self.landmark_range_share),
            ("beacon_range", self.beacon_range_m, self.beacon_range_share),
        ] {
            ensure!(
                constant_m > 0.0 || share > 0.0,
                "`robot.noise.{key}_m` and `robot.noise.{key}_share` are 0, one must be more than zero"
            );
        }
        Ok(())
    }
}

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

/// Limit of an entry's absolute value and of its sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
struct MaxMagnitude(f64);

impl MaxMagnitude {
    /// A larger relative error is a wrong geometry, not a calibration.
    const RATIO: Self = Self(0.5);
    /// 57 degrees per second at rest: a defective gyro.
    const TURN_RATE: Self = Self(1.0);
    /// Longer than any camera's delay, and the filter's longest history.
    const DELAY: Self = Self(60.0);
    /// Half a turn: more is no play.
    const ANGLE: Self = Self(std::f64::consts::PI);
    /// The filters' limit of a lever arm, and more than any radio's offset.
    const LENGTH: Self = Self(1e3);

    fn check(self, key: &str, entry: CalibrationEntry) -> Result<UncertainValue> {
        let CalibrationEntry { value, sigma } = entry;
        let Self(limit) = self;
        ensure!(value.abs() <= limit, "`robot.calibration.{key}.value` is {value}, must lie in {} to {limit}", -limit);
        ensure!((0.0..=limit).contains(&sigma), "`robot.calibration.{key}.sigma` is {sigma}, must lie in 0 to {limit}");
        Ok(UncertainValue { value, sigma })
    }
}

pub struct CalibrationKey {
    /// In files and in JSON.
    pub key: &'static str,
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
            /// Converts to the telemetry type; `power_up_bias` is the prior sigma of a gyro's bias, in rad/s.
            pub fn checked(&self, power_up_bias: f64) -> Result<Calibration> {
                let gyro_bias_rad_per_s = match self.gyro_bias_rad_per_s {
                    Some(entry) => MaxMagnitude::TURN_RATE.check("gyro_bias_rad_per_s", entry)?,
                    None => UncertainValue { value: 0.0, sigma: power_up_bias },
                };
                Ok(Calibration {
                    $($key: MaxMagnitude::$largest.check(stringify!($key), self.$key)?,)+
                    gyro_bias_rad_per_s,
                    mountings: Mountings::default(),
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

        /// In the order of reports.
        pub const CALIBRATION_KEYS: &[CalibrationKey] = &[
            $(CalibrationKey { key: stringify!($key), read: |learned| learned.$key },)+
            CalibrationKey { key: "gyro_bias_rad_per_s", read: |learned| learned.gyro_bias_rad_per_s },
        ];
    };
}

macro_rules! mounting_keys {
    ($($sensor:ident $x_m:literal $y_m:literal $yaw_deg:literal;)+) => {
        /// The mountings of the sensors that observe the pose, in the order of reports; keys of `[robot]`.
        const MOUNTING_KEYS: &[CalibrationKey] = &[
            $(
                CalibrationKey { key: $x_m, read: |learned| learned.mountings[MountedSensor::$sensor].x_m },
                CalibrationKey { key: $y_m, read: |learned| learned.mountings[MountedSensor::$sensor].y_m },
                CalibrationKey {
                    key: $yaw_deg,
                    read: |learned| in_degrees(learned.mountings[MountedSensor::$sensor].yaw_rad),
                },
            )+
        ];
    };
}

mounting_keys! {
    Landmarks "mounting.landmarks.x_m" "mounting.landmarks.y_m" "mounting.landmarks.yaw_deg";
    Beacons "mounting.beacons.x_m" "mounting.beacons.y_m" "mounting.beacons.yaw_deg";
    Range "mounting.range.x_m" "mounting.range.y_m" "mounting.range.yaw_deg";
    Compass "mounting.compass.x_m" "mounting.compass.y_m" "mounting.compass.yaw_deg";
}

/// All constants that a filter may learn, in the order of reports.
pub fn learnable_keys() -> impl Iterator<Item = &'static CalibrationKey> {
    CALIBRATION_KEYS.iter().chain(MOUNTING_KEYS)
}

calibration_table! {
    /// Relative error of the mean wheel radius: a tyre under load rolls on less than its printed radius.
    radius_scale = 0.01, RATIO;
    /// Relative difference of the wheels' radii, right minus left: two tyres of one mould, unequally loaded.
    radius_difference = 0.005, RATIO;
    /// Relative error of the track width: a wide tyre touches the ground somewhere across its width.
    track_scale = 0.05, RATIO;
    /// Relative error of the gyro's rate: it reads fast where positive. Cheap gyros are specified to a per cent or so.
    gyro_scale = 0.01, RATIO;
    /// Total play between each encoder and its wheel, in radians of the wheel.
    backlash_rad = 0.05, ANGLE;
    /// How much earlier than its stamp the motion of an odometer happened, in seconds; negative for commands.
    odometry_delay_s = 0.0, DELAY;
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
    /// How much earlier than its stamp a landmark was sighted, in seconds.
    landmark_delay_s = 0.0, DELAY;
    /// How much earlier than its stamp the range to a beacon was true, in seconds.
    beacon_delay_s = 0.0, DELAY;
    /// How much earlier than its stamp the range to a wall was true, in seconds.
    range_delay_s = 0.0, DELAY;
    /// How much earlier than its stamp a compass heading was true, in seconds.
    compass_delay_s = 0.0, DELAY;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_reaches_the_filter_under_its_own_name() {
        let noise = RobotNoise { landmark_range_m: 0.15, landmark_bearing_rad: 0.03, ..RobotNoise::default() };
        let checked = noise.checked().unwrap();
        assert_eq!((checked.landmark_range_m, checked.landmark_bearing_rad), (0.15, 0.03));
        assert_eq!(checked.gyro_bias_rad_per_s, 2.0 * DEGREE);
    }

    #[test]
    fn the_gyro_s_bias_is_known_as_well_as_its_noise_says_unless_it_was_measured() {
        let bias = |bias_rad_per_s| {
            let calibration = RobotCalibration { gyro_bias_rad_per_s: bias_rad_per_s, ..RobotCalibration::default() };
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
        let value_of = |row: usize| 0.02 * (row + 1) as f64;
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
