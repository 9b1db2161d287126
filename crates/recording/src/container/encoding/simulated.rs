//! The encoding of commands to the simulated brick.

use posebridge_telemetry::{SensorSwitch, SimulatorCommand, SlippingWheel, SteeringSource, TimeDelta};

use super::cursor::InputDecoder;
use super::{DecodeError, put_numbers, simulator};

/// Appends the command and its fields.
pub(super) fn put_simulator(command: &SimulatorCommand, bytes: &mut Vec<u8>) {
    let mut put = |kind: u8, values: &[f64]| {
        bytes.push(kind);
        put_numbers(values, bytes);
    };
    match command {
        SimulatorCommand::Kidnap { forward_m, left_m, turn_rad } => {
            put(simulator::KIDNAP, &[*forward_m, *left_m, *turn_rad]);
        }
        SimulatorCommand::Slip { wheel, factor, duration } => {
            put(simulator::SLIP, &[*factor]);
            put_duration(*duration, bytes);
            bytes.push(index_of(&SlippingWheel::ALL, wheel));
        }
        SimulatorCommand::Camera(SensorSwitch::Off) => put(simulator::CAMERA_OFF, &[]),
        SimulatorCommand::Camera(SensorSwitch::On) => put(simulator::CAMERA_ON, &[]),
        SimulatorCommand::CameraDelay { delay } => {
            put(simulator::CAMERA_DELAY, &[]);
            put_duration(*delay, bytes);
        }
        SimulatorCommand::GyroBiasStep { rad_per_s } => {
            put(simulator::GYRO_BIAS_STEP, &[*rad_per_s]);
        }
        SimulatorCommand::LinkProfile(Some(name)) => {
            put(simulator::LINK_PROFILE, &[]);
            bytes.extend_from_slice(name.as_str().as_bytes());
        }
        SimulatorCommand::LinkProfile(None) => put(simulator::NO_LINK_PROFILE, &[]),
        SimulatorCommand::PullCable { duration } => {
            put(simulator::PULL_CABLE, &[]);
            put_duration(*duration, bytes);
        }
        SimulatorCommand::Steering(source) => {
            bytes.extend_from_slice(&[simulator::STEERING, index_of(&SteeringSource::ALL, source)]);
        }
        SimulatorCommand::Drive { forward_m_per_s, turn_rad_per_s } => {
            put(simulator::DRIVE, &[*forward_m_per_s, *turn_rad_per_s]);
        }
        SimulatorCommand::Path => put(simulator::PATH, &[]),
    }
}

fn put_duration(span: TimeDelta, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&span.as_nanos().to_le_bytes());
}

/// The place in the list of all; each of them stands in it.
fn index_of<T: PartialEq>(all: &[T], one: &T) -> u8 {
    all.iter().take_while(|other| *other != one).count() as u8
}

impl InputDecoder<'_> {
    /// The command for the simulated brick that begins here.
    pub(super) fn simulator(&mut self) -> Result<SimulatorCommand, DecodeError> {
        Ok(match self.u8()? {
            simulator::KIDNAP => {
                SimulatorCommand::Kidnap { forward_m: self.f64()?, left_m: self.f64()?, turn_rad: self.f64()? }
            }
            simulator::SLIP => SimulatorCommand::Slip {
                factor: self.f64()?,
                duration: self.duration()?,
                wheel: self.choice("slipping wheel", &SlippingWheel::ALL)?,
            },
            simulator::CAMERA_OFF => SimulatorCommand::Camera(SensorSwitch::Off),
            simulator::CAMERA_ON => SimulatorCommand::Camera(SensorSwitch::On),
            simulator::CAMERA_DELAY => SimulatorCommand::CameraDelay { delay: self.duration()? },
            simulator::GYRO_BIAS_STEP => SimulatorCommand::GyroBiasStep { rad_per_s: self.f64()? },
            simulator::LINK_PROFILE => {
                SimulatorCommand::LinkProfile(Some(self.remaining_name("a link profile's name")?))
            }
            simulator::NO_LINK_PROFILE => SimulatorCommand::LinkProfile(None),
            simulator::PULL_CABLE => SimulatorCommand::PullCable { duration: self.duration()? },
            simulator::STEERING => SimulatorCommand::Steering(self.choice("steering source", &SteeringSource::ALL)?),
            simulator::DRIVE => SimulatorCommand::Drive { forward_m_per_s: self.f64()?, turn_rad_per_s: self.f64()? },
            simulator::PATH => SimulatorCommand::Path,
            value => {
                return Err(DecodeError::Unknown { field: "command for the simulated brick", value });
            }
        })
    }

    fn duration(&mut self) -> Result<TimeDelta, DecodeError> {
        self.i64().map(TimeDelta::from_nanos)
    }

    fn choice<T: Copy>(&mut self, field: &'static str, all: &[T]) -> Result<T, DecodeError> {
        let value = self.u8()?;
        all.get(usize::from(value)).copied().ok_or(DecodeError::Unknown { field, value })
    }
}
