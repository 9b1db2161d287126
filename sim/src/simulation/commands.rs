//! Commands to a running simulation, and which of them the simulation carries out itself.

use posebridge_telemetry::{SimulatorCommand, SteeringSource};

use super::Simulation;
use crate::faults::Displacement;
use crate::firmware::Twist;
use crate::scenario::Steering;

/// Who has to do the rest of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandExecutor {
    /// The world has done it.
    Simulation,
    /// The owner of the brick's link: a profile, or a cable that is pulled.
    Link,
}

impl Simulation {
    /// Does what a person asks for, from the next step on. Numbers are taken as they are: [`SimulatorCommand::validate`] checks them.
    ///
    /// The same commands before the same steps give the same bytes.
    pub fn execute(&mut self, command: &SimulatorCommand) -> CommandExecutor {
        match *command {
            SimulatorCommand::Kidnap { forward_m, left_m, turn_rad } => {
                self.body.lift(Displacement { forward_m, left_m, turn_rad });
            }
            SimulatorCommand::Slip { wheel, factor, duration } => self.body.reduce_grip(wheel, factor, duration),
            SimulatorCommand::Camera(to) => {
                if let Some(camera) = &mut self.camera {
                    camera.set_covered(to);
                }
            }
            SimulatorCommand::CameraDelay { delay } => {
                if let Some(camera) = &mut self.camera {
                    camera.set_delay(delay);
                }
            }
            SimulatorCommand::GyroBiasStep { rad_per_s } => {
                self.board.step_gyro_bias(rad_per_s);
                self.brick.step_gyro_bias(rad_per_s);
            }
            SimulatorCommand::Steering(source) => {
                self.brick.program_mut().set_steering(match source {
                    SteeringSource::Odometry => Steering::Odometry,
                    SteeringSource::Estimate => Steering::Estimate,
                });
            }
            SimulatorCommand::Drive { forward_m_per_s, turn_rad_per_s } => {
                let now = self.brick_clock.reading(self.world);
                let wanted = Twist { forward_m_per_s, turn_rad_per_s };
                self.brick.program_mut().drive_manually(now, wanted);
            }
            SimulatorCommand::Path => self.brick.program_mut().rejoin(),
            SimulatorCommand::LinkProfile(_) | SimulatorCommand::PullCable { .. } => {
                return CommandExecutor::Link;
            }
        }
        CommandExecutor::Simulation
    }
}
