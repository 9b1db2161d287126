//! The protocol of a simulated brick, its program and its plugged sensors.

use serde::Deserialize;

/// The protocol of a brick's link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Personality {
    /// MAVLink 2, together with the camera on one link.
    #[default]
    Mavlink,
    /// The telegrams of an unmodified LEGO NXT, which answers and never sends first. The camera has a link of its own.
    Nxt,
    /// A LEGO NXT whose program pushes a compact MAVLink frame in each telegram. The camera has a link of its own.
    NxtPush,
    /// The direct and system commands of an unmodified LEGO EV3. The camera has a link of its own.
    Ev3,
}

impl Personality {
    /// Whether brick and camera use the same protocol on one link.
    pub const fn shares_link_with_camera(self) -> bool {
        matches!(self, Self::Mavlink)
    }

    /// What its radio usually needs to turn around, in milliseconds.
    pub(crate) const fn turn_around_ms(self) -> f64 {
        match self {
            Self::Mavlink => 0.0,
            // LEGO's own figure for the Bluetooth chip of the NXT, which the RWTH Aachen toolbox waits for.
            Self::Nxt | Self::NxtPush => 30.0,
            // No trustworthy figure is published; ours, from the 20 to 60 ms that people report.
            Self::Ev3 => 20.0,
        }
    }
}

/// What runs on an NXT or EV3 from the beginning. A MAVLink brick without its program would be mute, so it always runs there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BrickProgram {
    /// A program that drives the scenario's path and takes the estimate out of its mailbox.
    #[default]
    Path,
    /// None: motors turn only when the station says so.
    None,
}

/// A sensor in a port of the NXT.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PortSensor {
    /// Nothing.
    #[default]
    None,
    /// HiTechnic gyro, analog.
    Gyro,
    /// HiTechnic accelerometer, on I2C.
    Accelerometer,
    /// HiTechnic compass, on I2C.
    Compass,
    /// LEGO ultrasonic sensor, on I2C.
    Ultrasonic,
    /// LEGO temperature sensor 9749, on I2C.
    Temperature,
}

impl PortSensor {
    /// What is plugged in unless the scenario says otherwise.
    pub(crate) const USUAL: [Self; 4] = [Self::Gyro, Self::Accelerometer, Self::Compass, Self::Ultrasonic];
}
