//! The firmware of an unmodified LEGO EV3: executes direct commands, receives mailbox messages, and runs a program.
//!
//! ```text
//! direct   LE16 length, LE16 counter, 00 (80: no answer), LE16 locals << 10 | globals, byte codes   answer .. 02 globals, 04 if it failed
//! system   LE16 length, LE16 counter, 01 (81: no answer), opcode ..                   answer .. 03 opcode status, 05 if it failed
//! ```
//! Commands are executed in order, each within a pass of 1 ms unless it waits for a sensor.
//!
//! # Sources
//! LEGO MINDSTORMS EV3 communication and firmware developer kits. docs/simulator.md describes what is ours.

mod machine;
mod motors;
mod opcodes;
mod sensors;
mod wire;

use posebridge_telemetry::TimeDelta;

use self::machine::BytecodeMachine;
use self::motors::Motors;
use self::sensors::SensorPorts;
use self::wire::{Ev3Wire, FACTORY_NAME};
use super::lego::{FirmwarePass, LegoFirmware};
use crate::scenario::{BrickProgram, Scenario};
use crate::wheels::PerWheel;

pub use self::wire::beacon;

const DIRECT: u8 = 0x00;
const SYSTEM: u8 = 0x01;
const NO_ANSWER: u8 = 0x80;
const DIRECT_DONE: u8 = 0x02;
const DIRECT_FAILED: u8 = 0x04;
const SYSTEM_DONE: u8 = 0x03;
const SYSTEM_FAILED: u8 = 0x05;
const WRITE_MAILBOX: u8 = 0x9E;
const STATUS_OK: u8 = 0x00;
const STATUS_UNKNOWN_ERROR: u8 = 0x0A;
const ESTIMATE_MAILBOX: &[u8] = b"estimate";
/// Limit of byte codes per pass, so that a jump to itself cannot block the world.
const CODES_PER_PASS: usize = 1_000;

/// Control flow after a byte code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flow {
    Next,
    /// Repeats the byte code in the next pass.
    Wait,
    End,
}

#[derive(Clone, Debug)]
struct Command {
    counter: [u8; 2],
    is_answered: bool,
    machine: BytecodeMachine,
}

#[derive(Debug)]
pub(super) struct Ev3 {
    wire: Ev3Wire,
    motors: Motors,
    sensors: SensorPorts,
    command: Option<Command>,
    is_running: bool,
    scenario_program: BrickProgram,
    mailbox_message: Option<Vec<u8>>,
    name: String,
    volume: i32,
    sleep_min: i32,
}

impl Ev3 {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let program = scenario.brick.program;
        Self {
            wire: Ev3Wire::new(scenario.brick.turn_around()),
            motors: Motors::new(&scenario.robot),
            sensors: SensorPorts::new(scenario.brick.missing_sensor),
            command: None,
            is_running: program == BrickProgram::Path,
            scenario_program: program,
            mailbox_message: None,
            name: FACTORY_NAME.to_owned(),
            volume: 50,
            sleep_min: 30,
        }
    }

    fn forget(&mut self, pass: &FirmwarePass<'_>) {
        self.motors.step(pass.sim_time, pass.counts());
        self.motors.stop(0xF);
        self.motors.clear_counts(0xF);
        self.motors.reset_tachos(0xF);
        self.sensors.reset();
        self.mailbox_message = None;
    }

    fn begin(&mut self, frame: &[u8]) {
        let [low, high, kind, body @ ..] = frame else {
            return;
        };
        let counter = [*low, *high];
        let is_answered = kind & NO_ANSWER == 0;
        match (kind & !NO_ANSWER, body) {
            (DIRECT, [low, high, code @ ..]) => {
                let memory = usize::from(u16::from_le_bytes([*low, *high]));
                self.command = Some(Command {
                    counter,
                    is_answered,
                    machine: BytecodeMachine::new(code, memory & 0x3FF, memory >> 10),
                });
            }
            (SYSTEM, [opcode, rest @ ..]) => {
                let status = self.system(*opcode, rest);
                let kind = if status == STATUS_OK { SYSTEM_DONE } else { SYSTEM_FAILED };
                if is_answered {
                    self.wire.send(&[*low, *high, kind, *opcode, status]);
                }
            }
            _ => {}
        }
    }

    /// Executes a command until it ends, fails or waits.
    fn run_command(&mut self, mut command: Command, pass: &mut FirmwarePass<'_>) {
        for _ in 0..CODES_PER_PASS {
            let start = command.machine.program_counter;
            let Some(code) = command.machine.next_code() else {
                return self.answer(&command, DIRECT_DONE);
            };
            match self.execute(code, &mut command.machine, pass) {
                Ok(Flow::Next) => {}
                Ok(Flow::End) => return self.answer(&command, DIRECT_DONE),
                Ok(Flow::Wait) => {
                    command.machine.program_counter = start;
                    break;
                }
                Err(_fault) => return self.answer(&command, DIRECT_FAILED),
            }
        }
        self.command = Some(command);
    }

    fn answer(&mut self, command: &Command, kind: u8) {
        if command.is_answered {
            self.wire.send(&[&command.counter[..], &[kind], &command.machine.globals].concat());
        }
    }

    fn system(&mut self, opcode: u8, rest: &[u8]) -> u8 {
        if opcode != WRITE_MAILBOX {
            return STATUS_UNKNOWN_ERROR;
        }
        let Some((name, payload)) = mailbox_message(rest) else {
            return STATUS_UNKNOWN_ERROR;
        };
        // A message to a mailbox that no program has opened is lost, as in the brick.
        if self.is_running && name == ESTIMATE_MAILBOX {
            self.mailbox_message = Some(payload.to_vec());
        }
        STATUS_OK
    }

    /// Runs the program for one pass, starting with its mailbox.
    fn run(&mut self, pass: &mut FirmwarePass<'_>) {
        if !self.is_running {
            return pass.idle();
        }
        if let Some(message) = self.mailbox_message.take() {
            pass.apply_mail(&message);
        }
        self.motors.drive(pass.run_program());
    }
}

impl LegoFirmware for Ev3 {
    fn step(&mut self, pass: &mut FirmwarePass<'_>) -> PerWheel<f64> {
        // A command that waits for a sensor that is not there would wait for ever: the next one takes its place.
        let is_free = self.command.is_none() || self.sensors.is_waited_for_in_vain;
        if is_free && let Some(frame) = self.wire.next_frame() {
            self.sensors.is_waited_for_in_vain = false;
            self.begin(&frame);
        }
        if let Some(command) = self.command.take() {
            self.run_command(command, pass);
        }
        self.run(pass);
        let duty = self.motors.step(pass.sim_time, pass.counts());
        pass.outgoing.extend(self.wire.radio.step(pass.sim_time));
        duty
    }

    fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        self.wire.receive(now, bytes);
    }

    fn reopen(&mut self) {
        self.wire.reopen();
        self.command = None;
    }

    fn restart(&mut self, pass: &mut FirmwarePass<'_>) {
        self.reopen();
        self.forget(pass);
        self.is_running = self.scenario_program == BrickProgram::Path;
    }

    fn restart_program(&mut self, pass: &mut FirmwarePass<'_>) {
        if self.is_running {
            self.forget(pass);
            pass.program.begin(pass.now, pass.counts());
        }
    }
}

/// Name and payload: length with the final zero, name, LE16 length, payload.
fn mailbox_message(rest: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = rest.split_first()?;
    let (name, rest) = rest.split_at_checked(usize::from(*length))?;
    let (length, payload) = rest.split_first_chunk()?;
    let payload = payload.get(..usize::from(u16::from_le_bytes(*length)))?;
    Some((name.strip_suffix(&[0]).unwrap_or(name), payload))
}
