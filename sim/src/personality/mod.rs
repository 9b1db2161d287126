//! The protocol of a simulated brick: MAVLink, or what LEGO's bricks speak as they come out of the box.
//!
//! A [`Brick`] is the program that drives and the [`BrickEmulation`] around it. The voices of the LEGO bricks are emulations of
//! their firmware, which also decides whether the program runs at all, and what the motors do when it does not. They are written
//! from the makers' documents and know nothing of the station's codecs: a codec must not be tested against itself.

mod estimate;
mod ev3;
mod firmware_pass;
mod nxt;
mod plugged_sensors;
mod radio;

use posebridge_protocol::message::Message;
use posebridge_telemetry::{Address, Arena, BrickClock, Pose, TimeDelta, Timestamp};

use self::ev3::Ev3;
use self::firmware_pass::FirmwarePass;
use self::nxt::Nxt;
use self::plugged_sensors::PluggedSensors;
use crate::firmware::{BrickMessenger, Program};
use crate::path::Path;
use crate::robot_body::RobotBody;
use crate::scenario::{Personality, Scenario, Steering};
use crate::sensors::SensorBoard;
use crate::wheels::PerWheel;

pub use self::ev3::beacon as ev3_beacon;

/// The protocol of a brick.
#[derive(Debug)]
enum BrickEmulation {
    Mavlink(Box<BrickMessenger>),
    Nxt(Box<Nxt>),
    Ev3(Box<Ev3>),
}

/// A brick: its program and what surrounds it.
#[derive(Debug)]
pub(crate) struct Brick {
    program: Program,
    senses: PluggedSensors,
    emulation: BrickEmulation,
    /// What the motors run on.
    duty: PerWheel<f64>,
    /// How often the program is stopped and started, and when next, by the world's time.
    program_restarts: Option<(TimeDelta, TimeDelta)>,
}

/// When something happens to a brick: by the world's time, and by its own clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BrickTime {
    /// Time since the beginning of the world.
    pub(crate) sim_time: TimeDelta,
    /// The brick's clock.
    pub(crate) now: Timestamp<BrickClock>,
}

impl Brick {
    /// A brick that is switched on at `now` with the robot at the beginning of `path`.
    pub(crate) fn new(scenario: &Scenario, path: Path, now: Timestamp<BrickClock>) -> Self {
        let emulation = match scenario.brick.personality {
            Personality::Mavlink => BrickEmulation::Mavlink(Box::new(BrickMessenger::new(scenario, now))),
            Personality::Nxt | Personality::NxtPush => BrickEmulation::Nxt(Box::new(Nxt::new(scenario, now))),
            Personality::Ev3 => BrickEmulation::Ev3(Box::new(Ev3::new(scenario))),
        };
        Self {
            program: Program::new(scenario, path, now),
            senses: PluggedSensors::new(scenario),
            emulation,
            duty: PerWheel::default(),
            program_restarts: scenario.brick.program_restart_s.map(|period_s| {
                let period = TimeDelta::from_secs_f64(period_s);
                (period, period)
            }),
        }
    }

    /// One pass; returns the duty of both motors.
    pub(crate) fn step(&mut self, when: BrickTime, board: &mut SensorBoard, body: &RobotBody) -> PerWheel<f64> {
        if let BrickEmulation::Mavlink(talk) = &mut self.emulation {
            self.duty = self.program.step(when.now, board.counts());
            talk.step(when.now, board);
            return self.duty;
        }
        self.senses.step(body, 0.5 * (self.duty.left + self.duty.right));
        let mut moment = FirmwarePass {
            sim_time: when.sim_time,
            now: when.now,
            board,
            senses: &self.senses,
            battery_v: body.battery_v(),
            program: &mut self.program,
        };
        let is_restarted = program_restarts(&mut self.program_restarts, when.sim_time);
        self.duty = match &mut self.emulation {
            BrickEmulation::Mavlink(_) => self.duty,
            BrickEmulation::Nxt(nxt) => {
                if is_restarted {
                    nxt.restart_program(&mut moment);
                }
                nxt.step(&mut moment)
            }
            BrickEmulation::Ev3(ev3) => {
                if is_restarted {
                    ev3.restart_program(&mut moment);
                }
                ev3.step(&mut moment)
            }
        };
        self.duty
    }

    /// Handles a MAVLink message, where the brick speaks MAVLink. Returns the instant and the pose of a usable estimate.
    pub(crate) fn handle(
        &mut self,
        now: Timestamp<BrickClock>,
        from: Address,
        message: &Message,
    ) -> Option<(Timestamp<BrickClock>, Pose<Arena>)> {
        let BrickEmulation::Mavlink(talk) = &mut self.emulation else {
            return None;
        };
        let (stamp, pose) = talk.handle(now, from, message)?;
        Some((self.program.apply_estimate(now, stamp, pose), pose))
    }

    /// Takes bytes, where no MAVLink is spoken.
    pub(crate) fn receive(&mut self, world: TimeDelta, bytes: &[u8]) {
        match &mut self.emulation {
            BrickEmulation::Mavlink(_) => {}
            BrickEmulation::Nxt(nxt) => nxt.receive(world, bytes),
            BrickEmulation::Ev3(ev3) => ev3.receive(world, bytes),
        }
    }

    /// The link has a new peer.
    pub(crate) fn reopen(&mut self) {
        match &mut self.emulation {
            BrickEmulation::Mavlink(_) => {}
            BrickEmulation::Nxt(nxt) => nxt.reopen(),
            BrickEmulation::Ev3(ev3) => ev3.reopen(),
        }
    }

    /// Switched off and on, the sensors with it.
    pub(crate) fn restart(&mut self, when: BrickTime, board: &mut SensorBoard, battery_v: f64) {
        self.duty = PerWheel::default();
        self.senses.restart();
        self.program.restart(when.now);
        let mut moment = FirmwarePass {
            sim_time: when.sim_time,
            now: when.now,
            board,
            senses: &self.senses,
            battery_v,
            program: &mut self.program,
        };
        match &mut self.emulation {
            BrickEmulation::Mavlink(talk) => talk.restart(when.now, PerWheel::default()),
            BrickEmulation::Nxt(nxt) => nxt.restart(&mut moment),
            BrickEmulation::Ev3(ev3) => ev3.restart(&mut moment),
        }
    }

    /// The bytes that go to the station next: whole frames, or one telegram.
    pub(crate) fn next_bytes(&mut self) -> Option<Vec<u8>> {
        match &mut self.emulation {
            BrickEmulation::Mavlink(talk) => talk.next_bytes(),
            BrickEmulation::Nxt(nxt) => nxt.next_bytes(),
            BrickEmulation::Ev3(ev3) => ev3.next_bytes(),
        }
    }

    /// The estimates that the program took since it was asked last, where no MAVLink is spoken.
    pub(crate) fn take_estimates(&mut self) -> Vec<(Timestamp<BrickClock>, Pose<Arena>)> {
        match &mut self.emulation {
            BrickEmulation::Mavlink(_) => Vec::new(),
            BrickEmulation::Nxt(nxt) => nxt.take_estimates(),
            BrickEmulation::Ev3(ev3) => ev3.take_estimates(),
        }
    }

    /// The program, to change what it does.
    pub(crate) const fn program_mut(&mut self) -> &mut Program {
        &mut self.program
    }

    /// The gyro that is plugged in shows so much more from here on.
    pub(crate) fn step_gyro_bias(&mut self, rad_per_s: f64) {
        self.senses.step_gyro_bias(rad_per_s);
    }

    /// The pose by dead reckoning alone, if it began at `start`.
    pub(crate) fn odometry(&self, start: Pose<Arena>) -> Pose<Arena> {
        self.program.odometry(start)
    }

    /// The program's own estimate of the pose.
    pub(crate) fn estimated_pose(&self) -> Pose<Arena> {
        self.program.estimated_pose()
    }

    /// What the program steers by at this moment.
    pub(crate) fn steering(&self, now: Timestamp<BrickClock>) -> Steering {
        self.program.steering(now)
    }

    /// How much of the path is driven, 0 to 1.
    pub(crate) fn progress(&self) -> f64 {
        self.program.progress()
    }

    /// Whether the program is at its end.
    pub(crate) fn is_finished(&self) -> bool {
        self.program.is_finished()
    }

    /// How often the path was driven to its end.
    pub(crate) fn laps_done(&self) -> u64 {
        self.program.laps_done()
    }
}

/// Whether the program begins anew now; then also the next time is set.
fn program_restarts(restarts: &mut Option<(TimeDelta, TimeDelta)>, world: TimeDelta) -> bool {
    let Some((period, next)) = restarts else {
        return false;
    };
    let is_due = world >= *next;
    if is_due {
        *next += *period;
    }
    is_due
}
