//! `[robot.wiring]`: what is connected or counted otherwise than by the conventions.

use posebridge_telemetry::{CameraUnit, GyroUnit, Polarity, WheelOrder, Wiring};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is connected or counted otherwise than by the conventions; what the robot and its cameras send is corrected by it.
#[expect(clippy::struct_excessive_bools, reason = "keys of a file, each for itself")]
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct RobotWiring {
    /// The counter of the left wheel is that of the right one, and the reverse.
    pub swap_wheels: bool,
    /// The left wheel counts backwards, after swap_wheels.
    pub reverse_left: bool,
    /// The right wheel counts backwards, after swap_wheels.
    pub reverse_right: bool,
    /// The gyro counts clockwise turns.
    pub reverse_gyro: bool,
    /// Unit of the gyro's rates, where a message says rad/s: rad/s or deg/s.
    pub gyro_unit: GyroUnitName,
    /// The y axis of the cameras points down: their picture is mirrored, headings turn clockwise.
    pub camera_y_down: bool,
    /// Unit of the cameras' positions, where a message says metres: m or mm.
    pub camera_unit: CameraUnitName,
}

/// A unit of turn rates.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
pub enum GyroUnitName {
    /// Radians per second.
    #[default]
    #[serde(rename = "rad/s")]
    RadiansPerSecond,
    /// Degrees per second.
    #[serde(rename = "deg/s")]
    DegreesPerSecond,
}

/// A unit of positions.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
pub enum CameraUnitName {
    /// Metres.
    #[default]
    #[serde(rename = "m")]
    Meters,
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimeters,
}

impl RobotWiring {
    /// So that a file need not say it.
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
    pub(super) fn is_conventional(&self) -> bool {
        *self == Self::default()
    }

    pub fn to_wiring(self) -> Wiring {
        let polarity = |is_reversed| if is_reversed { Polarity::Reversed } else { Polarity::Normal };
        Wiring {
            wheels: if self.swap_wheels { WheelOrder::Swapped } else { WheelOrder::AsNamed },
            left: polarity(self.reverse_left),
            right: polarity(self.reverse_right),
            gyro: polarity(self.reverse_gyro),
            gyro_unit: match self.gyro_unit {
                GyroUnitName::RadiansPerSecond => GyroUnit::RadiansPerSecond,
                GyroUnitName::DegreesPerSecond => GyroUnit::DegreesPerSecond,
            },
            camera_y: polarity(self.camera_y_down),
            camera_unit: match self.camera_unit {
                CameraUnitName::Meters => CameraUnit::Meters,
                CameraUnitName::Millimeters => CameraUnit::Millimeters,
            },
        }
    }
}

impl From<Wiring> for RobotWiring {
    fn from(wiring: Wiring) -> Self {
        Self {
            swap_wheels: wiring.wheels == WheelOrder::Swapped,
            reverse_left: wiring.left == Polarity::Reversed,
            reverse_right: wiring.right == Polarity::Reversed,
            reverse_gyro: wiring.gyro == Polarity::Reversed,
            gyro_unit: match wiring.gyro_unit {
                GyroUnit::RadiansPerSecond => GyroUnitName::RadiansPerSecond,
                GyroUnit::DegreesPerSecond => GyroUnitName::DegreesPerSecond,
            },
            camera_y_down: wiring.camera_y == Polarity::Reversed,
            camera_unit: match wiring.camera_unit {
                CameraUnit::Meters => CameraUnitName::Meters,
                CameraUnit::Millimeters => CameraUnitName::Millimeters,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_key_survives_its_wiring() {
        let text = "swap_wheels = true\nreverse_left = true\nreverse_right = true\nreverse_gyro = true\n\
                    gyro_unit = \"deg/s\"\ncamera_y_down = true\ncamera_unit = \"mm\"\n";
        let all: RobotWiring = toml::from_str(text).unwrap();
        assert_eq!(RobotWiring::from(all.to_wiring()), all);
        assert_eq!(RobotWiring::default().to_wiring(), Wiring::default());
        assert!(RobotWiring::default().is_conventional() && !all.is_conventional());
        let refusal = toml::from_str::<RobotWiring>("gyro_unit = \"degrees\"").unwrap_err().to_string();
        assert!(refusal.contains("rad/s") && refusal.contains("deg/s"), "{refusal}");
    }
}
