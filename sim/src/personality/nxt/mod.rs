//! The firmware of an unmodified LEGO NXT: answers telegrams and runs a program, which reach the world only through sensor ports, three
//! motors, mailboxes, IO maps and a radio with a long turn-around.
//!
//! ```text
//! a pass of 1 ms    buses and ports settle > one telegram is followed > the program runs > motors > the program pushes > the radio sends
//! ```
//! # Sources
//! LEGO Bluetooth developer kit; the published firmware. docs/simulator.md describes what is ours.

mod commands;
mod inputs;
mod low_speed;
mod outputs;
mod telegram;
mod wire;

use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

use self::inputs::InputPorts;
use self::low_speed::{DeviceInputs, LowSpeedBus};
use self::outputs::OutputPorts;
use self::telegram::{CommandFamily, TelegramRequest, reply_telegram, status};
use self::wire::NxtWire;
use super::lego::{FirmwarePass, LegoFirmware};
use crate::firmware::BrickMessenger;
use crate::scenario::{BrickProgram, Personality, Scenario};
use crate::wheels::PerWheel;

/// The brick sleeps after this time without a key press or keep-alive, unless a program runs. Factory setting.
const SLEEP_TIMEOUT: TimeDelta = TimeDelta::from_millis(600_000);
/// Without a simulated thermometer.
const AMBIENT_C: f64 = 21.0;
const ESTIMATE_INBOX: u8 = 0;
/// Frames that a pushing program queues while the radio is busy; the oldest are dropped.
const PUSH_QUEUE_CAPACITY: usize = 8;

const QUEUES: usize = 20;
/// One more drops the oldest.
const DEPTH: usize = 5;
/// With its final zero.
pub(super) const MAX_MESSAGE_BYTES: usize = 59;

#[derive(Debug)]
pub(super) struct Nxt {
    wire: NxtWire,
    inputs: InputPorts,
    outputs: OutputPorts,
    low_speed: LowSpeedBus,
    mailboxes: Mailboxes,
    program: Option<Vec<u8>>,
    /// The program's unsolicited messages.
    messenger: Option<BrickMessenger>,
    push_queue: VecDeque<Vec<u8>>,
    name: Vec<u8>,
    awake_since: TimeDelta,
    is_asleep: bool,
    scenario_program: BrickProgram,
    /// Has received something, or is a pushing brick: its program may drive.
    is_addressed: bool,
}

const PATH_PROGRAM: &[u8] = b"path.rxe";
const FACTORY_NAME: &[u8] = b"NXT";

impl Nxt {
    pub(super) fn new(scenario: &Scenario, now: Timestamp<BrickClock>) -> Self {
        let brick = &scenario.brick;
        let mut nxt = Self {
            wire: NxtWire::new(brick.telegram_bytes, brick.turn_around()),
            inputs: InputPorts::new(brick.sensors, scenario.seed),
            outputs: OutputPorts::new(&scenario.robot),
            low_speed: LowSpeedBus::default(),
            mailboxes: Mailboxes::default(),
            program: None,
            messenger: (brick.personality == Personality::NxtPush).then(|| BrickMessenger::new(scenario, now)),
            push_queue: VecDeque::new(),
            name: FACTORY_NAME.to_vec(),
            awake_since: TimeDelta::ZERO,
            is_asleep: false,
            scenario_program: brick.program,
            is_addressed: brick.personality == Personality::NxtPush,
        };
        nxt.autostart();
        nxt
    }

    fn autostart(&mut self) {
        self.program = (self.scenario_program == BrickProgram::Path).then(|| PATH_PROGRAM.to_vec());
    }

    fn execute(&mut self, telegram: &[u8], pass: &mut FirmwarePass<'_>) {
        let Some(request) = TelegramRequest::parse(telegram) else {
            return;
        };
        self.is_addressed = true;
        let answer = match request.family {
            CommandFamily::Direct => self.direct(request, pass),
            CommandFamily::System => self.system(request, pass),
        };
        if request.is_answered {
            self.wire.send(&reply_telegram(request.opcode, &answer));
        }
    }

    /// Runs the program for one pass, starting with its mailbox.
    fn run(&mut self, pass: &mut FirmwarePass<'_>) {
        // A program that is polled from outside waits for the first poll, which must see the robot at rest.
        if self.program.is_none() || !self.is_addressed {
            return pass.idle();
        }
        while let Some(message) = self.mailboxes.pop(ESTIMATE_INBOX) {
            pass.apply_mail(&message);
        }
        self.outputs.drive(pass.run_program());
    }

    /// Sends the frames of a pushing program, one at a time: the firmware reserves a buffer for its replies.
    fn push(&mut self, pass: &mut FirmwarePass<'_>) {
        let Some(messenger) = self.messenger.as_mut().filter(|_| self.program.is_some()) else {
            return;
        };
        messenger.step(pass.now, pass.board, pass.battery_v);
        self.push_queue.extend(messenger.node.take_frames());
        while self.push_queue.len() > PUSH_QUEUE_CAPACITY {
            self.push_queue.pop_front();
        }
        if self.wire.radio.is_idle()
            && let Some(frame) = self.push_queue.pop_front()
        {
            self.wire.send(&frame);
        }
    }

    /// Starts a program: all ports, counters and mailboxes are reset.
    fn start(&mut self, name: &[u8], pass: &mut FirmwarePass<'_>) {
        self.outputs.step(pass.counts());
        self.forget();
        self.program = Some(name.to_vec());
        pass.program.begin(pass.now, pass.counts());
        if let Some(messenger) = &mut self.messenger {
            messenger.restart(pass.now, pass.counts());
        }
    }

    /// Stops the program and resets everything that it configured.
    fn stop(&mut self) {
        self.forget();
        self.program = None;
    }

    fn forget(&mut self) {
        self.outputs.reset();
        self.inputs.reset();
        self.low_speed.reset();
        self.mailboxes.clear();
        self.push_queue.clear();
    }
}

impl LegoFirmware for Nxt {
    fn step(&mut self, pass: &mut FirmwarePass<'_>) -> PerWheel<f64> {
        if self.program.is_some() {
            self.awake_since = pass.sim_time;
        }
        self.is_asleep |= pass.sim_time - self.awake_since >= SLEEP_TIMEOUT;
        if self.is_asleep {
            pass.idle();
            return PerWheel::default();
        }
        self.inputs.step(pass.senses);
        self.low_speed.step(DeviceInputs {
            senses: pass.senses,
            temperature_c: pass.board.read_temperature().unwrap_or(AMBIENT_C),
        });
        if let Some(telegram) = self.wire.next_telegram() {
            self.execute(&telegram, pass);
        }
        self.run(pass);
        let duty = self.outputs.step(pass.counts());
        self.push(pass);
        pass.outgoing.extend(self.wire.radio.step(pass.sim_time));
        duty
    }

    fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        if !self.is_asleep {
            self.wire.receive(now, bytes);
        }
    }

    fn reopen(&mut self) {
        self.wire.reopen();
    }

    /// The gyro's rest value is kept.
    fn restart(&mut self, pass: &mut FirmwarePass<'_>) {
        self.wire.reopen();
        self.is_asleep = false;
        self.awake_since = pass.sim_time;
        self.outputs.step(pass.counts());
        self.forget();
        if let Some(messenger) = &mut self.messenger {
            messenger.restart(pass.now, pass.counts());
        }
        self.autostart();
    }

    fn restart_program(&mut self, pass: &mut FirmwarePass<'_>) {
        if let Some(name) = self.program.clone() {
            self.start(&name, pass);
        }
    }
}

/// The message queues between a station and the program on the brick: 0 to 9 are the program's inboxes, 10 to 19 its outboxes. A
/// message ends with a zero byte, which counts as a part of it; zeros before it are allowed.
#[derive(Clone, Debug, Default)]
pub(super) struct Mailboxes {
    queues: [VecDeque<Vec<u8>>; QUEUES],
}

impl Mailboxes {
    /// Appends a message, `size` bytes long according to its sender.
    pub(super) fn write(&mut self, queue: u8, size: u8, message: &[u8]) -> Result<(), u8> {
        let queue = self.queues.get_mut(usize::from(queue)).ok_or(status::ILLEGAL_MAILBOX)?;
        if message.len() != usize::from(size) || message.len() > MAX_MESSAGE_BYTES {
            return Err(status::ILLEGAL_SIZE);
        }
        if message.last() != Some(&0) {
            return Err(status::OUT_OF_RANGE);
        }
        if queue.len() >= DEPTH {
            queue.pop_front();
        }
        queue.push_back(message.to_vec());
        Ok(())
    }

    /// The final zero is included.
    pub(super) fn oldest(&self, queue: u8) -> Result<&[u8], u8> {
        let queue = self.queues.get(usize::from(queue)).ok_or(status::ILLEGAL_MAILBOX)?;
        queue.front().map(Vec::as_slice).ok_or(status::MAILBOX_EMPTY)
    }

    pub(super) fn pop(&mut self, queue: u8) -> Option<Vec<u8>> {
        self.queues.get_mut(usize::from(queue))?.pop_front()
    }

    pub(super) fn clear(&mut self) {
        self.queues.iter_mut().for_each(VecDeque::clear);
    }
}
