//! The guide through three motions by hand: which is next, whether it was the right one, and what all of them show.

use std::f64::consts::TAU;

use posebridge_telemetry::{Observation, Polarity, TimeDelta, UncertainValue, WheelOrder};

use super::figures::{MotionProblem, Side, SpotTurn, StraightRoll, WheelTurn};
use super::log::{Motion, MotionLog, WheelUnit};

/// A motion that the guide asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuideStep {
    /// The left wheel, forward, the robot lifted.
    WheelTurn,
    Straight,
    /// To the left.
    SpotTurn,
}

impl GuideStep {
    pub const ALL: [Self; 3] = [Self::WheelTurn, Self::Straight, Self::SpotTurn];

    /// The word for it in flags and messages.
    pub const fn flag_name(self) -> &'static str {
        match self {
            Self::WheelTurn => "wheel",
            Self::Straight => "straight",
            Self::SpotTurn => "turn",
        }
    }
}

/// How far each motion goes, and what is known without it.
#[derive(Clone, Debug, PartialEq)]
pub struct GuideSettings {
    /// In their order; a straight roll comes before a turn on the spot, whose figures need it.
    pub steps: Vec<GuideStep>,
    pub wheel_turns: f64,
    pub straight_m: f64,
    pub turns: f64,
    /// A motion is over when the wheels did not count for so long.
    pub rest: TimeDelta,
    /// Counts per turn of a wheel, if a person knows them.
    pub ticks_per_turn: Option<f64>,
}

impl Default for GuideSettings {
    fn default() -> Self {
        Self {
            steps: GuideStep::ALL.to_vec(),
            wheel_turns: 1.0,
            straight_m: 1.0,
            turns: 1.0,
            rest: TimeDelta::from_millis(2_000),
            ticks_per_turn: None,
        }
    }
}

/// What happened with an observation, or when a person ended a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GuideEvent {
    MotionBegan(GuideStep),
    StepDone(GuideStep),
    /// The step is to be repeated.
    StepFailed(GuideStep, MotionProblem),
}

/// What the motions show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandFigures {
    pub wheel: Option<WheelTurn>,
    pub straight: Option<StraightRoll>,
    pub spot: Option<SpotTurn>,
}

/// Asks for the motions of one robot, one after the other.
#[derive(Clone, Debug)]
pub struct SetupGuide {
    settings: GuideSettings,
    log: MotionLog,
    done: Vec<GuideStep>,
    next: usize,
    was_moving: bool,
    last_motion: Option<Motion>,
    figures: HandFigures,
}

impl SetupGuide {
    pub fn new(settings: GuideSettings) -> Self {
        Self {
            log: MotionLog::new(settings.rest),
            settings,
            done: Vec::new(),
            next: 0,
            was_moving: false,
            last_motion: None,
            figures: HandFigures::default(),
        }
    }

    /// The motion that it waits for; `None` after the last.
    pub fn step(&self) -> Option<GuideStep> {
        self.settings.steps.get(self.next).copied()
    }

    pub const fn settings(&self) -> &GuideSettings {
        &self.settings
    }

    pub const fn log(&self) -> &MotionLog {
        &self.log
    }

    pub const fn figures(&self) -> &HandFigures {
        &self.figures
    }

    /// Takes an observation. Its wheel angles are the robot's counts, or metres.
    pub fn push(&mut self, observation: &Observation) -> Option<GuideEvent> {
        if let Some(motion) = self.log.push(observation) {
            self.was_moving = false;
            return self.apply(&motion);
        }
        let began = self.log.is_moving() && !self.was_moving;
        self.was_moving = self.log.is_moving();
        self.step().filter(|_| began).map(GuideEvent::MotionBegan)
    }

    /// A person says that the motion is over.
    pub fn end_motion(&mut self) -> Option<GuideEvent> {
        let motion = self.log.end_motion()?;
        self.was_moving = false;
        self.apply(&motion)
    }

    /// Leaves the present step out.
    pub fn skip(&mut self) {
        self.next += 1;
    }

    /// Asks for the last motion again.
    pub fn repeat(&mut self) {
        if let Some(step) = self.done.pop() {
            self.next = self.settings.steps.iter().position(|other| *other == step).unwrap_or(self.next);
        }
    }

    /// Goes to this step, whatever was done before.
    pub fn go_to(&mut self, step: GuideStep) {
        self.next = self.settings.steps.iter().position(|other| *other == step).unwrap_or(self.next);
    }

    /// Takes the last motion for that of the present step, too.
    pub fn repeat_motion(&mut self) -> Option<GuideEvent> {
        self.last_motion.and_then(|motion| self.apply(&motion))
    }

    /// Forgets what was done.
    pub fn restart(&mut self) {
        self.next = 0;
        self.done.clear();
        self.figures = HandFigures::default();
    }

    /// Takes a motion for that of the present step.
    pub fn apply(&mut self, motion: &Motion) -> Option<GuideEvent> {
        let step = self.step()?;
        self.last_motion = Some(*motion);
        let result = match step {
            GuideStep::WheelTurn => WheelTurn::new(motion, self.log.unit(), Side::Left, self.settings.wheel_turns)
                .map(|wheel| self.figures.wheel = Some(wheel)),
            GuideStep::Straight => {
                let wheel = self.figures.wheel;
                let is_against = |straight: &StraightRoll| {
                    wheel.is_some_and(|wheel| straight.polarity[wheel.counter.index()] != wheel.polarity)
                };
                let rolled = StraightRoll::new(motion, self.log.unit(), self.settings.straight_m);
                rolled.and_then(|straight| {
                    if is_against(&straight) {
                        return Err(MotionProblem::AgainstWheel);
                    }
                    self.figures.straight = Some(straight);
                    Ok(())
                })
            }
            GuideStep::SpotTurn => {
                // Without a straight roll the counters are taken for forward and of one size.
                let straight = self.figures.straight.unwrap_or(UNKNOWN_ROLL);
                let order = self.figures.wheel.map(|wheel| wheel.order());
                SpotTurn::new(motion, self.log.unit(), &straight, order, self.settings.turns)
                    .map(|spot| self.figures.spot = Some(spot))
            }
        };
        Some(match result {
            Ok(()) => {
                self.next += 1;
                self.done.push(step);
                GuideEvent::StepDone(step)
            }
            Err(problem) => GuideEvent::StepFailed(step, problem),
        })
    }

    /// All that the motions show of the robot; `known_ticks_per_turn` stands in where no wheel was turned.
    pub fn result(&self, known_ticks_per_turn: f64) -> DriveFigures {
        let HandFigures { wheel, straight, spot } = self.figures;
        let order = wheel.map(|wheel| wheel.order()).or(spot.map(|spot| spot.order)).unwrap_or(WheelOrder::AsNamed);
        let counted = wheel.and_then(|wheel| wheel.ticks_per_turn);
        let given = self.settings.ticks_per_turn.map(|value| UncertainValue { value, sigma: 0.0 });
        let ticks_per_turn = given.or(counted);
        let used = ticks_per_turn.map_or(known_ticks_per_turn, |ticks| ticks.value.round());
        // The counter of each wheel.
        let counters = match order {
            WheelOrder::AsNamed => [Side::Left, Side::Right],
            WheelOrder::Swapped => [Side::Right, Side::Left],
        };
        let radii_m = straight.filter(|_| self.log.unit() == WheelUnit::Counts).map(|straight| {
            counters.map(|counter| {
                let UncertainValue { value, sigma } = straight.m_per_count[counter.index()];
                UncertainValue { value: value * used / TAU, sigma: sigma * used / TAU }
            })
        });
        // A wheel in the air shows its sign; a roll shows both.
        let in_air = |side: Side| wheel.filter(|wheel| wheel.counter == side).map(|wheel| wheel.polarity);
        let polarity = counters.map(|counter| {
            let rolled = straight.map(|straight| straight.polarity[counter.index()]);
            rolled.or(in_air(counter)).unwrap_or(Polarity::Normal)
        });
        DriveFigures {
            ticks_per_turn,
            radii_m,
            reported_m: straight
                .filter(|_| self.log.unit() == WheelUnit::Meters)
                .map(|straight| counters.map(|counter| straight.m_per_count[counter.index()])),
            track_m: spot.filter(|_| straight.is_some()).map(|spot| spot.track_m),
            order,
            polarity,
            gyro_ratio: spot.and_then(|spot| spot.gyro_ratio),
            gyro_step: self.log.gyro_step(),
        }
    }
}

const UNKNOWN_ROLL: StraightRoll =
    StraightRoll { m_per_count: [UncertainValue { value: 1.0, sigma: 0.0 }; 2], polarity: [Polarity::Normal; 2] };

/// Geometry and wiring of a robot. The radii and the track do not depend on the hand that turned the wheel: a wrong number of ticks per turn
/// makes a wrong radius, and the product of both is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveFigures {
    /// `None` where nobody knows or turned a wheel.
    pub ticks_per_turn: Option<UncertainValue>,
    /// Of the left and of the right wheel.
    pub radii_m: Option<[UncertainValue; 2]>,
    /// True metres per metre that the robot reports, of a robot that reports distances.
    pub reported_m: Option<[UncertainValue; 2]>,
    pub track_m: Option<UncertainValue>,
    pub order: WheelOrder,
    /// Of the left and of the right wheel, behind `order`.
    pub polarity: [Polarity; 2],
    pub gyro_ratio: Option<UncertainValue>,
    /// The step of a gyro that rounds, in the unit of its readings; `None` of one that does not.
    pub gyro_step: Option<f64>,
}
