//! From observations to a problem: which poses are unknown, what moved the robot between them, what was seen of it.
//!
//! There is a pose at every motion reading and at the instant of every fix, and one for all instants of a standstill: at
//! rest the motion is exact, so these are one pose and not many. What happened is asked of the same tracks that the filters
//! ask; the order in which the observations came does not matter.
//!
//! Source: docs/maths/batch.md sections 1 and 2.

use posebridge_telemetry::{BrickClock, Fix, Observation, Observed, Span, Stamp};

use super::values::{CONSTANTS, Layout, constants_of};
use crate::filters::{FilterConfig, intake};
use crate::models::differential_drive::{WheelTravel, body_step};
use crate::motion::{Added, GyroTrack, Leg, MotionReading, MotionTrack};
use crate::observations::gyro_window::{gyro_variance, rounding_variance};

/// Length of a gyro window here: windows count as independent of each other, so that few and long ones lose least by the rounding
/// of the encoders at their ends. The filter, which hands that on, has shorter ones.
const WINDOW: Span = Span::from_millis(400);

/// Less travel of both wheels than this is rounding and not motion, m: a nanometre.
const REST_M: f64 = 1e-9;
/// A step that turns further is cut into parts, each an arc of its own, rad: the arc's chord is then never near zero.
const LONGEST_TURN_RAD: f64 = 0.5;
/// No step is cut into more parts than this, however fast the wheels claim to have turned.
const MOST_PARTS: f64 = 1e3;
/// Half of the span over which the speeds at a fix are taken, three periods of a 20 Hz encoder in all.
const HALF_SPEED_SPAN: Span = Span::from_millis(75);

/// How the robot came from one pose to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Move {
    /// The wheels' travel is known.
    Driven {
        /// With the nominal geometry.
        travel: WheelTravel,
        /// Variance of each coordinate of where it ends, because the order of distance and turn is unknown, m².
        path_var_m2: f64,
    },
    /// Nothing tells how it moved, over so many seconds.
    Unseen(f64),
}

/// A fix at the pose that it saw.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenFix {
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
pub(super) struct Window {
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
pub(super) struct Run<'a> {
    config: &'a FilterConfig,
    track: MotionTrack,
    gyro: GyroTrack,
    readings: Vec<Stamp<BrickClock>>,
    fixes: Vec<Observation>,
}

impl<'a> Run<'a> {
    /// Sorts and sifts the observations: malformed ones, repeated ones and kinds that are not used are left out.
    pub(super) fn new(config: &'a FilterConfig, observations: &[Observation]) -> Self {
        let mut run = Self {
            config,
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            readings: Vec::new(),
            fixes: Vec::new(),
        };
        for observation in intake::sound_in_time(observations) {
            run.take(observation);
        }
        run
    }

    fn take(&mut self, observation: &Observation) {
        let stamp = observation.stamp;
        if let Some(reading) = MotionReading::of(&observation.observed) {
            if let Added::After(_) | Added::Rebased(_) = self.track.add(stamp, &reading) {
                self.readings.push(stamp);
            }
        } else if let Observed::TurnRate(rate) = observation.observed {
            self.gyro.add(stamp, rate.0);
        } else if let Observed::Fix(_) = observation.observed
            && !self.repeats_a_fix(observation)
        {
            self.fixes.push(*observation);
        }
    }

    /// A datagram that came twice must not count twice.
    fn repeats_a_fix(&self, observation: &Observation) -> bool {
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
    pub(super) fn problem(&self, delay_s: f64) -> Problem<'a> {
        let mut problem = Problem::empty(self.config);
        let (Some(&first), Some(&last)) = (self.readings.first(), self.readings.last()) else {
            return problem;
        };
        let delay = Span::from_secs_f64(delay_s);
        let mut stops: Vec<(Stamp<BrickClock>, Stop)> = self.readings.iter().map(|at| (*at, Stop::Reading)).collect();
        let seen = self.fixes.iter().enumerate();
        stops.extend(seen.map(|(index, fix)| (fix.stamp - delay, Stop::Fix(index))));
        stops.retain(|stop| (first..=last).contains(&stop.0));
        stops.sort();
        let mut at = first;
        for (stamp, stop) in stops {
            self.advance(&mut problem, at, stamp);
            at = stamp;
            match stop {
                Stop::Reading => problem.readings.push((stamp, problem.poses - 1)),
                Stop::Fix(index) => {
                    let seen = self.seen(index, stamp, problem.poses - 1, delay_s);
                    problem.fixes.extend(seen);
                }
            }
        }
        self.add_windows(&mut problem);
        problem
    }

    /// Appends the poses between two stops.
    fn advance(&self, problem: &mut Problem<'a>, from: Stamp<BrickClock>, to: Stamp<BrickClock>) {
        let mut at = from;
        while at < to {
            at = match self.track.leg(at, to) {
                Leg::Known { until, travel, path_var_m2 } => {
                    problem.drive(travel, path_var_m2);
                    until
                }
                Leg::Gap { until } | Leg::Ahead { until } => {
                    problem.append(Move::Unseen((until - at).as_secs_f64()));
                    until
                }
            };
        }
    }

    fn seen(&self, index: usize, at: Stamp<BrickClock>, node: usize, delay_s: f64) -> Option<SeenFix> {
        let observation = self.fixes.get(index)?;
        let Observed::Fix(fix) = observation.observed else {
            return None;
        };
        let (from, to) = (at - HALF_SPEED_SPAN, at + HALF_SPEED_SPAN);
        let step = body_step(self.track.travel_between(from, to), &self.config.geometry);
        let span_s = (to - from).as_secs_f64();
        Some(SeenFix {
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
    fn add_windows(&self, problem: &mut Problem<'a>) {
        let mut last_middle_s = None;
        let mut pairs = problem.readings.iter();
        let Some(mut start) = pairs.next().copied() else {
            return;
        };
        let mut before = start;
        for &reading in pairs {
            if problem.has_gap(before.1, reading.1) {
                start = reading;
            } else if reading.0 - start.0 >= WINDOW {
                let middle_s = 0.5 * (start.0.as_secs_f64() + reading.0.as_secs_f64());
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

    fn window(
        &self,
        (start, from): (Stamp<BrickClock>, usize),
        (end, to): (Stamp<BrickClock>, usize),
    ) -> Option<Window> {
        let length_s = (end - start).as_secs_f64();
        if length_s <= 0.0 || !self.gyro.covers(start, end) {
            return None;
        }
        let turn = self.gyro.turn_between(start, end);
        let quantisation = if from == to {
            0.0
        } else {
            // Both ends of the window are rounded.
            2.0 * rounding_variance(&self.config.geometry)
        };
        let variance = gyro_variance(&self.config.noise, turn.squared_secs) + quantisation;
        Some(Window {
            from,
            to,
            turn_rad: turn.turn_rad,
            length_s,
            // A gyro without noise would weigh without bound.
            variance: variance.max(SMALLEST_TURN_VARIANCE),
            since_last_s: 0.0,
        })
    }
}

/// Nobody's gyro is better than a microradian over a window, rad².
const SMALLEST_TURN_VARIANCE: f64 = 1e-12;

/// What lies at an instant; readings come first where both do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stop {
    Reading,
    Fix(usize),
}

/// The unknowns of a run and what ties them together.
#[derive(Clone, Debug)]
pub(super) struct Problem<'a> {
    /// What is known beforehand.
    pub(super) config: &'a FilterConfig,
    /// How many poses there are.
    pub(super) poses: usize,
    /// From each pose to the next.
    pub(super) moves: Vec<Move>,
    /// In the order of their poses.
    pub(super) fixes: Vec<SeenFix>,
    /// In the order of time.
    pub(super) windows: Vec<Window>,
    /// The instant of each motion reading, and its pose.
    pub(super) readings: Vec<(Stamp<BrickClock>, usize)>,
    /// Which constants are estimated.
    pub(super) is_free: [bool; CONSTANTS],
}

impl<'a> Problem<'a> {
    fn empty(config: &'a FilterConfig) -> Self {
        Self {
            config,
            poses: 1,
            moves: Vec::new(),
            fixes: Vec::new(),
            windows: Vec::new(),
            readings: Vec::new(),
            is_free: constants_of(&config.calibration).map(|known| known.sigma > 0.0),
        }
    }

    /// Where the variables are.
    pub(super) fn layout(&self) -> Layout {
        Layout { biases: self.windows.len(), poses: self.poses }
    }

    /// The fixes that saw a pose.
    pub(super) fn fixes_at(&self, node: usize) -> &[SeenFix] {
        let first = self.fixes.partition_point(|seen| seen.node < node);
        let end = self.fixes.partition_point(|seen| seen.node <= node);
        &self.fixes[first..end]
    }

    fn append(&mut self, by: Move) {
        self.moves.push(by);
        self.poses += 1;
    }

    fn drive(&mut self, travel: WheelTravel, path_var_m2: f64) {
        if travel.left_m.abs().max(travel.right_m.abs()) < REST_M {
            return;
        }
        let turn_rad = body_step(travel, &self.config.geometry).turn_rad.abs();
        let parts = (turn_rad / LONGEST_TURN_RAD).ceil().clamp(1.0, MOST_PARTS);
        for _ in 0..parts as usize {
            self.append(Move::Driven {
                travel: WheelTravel { left_m: travel.left_m / parts, right_m: travel.right_m / parts },
                path_var_m2: path_var_m2 / parts,
            });
        }
    }

    fn has_gap(&self, from: usize, to: usize) -> bool {
        self.moves[from..to].iter().any(|by| matches!(by, Move::Unseen(_)))
    }
}
