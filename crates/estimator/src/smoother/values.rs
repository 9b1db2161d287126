//! The unknowns of a batch problem: their numbers, their values, and how a solution moves them.
//!
//! # Model
//! ```text
//! T_k <- T_k Exp(xi_k)        xi = [forward, left, heading]' in the body's space
//! Exp(xi) = (V [forward, left]', heading)      V = [sin h, -(1 - cos h); 1 - cos h, sin h] / h
//! biases and constants add
//! ```
//! Headings are not wrapped: they count turns, so that differences over windows need no wrapping either.
//!
//! # Source
//! Barrau and Bonnabel (2018), Annual Review of Control, Robotics, and Autonomous Systems 1; docs/maths/pose.md section B1.

use posebridge_telemetry::{Arena, Calibration, Heading, Meters, Pose, UncertainValue};

use crate::numerics::elimination::Variable;

/// How many constants there are.
pub(super) const CONSTANTS: usize = 6;
/// Relative error of the mean wheel radius.
pub(super) const RADIUS_SCALE: usize = 0;
/// Relative difference of the wheels' radii.
pub(super) const RADIUS_DIFFERENCE: usize = 1;
/// Relative error of the track width.
pub(super) const TRACK_SCALE: usize = 2;
/// How much earlier than its stamp a fix was true, s.
pub(super) const FIX_DELAY: usize = 3;
/// Where the tag is, forward of where the fix says, m.
pub(super) const TAG_FORWARD: usize = 4;
/// Where the tag is, to the left of where the fix says, m.
pub(super) const TAG_LEFT: usize = 5;

/// The constants of a calibration, in the order of their numbers.
pub(super) fn constants_of(calibration: &Calibration) -> [UncertainValue; CONSTANTS] {
    [
        calibration.radius_scale,
        calibration.radius_difference,
        calibration.track_scale,
        calibration.fix_delay_s,
        calibration.tag_forward_m,
        calibration.tag_left_m,
    ]
}

/// Where the variables of a problem are: constants, then biases, then three per pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct VariableLayout {
    /// How many gyro biases there are.
    pub(super) biases: usize,
    /// How many poses there are.
    pub(super) poses: usize,
}

/// What a variable's number stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VariableKind {
    /// A constant.
    Constant(usize),
    /// The gyro bias over a window.
    Bias(usize),
    /// A row of xi of a pose.
    Pose(usize, usize),
}

impl VariableLayout {
    /// The number of a bias.
    pub(super) const fn bias(window: usize) -> Variable {
        CONSTANTS + window
    }

    /// The number of a row of xi of a pose: 0 forward, 1 left, 2 heading.
    pub(super) const fn pose(self, node: usize, row: usize) -> Variable {
        CONSTANTS + self.biases + 3 * node + row
    }

    /// How many variables there are.
    pub(super) const fn count(self) -> usize {
        CONSTANTS + self.biases + 3 * self.poses
    }

    /// What a number stands for.
    pub(super) const fn kind_of(self, variable: Variable) -> VariableKind {
        if variable < CONSTANTS {
            return VariableKind::Constant(variable);
        }
        let rest = variable - CONSTANTS;
        if rest < self.biases {
            return VariableKind::Bias(rest);
        }
        VariableKind::Pose((rest - self.biases) / 3, (rest - self.biases) % 3)
    }
}

/// A pose with a heading that counts turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct UnwrappedPose {
    /// x in the arena, m.
    pub(super) x_m: f64,
    /// y in the arena, m.
    pub(super) y_m: f64,
    /// Heading, not wrapped, rad.
    pub(super) heading_rad: f64,
}

impl UnwrappedPose {
    /// T Exp(xi).
    pub(super) fn retract(self, [forward, left, turn]: [f64; 3]) -> Self {
        // sin h / h and (1 - cos h) / h, by series where the quotients would lose digits.
        let (along, across) = if turn.abs() < 1e-4 {
            (1.0 - turn * turn / 6.0, 0.5 * turn)
        } else {
            (turn.sin() / turn, (1.0 - turn.cos()) / turn)
        };
        let ahead = along * forward - across * left;
        let aside = across * forward + along * left;
        let (sin, cos) = self.heading_rad.sin_cos();
        Self {
            x_m: self.x_m + cos * ahead - sin * aside,
            y_m: self.y_m + sin * ahead + cos * aside,
            heading_rad: self.heading_rad + turn,
        }
    }

    /// As the vocabulary has it, with a wrapped heading.
    pub(super) fn to_pose(self) -> Pose<Arena> {
        Pose::new(Meters(self.x_m), Meters(self.y_m), Heading::from_rad(self.heading_rad))
    }

    /// From the vocabulary's pose.
    pub(super) fn from_pose(pose: Pose<Arena>) -> Self {
        Self { x_m: pose.x.0, y_m: pose.y.0, heading_rad: pose.heading.rad() }
    }
}

/// A value for each unknown.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ProblemValues {
    /// The poses in the order of time.
    pub(super) poses: Vec<UnwrappedPose>,
    /// The gyro bias over each window, rad/s.
    pub(super) biases: Vec<f64>,
    /// The constants, estimated or given.
    pub(super) constants: [f64; CONSTANTS],
}

impl ProblemValues {
    /// Moves the unknowns by a solution, by variable.
    pub(super) fn retract(&mut self, layout: VariableLayout, solution: &[f64]) {
        for (constant, step) in self.constants.iter_mut().zip(solution) {
            *constant += step;
        }
        for (window, bias) in self.biases.iter_mut().enumerate() {
            *bias += solution[VariableLayout::bias(window)];
        }
        for (node, pose) in self.poses.iter_mut().enumerate() {
            let first = layout.pose(node, 0);
            *pose = pose.retract([solution[first], solution[first + 1], solution[first + 2]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_step_with_a_quarter_turn_runs_along_a_quarter_circle() {
        let start = UnwrappedPose { x_m: 1.0, y_m: 2.0, heading_rad: FRAC_PI_2 };
        let end = start.retract([FRAC_PI_2, 0.0, FRAC_PI_2]);
        assert!((end.x_m - 0.0).abs() < 1e-12 && (end.y_m - 3.0).abs() < 1e-12);
        assert!((end.heading_rad - 2.0 * FRAC_PI_2).abs() < 1e-12);
        let nearly_straight = start.retract([1.0, 0.5, 0.99e-4]);
        let quotient = start.retract([1.0, 0.5, 1.01e-4]);
        assert!((nearly_straight.x_m - quotient.x_m).abs() < 3e-6);
    }

    #[test]
    fn every_variable_has_one_number() {
        let layout = VariableLayout { biases: 3, poses: 4 };
        for variable in 0..layout.count() {
            let again = match layout.kind_of(variable) {
                VariableKind::Constant(constant) => constant,
                VariableKind::Bias(window) => VariableLayout::bias(window),
                VariableKind::Pose(node, row) => layout.pose(node, row),
            };
            assert_eq!(again, variable);
        }
    }
}
