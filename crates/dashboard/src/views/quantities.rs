//! A quantity over time, reading by reading: the one that a robot's filter knows, and the thermometers.

use posebridge_telemetry::{
    ChannelName, Event, FusionOutcome, ObservationKind, QuantitySteps, RobotId, ScalarEstimate,
};

use super::observations::priority_of;
use super::retained_series::{BoundedMap, MAX_ROBOTS, PointPriority, RetainedSeriesMap, SeriesView};
use super::view::ViewConfig;
use crate::model::{Number, QuantityPoint, seconds_of};

/// Most thermometers of all bricks, so that the history of all together is a message that a browser can process.
const MAX_THERMOMETERS: usize = 64;
/// A thermometer needs minutes where a distance needs seconds.
const THERMOMETER_WINDOW_FACTOR: i64 = 10;
/// Divisor of the history of one thermometer.
const THERMOMETER_SHARE: usize = 6;

/// A reading with its outcome.
#[derive(Clone, Copy, Debug)]
struct Reading {
    value: f64,
    outcome: FusionOutcome,
}

/// What is known of a robot's quantity between two estimates.
#[derive(Default)]
pub(super) struct RobotQuantity {
    steps: QuantitySteps,
    /// Its record follows.
    value: Option<f64>,
    reading: Option<Reading>,
    kind: &'static str,
    unit: &'static str,
}

impl RobotQuantity {
    fn point(&mut self, t_s: f64, estimate: Option<&ScalarEstimate>) -> (QuantityPoint, PointPriority) {
        let reading = self.reading.take();
        let number = |read: fn(&ScalarEstimate) -> f64| Number::from(estimate.map_or(f64::NAN, read));
        let point = QuantityPoint {
            t_s,
            name: String::new(),
            kind: self.kind.into(),
            unit: self.unit.into(),
            reading: reading.map_or(f64::NAN, |reading| reading.value).into(),
            verdict: reading.map_or("", |reading| reading.outcome.reason()).into(),
            estimate: number(|estimate| estimate.value),
            bound_95: number(ScalarEstimate::bound_95),
            rate_per_s: number(|estimate| estimate.rate_per_s),
            steps: self.steps.taken(),
            predicted: self.steps.predicted(),
        };
        (point, reading.map_or(PointPriority::Normal, |reading| priority_of(reading.outcome)))
    }
}

/// The quantity that a robot's filter knows. A point is a step of the filter, with the reading of that step; further readings of a step
/// have points without an estimate.
pub(super) fn quantities(config: &ViewConfig) -> SeriesView<BoundedMap<RobotId, RobotQuantity>, (), QuantityPoint> {
    SeriesView {
        state: BoundedMap::default(),
        points: RetainedSeriesMap::new(config.retention, MAX_ROBOTS),
        observe: |robots, now, event| {
            #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
            let (robot, point) = match event {
                Event::ObservationAligned { robot, observation, .. } => {
                    let value = reading_value(&observation.measurement)?;
                    robots.get_or_insert(*robot, RobotQuantity::default)?.value = Some(value);
                    return None;
                }
                Event::ObservationFused { robot, record } => {
                    if !QuantitySteps::is_reading(record) {
                        return None;
                    }
                    let known = robots.get_or_insert(*robot, RobotQuantity::default)?;
                    // Before the first estimate nobody knows whether the filter is one of a quantity: filters of a pose read distances, too.
                    let is_shown = known.reading.is_some() && known.steps.taken() > 0;
                    let earlier = is_shown.then(|| known.point(seconds_of(now), None));
                    known.steps.observe(record);
                    known.kind = record.kind;
                    known.reading = known.value.take().map(|value| Reading { value, outcome: record.outcome });
                    (robot, earlier?)
                }
                Event::QuantityUpdated { robot, estimate } => {
                    let known = robots.get_or_insert(*robot, RobotQuantity::default)?;
                    known.unit = estimate.unit;
                    if !known.steps.step(estimate.stamp) {
                        return None;
                    }
                    (robot, known.point(seconds_of(now), Some(estimate)))
                }
                _ => return None,
            };
            Some(((*robot, ()), point.0, point.1))
        },
        write: |frame, points| frame.quantities.extend(points),
    }
}

fn reading_value(measurement: &ObservationKind) -> Option<f64> {
    #[expect(clippy::wildcard_enum_match_arm, reason = "the others are readings of no quantity")]
    match measurement {
        ObservationKind::WallRange(range) => Some(range.0),
        ObservationKind::Temperature(temperature) => Some(temperature.0),
        _ => None,
    }
}

/// The thermometers of all bricks with their predicted ends, whatever the robot's filter is.
pub(super) fn thermometers(
    config: &ViewConfig,
) -> SeriesView<BoundedMap<(RobotId, ChannelName), QuantitySteps>, ChannelName, QuantityPoint> {
    let policy = config.retention.lasting(THERMOMETER_WINDOW_FACTOR).map_points(|points| points / THERMOMETER_SHARE);
    SeriesView {
        state: BoundedMap::new(MAX_THERMOMETERS),
        points: RetainedSeriesMap::new(policy, MAX_THERMOMETERS),
        observe: |channels, now, event| {
            let Event::Temperature { brick, channel, stamp, shown, verdict, settled, .. } = event else {
                return None;
            };
            let steps = channels.get_or_insert((*brick, *channel), QuantitySteps::default)?;
            steps.observe_reading(*verdict);
            steps.step(*stamp);
            let number = |read: fn(&ScalarEstimate) -> f64| Number::from(settled.as_ref().map_or(f64::NAN, read));
            let point = QuantityPoint {
                t_s: seconds_of(now),
                name: channel.to_string(),
                kind: ObservationKind::Temperature(*shown).kind().into(),
                unit: "°C".into(),
                reading: shown.0.into(),
                verdict: verdict.reason().into(),
                estimate: number(|settled| settled.value),
                bound_95: number(ScalarEstimate::bound_95),
                rate_per_s: f64::NAN.into(),
                steps: steps.taken(),
                predicted: steps.predicted(),
            };
            Some(((*brick, *channel), point, priority_of(*verdict)))
        },
        write: |frame, points| frame.quantities.extend(points),
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{
        Address, BrickClock, Celsius, FusionRecord, Meters, Observation, SensorId, TimeDelta, Timestamp,
    };

    use super::super::tests::{at, history, robot, updates, view};
    use super::super::{FrameContent, View, ViewInput};
    use super::*;

    /// What the station emits for a reading.
    fn read(view: &mut dyn View, millis: i64, range_m: f64, outcome: FusionOutcome) {
        let observation = Observation {
            sensor: SensorId::RANGE,
            stamp: Timestamp::from_millis(millis),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::WallRange(Meters(range_m)),
        };
        let source = Address::new(1, 1);
        let record = FusionRecord::new(SensorId::RANGE, "wall_range", observation.stamp, outcome);
        let aligned = Event::ObservationAligned { robot: robot(), source, arrival: at(millis), observation };
        for event in [aligned, Event::ObservationFused { robot: robot(), record }] {
            assert!(event.is_for_viewers());
            view.observe(at(millis), ViewInput::Event(&event));
        }
    }

    fn scalar(stamp: Timestamp<BrickClock>, value: f64, unit: &'static str) -> ScalarEstimate {
        ScalarEstimate { stamp, value, sigma: 0.1, rate_per_s: -0.5, unit }
    }

    fn estimate(view: &mut dyn View, millis: i64, value: f64) {
        let estimate = scalar(Timestamp::from_millis(millis), value, "m");
        view.observe(at(millis), ViewInput::Event(&Event::QuantityUpdated { robot: robot(), estimate }));
    }

    fn near(number: Number, expected: f64) {
        let value = number.get().expect("it is a number");
        assert!((value - expected).abs() < 1e-5, "{value} {expected}");
    }

    #[test]
    fn each_step_has_its_reading_its_verdict_and_the_share_of_predictions_so_far() {
        let mut view = view("quantities");
        read(&mut *view, 0, 2.0, FusionOutcome::Accepted);
        estimate(&mut *view, 0, 2.0);
        // The wheels came: the same estimate again.
        estimate(&mut *view, 0, 2.0);
        // A burst of the link: two readings before the next estimate.
        read(&mut *view, 80, 1.9, FusionOutcome::Accepted);
        read(&mut *view, 80, 0.5, FusionOutcome::Gated);
        estimate(&mut *view, 80, 1.9);
        read(&mut *view, 160, 0.4, FusionOutcome::Gated);
        estimate(&mut *view, 80, 1.9);
        let frame = updates(&mut *view, FrameContent::Delta);
        let points = &frame.robots[0].quantities;
        let verdicts: Vec<&str> = points.iter().map(|point| &*point.verdict).collect();
        assert_eq!(verdicts, ["accepted", "accepted", "gated", "gated"]);
        assert_eq!(points[1].estimate.get(), None, "the second reading of this step has it");
        let last = &points[3];
        assert_eq!((last.name.as_str(), &*last.kind, &*last.unit), ("", "wall_range", "m"));
        near(last.reading, 0.4);
        near(last.estimate, 1.9);
        near(last.bound_95, 0.195_996_4);
        near(last.rate_per_s, -0.5);
        assert_eq!((last.steps, last.predicted), (3, 1));
        assert_eq!(history(&*view).robots, frame.robots);
    }

    #[test]
    fn the_ranges_of_a_filter_of_a_pose_are_no_quantity() {
        let mut view = view("quantities");
        for millis in 0..10 {
            read(&mut *view, 100 * millis, 1.0, FusionOutcome::Accepted);
        }
        assert!(updates(&mut *view, FrameContent::DeltaAndSummary).robots.is_empty());
        assert!(history(&*view).robots.is_empty());
    }

    #[test]
    fn a_thermometer_has_its_reading_and_its_end_and_none_while_nobody_can_tell() {
        let mut view = view("thermometers");
        for (millis, verdict, end) in [
            (0, FusionOutcome::Accepted, None),
            (500, FusionOutcome::Malformed, Some(48.7)),
            (1_000, FusionOutcome::Accepted, Some(48.6)),
        ] {
            let stamp = Timestamp::from_millis(millis);
            let event = Event::Temperature {
                brick: robot(),
                channel: ChannelName::from_bytes(b"temp1"),
                arrival: at(millis),
                stamp,
                shown: Celsius(20.0),
                verdict,
                settled: end.map(|value| scalar(stamp, value, "°C")),
            };
            view.observe(at(millis), ViewInput::Event(&event));
        }
        let frame = updates(&mut *view, FrameContent::Delta);
        let [first, _, last] = frame.robots[0].quantities.as_slice() else {
            panic!("{frame:?}");
        };
        assert_eq!((first.name.as_str(), first.estimate.get()), ("temp1", None));
        near(last.reading, 20.0);
        near(last.estimate, 48.6);
        assert_eq!((last.rate_per_s.get(), last.steps, last.predicted), (None, 3, 1));
    }

    #[test]
    fn thermometers_are_bounded_whoever_invents_them() {
        let mut view = view("thermometers");
        for number in 0..2 * MAX_THERMOMETERS {
            let event = Event::Temperature {
                brick: robot(),
                channel: ChannelName::from_bytes(format!("temp{number}").as_bytes()),
                arrival: at(0),
                stamp: Timestamp::ZERO,
                shown: Celsius(20.0),
                verdict: FusionOutcome::Accepted,
                settled: None,
            };
            view.observe(at(0), ViewInput::Event(&event));
        }
        assert_eq!(history(&*view).robots[0].quantities.len(), MAX_THERMOMETERS);
    }
}
