//! What wheels and gyro of one robot reported, and the motions between rests in it.

use posebridge_telemetry::{BrickClock, Observation, ObservationKind, TimeDelta, Timestamp};

use crate::numerics::quantization::find_quantization_step;

/// Bounds memory: an hour at 50 readings per second.
const MAX_SAMPLES: usize = 180_000;
/// Smaller changes are a shaken wheel or an encoder on an edge; counts and metres.
const NO_MOTION: [f64; 2] = [3.0, 0.002];
/// Changes while a wheel rests on an edge.
const JITTER: [f64; 2] = [1.0, 1e-9];
/// Gyro and wheels may be stamped a little differently: the gyro's turn is taken over this much more on both sides.
const GYRO_MARGIN: TimeDelta = TimeDelta::from_millis(200);
/// Longest part of a rest over which the gyro's bias is averaged.
const MAX_BIAS_TIME: TimeDelta = TimeDelta::from_millis(10_000);
/// A gyro that was silent for longer missed a part of a turn.
const MAX_GYRO_GAP_S: f64 = 0.5;

/// The unit of what the wheels report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelUnit {
    Counts,
    /// The robot knows its wheels and reports distances.
    Meters,
}

impl WheelUnit {
    const fn index(self) -> usize {
        match self {
            Self::Counts => 0,
            Self::Meters => 1,
        }
    }
}

/// A motion from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    pub begin: Timestamp<BrickClock>,
    pub end: Timestamp<BrickClock>,
    /// Change of the left and of the right counter.
    pub change: [f64; 2],
    /// The gyro's turn in its own unit, without its bias; `None` without a gyro.
    pub gyro_turn: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct WheelSample {
    at: Timestamp<BrickClock>,
    counts: [f64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct GyroSample {
    at: Timestamp<BrickClock>,
    rate: f64,
    /// Integral of the rate up to here.
    turn: f64,
}

/// Finds motions as the observations come.
#[derive(Clone, Debug)]
pub struct MotionLog {
    rest: TimeDelta,
    unit: WheelUnit,
    wheels: Vec<WheelSample>,
    gyro: Vec<GyroSample>,
    /// The counts of the present rest, or of the one before the present motion.
    base: Option<WheelSample>,
    last_change: Option<WheelSample>,
    is_moving: bool,
}

impl MotionLog {
    /// A motion ends when the wheels did not count for `rest`.
    pub const fn new(rest: TimeDelta) -> Self {
        Self {
            rest,
            unit: WheelUnit::Counts,
            wheels: Vec::new(),
            gyro: Vec::new(),
            base: None,
            last_change: None,
            is_moving: false,
        }
    }

    pub const fn unit(&self) -> WheelUnit {
        self.unit
    }

    pub const fn is_moving(&self) -> bool {
        self.is_moving
    }

    pub const fn has_wheels(&self) -> bool {
        self.base.is_some()
    }

    pub const fn has_gyro(&self) -> bool {
        !self.gyro.is_empty()
    }

    /// The step of a gyro that rounds, in the unit of its readings; `None` of one that does not.
    pub fn gyro_step(&self) -> Option<f64> {
        let rates: Vec<f64> = self.gyro.iter().map(|sample| sample.rate).collect();
        find_quantization_step(&rates)
    }

    /// The instant of the first and of the last reading of the wheels.
    pub fn span(&self) -> Option<(Timestamp<BrickClock>, Timestamp<BrickClock>)> {
        Some((self.wheels.first()?.at, self.wheels.last()?.at))
    }

    /// How far the wheels have counted since they rested.
    pub fn change_so_far(&self) -> [f64; 2] {
        let now = self.wheels.last().zip(self.base);
        now.map_or([0.0; 2], |(now, base)| difference(now.counts, base.counts))
    }

    /// Takes an observation; its wheel angles are counts, or metres. Returns the motion that ended with it. Other kinds of observation
    /// change nothing.
    #[expect(clippy::wildcard_enum_match_arm, reason = "a hand moves what wheels and gyro feel; the rest is of no use")]
    pub fn push(&mut self, observation: &Observation) -> Option<Motion> {
        match observation.measurement {
            ObservationKind::WheelAngles { left, right } => self.push_wheels(observation.stamp, [left.0, right.0]),
            ObservationKind::TurnRate(rate) => {
                self.push_gyro(observation.stamp, rate.0);
                None
            }
            _ => None,
        }
    }

    fn push_gyro(&mut self, at: Timestamp<BrickClock>, rate: f64) {
        let last = self.gyro.last().copied();
        // The rate is the mean since the reading before.
        let (turn, interval_s) = last.map_or((0.0, 0.0), |last| (last.turn, (at - last.at).as_secs_f64()));
        if interval_s < 0.0 {
            self.gyro.clear();
        }
        let covered_s = interval_s.clamp(0.0, MAX_GYRO_GAP_S);
        self.gyro.push(GyroSample { at, rate, turn: turn + rate * covered_s });
        limit(&mut self.gyro);
    }

    fn push_wheels(&mut self, at: Timestamp<BrickClock>, counts: [f64; 2]) -> Option<Motion> {
        if self.wheels.last().is_some_and(|last| at < last.at) {
            // A brick that was restarted begins anew.
            self.wheels.clear();
            self.base = None;
        }
        if counts.iter().any(|count| count.fract() != 0.0) {
            self.unit = WheelUnit::Meters;
        }
        let sample = WheelSample { at, counts };
        self.wheels.push(sample);
        limit(&mut self.wheels);
        let Some(base) = self.base else {
            self.base = Some(sample);
            self.last_change = Some(sample);
            self.is_moving = false;
            return None;
        };
        let last_change = self.last_change.unwrap_or(sample);
        if largest(difference(counts, last_change.counts)) > JITTER[self.unit.index()] {
            self.last_change = Some(sample);
        }
        if !self.is_moving {
            self.is_moving = largest(difference(counts, base.counts)) > NO_MOTION[self.unit.index()];
            if !self.is_moving && at - last_change.at >= self.rest {
                self.base = Some(sample);
            }
            return None;
        }
        (at - self.last_change?.at >= self.rest).then(|| self.end_motion()).flatten()
    }

    /// Ends the present motion now, as a person says; `None` while the wheels rest.
    pub fn end_motion(&mut self) -> Option<Motion> {
        let (base, last) = self.base.zip(self.wheels.last().copied())?;
        let end = self.last_change?.at;
        let is_motion = std::mem::replace(&mut self.is_moving, false);
        self.base = Some(last);
        self.last_change = Some(last);
        is_motion.then(|| self.motion(base, WheelSample { at: end, counts: last.counts }))
    }

    /// The motion between two instants that a person names.
    pub fn motion_between(&self, begin: Timestamp<BrickClock>, end: Timestamp<BrickClock>) -> Option<Motion> {
        let at = |instant: Timestamp<BrickClock>| {
            let after = self.wheels.partition_point(|sample| sample.at <= instant);
            self.wheels.get(after.saturating_sub(1)).copied()
        };
        let (first, last) = (at(begin)?, at(end)?);
        (first.at < last.at).then(|| self.motion(first, last))
    }

    fn motion(&self, from: WheelSample, to: WheelSample) -> Motion {
        let begin = self.motion_begin(from, to);
        Motion {
            begin,
            end: to.at,
            change: difference(to.counts, from.counts),
            gyro_turn: self.gyro_turn(begin, to.at),
        }
    }

    /// The last instant with the counts of the rest before.
    fn motion_begin(&self, from: WheelSample, to: WheelSample) -> Timestamp<BrickClock> {
        let first = self.wheels.partition_point(|sample| sample.at < from.at);
        let within = self.wheels.iter().skip(first).take_while(|sample| sample.at <= to.at);
        let is_at_rest =
            |sample: &&WheelSample| largest(difference(sample.counts, from.counts)) <= JITTER[self.unit.index()];
        within.take_while(is_at_rest).last().map_or(from.at, |sample| sample.at)
    }

    /// The gyro's turn, less what it reads in the rest before.
    fn gyro_turn(&self, begin: Timestamp<BrickClock>, end: Timestamp<BrickClock>) -> Option<f64> {
        let (begin, end) = (begin - GYRO_MARGIN, end + GYRO_MARGIN);
        let rest = self.rest_before(begin);
        let first = self.gyro.first()?.at;
        let bias = rest.filter(|rest| *rest >= first).and_then(|rest| {
            let rest_s = (begin - rest).as_secs_f64();
            (rest_s > 0.0).then_some((self.turn_at(begin)? - self.turn_at(rest)?) / rest_s)
        });
        let turn = self.turn_at(end)? - self.turn_at(begin)?;
        Some(turn - bias.unwrap_or(0.0) * (end - begin).as_secs_f64())
    }

    /// When the rest before `begin` began, or its last part.
    fn rest_before(&self, begin: Timestamp<BrickClock>) -> Option<Timestamp<BrickClock>> {
        let until = self.wheels.partition_point(|sample| sample.at <= begin);
        let counts = self.wheels.get(until.checked_sub(1)?)?.counts;
        let at_rest = self.wheels.get(..until)?.iter().rev();
        let jitter = JITTER[self.unit.index()];
        let at_rest = at_rest.take_while(|sample| {
            largest(difference(sample.counts, counts)) <= jitter && begin - sample.at <= MAX_BIAS_TIME
        });
        let start = at_rest.last()?.at + GYRO_MARGIN;
        let first = self.gyro.first()?.at;
        Some(start.max(first))
    }

    /// The gyro's integral at an instant, by a straight line between two readings.
    fn turn_at(&self, at: Timestamp<BrickClock>) -> Option<f64> {
        let after = self.gyro.partition_point(|sample| sample.at <= at);
        match (after.checked_sub(1).and_then(|before| self.gyro.get(before)), self.gyro.get(after)) {
            (Some(before), Some(after)) => {
                let share = (at - before.at).as_secs_f64() / (after.at - before.at).as_secs_f64();
                Some(before.turn + share * (after.turn - before.turn))
            }
            (before, after) => before.or(after).map(|sample| sample.turn),
        }
    }
}

fn limit<T>(samples: &mut Vec<T>) {
    if samples.len() > MAX_SAMPLES {
        samples.drain(..MAX_SAMPLES / 2);
    }
}

fn difference(later: [f64; 2], earlier: [f64; 2]) -> [f64; 2] {
    [later[0] - earlier[0], later[1] - earlier[1]]
}

fn largest(change: [f64; 2]) -> f64 {
    change[0].abs().max(change[1].abs())
}
