//! Drives that are altered on their way to the filter, and what the filter made of them.

use std::ops::Range;

use posebridge_telemetry::{
    Estimate, Fix, FusionOutcome, FusionRecord, Meters, Observation, ObservationKind, Radians, TimeDelta,
};

use super::score::{FilterRun, error_of};
use super::simulation::{Camera, Drive, STEP_S, stamp};

/// The steps of the first corner, from rest to rest, and of the straight before it.
pub(crate) const CORNER: Range<usize> = 366..410;
pub(crate) const STRAIGHT: Range<usize> = 41..347;

/// 10 Hz, 100 ± 50 ms late.
pub(crate) const CAMERA: Camera = Camera { every: 2, delay: 2, spread: 1, outliers: 0.0 };
/// 10 Hz, at once.
pub(crate) const PROMPT_CAMERA: Camera = Camera { every: 2, delay: 0, spread: 0, outliers: 0.0 };

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

/// Adds `extra` of each step to the wheels' rotation, in radians: left, right.
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

/// What became of the observations of a kind that were made during some steps.
pub(crate) fn records<'a>(played: &'a FilterRun, kind: &str, steps: &Range<usize>) -> Vec<&'a FusionRecord> {
    let during = stamp(steps.start)..stamp(steps.end);
    played.records.iter().filter(|record| record.kind == kind && during.contains(&record.stamp)).collect()
}

pub(crate) fn fixes<'a>(played: &'a FilterRun, steps: &Range<usize>) -> Vec<&'a FusionRecord> {
    records(played, "fix", steps)
}

pub(crate) fn share_accepted(records: &[&FusionRecord]) -> f64 {
    let accepted = records.iter().filter(|record| record.outcome == FusionOutcome::Accepted);
    accepted.count() as f64 / records.len() as f64
}

/// Fixes of a tag off their lever, (forward, left) in m, as a camera sees it that gives the robot's own pose; their
/// stamps are `late` after the instant that they show.
pub(crate) fn with_tag_moved(drive: Drive, (forward_m, left_m): (f64, f64), late: TimeDelta) -> Drive {
    let poses = drive.poses.clone();
    altered(drive, |observation| {
        let ObservationKind::Fix(mut fix) = observation.measurement else {
            return Some(observation);
        };
        let (sin, cos) = poses[step_of(&observation) - 1].2.sin_cos();
        fix.position.x += Meters(cos * forward_m - sin * left_m);
        fix.position.y += Meters(sin * forward_m + cos * left_m);
        Some(Observation { stamp: observation.stamp + late, measurement: ObservationKind::Fix(fix), ..observation })
    })
}
