//! What the filters of paper 1 share: everything but their maths.
//!
//! Observations are used when they come. Each one carries the belief to its own instant, if that is ahead, and is then
//! applied; one from the past is applied to the present, or refused where it would make an interval negative. So the order of
//! the sensors within one instant does not matter, and a filter's own file holds its matrices and nothing else.
//!
//! ```text
//! speeds are held for 0.5 s after the last reading of the wheels, accelerations for 0.3 s after they were felt;
//! behind that the pose stays and only the doubt grows
//! an interval of more than 0.3 s between two readings of the wheels is a gap: over what of it has not been predicted yet the
//! robot is taken to have driven at the counters' mean speeds
//! ```
//! A timeline of past beliefs answers for earlier instants: as they were believed then, for nothing is corrected afterwards.
//!
//! Source: docs/maths/paper1.md section 1.

mod counters;
pub(super) mod innovation;
mod maths;
pub(super) mod rows;

use std::collections::BTreeMap;

use posebridge_telemetry::{
    BrickClock, Calibration, Estimate, Fix, FusionRecord, Heading, Meters, MetersPerSecond, Observation, Observed,
    Pose, PoseJump, RadiansPerSecond, SensorId, Span, Stamp, Validity, Verdict, estimate::row,
};

use self::counters::{Counters, Reading};
pub(super) use self::counters::{LONGEST_STEP, WheelStep};
pub(super) use self::maths::{Belief, Context, Extra, Maths};
use super::timeline::Timeline;
use super::{Filter, FilterConfig, StartPose, intake};
use crate::gate::chi_square_quantile;
use crate::models::planar_speeds::{Acceleration, Mean};
use crate::observations::fix::{Circumstances, mid_axle, noise_of};

/// Speeds are held for this long after the last reading of the wheels, and are stale behind it.
const SPEEDS_HELD: Span = Span::from_millis(500);
/// Accelerations are held for this long: as long as an interval that is no gap.
const ACCELERATIONS_HELD: Span = LONGEST_STEP;

/// What is believed at one instant, with all that a prediction from there needs.
#[derive(Clone, Copy)]
struct Instant<M> {
    stamp: Option<Stamp<BrickClock>>,
    maths: M,
    felt: Option<(Stamp<BrickClock>, Acceleration)>,
    last_motion: Option<Stamp<BrickClock>>,
    last_fix: Option<Stamp<BrickClock>>,
    /// The pose was given, by the configuration, a person or a fix.
    is_placed: bool,
}

impl<M: Maths> Instant<M> {
    fn advance_to(&mut self, stamp: Stamp<BrickClock>, context: &Context) {
        let Some(from) = self.stamp.filter(|from| *from < stamp) else {
            self.stamp = self.stamp.or(Some(stamp));
            return;
        };
        // Before the first reading of the wheels nothing has gone stale yet.
        let held_until = self.last_motion.unwrap_or(from) + SPEEDS_HELD;
        let moving_until = held_until.clamp(from, stamp);
        let (felt, felt_until) = self
            .felt
            .map_or_else(|| (Acceleration::default(), from), |(felt_at, felt)| (felt, felt_at + ACCELERATIONS_HELD));
        let changing_until = felt_until.clamp(from, moving_until);
        if changing_until > from {
            let dt_s = (changing_until - from).as_secs_f64();
            self.maths.advance(dt_s, felt, context);
        }
        if moving_until > changing_until {
            let dt_s = (moving_until - changing_until).as_secs_f64();
            self.maths.advance(dt_s, Acceleration::default(), context);
        }
        if stamp > moving_until {
            self.maths.wait((stamp - moving_until).as_secs_f64(), context);
        }
        self.stamp = Some(stamp);
    }

    /// Crosses what of a gap has not been predicted yet at the mean speeds that the counters tell.
    fn bridge(&mut self, step: &WheelStep, stamp: Stamp<BrickClock>, context: &Context) {
        let Some(from) = self.stamp.filter(|from| *from < stamp) else {
            return;
        };
        let body = step.body(&context.config.geometry);
        let gap_s = step.interval.as_secs_f64();
        let left_s = (stamp - from).as_secs_f64();
        let share = left_s / gap_s;
        // In which order distance and turn came is unknown: the direction of the way is uniform within the turn.
        let path_m2 = share * (body.forward_m * body.turn_rad).powi(2) / 12.0;
        let speeds = [body.forward_m / gap_s, body.turn_rad / gap_s];
        self.maths.bridge(speeds, path_m2);
        self.maths.advance(left_s, Acceleration::default(), context);
        self.stamp = Some(stamp);
    }
}

/// A filter that uses observations when they come.
pub(super) struct OnArrival<M> {
    context: Context,
    counters: Counters,
    last_gyro: Option<Stamp<BrickClock>>,
    last_felt: Option<Stamp<BrickClock>>,
    last_fixes: BTreeMap<SensorId, Stamp<BrickClock>>,
    last: Instant<M>,
    /// The belief after each instant within the history.
    past: Timeline<Instant<M>>,
    reset_counter: u8,
    last_jump: Option<PoseJump>,
}

impl<M: Maths> OnArrival<M> {
    /// Starts at the configured pose, or at the arena's origin.
    pub(super) fn new(mut maths: M, config: &FilterConfig) -> Self {
        if let Some(start) = &config.start {
            maths.place(start);
        }
        let first = Instant {
            stamp: None,
            maths,
            felt: None,
            last_motion: None,
            last_fix: None,
            is_placed: config.start.is_some(),
        };
        Self {
            context: Context {
                config: config.clone(),
                gates: [1, 2, 3].map(|degrees| chi_square_quantile(degrees, config.params.gate_probability)),
            },
            counters: Counters::default(),
            last_gyro: None,
            last_felt: None,
            last_fixes: BTreeMap::new(),
            last: first,
            past: Timeline::new(config.params.history_s),
            reset_counter: 0,
            last_jump: None,
        }
    }

    /// Keeps a belief: one for each instant, as far back as the history reaches.
    fn keep(&mut self, next: Instant<M>) {
        self.last = next;
        if let Some(stamp) = next.stamp {
            self.past.push(stamp, next);
        }
    }

    /// Goes on from a belief that owes nothing to those before it, which are forgotten.
    fn begin(&mut self, next: Instant<M>) {
        self.past.clear();
        self.keep(next);
    }

    fn take(&mut self, observation: &Observation, record: &mut FusionRecord) -> Verdict {
        let uses = |extra| self.last.maths.uses(extra);
        match observation.observed {
            Observed::WheelAngles { left, right } => self.take_wheels(observation.stamp, [left.0, right.0], record),
            Observed::TurnRate(rate) if uses(Extra::Gyro) => self.take_gyro(observation.stamp, rate.0, record),
            Observed::WheelAccelerations { left, right } if uses(Extra::Accelerometers) => {
                let geometry = &self.context.config.geometry;
                let felt = Acceleration::of_wheels(left.0, right.0, geometry);
                self.take_accelerations(observation.stamp, felt)
            }
            Observed::Fix(fix) if uses(Extra::Camera) => self.take_fix(observation, &fix, record),
            Observed::OdometerPose(_)
            | Observed::BodyVelocity { .. }
            | Observed::TurnRate(_)
            | Observed::WheelAccelerations { .. }
            | Observed::Fix(_)
            | Observed::Landmark { .. }
            | Observed::BeaconRange { .. }
            | Observed::WallRange(_)
            | Observed::CompassHeading(_)
            | Observed::Temperature(_) => Verdict::Unused,
        }
    }

    fn take_wheels(&mut self, stamp: Stamp<BrickClock>, angles_rad: [f64; 2], record: &mut FusionRecord) -> Verdict {
        let reading = self.counters.read(stamp, angles_rad, &self.context.config);
        let mut next = self.last;
        let verdict = match reading {
            Reading::Refused(verdict) => return verdict,
            Reading::First | Reading::Rebased => {
                next.advance_to(stamp, &self.context);
                next.maths.rebase_wheels(&self.context);
                if reading == Reading::First { Verdict::Accepted } else { Verdict::Rebased }
            }
            Reading::Step(step) => {
                if step.is_gap() {
                    next.bridge(&step, stamp, &self.context);
                } else {
                    next.advance_to(stamp, &self.context);
                }
                next.maths.use_wheels(&step, &self.context, record)
            }
        };
        next.last_motion = next.last_motion.max(Some(stamp));
        self.keep(next);
        verdict
    }

    fn take_gyro(&mut self, stamp: Stamp<BrickClock>, rate_rad_per_s: f64, record: &mut FusionRecord) -> Verdict {
        if let Some(verdict) = intake::refuse_repeated(self.last_gyro, stamp) {
            return verdict;
        }
        let interval = self.last_gyro.map(|before| stamp - before);
        self.last_gyro = Some(stamp);
        let mut next = self.last;
        next.advance_to(stamp, &self.context);
        let short = interval.filter(|interval| *interval <= LONGEST_STEP);
        let verdict = if let Some(interval) = short {
            let dt_s = interval.as_secs_f64();
            next.maths.use_gyro(rate_rad_per_s, dt_s, &self.context, record)
        } else {
            next.maths.rebase_gyro();
            Verdict::Accepted
        };
        self.keep(next);
        verdict
    }

    fn take_accelerations(&mut self, stamp: Stamp<BrickClock>, felt: Acceleration) -> Verdict {
        if let Some(verdict) = intake::refuse_repeated(self.last_felt, stamp) {
            return verdict;
        }
        self.last_felt = Some(stamp);
        let mut next = self.last;
        next.advance_to(stamp, &self.context);
        next.felt = Some((stamp, felt));
        self.keep(next);
        Verdict::Accepted
    }

    fn take_fix(&mut self, observation: &Observation, fix: &Fix, record: &mut FusionRecord) -> Verdict {
        let before = self.last_fixes.get(&observation.sensor).copied();
        if let Some(verdict) = intake::refuse_repeated(before, observation.stamp) {
            return verdict;
        }
        let mut next = self.last;
        next.advance_to(observation.stamp, &self.context);
        let verdict = if next.is_placed {
            let stamp_sigma_s = observation.stamp_sigma.as_secs_f64();
            next.maths.use_fix(fix, stamp_sigma_s, &self.context, record)
        } else {
            place_at(&mut next.maths, fix, &self.context)
        };
        if verdict == Verdict::Accepted {
            next.is_placed = true;
            next.last_fix = next.last_fix.max(Some(observation.stamp));
            self.last_fixes.insert(observation.sensor, observation.stamp);
            self.keep(next);
        }
        verdict
    }

    fn published(&self, at: &Instant<M>, stamp: Stamp<BrickClock>) -> Estimate {
        let belief = at.maths.belief(&self.context);
        let fix_age = at.last_fix.map(|last_fix| (stamp - last_fix).max(Span::ZERO));
        let timeout = Span::from_secs_f64(self.context.config.params.fix_timeout_s);
        Estimate {
            stamp,
            pose: pose_of(&belief.mean),
            forward_speed: MetersPerSecond(belief.mean[row::FORWARD]),
            turn_rate: RadiansPerSecond(belief.mean[row::TURN]),
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| belief.covariance[(i, j)])),
            validity: Validity {
                position: at.is_placed,
                heading: at.is_placed,
                speeds: at.last_motion.is_some_and(|last| stamp - last <= SPEEDS_HELD),
            },
            is_dead_reckoning: fix_age.is_none_or(|age| age > timeout),
            fix_age,
            reset_counter: self.reset_counter,
            last_jump: self.last_jump,
        }
    }
}

/// Places a robot that nobody has placed yet: a fix without a heading cannot.
fn place_at(maths: &mut impl Maths, fix: &Fix, context: &Context) -> Verdict {
    let Some(heading) = fix.heading else {
        return Verdict::Unused;
    };
    let circumstances = Circumstances::default();
    let noise = noise_of(fix, &context.config.noise, [1.0, 1.0], &circumstances);
    maths.place(&StartPose {
        pose: mid_axle(fix, heading.rad()),
        position_sigma_m: (0.5 * noise.position.trace()).sqrt(),
        heading_sigma_rad: noise.heading_rad2.sqrt(),
    });
    Verdict::Accepted
}

fn pose_of(mean: &Mean) -> Pose<posebridge_telemetry::Arena> {
    Pose::new(Meters(mean[row::X]), Meters(mean[row::Y]), Heading::from_rad(mean[row::HEADING]))
}

impl<M: Maths> Filter for OnArrival<M> {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let latest = self.latest();
        let lag = intake::lag_of(observation, latest);
        let mut record = intake::bare_record(observation, lag, Verdict::Accepted);
        let history_s = self.context.config.params.history_s;
        record.verdict = match intake::refuse_outright(observation, latest, history_s) {
            Some(verdict) => verdict,
            None => self.take(observation, &mut record),
        };
        record
    }

    fn set_pose(&mut self, start: &StartPose) -> Verdict {
        if !intake::is_usable(start) {
            return Verdict::Malformed;
        }
        let mut next = self.last;
        let before = pose_of(&next.maths.belief(&self.context).mean);
        next.maths.place(start);
        next.is_placed = true;
        self.begin(next);
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.last_jump = Some(intake::jump_between(before, start.pose));
        Verdict::ResetTo
    }

    fn restart_clock(&mut self) {
        let mut next = Instant { stamp: None, felt: None, last_motion: None, last_fix: None, ..self.last };
        let position_m = intake::RESTART_POSITION_M;
        let heading_rad = intake::RESTART_HEADING_RAD;
        next.maths.restart(position_m, heading_rad, &self.context);
        self.counters = Counters::default();
        self.last_gyro = None;
        self.last_felt = None;
        self.last_fixes.clear();
        self.begin(next);
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.last.stamp
    }

    fn calibration(&self) -> Option<Calibration> {
        let gyro_bias_rad_per_s = self.last.maths.gyro_bias()?;
        Some(Calibration { gyro_bias_rad_per_s, ..self.context.config.calibration })
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let (_, mut at) = self.past.up_to(stamp)?;
        at.advance_to(stamp, &self.context);
        Some(self.published(&at, stamp))
    }
}
