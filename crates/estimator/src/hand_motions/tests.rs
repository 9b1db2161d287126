//! Robots with known geometry, moved by a hand that does what it is asked, or something else.

use std::f64::consts::TAU;

use posebridge_telemetry::{
    Observation, ObservationKind, Polarity, Radians, RadiansPerSecond, SensorId, TimeDelta, Timestamp, UncertainValue,
    WheelOrder,
};

use super::*;

/// 30 mm wheels on a track of 150 mm, 600 counts per turn, a gyro with a bias.
struct Hand {
    guide: SetupGuide,
    at_ms: i64,
    /// Of the left and of the right wheel, in turns.
    turned: [f64; 2],
    /// Counts, or metres, of the counters for the turns of the wheels.
    counters: fn([f64; 2]) -> [f64; 2],
    gyro_scale: f64,
    events: Vec<GuideEvent>,
}

const RADIUS_M: f64 = 0.03;
const TRACK_M: f64 = 0.15;
const BIAS: f64 = 0.1;
const PERIOD_MS: i64 = 50;

impl Hand {
    fn new(counters: fn([f64; 2]) -> [f64; 2], gyro_scale: f64) -> Self {
        let guide = SetupGuide::new(GuideSettings::default());
        let mut hand = Self { guide, at_ms: 7_000, turned: [0.0; 2], counters, gyro_scale, events: Vec::new() };
        hand.rest(3.0);
        hand
    }

    fn step(&mut self, wheels: [f64; 2], turn_rad_per_s: f64) {
        self.at_ms += PERIOD_MS;
        self.turned = [self.turned[0] + wheels[0], self.turned[1] + wheels[1]];
        let [left, right] = (self.counters)(self.turned);
        let observe = |sensor, measurement| Observation {
            sensor,
            stamp: Timestamp::from_millis(self.at_ms),
            stamp_sigma: TimeDelta::ZERO,
            measurement,
        };
        let wheels = ObservationKind::WheelAngles { left: Radians(left), right: Radians(right) };
        let rate = RadiansPerSecond(self.gyro_scale * turn_rad_per_s + BIAS);
        for observation in [observe(SensorId::GYRO, ObservationKind::TurnRate(rate)), observe(SensorId::WHEELS, wheels)]
        {
            self.events.extend(self.guide.push(&observation));
        }
    }

    fn rest(&mut self, seconds: f64) {
        for _ in 0..(seconds * 20.0) as u32 {
            self.step([0.0; 2], 0.0);
        }
    }

    /// Moves the wheels by so many turns within two seconds.
    fn move_by(&mut self, wheels: [f64; 2], turn_rad: f64) {
        for _ in 0..40 {
            self.step([wheels[0] / 40.0, wheels[1] / 40.0], turn_rad / 2.0);
        }
        self.rest(3.0);
    }

    fn do_all(&mut self) -> DriveFigures {
        self.move_by([1.0, 0.0], 0.0);
        let metre = 1.0 / (TAU * RADIUS_M);
        self.move_by([metre, metre], 0.0);
        let half_turn = 0.5 * TAU * TRACK_M / (TAU * RADIUS_M);
        self.move_by([-half_turn, half_turn], TAU);
        self.guide.result(360.0)
    }
}

fn counted(turns: [f64; 2]) -> [f64; 2] {
    turns.map(|turn| (600.0 * turn).floor())
}

fn assert_near(found: UncertainValue, expected: f64, relative: f64) {
    assert!((found.value / expected - 1.0).abs() < relative, "{found:?} for {expected}");
    assert!(found.sigma > 0.0 && found.sigma < 0.03 * expected, "{found:?}");
}

fn assert_geometry(figures: &DriveFigures) {
    assert_near(figures.ticks_per_turn.unwrap(), 600.0, 0.003);
    for radius in figures.radii_m.unwrap() {
        assert_near(radius, RADIUS_M, 0.003);
    }
    assert_near(figures.track_m.unwrap(), TRACK_M, 0.003);
}

#[test]
fn three_motions_show_the_geometry_and_nothing_wrong() {
    let mut hand = Hand::new(counted, 1.0);
    let figures = hand.do_all();
    assert_geometry(&figures);
    assert_eq!((figures.order, figures.polarity), (WheelOrder::AsNamed, [Polarity::Normal; 2]));
    assert_near(figures.gyro_ratio.unwrap(), 1.0, 0.01);
    assert_eq!(hand.guide.step(), None);
    let of_each = |step| [GuideEvent::MotionBegan(step), GuideEvent::StepDone(step)];
    assert_eq!(hand.events, GuideStep::ALL.map(of_each).concat());
}

#[test]
fn swapped_and_reversed_counters_and_a_gyro_in_degrees_are_seen() {
    // The left wheel's counter is the right one, and the right wheel counts backwards.
    let swapped = |[left, right]: [f64; 2]| counted([-right, left]);
    let figures = Hand::new(swapped, -TAU.recip() * 360.0).do_all();
    assert_geometry(&figures);
    assert_eq!(figures.order, WheelOrder::Swapped);
    assert_eq!(figures.polarity, [Polarity::Normal, Polarity::Reversed]);
    let ratio = figures.gyro_ratio.unwrap().value;
    assert_eq!(GyroScale::from_ratio(ratio), GyroScale::DegreesPerSecond);
    assert!(ratio < 0.0);
    // Without the turned wheel the turn on the spot shows it.
    let mut hand = Hand::new(swapped, 1.0);
    hand.guide.skip();
    let metre = 1.0 / (TAU * RADIUS_M);
    hand.move_by([metre, metre], 0.0);
    hand.move_by([-2.5, 2.5], TAU);
    assert_eq!(hand.guide.result(600.0).order, WheelOrder::Swapped);
}

#[test]
fn a_robot_that_reports_metres_knows_its_wheels() {
    let metres = |turns: [f64; 2]| turns.map(|turn| 0.98 * TAU * RADIUS_M * turn);
    let mut hand = Hand::new(metres, 1.0);
    hand.guide.skip();
    let metre = 1.0 / (TAU * RADIUS_M);
    hand.move_by([metre, metre], 0.0);
    hand.move_by([-2.5, 2.5], TAU);
    let figures = hand.guide.result(360.0);
    assert_eq!(figures.radii_m, None);
    for scale in figures.reported_m.unwrap() {
        assert_near(scale, 1.0 / 0.98, 0.001);
    }
    assert_near(figures.track_m.unwrap(), TRACK_M, 0.003);
}

#[test]
fn what_was_not_asked_for_is_told_and_asked_for_again() {
    let mut hand = Hand::new(counted, 1.0);
    hand.move_by([2.0, 2.0], 0.0);
    assert!(matches!(hand.events[1], GuideEvent::StepFailed(GuideStep::WheelTurn, MotionProblem::BothWheels { .. })));
    // A nudge is no motion.
    hand.move_by([0.004, 0.0], 0.0);
    assert_eq!(hand.events.len(), 2);
    hand.move_by([1.0, 0.0], 0.0);
    hand.move_by([1.0, 0.0], 0.0);
    hand.move_by([1.0, 0.5], 0.0);
    hand.move_by([5.0, 5.0], 0.0);
    hand.move_by([5.0, 5.0], 0.0);
    hand.move_by([2.5, -2.5], -TAU);
    let problems: Vec<MotionProblem> = hand
        .events
        .iter()
        .filter_map(|event| if let GuideEvent::StepFailed(_, problem) = event { Some(*problem) } else { None })
        .collect();
    assert!(
        matches!(
            problems[1..],
            [
                MotionProblem::OneWheel { .. },
                MotionProblem::Unequal { .. },
                MotionProblem::NotOnSpot { .. },
                MotionProblem::Clockwise
            ]
        ),
        "{problems:?}"
    );
    hand.guide.repeat();
    assert_eq!(hand.guide.step(), Some(GuideStep::Straight));
}

#[test]
fn a_person_may_end_a_motion_and_name_one() {
    let mut hand = Hand::new(counted, 1.0);
    let begin = Timestamp::from_millis(hand.at_ms);
    for _ in 0..40 {
        hand.step([0.025, 0.0], 0.0);
    }
    assert_eq!(hand.guide.end_motion(), Some(GuideEvent::StepDone(GuideStep::WheelTurn)));
    assert_eq!(hand.guide.end_motion(), None, "it rests");
    let end = Timestamp::from_millis(hand.at_ms);
    let motion = hand.guide.log().motion_between(begin, end).unwrap();
    assert_eq!(motion.change, [600.0, 0.0]);
    assert_eq!(hand.guide.log().motion_between(end, begin), None);
}
