//! How small the error over drives can be at all: the posterior Cramer-Rao bound, added up like a [`Score`](super::Score).
//!
//! # Source
//! [`posebridge_estimator::smoother::cramer_rao`], which says what it assumes.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::smoother::{FixArrival, FixContent, GroundTruthRun, cramer_rao_bound};
use posebridge_telemetry::{DriveGeometry, ObservationKind, Radians};

use super::{ObservationArrival, ReferenceDrive};

/// What the wheels really turned over one step, before encoders round it; slip does not show in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WheelRotation {
    /// The left wheel, forward positive.
    pub left: Radians,
    /// The right wheel, forward positive.
    pub right: Radians,
}

/// The least mean squared position error over the steps of one drive or of many.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BoundSum {
    sum_m2: f64,
    steps: u64,
}

impl BoundSum {
    /// The bound of a drive for a filter of this configuration, over the steps that count.
    ///
    /// `wheel_turns` holds one entry for each step. `None` where the bound does not apply: other than one turn per step, a stamp
    /// of a fix that is no step's, or a bound that is no number.
    pub fn from_drive(config: &FilterConfig, drive: &ReferenceDrive, wheel_turns: &[WheelRotation]) -> Option<Self> {
        let [first, second, ..] = drive.truth.as_slice() else {
            return None;
        };
        if wheel_turns.len() + 1 != drive.truth.len() {
            return None;
        }
        let poses: Vec<_> = drive.truth.iter().map(|truth| truth.pose).collect();
        let travel: Vec<WheelTravel> = wheel_turns.iter().map(|turn| nominal_travel(*turn, &config.geometry)).collect();
        let run = GroundTruthRun {
            poses: &poses,
            travel: &travel,
            step_s: (second.time - first.time).as_secs_f64(),
            fixes: &fixes(drive)?,
        };
        let after_steps = cramer_rao_bound(config, &run);
        let scored = after_steps.into_iter().skip(drive.scored_from.saturating_sub(1));
        let mut sum = Self::default();
        for variance_m2 in scored {
            sum.sum_m2 += variance_m2;
            sum.steps += 1;
        }
        sum.sum_m2.is_finite().then_some(sum)
    }

    /// Adds another one. The result depends on the order in the last digits: add them in the order of the runs.
    pub fn merge(&mut self, other: &Self) {
        self.sum_m2 += other.sum_m2;
        self.steps += other.steps;
    }

    /// The root mean square position error that no filter can be better than, in metres; `None` without a step.
    pub fn rms_m(&self) -> Option<f64> {
        (self.steps > 0).then(|| (self.sum_m2 / self.steps as f64).sqrt())
    }
}

/// Travel as a filter sees it that takes its geometry as given.
fn nominal_travel(turn: WheelRotation, geometry: &DriveGeometry) -> WheelTravel {
    WheelTravel {
        left_m: turn.left.0 * geometry.left_wheel_radius.0,
        right_m: turn.right.0 * geometry.right_wheel_radius.0,
    }
}

/// The fixes by their steps; `None` if one is of an instant between steps.
fn fixes(drive: &ReferenceDrive) -> Option<Vec<FixArrival>> {
    let of_fix = |arrival: &ObservationArrival| {
        let ObservationKind::Fix(fix) = arrival.observation.measurement else {
            return None;
        };
        let stamp = arrival.observation.stamp;
        let taken = drive.truth.binary_search_by_key(&stamp, |truth| truth.time);
        Some(taken.ok().map(|taken| FixArrival {
            exposure_step: taken,
            arrival_step: arrival.step,
            content: if fix.heading.is_some() { FixContent::Pose } else { FixContent::Position },
        }))
    };
    drive.arrivals.iter().filter_map(of_fix).collect()
}
