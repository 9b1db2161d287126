//! A robot that a person moves, as `posebridge init --guide` asks: one wheel is turned, the robot is rolled straight on, then turned on
//! the spot, with rests between. The hand knows the true wheels and errs a little; the motors do nothing.

use std::f64::consts::{PI, TAU};

use crate::clock::STEP_S;
use crate::random::RandomStream;
use crate::scenario::{DriveSettings, HandMotions};
use crate::wheels::PerWheel;

/// How far a hand misses a mark, one standard deviation: a chalk mark on a tyre, a line on the floor, an edge of a tile.
const WHEEL_ERROR_RAD: f64 = 0.02;
const STRAIGHT_ERROR_M: f64 = 0.002;
const TURN_ERROR_RAD: f64 = 0.02;

/// Whether the wheels move the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FloorContact {
    Rolling,
    Lifted,
}

#[derive(Clone, Copy, Debug)]
struct HandMotion {
    steps: u32,
    /// Rotation of the wheels in one step.
    rad_per_step: PerWheel<f64>,
    contact: FloorContact,
}

#[derive(Clone, Debug)]
pub(crate) struct HandMover {
    motions: Vec<HandMotion>,
    next: usize,
    steps_done: u32,
}

impl HandMover {
    pub(crate) fn new(
        seed: u64,
        asked: HandMotions,
        drive: &DriveSettings,
        radius_m: PerWheel<f64>,
        track_m: f64,
    ) -> Self {
        let mut errors = RandomStream::new(seed, "hand");
        let wheel_rad = TAU * asked.wheel_turns + WHEEL_ERROR_RAD * errors.normal();
        let straight_m = asked.straight_m + STRAIGHT_ERROR_M * errors.normal();
        let arc_m = 0.5 * track_m * (TAU * asked.turns + TURN_ERROR_RAD * errors.normal());
        let rest = |rest_s: f64| motion(rest_s, PerWheel::default(), FloorContact::Rolling);
        let turn_s = TAU * asked.turns / drive.turn_rate_rad_per_s;
        let roll = |duration_s: f64, left_m: f64, right_m: f64| {
            let rotation = PerWheel { left: left_m, right: right_m }.zip(radius_m).map(|(travel, r)| travel / r);
            motion(duration_s, rotation, FloorContact::Rolling)
        };
        let lifted_wheel = PerWheel { left: wheel_rad, right: 0.0 };
        let motions = vec![
            rest(drive.rest_s),
            motion(wheel_rad / PI, lifted_wheel, FloorContact::Lifted),
            rest(drive.pause_s),
            roll(asked.straight_m / drive.speed_m_per_s, straight_m, straight_m),
            rest(drive.pause_s),
            roll(turn_s, -arc_m, arc_m),
            rest(drive.pause_s),
        ];
        Self { motions, next: 0, steps_done: 0 }
    }

    /// The rotation of the wheels in the next step.
    pub(crate) fn step(&mut self) -> (PerWheel<f64>, FloorContact) {
        let Some(motion) = self.motions.get(self.next).copied() else {
            return (PerWheel::default(), FloorContact::Rolling);
        };
        self.steps_done += 1;
        if self.steps_done >= motion.steps {
            self.steps_done = 0;
            self.next += 1;
        }
        (motion.rad_per_step, motion.contact)
    }

    pub(crate) const fn is_finished(&self) -> bool {
        self.next >= self.motions.len()
    }
}

fn motion(duration_s: f64, rotation_rad: PerWheel<f64>, contact: FloorContact) -> HandMotion {
    let steps = (duration_s / STEP_S).ceil().max(1.0);
    HandMotion { steps: steps as u32, rad_per_step: rotation_rad.map(|angle| angle / steps), contact }
}
