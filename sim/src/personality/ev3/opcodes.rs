//! The byte codes of direct commands: clock, motors, sensors, battery, names.
//!
//! Clients use a small subset of the virtual machine; everything else is answered with an error.
//!
//! # Sources
//! LEGO MINDSTORMS EV3 firmware developer kit, byte codes; its header c_com.h for the commands of names and networks.

use posebridge_telemetry::TimeDelta;

use super::super::lego::FirmwarePass;
use super::machine::{BytecodeMachine, ExecutionFault, OperandWidth, calculate, math};
use super::motors::{MotorDrive, StopCondition};
use super::sensors::{SensorReading, SensorRequest};
use super::wire::SERIAL_NUMBER;
use super::{Ev3, Flow};

/// Versions that an up-to-date brick reports.
const OS_VERSION: &str = "Linux 2.6.33-rc4";
const OS_BUILD: &str = "1212131117";
const HARDWARE_VERSION: &str = "V0.60";
const FIRMWARE_VERSION: &str = "V1.09H";
const FIRMWARE_BUILD: &str = "1512030906";
const MEMORY_KB: (i32, i32) = (6_000, 5_000);
/// An empty and a full battery, in volts.
const EMPTY_V: f64 = 6.2;
const FULL_V: f64 = 7.5;
const CURRENT_A: f32 = 0.2;

impl Ev3 {
    pub(super) fn execute(
        &mut self,
        code: u8,
        machine: &mut BytecodeMachine,
        pass: &mut FirmwarePass<'_>,
    ) -> Result<Flow, ExecutionFault> {
        if let Some(done) = calculate(code, machine) {
            return done.map(|()| Flow::Next);
        }
        match code {
            // NOP and OBJECT_END.
            0x01 => {}
            0x0A => return Ok(Flow::End),
            // PROGRAM_STOP: the program of the user is the only one.
            0x02 => {
                machine.int(OperandWidth::Word)?;
                self.is_running = false;
                self.motors.stop(0xF);
            }
            0x7C => self.info(machine)?,
            0x81 => ui_read(machine, pass)?,
            // UI_WRITE: the lamp, which is not simulated.
            0x82 => {
                expect_command(machine, 0x1B)?;
                machine.byte()?;
            }
            // TIMER_READ: milliseconds since the program began, and a direct command is its own program.
            0x87 => machine.write_int(OperandWidth::Long, 0)?,
            0x8F => machine.write_int(OperandWidth::Long, pass.now.as_micros() as i32)?,
            0x8D => math(machine)?,
            0x90 => machine.write_int(OperandWidth::Byte, 0)?,
            0x94 => sound(machine)?,
            0x99 => return self.input_device(machine, pass),
            0x9A | 0x9D => self.input_read(code, machine, pass)?,
            0x9C => {
                let (layer, port) = (machine.byte()?, machine.byte()?);
                if !self.sensors.is_ready(pass.sim_time, port_of(layer, port)) {
                    return Ok(Flow::Wait);
                }
            }
            0xA0..=0xB4 => self.output(code, machine, pass)?,
            0xC5 => {
                machine.write_int(OperandWidth::Long, MEMORY_KB.0)?;
                machine.write_int(OperandWidth::Long, MEMORY_KB.1)?;
            }
            0xD3 => self.com_get(machine)?,
            // COM_SET: SET_BRICKNAME alone.
            0xD4 => {
                expect_command(machine, 0x08)?;
                self.name = String::from_utf8_lossy(&machine.text()?).into_owned();
            }
            _ => return Err(ExecutionFault),
        }
        Ok(Flow::Next)
    }

    fn info(&mut self, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
        match machine.byte()? {
            0x04 => machine.write_int(OperandWidth::Byte, self.volume)?,
            0x05 => self.volume = machine.byte()?,
            0x06 => machine.write_int(OperandWidth::Byte, self.sleep_min)?,
            0x07 => self.sleep_min = machine.byte()?,
            _ => return Err(ExecutionFault),
        }
        Ok(())
    }

    fn com_get(&mut self, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
        match machine.byte()? {
            // GET_BRICKNAME.
            0x0D => {
                let capacity = machine.byte()?;
                machine.write_text(&self.name, capacity)
            }
            // GET_NETWORK: name, address of the hardware, address on the network.
            0x0E => {
                let (_hardware, capacity) = (machine.byte()?, machine.byte()?);
                machine.write_text("posebridge", capacity)?;
                machine.write_text(SERIAL_NUMBER, capacity)?;
                machine.write_text("127.0.0.1", capacity)
            }
            _ => Err(ExecutionFault),
        }
    }

    fn input_device(&mut self, machine: &mut BytecodeMachine, pass: &FirmwarePass<'_>) -> Result<Flow, ExecutionFault> {
        let command = machine.byte()?;
        let layer = machine.byte()?;
        match command {
            // CLR_ALL.
            0x0A => {
                self.sensors.clear(pass.senses);
                self.motors.clear_counts(0xF);
                return Ok(Flow::Next);
            }
            // STOP_ALL.
            0x0D => {
                self.motors.stop(0xF);
                return Ok(Flow::Next);
            }
            _ => {}
        }
        let port = port_of(layer, machine.byte()?);
        match command {
            // GET_TYPEMODE.
            0x05 => {
                let (kind, mode) = self.sensors.kind_and_mode(port);
                machine.write_int(OperandWidth::Byte, i32::from(kind))?;
                machine.write_int(OperandWidth::Byte, i32::from(mode))?;
            }
            // CLR_CHANGES.
            0x1A => self.sensors.clear(pass.senses),
            // READY_PCT, READY_RAW, READY_SI.
            0x1B..=0x1D => {
                let (kind, mode) = (machine.byte()?, machine.byte()?);
                let count = machine.byte()?;
                let reading = self.read(pass, SensorRequest { port, kind, mode });
                let reading = self.sensors.await_reading(reading);
                if reading == SensorReading::NotYet {
                    return Ok(Flow::Wait);
                }
                for index in 0..usize::try_from(count).map_err(|_negative| ExecutionFault)? {
                    put_reading(command, &reading, index, machine)?;
                }
            }
            _ => return Err(ExecutionFault),
        }
        Ok(Flow::Next)
    }

    /// INPUT_READ and INPUT_READSI, which return the present reading without waiting.
    fn input_read(
        &mut self,
        code: u8,
        machine: &mut BytecodeMachine,
        pass: &FirmwarePass<'_>,
    ) -> Result<(), ExecutionFault> {
        let (layer, port) = (machine.byte()?, machine.byte()?);
        let (kind, mode) = (machine.byte()?, machine.byte()?);
        let reading = self.read(pass, SensorRequest { port: port_of(layer, port), kind, mode });
        let format = if code == 0x9A { READY_PCT } else { READY_SI };
        put_reading(format, &reading, 0, machine)
    }

    fn read(&mut self, pass: &FirmwarePass<'_>, request: SensorRequest) -> SensorReading {
        self.sensors.read(pass.sim_time, request, pass.senses, &self.motors)
    }

    fn output(
        &mut self,
        code: u8,
        machine: &mut BytecodeMachine,
        pass: &FirmwarePass<'_>,
    ) -> Result<(), ExecutionFault> {
        let (layer, which) = (machine.byte()?, machine.byte()?);
        // Other layers are other bricks; there are none.
        let which = if layer == 0 { which } else { 0 };
        let port = usize::try_from(which).unwrap_or(usize::MAX);
        match code {
            // RESET, STOP, POWER, SPEED, START, POLARITY.
            0xA2 => self.motors.reset_tachos(which),
            0xA3 => {
                machine.byte()?;
                self.motors.stop(which);
            }
            0xA4 => self.motors.set(which, MotorDrive::Power(f64::from(machine.byte()?) / 100.0)),
            0xA5 => self.motors.set(which, MotorDrive::Speed(f64::from(machine.byte()?))),
            0xA6 => self.motors.start(which),
            0xA7 => self.motors.set_polarity(which, machine.byte()?),
            // READ.
            0xA8 => {
                let (tacho, percent) = self.motors.tacho(port);
                machine.write_int(OperandWidth::Byte, percent)?;
                machine.write_int(OperandWidth::Long, tacho)?;
            }
            // TEST.
            0xA9 => machine.write_int(OperandWidth::Byte, i32::from(self.motors.is_busy(which)))?,
            // STEP_POWER, TIME_POWER, STEP_SPEED, TIME_SPEED.
            0xAC..=0xAF => self.movement(code, which, machine, pass.sim_time)?,
            // CLR_COUNT, GET_COUNT.
            0xB2 => self.motors.clear_counts(which),
            0xB3 => machine.write_int(OperandWidth::Long, self.motors.count(port))?,
            _ => return Err(ExecutionFault),
        }
        Ok(())
    }

    fn movement(
        &mut self,
        code: u8,
        which: i32,
        machine: &mut BytecodeMachine,
        now: TimeDelta,
    ) -> Result<(), ExecutionFault> {
        let percent = f64::from(machine.byte()?);
        let drive = if code < 0xAE { MotorDrive::Power(percent / 100.0) } else { MotorDrive::Speed(percent) };
        let mut length = 0_i64;
        for _ in 0..3 {
            length += i64::from(machine.int(OperandWidth::Long)?);
        }
        let _brake = machine.byte()?;
        let until = if code & 1 == 0 {
            StopCondition::Turned(length)
        } else {
            StopCondition::Time(now + TimeDelta::from_millis(length))
        };
        self.motors.begin(which, drive, until);
        Ok(())
    }
}

const READY_PCT: i32 = 0x1B;
const READY_RAW: i32 = 0x1C;
const READY_SI: i32 = 0x1D;

fn put_reading(
    format: i32,
    reading: &SensorReading,
    index: usize,
    machine: &mut BytecodeMachine,
) -> Result<(), ExecutionFault> {
    let value = match reading {
        SensorReading::Values(values, full) => values.get(index).map(|value| (*value, *full)),
        SensorReading::NoSensor | SensorReading::NotYet => None,
    };
    match (format, value) {
        (READY_PCT, value) => {
            let percent = value.map_or(0.0, |(value, full)| value / full * 100.0);
            machine.write_int(OperandWidth::Byte, percent.round().clamp(-100.0, 100.0) as i32)
        }
        (READY_RAW, value) => machine.write_int(OperandWidth::Long, value.map_or(0, |(value, _)| value as i32)),
        (_, Some((value, _))) => machine.write_real(value as f32),
        (_, None) => machine.write_real(f32::NAN),
    }
}

fn ui_read(machine: &mut BytecodeMachine, pass: &FirmwarePass<'_>) -> Result<(), ExecutionFault> {
    let text = match machine.byte()? {
        0x01 => return machine.write_real(pass.battery_v as f32),
        0x02 => return machine.write_real(CURRENT_A),
        // GET_TBATT: the battery is as warm as the room.
        0x05 => return machine.write_real(21.0),
        0x12 => {
            let percent = (pass.battery_v - EMPTY_V) / (FULL_V - EMPTY_V) * 100.0;
            return machine.write_int(OperandWidth::Byte, percent.clamp(0.0, 100.0) as i32);
        }
        0x03 => OS_VERSION,
        0x09 => HARDWARE_VERSION,
        0x0A => FIRMWARE_VERSION,
        0x0B => FIRMWARE_BUILD,
        0x0C => OS_BUILD,
        _ => return Err(ExecutionFault),
    };
    let capacity = machine.byte()?;
    machine.write_text(text, capacity)
}

/// BREAK and TONE; sound is not simulated.
fn sound(machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    match machine.byte()? {
        0x00 => Ok(()),
        0x01 => {
            machine.byte()?;
            machine.int(OperandWidth::Word)?;
            machine.int(OperandWidth::Word)?;
            Ok(())
        }
        _ => Err(ExecutionFault),
    }
}

/// Fails on any subcommand but the one supported.
fn expect_command(machine: &mut BytecodeMachine, command: i32) -> Result<(), ExecutionFault> {
    if machine.byte()? == command { Ok(()) } else { Err(ExecutionFault) }
}

/// Ports exist only on layer 0.
fn port_of(layer: i32, port: i32) -> usize {
    if layer == 0 { usize::try_from(port).unwrap_or(usize::MAX) } else { usize::MAX }
}
