//! `[robot.mounting]`: where each sensor sits on the robot, and how well that is known.

use anyhow::{Result, ensure};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{MountedSensor, Mounting, Mountings, UncertainValue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Further from mid-axle than this no sensor is on the robot.
const MAX_LEVER_M: f64 = 100.0;
/// Any direction.
const MAX_YAW_DEG: f64 = 180.0;
/// An accelerometer that measures hardly anything of the forward acceleration is another sensor.
const MAX_IMU_YAW_DEG: f64 = 60.0;

/// A number that is known, or a table of value and sigma.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(untagged, expecting = "a number, or a table { value, sigma }")]
pub enum MountingEntry {
    /// Known.
    Known(f64),
    /// Known within one standard deviation; estimated unless that is zero.
    Uncertain {
        /// The number.
        value: f64,
        /// One standard deviation.
        sigma: f64,
    },
}

impl Default for MountingEntry {
    fn default() -> Self {
        Self::Known(0.0)
    }
}

impl From<UncertainValue> for MountingEntry {
    fn from(UncertainValue { value, sigma }: UncertainValue) -> Self {
        if sigma > 0.0 { Self::Uncertain { value, sigma } } else { Self::Known(value) }
    }
}

impl MountingEntry {
    fn checked(self, sensor: MountedSensor, key: &str, limit: f64) -> Result<UncertainValue> {
        let (value, sigma) = match self {
            Self::Known(value) => (value, 0.0),
            Self::Uncertain { value, sigma } => (value, sigma),
        };
        let name = format!("robot.mounting.{}.{key}", sensor.name());
        ensure!(value.abs() <= limit, "`{name}` is {value}, must lie in {} to {limit}", -limit);
        ensure!((0.0..=limit).contains(&sigma), "`{name}.sigma` is {sigma}, must lie in 0 to {limit}");
        ensure!(
            sensor != MountedSensor::Imu || sigma == 0.0,
            "`{name}.sigma` is {sigma}, must be 0: no observation tells where accelerations are measured"
        );
        Ok(UncertainValue { value, sigma })
    }
}

/// A sensor's position and direction on the robot.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct SensorMounting {
    /// Forward of mid-axle.
    pub x_m: MountingEntry,
    /// To the left of it.
    pub y_m: MountingEntry,
    /// Of the sensor's x axis, counter-clockwise from forward.
    pub yaw_deg: MountingEntry,
}

/// The mounting of the robot's sensors.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RobotMounting {
    /// The camera or scanner that sights landmarks.
    pub landmarks: SensorMounting,
    /// The radio tag whose range to beacons is measured.
    pub beacons: SensorMounting,
    /// The range finder that measures walls.
    pub range: SensorMounting,
    /// The compass.
    pub compass: SensorMounting,
    /// The accelerometers; a gyro measures the same everywhere on the robot.
    pub imu: SensorMounting,
}

impl RobotMounting {
    const fn of(&self, sensor: MountedSensor) -> &SensorMounting {
        match sensor {
            MountedSensor::Landmarks => &self.landmarks,
            MountedSensor::Beacons => &self.beacons,
            MountedSensor::Range => &self.range,
            MountedSensor::Compass => &self.compass,
            MountedSensor::Imu => &self.imu,
        }
    }

    pub fn checked(&self) -> Result<Mountings> {
        let mut mountings = Mountings::default();
        for sensor in MountedSensor::ALL {
            let entry = self.of(sensor);
            let max_deg = if sensor == MountedSensor::Imu { MAX_IMU_YAW_DEG } else { MAX_YAW_DEG };
            let yaw_deg = entry.yaw_deg.checked(sensor, "yaw_deg", max_deg)?;
            mountings[sensor] = Mounting {
                x_m: entry.x_m.checked(sensor, "x_m", MAX_LEVER_M)?,
                y_m: entry.y_m.checked(sensor, "y_m", MAX_LEVER_M)?,
                yaw_rad: UncertainValue { value: yaw_deg.value.to_radians(), sigma: yaw_deg.sigma.to_radians() },
            };
        }
        Ok(mountings)
    }
}

impl From<&Mountings> for RobotMounting {
    fn from(mountings: &Mountings) -> Self {
        let of = |sensor| {
            let mounting: &Mounting = &mountings[sensor];
            SensorMounting {
                x_m: mounting.x_m.into(),
                y_m: mounting.y_m.into(),
                yaw_deg: in_degrees(mounting.yaw_rad).into(),
            }
        };
        Self {
            landmarks: of(MountedSensor::Landmarks),
            beacons: of(MountedSensor::Beacons),
            range: of(MountedSensor::Range),
            compass: of(MountedSensor::Compass),
            imu: of(MountedSensor::Imu),
        }
    }
}

pub(super) fn in_degrees(angle_rad: UncertainValue) -> UncertainValue {
    UncertainValue { value: wrap_rad(angle_rad.value).to_degrees(), sigma: angle_rad.sigma.to_degrees() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_known_and_a_table_is_uncertain_and_both_survive_a_profile() {
        let text = "landmarks = { x_m = 0.08, yaw_deg = { value = 5.0, sigma = 3.0 } }\nimu = { y_m = 0.02 }\n";
        let file: RobotMounting = toml::from_str(text).unwrap();
        let mountings = file.checked().unwrap();
        let landmarks = &mountings[MountedSensor::Landmarks];
        assert_eq!(landmarks.x_m, UncertainValue { value: 0.08, sigma: 0.0 });
        assert_eq!(landmarks.yaw_rad.sigma, 3.0_f64.to_radians());
        assert_eq!(mountings[MountedSensor::Imu].y_m.value, 0.02);
        let profile = toml::to_string(&RobotMounting::from(&mountings)).unwrap();
        let again = toml::from_str::<RobotMounting>(&profile).unwrap().checked().unwrap();
        for sensor in MountedSensor::ALL {
            let (before, after) = (&mountings[sensor], &again[sensor]);
            assert_eq!((after.x_m, after.y_m), (before.x_m, before.y_m));
            assert!((after.yaw_rad.sigma - before.yaw_rad.sigma).abs() < 1e-15);
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_limits() {
        let refusal = |text: &str| toml::from_str::<RobotMounting>(text).unwrap().checked().unwrap_err().to_string();
        let far = refusal("beacons = { x_m = 101.0 }");
        assert_eq!(far, "`robot.mounting.beacons.x_m` is 101, must lie in -100 to 100");
        let negative = refusal("range = { yaw_deg = { value = 0.0, sigma = -1.0 } }");
        assert_eq!(negative, "`robot.mounting.range.yaw_deg.sigma` is -1, must lie in 0 to 180");
        assert!(refusal("imu = { x_m = { value = 0.1, sigma = 0.1 } }").ends_with("accelerations are measured"));
    }
}
