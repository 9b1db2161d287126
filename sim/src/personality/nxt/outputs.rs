//! The NXT's three motor ports: commands, rotation, and their registers in the Output module.
//!
//! # Model
//! ```text
//! on and running                  duty = power / 100
//! regulated in speed              10 degrees per second for each percent of power, held by a PI control every 10 ms
//! regulated in step with others   the same; a turn ratio t takes 2 |t| percent of the speed away from the right motor if t < 0,
//! else from the left tacho limit                     the port goes idle when it has turned that far since the command
//! ```
//! # Assumptions
//! Motors sit on B (left) and C (right); A is empty. A motor without power is braked, whether brake or coast was asked for, since
//! the simulated motor's terminals are never open. Ramps are steps.
//!
//! # Sources
//! LEGO's NXT firmware: the struct of the Output module, its flags, and the regulation's 100 counts per 100 ms at full speed.

use super::telegram::{TelegramReply, status};
use crate::firmware::SpeedControl;
use crate::scenario::{RobotSettings, TICK_RAD};
use crate::wheels::PerWheel;

pub(super) const PORTS: usize = 3;
/// Ports of the wheel motors.
const LEFT: usize = 1;
const RIGHT: usize = 2;
const ALL: u8 = 0xFF;
pub(super) const MAP_BYTES: usize = 32;
const ON: u8 = 0x01;
const BRAKE: u8 = 0x02;
const REGULATED: u8 = 0x04;
/// Synchronised with the other motors.
const SYNC: u8 = 2;
/// Run states; every other state runs.
const IDLE: u8 = 0x00;
const RUNNING: u8 = 0x20;
const REGULATION_PASSES: u32 = 10;
const RAD_PER_S_PER_PERCENT: f64 = 10.0 * TICK_RAD;
/// Flags of the module: fields to apply, and counters to zero.
const UPDATE_MODE: u8 = 0x01;
const UPDATE_SPEED: u8 = 0x02;
const UPDATE_LIMIT: u8 = 0x04;
const RESET_TACHO: u8 = 0x08;
const RESET_BLOCK: u8 = 0x20;
const RESET_ROTATION: u8 = 0x40;
const LIMIT_AT: usize = 12;
const FLAGS_AT: usize = 18;
const MODE_AT: usize = 19;
const SPEED_AT: usize = 20;
const ACTUAL_SPEED_AT: usize = 21;
const RUN_STATE_AT: usize = 25;
const REGULATION_AT: usize = 26;
const OVERLOADED_AT: usize = 27;
const TURN_RATIO_AT: usize = 28;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct OutputCommand {
    /// Negative is backward.
    pub(super) power: i8,
    /// Bits: on, brake, regulated.
    pub(super) mode: u8,
    /// None, speed, synchronised.
    pub(super) regulation: u8,
    pub(super) turn_ratio: i8,
    /// Idle, ramp up, running, ramp down.
    pub(super) run_state: u8,
    /// Degrees; 0 for no limit.
    pub(super) limit: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TachoCounter {
    /// Since the program began.
    Rotation,
    /// Since the block began.
    Block,
}

#[derive(Clone, Debug)]
struct OutputPort {
    command: OutputCommand,
    position: i64,
    tacho_zero: i64,
    block_zero: i64,
    rotation_zero: i64,
    start_position: i64,
    control: SpeedControl,
    duty: f64,
    is_overloaded: bool,
    /// Bytes written into the module and not yet applied.
    written: [u8; MAP_BYTES],
}

#[derive(Clone, Debug)]
pub(super) struct OutputPorts {
    ports: [OutputPort; PORTS],
    passes: u32,
}

impl OutputPorts {
    pub(super) fn new(robot: &RobotSettings) -> Self {
        let control = SpeedControl::new(robot);
        let port = || OutputPort {
            command: OutputCommand::default(),
            position: 0,
            tacho_zero: 0,
            block_zero: 0,
            rotation_zero: 0,
            start_position: 0,
            control: control.clone(),
            duty: 0.0,
            is_overloaded: false,
            written: [0; MAP_BYTES],
        };
        Self { ports: [port(), port(), port()], passes: 0 }
    }

    /// Updates from the encoders for one pass and returns the duty of both motors.
    pub(super) fn step(&mut self, positions: PerWheel<i64>) -> PerWheel<f64> {
        self.ports[LEFT].position = positions.left;
        self.ports[RIGHT].position = positions.right;
        let is_due = self.passes.is_multiple_of(REGULATION_PASSES);
        self.passes = self.passes.wrapping_add(1);
        for (index, port) in self.ports.iter_mut().enumerate() {
            port.step();
            if is_due {
                port.regulate(index);
            }
        }
        PerWheel { left: self.ports[LEFT].duty, right: self.ports[RIGHT].duty }
    }

    pub(super) fn command(&mut self, port: u8, order: OutputCommand) -> TelegramReply {
        let indices = if port == ALL { 0..PORTS } else { usize::from(port)..usize::from(port) + 1 };
        let ports = self.ports.get_mut(indices).ok_or(status::OUT_OF_RANGE)?;
        for port in ports {
            port.apply(order);
        }
        Ok(Vec::new())
    }

    /// Both motors on at these duties, as the program on the brick sets them.
    pub(super) fn drive(&mut self, duty: PerWheel<f64>) {
        for (index, duty) in [(LEFT, duty.left), (RIGHT, duty.right)] {
            self.ports[index].duty = duty;
            self.ports[index].command = OutputCommand {
                power: (duty * 100.0).round() as i8,
                mode: ON | BRAKE,
                run_state: RUNNING,
                ..OutputCommand::default()
            };
        }
    }

    pub(super) fn zero(&mut self, port: u8, counter: TachoCounter) -> TelegramReply {
        let port = self.ports.get_mut(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        match counter {
            TachoCounter::Rotation => port.rotation_zero = port.position,
            TachoCounter::Block => port.block_zero = port.position,
        }
        Ok(Vec::new())
    }

    /// A program was started or stopped: all motors idle, all counters at zero.
    pub(super) fn reset(&mut self) {
        for port in &mut self.ports {
            port.apply(OutputCommand::default());
            port.duty = 0.0;
            port.tacho_zero = port.position;
            port.block_zero = port.position;
            port.rotation_zero = port.position;
        }
    }

    /// The reply to GETOUTPUTSTATE after its status.
    pub(super) fn state(&self, port: u8) -> TelegramReply {
        let output = self.ports.get(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        let order = output.command;
        let mut state = vec![port, order.power as u8, order.mode, order.regulation];
        state.extend([order.turn_ratio as u8, order.run_state]);
        state.extend(order.limit.to_le_bytes());
        for count in output.counts() {
            state.extend(count.to_le_bytes());
        }
        Ok(state)
    }

    pub(super) fn map(&self) -> Vec<u8> {
        let mut map: Vec<u8> = self.ports.iter().flat_map(OutputPort::map).collect();
        // The motors' pulse frequency, in kilohertz.
        map.push(8);
        map
    }

    /// Stores a write into the module. The fields wait until a flag applies them.
    pub(super) fn write(&mut self, offset: usize, bytes: &[u8]) {
        for (index, byte) in (offset..).zip(bytes) {
            let port = self.ports.get_mut(index / MAP_BYTES);
            if let Some(slot) = port.and_then(|port| port.written.get_mut(index % MAP_BYTES)) {
                *slot = *byte;
            }
        }
        for port in &mut self.ports {
            port.apply_written();
        }
    }
}

impl OutputPort {
    fn step(&mut self) {
        let limit = i64::from(self.command.limit);
        if limit > 0 && (self.position - self.start_position).abs() >= limit {
            self.command.run_state = IDLE;
            self.command.limit = 0;
        }
        if !self.is_on() {
            self.duty = 0.0;
            self.is_overloaded = false;
        } else if !self.is_regulated() && (self.duty * 100.0).round() as i8 != self.command.power {
            // A running program has set a finer duty than percent.
            self.duty = f64::from(self.command.power) / 100.0;
        }
    }

    fn regulate(&mut self, index: usize) {
        if self.is_on() && self.is_regulated() {
            let target_rad_per_s = self.regulated_percent(index) * RAD_PER_S_PER_PERCENT;
            self.duty = self.control.duty(target_rad_per_s, self.position - self.start_position);
            self.is_overloaded = self.duty.abs() >= 1.0;
        }
    }

    const fn is_on(&self) -> bool {
        self.command.mode & ON != 0 && self.command.run_state != IDLE
    }

    const fn is_regulated(&self) -> bool {
        self.command.mode & REGULATED != 0 && self.command.regulation != 0
    }

    fn regulated_percent(&self, index: usize) -> f64 {
        let power = f64::from(self.command.power);
        let ratio = f64::from(self.command.turn_ratio);
        let is_slower = (ratio < 0.0) == (index == RIGHT);
        if self.command.regulation == SYNC && is_slower { power * (1.0 - ratio.abs() / 50.0) } else { power }
    }

    fn apply(&mut self, order: OutputCommand) {
        self.command = OutputCommand {
            power: order.power.clamp(-100, 100),
            turn_ratio: order.turn_ratio.clamp(-100, 100),
            ..order
        };
        self.start_position = self.position;
        self.control.restart();
    }

    fn apply_written(&mut self) {
        let written = self.written;
        let flags = std::mem::take(&mut self.written[FLAGS_AT]);
        let is_set = |flag: u8| flags & flag != 0;
        if is_set(UPDATE_MODE | UPDATE_SPEED | UPDATE_LIMIT) {
            let mut order = self.command;
            if is_set(UPDATE_MODE) {
                (order.mode, order.regulation) = (written[MODE_AT], written[REGULATION_AT]);
            }
            if is_set(UPDATE_SPEED) {
                order.power = written[SPEED_AT] as i8;
                order.run_state = written[RUN_STATE_AT];
                order.turn_ratio = written[TURN_RATIO_AT] as i8;
            }
            if is_set(UPDATE_LIMIT) {
                let limit = written.get(LIMIT_AT..).and_then(<[u8]>::first_chunk);
                order.limit = limit.map_or(0, |limit| u32::from_le_bytes(*limit));
            }
            self.apply(order);
        }
        for (flag, zero) in [
            (RESET_TACHO, &mut self.tacho_zero),
            (RESET_BLOCK, &mut self.block_zero),
            (RESET_ROTATION, &mut self.rotation_zero),
        ] {
            if flags & flag != 0 {
                *zero = self.position;
            }
        }
    }

    /// Tacho, block and rotation count.
    fn counts(&self) -> [i32; 3] {
        [self.tacho_zero, self.block_zero, self.rotation_zero].map(|zero| (self.position - zero) as i32)
    }

    fn map(&self) -> [u8; MAP_BYTES] {
        let mut map = [0; MAP_BYTES];
        let counts = self.counts().into_iter().flat_map(i32::to_le_bytes);
        let head = counts.chain(self.command.limit.to_le_bytes());
        for (slot, byte) in map.iter_mut().zip(head) {
            *slot = byte;
        }
        map[MODE_AT] = self.command.mode;
        map[SPEED_AT] = self.command.power as u8;
        map[ACTUAL_SPEED_AT] = (self.duty * 100.0).round() as i8 as u8;
        map[RUN_STATE_AT] = self.command.run_state;
        map[REGULATION_AT] = self.command.regulation;
        map[OVERLOADED_AT] = u8::from(self.is_overloaded);
        map[TURN_RATIO_AT] = self.command.turn_ratio as u8;
        map
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUN: OutputCommand =
        OutputCommand { power: 50, mode: ON, regulation: 0, turn_ratio: 0, run_state: RUNNING, limit: 0 };

    fn outputs() -> OutputPorts {
        OutputPorts::new(&RobotSettings::default())
    }

    fn at(left: i64, right: i64) -> PerWheel<i64> {
        PerWheel { left, right }
    }

    #[test]
    fn power_is_a_duty_of_at_most_one_until_the_limit_is_reached() {
        let mut outputs = outputs();
        outputs.step(at(1_000, 0));
        outputs.command(1, OutputCommand { limit: 90, ..RUN }).unwrap();
        outputs.command(2, OutputCommand { power: -120, ..RUN }).unwrap();
        assert_eq!(outputs.step(at(1_089, 0)), PerWheel { left: 0.5, right: -1.0 });
        assert_eq!(outputs.step(at(1_090, 0)), PerWheel { left: 0.0, right: -1.0 });
    }

    #[test]
    fn each_counter_has_its_own_zero() {
        let mut outputs = outputs();
        outputs.step(at(10, 0));
        outputs.zero(1, TachoCounter::Block).unwrap();
        outputs.step(at(14, 0));
        outputs.zero(1, TachoCounter::Rotation).unwrap();
        outputs.step(at(20, 0));
        assert_eq!(outputs.ports[1].counts(), [20, 10, 6]);
        outputs.reset();
        assert_eq!(outputs.ports[1].counts(), [0, 0, 0]);
    }

    #[test]
    fn what_is_written_into_the_module_waits_for_its_flag() {
        let mut outputs = outputs();
        // Port C: mode on, speed 30, then run state, each in a telegram of its own.
        outputs.write(64 + MODE_AT, &[ON, 30]);
        outputs.write(64 + RUN_STATE_AT, &[RUNNING]);
        assert_eq!(outputs.step(at(0, 0)).right, 0.0);
        outputs.write(64 + FLAGS_AT, &[UPDATE_MODE | UPDATE_SPEED]);
        assert_eq!(outputs.step(at(0, 7)).right, 0.3);
        assert_eq!(outputs.map()[64..68], [7, 0, 0, 0]);
        outputs.write(64 + FLAGS_AT, &[RESET_TACHO]);
        assert_eq!(outputs.map()[64..72], [0, 0, 0, 0, 7, 0, 0, 0]);
    }

    #[test]
    fn in_step_a_turn_ratio_slows_the_motor_inside_the_turn() {
        for (turn_ratio, expected) in [(25, [25.0, 50.0]), (-50, [50.0, 0.0])] {
            let mut outputs = outputs();
            outputs.command(0xFF, OutputCommand { mode: ON | REGULATED, regulation: SYNC, turn_ratio, ..RUN }).unwrap();
            assert_eq!([LEFT, RIGHT].map(|index| outputs.ports[index].regulated_percent(index)), expected);
        }
    }
}
