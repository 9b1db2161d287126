//! From observations to a least-squares problem: a pose at every motion reading and at the instant of every fix, but
//! one for all instants of a standstill, where the motion is exact; the motion between them; and the fixes.
//!
//! Source: docs/maths/pose.md sections B1 and B2.

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, Fix, Heading, Meters, Observation, ObservationKind, Pose, TimeDelta, Timestamp,
    UncertainValue,
};

use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, body_step};
use crate::motion::{GyroTrack, InsertOutcome, MotionReading, MotionTrack, TravelSegment};
use crate::numerics::elimination::Variable;
use crate::observations::gyro_window::{gyro_variance, rounding_variance};
use crate::validation;

/// Length of a gyro window here: windows count as independent of each other, so that few and long ones lose least by
/// the rounding of the encoders at their ends. The filter carries that rounding over, and has shorter ones.
const GYRO_WINDOW: TimeDelta = TimeDelta::from_millis(400);

/// Less travel of both wheels than this is rounding and not motion, m: a nanometre.
const MIN_TRAVEL_M: f64 = 1e-9;
/// A larger turn is divided into several arcs, rad: the arc's chord is then never near zero.
const MAX_TURN_RAD: f64 = 0.5;
/// Most arcs of a step, whatever turn the wheels report.
const MAX_PARTS: f64 = 1e3;
/// Half of the interval over which the speeds at a fix are taken, three periods of a 20 Hz encoder in all.
const HALF_SPEED_WINDOW: TimeDelta = TimeDelta::from_millis(75);

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MotionSegment {
    /// Known travel of the wheels, with the nominal geometry.
    Driven {
        travel: WheelTravel,
        /// Variance of each coordinate of its end, because the order of distance and turn is unknown.
        path_var_m2: f64,
    },
    /// Unobserved motion over this number of seconds.
    Unobserved(f64),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct AssociatedFix {
    /// Its number among the run's fixes.
    pub(super) index: usize,
    pub(super) node: usize,
    pub(super) fix: Fix,
    pub(super) stamp_sigma_s: f64,
    /// Nominal, at the exposure.
    pub(super) forward_m_per_s: f64,
    pub(super) turn_rad_per_s: f64,
    /// The delay with which `node` was chosen.
    pub(super) delay_s: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct GyroInterval {
    pub(super) from: usize,
    /// The pose at its end; the same one at rest.
    pub(super) to: usize,
    pub(super) turn_rad: f64,
    pub(super) length_s: f64,
    /// Variance of the gyro's turn minus that of the poses' headings, rad².
    pub(super) variance: f64,
    /// From the middle of the previous window to the middle of this one; zero for the first.
    pub(super) since_last_s: f64,
}

/// The valid observations of a run, in time order.
pub(super) struct RunData<'a> {
    config: &'a FilterConfig,
    track: MotionTrack,
    gyro: GyroTrack,
    readings: Vec<Timestamp<BrickClock>>,
    fixes: Vec<Observation>,
}

impl<'a> RunData<'a> {
    /// Sorts and filters the observations: leaves out malformed ones, repeated ones and kinds that are not used.
    pub(super) fn new(config: &'a FilterConfig, observations: &[Observation]) -> Self {
        let mut run = Self {
            config,
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            readings: Vec::new(),
            fixes: Vec::new(),
        };
        for observation in validation::valid_in_time_order(observations) {
            run.push(observation);
        }
        run
    }

    fn push(&mut self, observation: &Observation) {
        let stamp = observation.stamp;
        if let Some(reading) = MotionReading::from_observation(&observation.measurement) {
            if let InsertOutcome::Inserted(_) | InsertOutcome::Rebased(_) = self.track.insert(stamp, &reading) {
                self.readings.push(stamp);
            }
        } else if let ObservationKind::TurnRate(rate) = observation.measurement {
            self.gyro.insert(stamp, rate.0);
        } else if let ObservationKind::Fix(_) = observation.measurement
            && !self.is_duplicate_fix(observation)
        {
            self.fixes.push(*observation);
        }
    }

    /// A datagram that was received twice must not count twice.
    fn is_duplicate_fix(&self, observation: &Observation) -> bool {
        self.fixes.iter().rev().take_while(|other| other.stamp == observation.stamp).any(|other| other == observation)
    }

    pub(super) fn fixes(&self) -> usize {
        self.fixes.len()
    }

    pub(super) fn motion_readings(&self) -> usize {
        self.readings.len()
    }

    pub(super) fn problem(&self, delay_s: f64) -> SmoothingProblem<'a> {
        let mut problem = SmoothingProblem::empty(self.config);
        let (Some(&first), Some(&last)) = (self.readings.first(), self.readings.last()) else {
            return problem;
        };
        let delay = TimeDelta::from_secs_f64(delay_s);
        let mut stops: Vec<(Timestamp<BrickClock>, NodeKind)> =
            self.readings.iter().map(|at| (*at, NodeKind::Reading)).collect();
        let indexed = self.fixes.iter().enumerate();
        stops.extend(indexed.map(|(index, fix)| (fix.stamp - delay, NodeKind::Fix(index))));
        stops.retain(|stop| (first..=last).contains(&stop.0));
        stops.sort();
        let mut at = first;
        for (stamp, stop) in stops {
            self.advance(&mut problem, at, stamp);
            at = stamp;
            match stop {
                NodeKind::Reading => problem.readings.push(ReadingPose { stamp, pose: problem.poses - 1 }),
                NodeKind::Fix(index) => {
                    let associated = self.associate_fix(index, stamp, problem.poses - 1, delay_s);
                    problem.fixes.extend(associated);
                }
            }
        }
        self.add_windows(&mut problem);
        problem
    }

    fn advance(&self, problem: &mut SmoothingProblem<'a>, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) {
        let mut at = from;
        while at < to {
            at = match self.track.segment(at, to) {
                TravelSegment::Known { until, travel, path_var_m2, .. } => {
                    problem.append_travel(travel, path_var_m2);
                    until
                }
                TravelSegment::Gap { until } | TravelSegment::BeyondData { until } => {
                    problem.append(MotionSegment::Unobserved((until - at).as_secs_f64()));
                    until
                }
            };
        }
    }

    fn associate_fix(
        &self,
        index: usize,
        at: Timestamp<BrickClock>,
        node: usize,
        delay_s: f64,
    ) -> Option<AssociatedFix> {
        let observation = self.fixes.get(index)?;
        let ObservationKind::Fix(fix) = observation.measurement else {
            return None;
        };
        let (from, to) = (at - HALF_SPEED_WINDOW, at + HALF_SPEED_WINDOW);
        let step = body_step(self.track.travel_between(from, to), &self.config.geometry);
        let window_s = (to - from).as_secs_f64();
        Some(AssociatedFix {
            index,
            node,
            fix,
            stamp_sigma_s: observation.stamp_sigma.as_secs_f64(),
            forward_m_per_s: step.forward_m / window_s,
            turn_rad_per_s: step.turn_rad / window_s,
            delay_s,
        })
    }

    /// Gyro windows from reading to reading; leaves out those with a gap.
    fn add_windows(&self, problem: &mut SmoothingProblem<'a>) {
        let mut last_middle_s = None;
        let mut pairs = problem.readings.iter();
        let Some(mut start) = pairs.next().copied() else {
            return;
        };
        let mut before = start;
        for &reading in pairs {
            if problem.has_gap(before.pose, reading.pose) {
                start = reading;
            } else if reading.stamp - start.stamp >= GYRO_WINDOW {
                let middle_s = 0.5 * (start.stamp.as_secs_f64() + reading.stamp.as_secs_f64());
                if let Some(mut window) = self.window(start, reading) {
                    window.since_last_s = last_middle_s.map_or(0.0, |last| middle_s - last);
                    last_middle_s = Some(middle_s);
                    problem.windows.push(window);
                }
                start = reading;
            }
            before = reading;
        }
    }

    fn window(&self, from: ReadingPose, to: ReadingPose) -> Option<GyroInterval> {
        let length_s = (to.stamp - from.stamp).as_secs_f64();
        if length_s <= 0.0 {
            return None;
        }
        let turn = self.gyro.covered_turn(from.stamp, to.stamp)?;
        let quantisation = if from.pose == to.pose {
            0.0
        } else {
            // Both ends of the window are rounded.
            2.0 * rounding_variance(&self.config.geometry)
        };
        let variance = gyro_variance(&self.config.noise, turn.squared_intervals_s2) + quantisation;
        Some(GyroInterval {
            from: from.pose,
            to: to.pose,
            turn_rad: turn.turn_rad,
            length_s,
            // A gyro without noise would weigh without bound.
            variance: variance.max(MIN_TURN_VARIANCE),
            since_last_s: 0.0,
        })
    }
}

/// Least variance of a window's turn, a microradian squared.
const MIN_TURN_VARIANCE: f64 = 1e-12;

/// What a pose belongs to; readings come first at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum NodeKind {
    Reading,
    Fix(usize),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ReadingPose {
    pub(super) stamp: Timestamp<BrickClock>,
    /// Its number among the poses of the problem.
    pub(super) pose: usize,
}

/// The unknowns of a run and their constraints.
#[derive(Clone, Debug)]
pub(super) struct SmoothingProblem<'a> {
    /// Start, noise and priors.
    pub(super) config: &'a FilterConfig,
    pub(super) poses: usize,
    /// From each pose to the next.
    pub(super) segments: Vec<MotionSegment>,
    /// In the order of their poses.
    pub(super) fixes: Vec<AssociatedFix>,
    /// In the order of time.
    pub(super) windows: Vec<GyroInterval>,
    pub(super) readings: Vec<ReadingPose>,
    pub(super) is_free: [bool; CONSTANTS],
}

impl<'a> SmoothingProblem<'a> {
    fn empty(config: &'a FilterConfig) -> Self {
        Self {
            config,
            poses: 1,
            segments: Vec::new(),
            fixes: Vec::new(),
            windows: Vec::new(),
            readings: Vec::new(),
            is_free: constants_of(&config.calibration).map(|known| known.sigma > 0.0),
        }
    }

    pub(super) fn layout(&self) -> VariableLayout {
        VariableLayout { biases: self.windows.len(), poses: self.poses }
    }

    pub(super) fn fixes_at(&self, node: usize) -> &[AssociatedFix] {
        let first = self.fixes.partition_point(|fix| fix.node < node);
        let end = self.fixes.partition_point(|fix| fix.node <= node);
        &self.fixes[first..end]
    }

    fn append(&mut self, by: MotionSegment) {
        self.segments.push(by);
        self.poses += 1;
    }

    fn append_travel(&mut self, travel: WheelTravel, path_var_m2: f64) {
        if travel.left_m.abs().max(travel.right_m.abs()) < MIN_TRAVEL_M {
            return;
        }
        let turn_rad = body_step(travel, &self.config.geometry).turn_rad.abs();
        let parts = (turn_rad / MAX_TURN_RAD).ceil().clamp(1.0, MAX_PARTS);
        for _ in 0..parts as usize {
            self.append(MotionSegment::Driven {
                travel: WheelTravel { left_m: travel.left_m / parts, right_m: travel.right_m / parts },
                path_var_m2: path_var_m2 / parts,
            });
        }
    }

    fn has_gap(&self, from: usize, to: usize) -> bool {
        self.segments[from..to].iter().any(|by| matches!(by, MotionSegment::Unobserved(_)))
    }
}

// The unknowns of a batch problem: their numbers, their values, and how a solution moves them.
//
//     T_k <- T_k Exp(xi_k)        xi = [forward, left, heading]' in the body's space
//     Exp(xi) = (V [forward, left]', heading)      V = [sin h, -(1 - cos h); 1 - cos h, sin h] / h
//     biases and constants add
// Headings are not wrapped: they count turns, so that differences over windows need no wrapping either.
// Source: Barrau and Bonnabel (2018), Annual Review of Control, Robotics, and Autonomous Systems 1; docs/maths/pose.md section B1.

pub(super) const CONSTANTS: usize = 6;
pub(super) const RADIUS_SCALE: usize = 0;
pub(super) const RADIUS_DIFFERENCE: usize = 1;
pub(super) const TRACK_SCALE: usize = 2;
pub(super) const FIX_DELAY: usize = 3;
pub(super) const TAG_FORWARD: usize = 4;
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

/// The numbers of a problem's variables: constants, then biases, then three per pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct VariableLayout {
    pub(super) biases: usize,
    pub(super) poses: usize,
}

/// The meaning of a variable's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VariableKind {
    Constant(usize),
    /// The gyro bias over a window.
    Bias(usize),
    Pose(usize, usize),
}

impl VariableLayout {
    pub(super) const fn bias(window: usize) -> Variable {
        CONSTANTS + window
    }

    /// The number of a row of xi of a pose: 0 forward, 1 left, 2 heading.
    pub(super) const fn pose(self, node: usize, row: usize) -> Variable {
        CONSTANTS + self.biases + 3 * node + row
    }

    pub(super) const fn count(self) -> usize {
        CONSTANTS + self.biases + 3 * self.poses
    }

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

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct UnwrappedPose {
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    /// Not wrapped.
    pub(super) heading_rad: f64,
}

impl UnwrappedPose {
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

    /// With a wrapped heading.
    pub(super) fn to_pose(self) -> Pose<Arena> {
        Pose::new(Meters(self.x_m), Meters(self.y_m), Heading::from_rad(self.heading_rad))
    }

    pub(super) fn from_pose(pose: Pose<Arena>) -> Self {
        Self { x_m: pose.x.0, y_m: pose.y.0, heading_rad: pose.heading.rad() }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct ProblemValues {
    pub(super) poses: Vec<UnwrappedPose>,
    /// Over each window, rad/s.
    pub(super) biases: Vec<f64>,
    /// Estimated or given.
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
