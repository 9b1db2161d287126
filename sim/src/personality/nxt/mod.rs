//! The firmware of an unmodified LEGO NXT: it answers telegrams, and lets a program run.
//!
//! It has the sensor ports, three motors, the mailboxes, the IO maps and a radio that turns around slowly. Everything that a program or a
//! station can see of the world goes through them. It is written from the protocol's documents, never from a station's codec.
//!
//! ```text
//! a pass of 1 ms    buses and ports settle > one telegram is followed > the program runs > motors > the program pushes > the radio sends
//! ```
//! # Sources
//! LEGO Bluetooth developer kit; the published firmware. docs/simulator.md describes what is ours.

mod devices;
mod direct;
mod inputs;
mod io_map;
mod low_speed;
mod mailboxes;
mod outputs;
mod status;
mod system;
mod telegram;
mod wire;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, BrickClock, Pose, TimeDelta, Timestamp};

use self::devices::DeviceInputs;
use self::inputs::InputPorts;
use self::low_speed::LowSpeedBus;
use self::mailboxes::Mailboxes;
use self::outputs::OutputPorts;
use self::telegram::{CommandFamily, TelegramRequest, reply_telegram};
use self::wire::NxtWire;
use super::estimate::{NXT_INBOX, estimate_from};
use super::firmware_pass::FirmwarePass;
use crate::firmware::BrickMessenger;
use crate::scenario::{BrickProgram, Personality, Scenario};
use crate::wheels::PerWheel;

/// The brick falls asleep after this time without a key or a keep-alive, unless a program runs. The factory's setting.
const SLEEP_TIMEOUT: TimeDelta = TimeDelta::from_millis(600_000);
/// The temperature of a room whose thermometer is not simulated, in degrees Celsius.
const AMBIENT_C: f64 = 21.0;
/// Frames that a pushing program holds back while the radio is busy; the oldest are given up.
const PUSH_QUEUE_CAPACITY: usize = 8;

/// An NXT.
#[derive(Debug)]
pub(super) struct Nxt {
    wire: NxtWire,
    inputs: InputPorts,
    outputs: OutputPorts,
    low_speed: LowSpeedBus,
    mailboxes: Mailboxes,
    /// The name of the program that runs.
    program: Option<Vec<u8>>,
    /// The program's unrequested output, if there is any.
    messenger: Option<BrickMessenger>,
    push_queue: VecDeque<Vec<u8>>,
    name: Vec<u8>,
    awake_since: TimeDelta,
    is_asleep: bool,
    scenario_program: BrickProgram,
    /// It has received something, or it is one that sends first: its program may drive.
    is_addressed: bool,
    outgoing: VecDeque<Vec<u8>>,
    estimates: Vec<(Timestamp<BrickClock>, Pose<Arena>)>,
}

/// The file name of the program that drives the path.
const PATH_PROGRAM: &[u8] = b"path.rxe";
/// The name that comes from the factory.
const FACTORY_NAME: &[u8] = b"NXT";

impl Nxt {
    /// A brick that is switched on at `now`.
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
            outgoing: VecDeque::new(),
            estimates: Vec::new(),
        };
        nxt.autostart();
        nxt
    }

    /// One pass; returns the duty of both motors.
    pub(super) fn step(&mut self, moment: &mut FirmwarePass<'_>) -> PerWheel<f64> {
        if self.program.is_some() {
            self.awake_since = moment.sim_time;
        }
        self.is_asleep |= moment.sim_time - self.awake_since >= SLEEP_TIMEOUT;
        if self.is_asleep {
            moment.program.observe_odometry(moment.now, moment.counts());
            return PerWheel::default();
        }
        self.inputs.step(moment.senses);
        self.low_speed.step(DeviceInputs {
            senses: moment.senses,
            temperature_c: moment.board.read_temperature().unwrap_or(AMBIENT_C),
        });
        if let Some(telegram) = self.wire.next_telegram() {
            self.execute(&telegram, moment);
        }
        self.run(moment);
        let duty = self.outputs.step(moment.counts());
        self.push(moment);
        self.outgoing.extend(self.wire.step(moment.sim_time));
        duty
    }

    /// Takes bytes that arrive from the station.
    pub(super) fn receive(&mut self, world: TimeDelta, bytes: &[u8]) {
        if !self.is_asleep {
            self.wire.receive(world, bytes);
        }
    }

    /// The link has a new peer.
    pub(super) fn reopen(&mut self) {
        self.wire.reopen();
    }

    /// Switched off and on: as from the beginning, but for its name and its gyro.
    pub(super) fn restart(&mut self, moment: &mut FirmwarePass<'_>) {
        self.wire.reopen();
        self.is_asleep = false;
        self.awake_since = moment.sim_time;
        self.outputs.step(moment.counts());
        self.forget();
        if let Some(talk) = &mut self.messenger {
            talk.restart(moment.now, moment.counts());
        }
        self.autostart();
    }

    /// The next telegram on its way to the station.
    pub(super) fn next_bytes(&mut self) -> Option<Vec<u8>> {
        self.outgoing.pop_front()
    }

    /// The estimates that the program took out of its mailbox: instant and pose.
    pub(super) fn take_estimates(&mut self) -> Vec<(Timestamp<BrickClock>, Pose<Arena>)> {
        std::mem::take(&mut self.estimates)
    }

    fn autostart(&mut self) {
        self.program = (self.scenario_program == BrickProgram::Path).then(|| PATH_PROGRAM.to_vec());
    }

    fn execute(&mut self, telegram: &[u8], moment: &mut FirmwarePass<'_>) {
        let Some(request) = TelegramRequest::parse(telegram) else {
            return;
        };
        self.is_addressed = true;
        let answer = match request.family {
            CommandFamily::Direct => self.direct(request, moment),
            CommandFamily::System => self.system(request, moment),
        };
        if request.is_answered {
            self.wire.send(&reply_telegram(request.opcode, &answer));
        }
    }

    /// Lets the program run, which looks into its mailbox first.
    fn run(&mut self, moment: &mut FirmwarePass<'_>) {
        // A program that is polled from outside waits for the first poll, which must see the robot at rest.
        if self.program.is_none() || !self.is_addressed {
            moment.program.observe_odometry(moment.now, moment.counts());
            return;
        }
        while let Some(message) = self.mailboxes.pop(NXT_INBOX) {
            if let Some((stamp, pose)) = estimate_from(&message) {
                let instant = moment.program.apply_estimate(moment.now, stamp, pose);
                self.estimates.push((instant, pose));
            }
        }
        let duty = moment.program.step(moment.now, moment.counts());
        self.outputs.drive(duty);
    }

    /// Lets the program say what it has to say. It waits until the last frame is sent, so that the firmware has a buffer for its answers.
    fn push(&mut self, moment: &mut FirmwarePass<'_>) {
        let Some(talk) = self.messenger.as_mut().filter(|_| self.program.is_some()) else {
            return;
        };
        talk.step(moment.now, moment.board);
        self.push_queue.extend(talk.take_frames());
        while self.push_queue.len() > PUSH_QUEUE_CAPACITY {
            self.push_queue.pop_front();
        }
        if self.wire.is_idle()
            && let Some(frame) = self.push_queue.pop_front()
        {
            self.wire.send(&frame);
        }
    }

    /// A program begins: all ports, counters and mailboxes begin anew.
    fn start(&mut self, name: &[u8], moment: &mut FirmwarePass<'_>) {
        self.outputs.step(moment.counts());
        self.forget();
        self.program = Some(name.to_vec());
        moment.program.begin(moment.now, moment.counts());
        if let Some(talk) = &mut self.messenger {
            talk.restart(moment.now, moment.counts());
        }
    }

    /// Stops the program and starts it again.
    pub(super) fn restart_program(&mut self, moment: &mut FirmwarePass<'_>) {
        if let Some(name) = self.program.clone() {
            self.start(&name, moment);
        }
    }

    /// The program ends, and with it everything that it has set up.
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
