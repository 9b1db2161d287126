//! What a simulated brick speaks: MAVLink, or what LEGO's bricks speak as they come out of the box.
//!
//! A [`Brick`] is the program that drives and the [`Voice`] around it. The voices of the LEGO bricks are emulations of their firmware, which
//! also decides whether the program runs at all, and what the motors do when it does not. They are written from the makers' documents and
//! know nothing of the station's codecs: nobody marks their own exam.

mod estimate;
mod ev3;
mod nxt;
mod radio;
mod senses;

use posebridge_protocol::message::Message;
use posebridge_telemetry::{Address, Arena, BrickClock, Pose, Span, Stamp};

use self::ev3::Ev3;
use self::nxt::Nxt;
use self::senses::Senses;
use crate::firmware::{Program, Talk};
use crate::path::Path;
use crate::scenario::{Personality, Scenario, Steering};
use crate::sensors::SensorBoard;
use crate::wheels::Pair;
use crate::world::Body;

pub use self::ev3::beacon as ev3_beacon;

/// How a brick speaks.
#[derive(Debug)]
enum Voice {
    Mavlink(Box<Talk>),
    Nxt(Box<Nxt>),
    Ev3(Box<Ev3>),
}

/// A brick: its program and what surrounds it.
#[derive(Debug)]
pub(crate) struct Brick {
    program: Program,
    senses: Senses,
    voice: Voice,
    /// What the motors run on.
    duty: Pair<f64>,
    /// How often the program is stopped and started, and when next, by the world's time.
    program_restarts: Option<(Span, Span)>,
}

/// One pass of a brick's firmware, and everything that it can reach then.
struct Moment<'a> {
    /// Time since the beginning of the world, as a part on the board would count it.
    world: Span,
    /// The brick's clock.
    now: Stamp<BrickClock>,
    board: &'a mut SensorBoard,
    senses: &'a Senses,
    battery_v: f64,
    program: &'a mut Program,
}

impl Moment<'_> {
    /// What the encoders have counted since power-up.
    fn counts(&self) -> Pair<i64> {
        self.board.counts()
    }

    /// The brick's clock in its register of milliseconds.
    const fn tick_ms(&self) -> u32 {
        (self.now.as_micros() / 1_000) as u32
    }
}

/// When something happens to a brick: by the world's time, and by its own clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct When {
    /// Time since the beginning of the world.
    pub(crate) world: Span,
    /// The brick's clock.
    pub(crate) now: Stamp<BrickClock>,
}

impl Brick {
    /// A brick that is switched on at `now` with the robot at the beginning of `path`.
    pub(crate) fn new(scenario: &Scenario, path: Path, now: Stamp<BrickClock>) -> Self {
        let voice = match scenario.brick.personality {
            Personality::Mavlink => Voice::Mavlink(Box::new(Talk::new(scenario, now))),
            Personality::Nxt | Personality::NxtPush => Voice::Nxt(Box::new(Nxt::new(scenario, now))),
            Personality::Ev3 => Voice::Ev3(Box::new(Ev3::new(scenario))),
        };
        Self {
            program: Program::new(scenario, path, now),
            senses: Senses::new(scenario),
            voice,
            duty: Pair::default(),
            program_restarts: scenario.brick.program_restart_s.map(|period_s| {
                let period = Span::from_secs_f64(period_s);
                (period, period)
            }),
        }
    }

    /// One pass; returns the duty of both motors.
    pub(crate) fn step(&mut self, when: When, board: &mut SensorBoard, body: &Body) -> Pair<f64> {
        if let Voice::Mavlink(talk) = &mut self.voice {
            self.duty = self.program.step(when.now, board.counts());
            talk.step(when.now, board);
            return self.duty;
        }
        self.senses.step(body, 0.5 * (self.duty.left + self.duty.right));
        let mut moment = Moment {
            world: when.world,
            now: when.now,
            board,
            senses: &self.senses,
            battery_v: body.battery_v(),
            program: &mut self.program,
        };
        let is_restarted = program_restarts(&mut self.program_restarts, when.world);
        self.duty = match &mut self.voice {
            Voice::Mavlink(_) => self.duty,
            Voice::Nxt(nxt) => {
                if is_restarted {
                    nxt.restart_program(&mut moment);
                }
                nxt.step(&mut moment)
            }
            Voice::Ev3(ev3) => {
                if is_restarted {
                    ev3.restart_program(&mut moment);
                }
                ev3.step(&mut moment)
            }
        };
        self.duty
    }

    /// Takes a MAVLink message, where that is spoken. If it is a usable estimate, returns the instant and the pose of which it speaks.
    pub(crate) fn handle(
        &mut self,
        now: Stamp<BrickClock>,
        from: Address,
        message: &Message,
    ) -> Option<(Stamp<BrickClock>, Pose<Arena>)> {
        let Voice::Mavlink(talk) = &mut self.voice else {
            return None;
        };
        let (stamp, pose) = talk.handle(now, from, message)?;
        Some((self.program.take_estimate(now, stamp, pose), pose))
    }

    /// Takes bytes, where no MAVLink is spoken.
    pub(crate) fn receive(&mut self, world: Span, bytes: &[u8]) {
        match &mut self.voice {
            Voice::Mavlink(_) => {}
            Voice::Nxt(nxt) => nxt.receive(world, bytes),
            Voice::Ev3(ev3) => ev3.receive(world, bytes),
        }
    }

    /// Somebody else is at the other end of the link.
    pub(crate) fn reopen(&mut self) {
        match &mut self.voice {
            Voice::Mavlink(_) => {}
            Voice::Nxt(nxt) => nxt.reopen(),
            Voice::Ev3(ev3) => ev3.reopen(),
        }
    }

    /// Switched off and on, the sensors with it.
    pub(crate) fn restart(&mut self, when: When, board: &mut SensorBoard, battery_v: f64) {
        self.duty = Pair::default();
        self.senses.restart();
        self.program.restart(when.now);
        let mut moment = Moment {
            world: when.world,
            now: when.now,
            board,
            senses: &self.senses,
            battery_v,
            program: &mut self.program,
        };
        match &mut self.voice {
            Voice::Mavlink(talk) => talk.restart(when.now, Pair::default()),
            Voice::Nxt(nxt) => nxt.restart(&mut moment),
            Voice::Ev3(ev3) => ev3.restart(&mut moment),
        }
    }

    /// The bytes that go to the station next: whole frames, or one telegram.
    pub(crate) fn take(&mut self) -> Option<Vec<u8>> {
        match &mut self.voice {
            Voice::Mavlink(talk) => talk.take(),
            Voice::Nxt(nxt) => nxt.take(),
            Voice::Ev3(ev3) => ev3.take(),
        }
    }

    /// The estimates that the program took since it was asked last, where no MAVLink is spoken.
    pub(crate) fn take_estimates(&mut self) -> Vec<(Stamp<BrickClock>, Pose<Arena>)> {
        match &mut self.voice {
            Voice::Mavlink(_) => Vec::new(),
            Voice::Nxt(nxt) => nxt.take_estimates(),
            Voice::Ev3(ev3) => ev3.take_estimates(),
        }
    }

    /// The program, for who changes what it does.
    pub(crate) const fn program_mut(&mut self) -> &mut Program {
        &mut self.program
    }

    /// The gyro that is plugged in shows so much more from here on.
    pub(crate) fn step_gyro_bias(&mut self, rad_per_s: f64) {
        self.senses.step_gyro_bias(rad_per_s);
    }

    /// Where dead reckoning alone believes to be, if it began at `start`.
    pub(crate) fn odometry(&self, start: Pose<Arena>) -> Pose<Arena> {
        self.program.odometry(start)
    }

    /// Where the program believes the robot to be.
    pub(crate) fn belief(&self) -> Pose<Arena> {
        self.program.belief()
    }

    /// What the program steers by at this moment.
    pub(crate) fn steering(&self, now: Stamp<BrickClock>) -> Steering {
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
fn program_restarts(restarts: &mut Option<(Span, Span)>, world: Span) -> bool {
    let Some((period, next)) = restarts else {
        return false;
    };
    let is_due = world >= *next;
    if is_due {
        *next += *period;
    }
    is_due
}
