//! From observations to a problem: which poses are unknown, what moved the robot between them, what was seen of it.
//!
//! There is a pose at every motion reading and at the instant of every fix, and one for all instants of a standstill: at
//! rest the motion is exact, so these are one pose and not many. What happened is asked of the same tracks that the filters
//! ask; the order in which the observations came does not matter.
//!
//! Source: docs/maths/pose.md sections B1 and B2.

use posebridge_telemetry::{BrickClock, Fix, Observation, ObservationKind, TimeDelta, Timestamp};

use super::values::{CONSTANTS, VariableLayout, constants_of};
use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, body_step};
use crate::motion::{GyroTrack, InsertOutcome, MotionReading, MotionTrack, TravelSegment};
use crate::observations::gyro_window::{gyro_variance, rounding_variance};
use crate::validation;

/// Length of a gyro window here: windows count as independent of each other, so that few and long ones lose least by the rounding
/// of the encoders at their ends. The filter, which hands that on, has shorter ones.
const GYRO_WINDOW: TimeDelta = TimeDelta::from_millis(400);

/// Less travel of both wheels than this is rounding and not motion, m: a nanometre.
const MIN_TRAVEL_M: f64 = 1e-9;
/// A step that turns further is cut into parts, each an arc of its own, rad: the arc's chord is then never near zero.
const MAX_TURN_RAD: f64 = 0.5;
/// No step is cut into more parts than this, however fast the wheels claim to have turned.
const MAX_PARTS: f64 = 1e3;
/// Half of the span over which the speeds at a fix are taken, three periods of a 20 Hz encoder in all.
const HALF_SPEED_WINDOW: TimeDelta = TimeDelta::from_millis(75);

/// How the robot came from one pose to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MotionSegment {
    /// The wheels' travel is known.
    Driven {
        /// With the nominal geometry.
        travel: WheelTravel,
        /// Variance of each coordinate of where it ends, because the order of distance and turn is unknown, m².
        path_var_m2: f64,
    },
    /// No observation of the motion, over this number of seconds.
    Unobserved(f64),
}

/// A fix at the pose that it saw.
#[derive(Clone, Copy, Debug)]
pub(super) struct AssociatedFix {
    /// Which of the run's fixes it is.
    pub(super) index: usize,
    /// The pose.
    pub(super) node: usize,
    /// What was seen.
    pub(super) fix: Fix,
    /// How far its stamp may be off, s.
    pub(super) stamp_sigma_s: f64,
    /// Nominal forward speed then, m/s.
    pub(super) forward_m_per_s: f64,
    /// Nominal turn rate then, rad/s.
    pub(super) turn_rad_per_s: f64,
    /// The delay with which `node` was chosen, s.
    pub(super) delay_s: f64,
}

/// A gyro window between two poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct GyroInterval {
    /// The pose where it begins.
    pub(super) from: usize,
    /// The pose where it ends; the same one at rest.
    pub(super) to: usize,
    /// The gyro's turn, bias included, rad.
    pub(super) turn_rad: f64,
    /// Its length, s.
    pub(super) length_s: f64,
    /// Variance of the turn against the poses' headings, rad².
    pub(super) variance: f64,
    /// From the middle of the window before to the middle of this one, s; zero for the first.
    pub(super) since_last_s: f64,
}

/// What is known of a run: the readings, in the order of time.
pub(super) struct RunData<'a> {
    config: &'a FilterConfig,
    track: MotionTrack,
    gyro: GyroTrack,
    readings: Vec<Timestamp<BrickClock>>,
    fixes: Vec<Observation>,
}

impl<'a> RunData<'a> {
    /// Sorts and sifts the observations: malformed ones, repeated ones and kinds that are not used are left out.
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

    /// A datagram that came twice must not count twice.
    fn is_duplicate_fix(&self, observation: &Observation) -> bool {
        self.fixes.iter().rev().take_while(|other| other.stamp == observation.stamp).any(|other| other == observation)
    }

    /// How many fixes there are, those outside the motion readings included.
    pub(super) fn fixes(&self) -> usize {
        self.fixes.len()
    }

    /// How many motion readings there are.
    pub(super) fn motion_readings(&self) -> usize {
        self.readings.len()
    }

    /// The problem with the poses where fixes were true if they come with this delay, s.
    pub(super) fn problem(&self, delay_s: f64) -> SmoothingProblem<'a> {
        let mut problem = SmoothingProblem::empty(self.config);
        let (Some(&first), Some(&last)) = (self.readings.first(), self.readings.last()) else {
            return problem;
        };
        let delay = TimeDelta::from_secs_f64(delay_s);
        let mut stops: Vec<(Timestamp<BrickClock>, NodeKind)> =
            self.readings.iter().map(|at| (*at, NodeKind::Reading)).collect();
        let seen = self.fixes.iter().enumerate();
        stops.extend(seen.map(|(index, fix)| (fix.stamp - delay, NodeKind::Fix(index))));
        stops.retain(|stop| (first..=last).contains(&stop.0));
        stops.sort();
        let mut at = first;
        for (stamp, stop) in stops {
            self.advance(&mut problem, at, stamp);
            at = stamp;
            match stop {
                NodeKind::Reading => problem.readings.push(ReadingPose { stamp, pose: problem.poses - 1 }),
                NodeKind::Fix(index) => {
                    let seen = self.associate_fix(index, stamp, problem.poses - 1, delay_s);
                    problem.fixes.extend(seen);
                }
            }
        }
        self.add_windows(&mut problem);
        problem
    }

    /// Appends the poses between two stops.
    fn advance(&self, problem: &mut SmoothingProblem<'a>, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) {
        let mut at = from;
        while at < to {
            at = match self.track.segment(at, to) {
                TravelSegment::Known { until, travel, path_var_m2 } => {
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
        let span_s = (to - from).as_secs_f64();
        Some(AssociatedFix {
            index,
            node,
            fix,
            stamp_sigma_s: observation.stamp_sigma.as_secs_f64(),
            forward_m_per_s: step.forward_m / span_s,
            turn_rad_per_s: step.turn_rad / span_s,
            delay_s,
        })
    }

    /// Gyro windows from reading to reading; one that has a hole in it is left out.
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
        if length_s <= 0.0 || !self.gyro.covers(from.stamp, to.stamp) {
            return None;
        }
        let turn = self.gyro.turn_between(from.stamp, to.stamp);
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

/// No gyro is better than a microradian over a window, rad².
const MIN_TURN_VARIANCE: f64 = 1e-12;

/// What lies at an instant; readings come first where both do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum NodeKind {
    Reading,
    Fix(usize),
}

/// A motion reading and the pose at its instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReadingPose {
    pub(super) stamp: Timestamp<BrickClock>,
    /// Its number among the poses of the problem.
    pub(super) pose: usize,
}

/// The unknowns of a run and what ties them together.
#[derive(Clone, Debug)]
pub(super) struct SmoothingProblem<'a> {
    /// What is known beforehand.
    pub(super) config: &'a FilterConfig,
    /// How many poses there are.
    pub(super) poses: usize,
    /// From each pose to the next.
    pub(super) segments: Vec<MotionSegment>,
    /// In the order of their poses.
    pub(super) fixes: Vec<AssociatedFix>,
    /// In the order of time.
    pub(super) windows: Vec<GyroInterval>,
    /// In the order of time.
    pub(super) readings: Vec<ReadingPose>,
    /// Which constants are estimated.
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

    /// Where the variables are.
    pub(super) fn layout(&self) -> VariableLayout {
        VariableLayout { biases: self.windows.len(), poses: self.poses }
    }

    /// The fixes that saw a pose.
    pub(super) fn fixes_at(&self, node: usize) -> &[AssociatedFix] {
        let first = self.fixes.partition_point(|seen| seen.node < node);
        let end = self.fixes.partition_point(|seen| seen.node <= node);
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
