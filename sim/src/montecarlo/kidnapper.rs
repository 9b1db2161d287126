//! Carries the robot to another pose, or moves it there at once.

use super::disturbances::Kidnaps;
use super::plan::{StepCommand, first_step_from};
use super::robot::{Robot, RobotMotion};
use super::scenario::Scenario;
use super::schedule::starts;
use crate::random::RandomStream;

pub(super) struct Kidnapper {
    moves: Vec<PlannedMove>,
    /// 0 for a robot that is moved at once.
    carry_steps: usize,
}

/// In the step `first`, or in equal parts from there on.
struct PlannedMove {
    first: usize,
    shift_m: (f64, f64),
    turn_rad: f64,
}

impl Kidnapper {
    pub(super) fn new(kidnaps: &Kidnaps, scenario: &Scenario, seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "kidnaps");
        let firsts = starts(kidnaps.first_s, kidnaps.every_s, scenario, &mut stream);
        let moves = firsts.into_iter().map(|first| {
            let distance_m = stream.uniform(kidnaps.least_m, kidnaps.most_m);
            let (sin, cos) = stream.uniform(0.0, std::f64::consts::TAU).sin_cos();
            let turn_deg = stream.sign() * stream.uniform(kidnaps.least_deg, kidnaps.most_deg);
            PlannedMove { first, shift_m: (distance_m * cos, distance_m * sin), turn_rad: turn_deg.to_radians() }
        });
        Self { moves: moves.collect(), carry_steps: first_step_from(kidnaps.carry_s, scenario.step_s) }
    }

    /// Lets the robot stand while it is carried.
    pub(super) fn pause(&self, commands: &mut Vec<StepCommand>) {
        for planned in &self.moves {
            let index = planned.first - 1;
            if index < commands.len() {
                commands.splice(index..index, std::iter::repeat_n(StepCommand::default(), self.carry_steps));
            }
        }
    }

    /// The steps of a drive after which the robot is at its new pose.
    pub(super) fn landings(&self, steps: usize) -> Vec<usize> {
        let last = |planned: &PlannedMove| planned.first + self.carry_steps.max(1) - 1;
        self.moves.iter().map(last).filter(|landing| *landing < steps).collect()
    }

    /// Moves the robot in this step. Returns what its gyro feels instead of the robot's own motion.
    pub(super) fn carry(&self, step: usize, robot: &mut Robot) -> Option<RobotMotion> {
        let steps = self.carry_steps.max(1);
        let planned = self.moves.iter().find(|planned| (planned.first..planned.first + steps).contains(&step))?;
        let part = 1.0 / steps as f64;
        let felt = robot.carry((part * planned.shift_m.0, part * planned.shift_m.1), part * planned.turn_rad);
        (self.carry_steps > 0).then_some(felt)
    }
}
