//! Drives that are altered on their way to the filter, and what the filter made of them.

use std::ops::Range;

use posebridge_estimator::{FilterConfig, StartPose};
use posebridge_telemetry::{
    Estimate, Fix, FusionOutcome, FusionRecord, Heading, Meters, Observation, ObservationKind, Pose, Radians, SensorId,
};

use crate::drive::{Camera, Drive, RobotSimulation, STEP_S, Scenario, stamp};
use crate::robot::config;
use crate::score::{FilterRun, error_of};

/// The steps of the first corner, from rest to rest, and of the straight before it.
pub(crate) const CORNER: Range<usize> = 366..410;
pub(crate) const STRAIGHT: Range<usize> = 41..347;

pub(crate) fn camera_10_hz() -> Scenario {
    Scenario { laps: 1, camera: Some(Camera { every: 2, delay: 2, spread: 1, outliers: 0.0 }) }
}

pub(crate) fn without_start() -> FilterConfig {
    FilterConfig { start: None, ..config() }
}

/// The same drive with other observations; those that become `None` never arrive.
pub(crate) fn altered(mut drive: Drive, alter: impl Fn(Observation) -> Option<Observation>) -> Drive {
    drive.arrivals.retain_mut(|arrival| {
        alter(arrival.observation).is_some_and(|altered| {
            arrival.observation = altered;
            true
        })
    });
    drive
}

pub(crate) fn altered_fixes(drive: Drive, alter: impl Fn(usize, Fix) -> Option<Fix>) -> Drive {
    altered(drive, |observation| {
        let ObservationKind::Fix(fix) = observation.measurement else {
            return Some(observation);
        };
        let fix = alter(step_of(&observation), fix)?;
        Some(Observation { measurement: ObservationKind::Fix(fix), ..observation })
    })
}

pub(crate) fn without_headings(drive: Drive) -> Drive {
    altered_fixes(drive, |_, fix| Some(Fix { heading: None, ..fix }))
}

/// Adds to the wheels' rotation what `extra` says of each step, in radians: left, right.
pub(crate) fn with_slip(drive: Drive, extra: impl Fn(usize) -> (f64, f64)) -> Drive {
    altered(drive, |observation| {
        let ObservationKind::WheelAngles { left, right } = observation.measurement else {
            return Some(observation);
        };
        let (left_rad, right_rad) = extra(step_of(&observation));
        Some(Observation {
            measurement: ObservationKind::WheelAngles {
                left: left + Radians(left_rad),
                right: right + Radians(right_rad),
            },
            ..observation
        })
    })
}

pub(crate) fn step_of(observation: &Observation) -> usize {
    ((observation.stamp - stamp(0)).as_secs_f64() / STEP_S).round() as usize
}

/// 0 before the steps, 1 after them, rising evenly in between.
pub(crate) fn share_done(steps: &Range<usize>, step: usize) -> f64 {
    let done = step.clamp(steps.start, steps.end) - steps.start;
    done as f64 / steps.len() as f64
}

pub(crate) fn at(played: &FilterRun, step: usize) -> Estimate {
    played.estimates[step - 1].expect("something was observed")
}

pub(crate) fn error_at(drive: &Drive, played: &FilterRun, step: usize) -> (f64, f64) {
    let [x, y, heading] = error_of(&at(played, step), drive.poses[step - 1]);
    (x.hypot(y), heading.abs())
}

/// What became of the fixes that were taken during some steps.
pub(crate) fn fixes<'a>(played: &'a FilterRun, steps: &Range<usize>) -> Vec<&'a FusionRecord> {
    let during = stamp(steps.start)..stamp(steps.end);
    let records = played.records.iter();
    records.filter(|record| record.sensor == SensorId::CAMERA && during.contains(&record.stamp)).collect()
}

pub(crate) fn share_accepted(records: &[&FusionRecord]) -> f64 {
    let accepted = records.iter().filter(|record| record.outcome == FusionOutcome::Accepted);
    accepted.count() as f64 / records.len() as f64
}

pub(crate) fn started_at(x_m: f64, y_m: f64, heading_rad: f64) -> FilterConfig {
    FilterConfig {
        start: Some(StartPose {
            pose: Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad)),
            position_sigma_m: 0.01,
            heading_sigma_rad: 0.02,
        }),
        ..config()
    }
}

/// A drive with steps of one's own, (distance, turn) each, in a world of one's own.
pub(crate) fn driven(
    world: &mut RobotSimulation,
    steps: impl IntoIterator<Item = (f64, f64)>,
    camera: Option<Camera>,
) -> Drive {
    let mut drive = Drive { poses: vec![], arrivals: vec![] };
    for step in steps {
        drive.append(world, step, camera);
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
    drive
}
