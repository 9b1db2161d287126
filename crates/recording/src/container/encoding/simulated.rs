//! Commands for the simulated brick as bytes and back.

use posebridge_telemetry::{SimulatorCommand, SlippingWheel, Span, SteeringSource, Switch};

use super::cursor::Cursor;
use super::encode::put_all;
use super::{DecodeError, simulator};

/// Appends the command and its fields.
pub(super) fn put_simulator(command: &SimulatorCommand, bytes: &mut Vec<u8>) {
    let mut put = |kind: u8, values: &[f64]| {
        bytes.push(kind);
        put_all(values, bytes);
    };
    match command {
        SimulatorCommand::Kidnap { forward_m, left_m, turn_rad } => {
            put(simulator::KIDNAP, &[*forward_m, *left_m, *turn_rad])
        }
        SimulatorCommand::Slip { wheel, factor, duration } => {
            put(simulator::SLIP, &[*factor]);
            put_span(*duration, bytes);
            bytes.push(place(&SlippingWheel::ALL, wheel));
        }
        SimulatorCommand::Camera(Switch::Off) => put(simulator::CAMERA_OFF, &[]),
        SimulatorCommand::Camera(Switch::On) => put(simulator::CAMERA_ON, &[]),
        SimulatorCommand::CameraDelay { delay } => {
            put(simulator::CAMERA_DELAY, &[]);
            put_span(*delay, bytes);
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
            put_span(*duration, bytes);
        }
        SimulatorCommand::Steering(source) => {
            bytes.extend_from_slice(&[simulator::STEERING, place(&SteeringSource::ALL, source)]);
        }
        SimulatorCommand::Drive { forward_m_per_s, turn_rad_per_s } => {
            put(simulator::DRIVE, &[*forward_m_per_s, *turn_rad_per_s])
        }
        SimulatorCommand::Path => put(simulator::PATH, &[]),
    }
}

fn put_span(span: Span, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&span.as_nanos().to_le_bytes());
}

/// The place in the list of all; each of them stands in it.
fn place<T: PartialEq>(all: &[T], one: &T) -> u8 {
    all.iter().take_while(|other| *other != one).count() as u8
}

impl Cursor<'_> {
    /// The command for the simulated brick that begins here.
    pub(super) fn simulator(&mut self) -> Result<SimulatorCommand, DecodeError> {
        Ok(match self.u8()? {
            simulator::KIDNAP => {
                SimulatorCommand::Kidnap { forward_m: self.f64()?, left_m: self.f64()?, turn_rad: self.f64()? }
            }
            simulator::SLIP => SimulatorCommand::Slip {
                factor: self.f64()?,
                duration: self.span()?,
                wheel: self.one_of("slipping wheel", &SlippingWheel::ALL)?,
            },
            simulator::CAMERA_OFF => SimulatorCommand::Camera(Switch::Off),
            simulator::CAMERA_ON => SimulatorCommand::Camera(Switch::On),
            simulator::CAMERA_DELAY => SimulatorCommand::CameraDelay { delay: self.span()? },
            simulator::GYRO_BIAS_STEP => SimulatorCommand::GyroBiasStep { rad_per_s: self.f64()? },
            simulator::LINK_PROFILE => SimulatorCommand::LinkProfile(Some(self.rest_as_name("a link profile's name")?)),
            simulator::NO_LINK_PROFILE => SimulatorCommand::LinkProfile(None),
            simulator::PULL_CABLE => SimulatorCommand::PullCable { duration: self.span()? },
            simulator::STEERING => SimulatorCommand::Steering(self.one_of("steering source", &SteeringSource::ALL)?),
            simulator::DRIVE => SimulatorCommand::Drive { forward_m_per_s: self.f64()?, turn_rad_per_s: self.f64()? },
            simulator::PATH => SimulatorCommand::Path,
            value => {
                return Err(DecodeError::Unknown { field: "command for the simulated brick", value });
            }
        })
    }

    fn span(&mut self) -> Result<Span, DecodeError> {
        self.i64().map(Span::from_nanos)
    }

    fn one_of<T: Copy>(&mut self, field: &'static str, all: &[T]) -> Result<T, DecodeError> {
        let value = self.u8()?;
        all.get(usize::from(value)).copied().ok_or(DecodeError::Unknown { field, value })
    }
}
