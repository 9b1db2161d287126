//! The protocol of a simulated brick: MAVLink, the native protocols of LEGO bricks, or lines of text.
//!
//! A [`Brick`] is the driving program and the [`BrickEmulation`] around it. The LEGO bricks are emulations of their firmware, which
//! also decides whether the program runs at all, and what the motors do when it does not. They follow the makers' documents and share
//! no code with the station's codecs: a codec must not be tested against itself.

mod ev3;
mod lego;
mod nxt;
mod plugged_sensors;
mod text_board;

use std::collections::VecDeque;

use posebridge_protocol::message::Message;
use posebridge_telemetry::{Address, Arena, BrickClock, Pose, TimeDelta, Timestamp};

use self::ev3::Ev3;
use self::lego::{FirmwarePass, LegoFirmware};
use self::nxt::Nxt;
use self::plugged_sensors::PluggedSensors;
use self::text_board::TextBoard;
use crate::firmware::{BrickMessenger, Program};
use crate::path::Path;
use crate::robot_body::RobotBody;
use crate::scenario::{Personality, Scenario};
use crate::sensors::SensorBoard;
use crate::wheels::PerWheel;

pub use self::ev3::beacon as ev3_beacon;

#[derive(Debug)]
enum BrickEmulation {
    Mavlink(Box<BrickMessenger>),
    Lego(Box<dyn LegoFirmware>),
    Text(TextBoard),
}

#[derive(Debug)]
pub(crate) struct Brick {
    pub(crate) program: Program,
    senses: PluggedSensors,
    emulation: BrickEmulation,
    duty: PerWheel<f64>,
    /// Interval between program restarts of a LEGO brick, and the world time of the next.
    program_restarts: Option<(TimeDelta, TimeDelta)>,
    outgoing: VecDeque<Vec<u8>>,
    /// Estimates that the program of a LEGO brick took, until somebody takes them: instant and pose.
    pub(crate) estimates: Vec<(Timestamp<BrickClock>, Pose<Arena>)>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct BrickTime {
    pub(crate) sim_time: TimeDelta,
    pub(crate) now: Timestamp<BrickClock>,
}

impl Brick {
    /// A brick that is switched on at `now` with the robot at the start of `path`.
    pub(crate) fn new(scenario: &Scenario, path: Path, now: Timestamp<BrickClock>) -> Self {
        let restart_interval = scenario.brick.program_restart_s.map(TimeDelta::from_secs_f64);
        Self {
            program: Program::new(scenario, path, now),
            senses: PluggedSensors::new(scenario),
            emulation: match scenario.brick.personality {
                Personality::Mavlink => BrickEmulation::Mavlink(Box::new(BrickMessenger::new(scenario, now))),
                Personality::Nxt | Personality::NxtPush => BrickEmulation::Lego(Box::new(Nxt::new(scenario, now))),
                Personality::Ev3 => BrickEmulation::Lego(Box::new(Ev3::new(scenario))),
                Personality::Line => BrickEmulation::Text(TextBoard::new(scenario, now)),
            },
            duty: PerWheel::default(),
            program_restarts: restart_interval.map(|interval| (interval, interval)),
            outgoing: VecDeque::new(),
            estimates: Vec::new(),
        }
    }

    pub(crate) fn step(&mut self, when: BrickTime, board: &mut SensorBoard, body: &RobotBody) -> PerWheel<f64> {
        match &mut self.emulation {
            BrickEmulation::Mavlink(messenger) => {
                self.duty = self.program.step(when.now, board.counts());
                messenger.step(when.now, board, body.battery_v);
            }
            BrickEmulation::Text(printer) => {
                self.duty = self.program.step(when.now, board.counts());
                printer.step(when.now, board, &mut self.outgoing);
            }
            BrickEmulation::Lego(firmware) => {
                self.senses.step(body, 0.5 * (self.duty.left + self.duty.right));
                let mut pass = FirmwarePass {
                    sim_time: when.sim_time,
                    now: when.now,
                    board,
                    senses: &self.senses,
                    battery_v: body.battery_v,
                    program: &mut self.program,
                    outgoing: &mut self.outgoing,
                    estimates: &mut self.estimates,
                };
                if let Some((interval, next)) = &mut self.program_restarts
                    && when.sim_time >= *next
                {
                    *next += *interval;
                    firmware.restart_program(&mut pass);
                }
                self.duty = firmware.step(&mut pass);
            }
        }
        self.duty
    }

    /// Handles a MAVLink message, on a MAVLink brick. Returns the instant and the pose of a usable estimate.
    pub(crate) fn handle(
        &mut self,
        now: Timestamp<BrickClock>,
        from: Address,
        message: &Message,
    ) -> Option<(Timestamp<BrickClock>, Pose<Arena>)> {
        let BrickEmulation::Mavlink(messenger) = &mut self.emulation else {
            return None;
        };
        self.program.steer(now, messenger.address(), message);
        let (stamp, pose) = messenger.handle(now, from, message)?;
        Some((self.program.apply_estimate(now, stamp, pose), pose))
    }

    /// Number of estimates that were dropped because their station no longer owns the robot.
    pub(crate) const fn outdated_estimates(&self) -> u64 {
        match &self.emulation {
            BrickEmulation::Mavlink(messenger) => messenger.outdated_estimates,
            BrickEmulation::Lego(_) | BrickEmulation::Text(_) => 0,
        }
    }

    pub(crate) fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        if let BrickEmulation::Lego(firmware) = &mut self.emulation {
            firmware.receive(now, bytes);
        }
    }

    pub(crate) fn reopen(&mut self) {
        if let BrickEmulation::Lego(firmware) = &mut self.emulation {
            firmware.reopen();
        }
    }

    pub(crate) fn restart(&mut self, when: BrickTime, board: &mut SensorBoard, battery_v: f64) {
        self.duty = PerWheel::default();
        self.senses.restart();
        self.program.restart(when.now);
        match &mut self.emulation {
            BrickEmulation::Mavlink(messenger) => messenger.restart(when.now, PerWheel::default()),
            BrickEmulation::Text(printer) => printer.restart(when.now),
            BrickEmulation::Lego(firmware) => firmware.restart(&mut FirmwarePass {
                sim_time: when.sim_time,
                now: when.now,
                board,
                senses: &self.senses,
                battery_v,
                program: &mut self.program,
                outgoing: &mut self.outgoing,
                estimates: &mut self.estimates,
            }),
        }
    }

    /// The next bytes for the station: whole frames, or one telegram.
    pub(crate) fn next_bytes(&mut self) -> Option<Vec<u8>> {
        match &mut self.emulation {
            BrickEmulation::Mavlink(messenger) => messenger.node.next_bytes(),
            BrickEmulation::Lego(_) | BrickEmulation::Text(_) => self.outgoing.pop_front(),
        }
    }

    pub(crate) fn step_gyro_bias(&mut self, rad_per_s: f64) {
        self.senses.gyro.gyro.step_bias(rad_per_s);
    }
}
