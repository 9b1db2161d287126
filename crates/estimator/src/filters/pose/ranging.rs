//! The pose from ranges to beacons alone: least squares over the ranges of some seconds, with the motion between them.
//!
//! ```text
//! minimise   sum huber((z_i - |L_i - X M_i|) / sigma_i)          M_i the tag's pose at range i in the body's present frame
//! ```
//! The distances to two beacons leave two positions and any heading, so the search starts from both in eight directions. A pose is
//! found when no other one explains the ranges nearly as well: that takes three beacons that are not in line, and a robot that moves.
//!
//! Source: docs/maths/pose.md section 4; Huber (1964) for the weights.

use std::f64::consts::{FRAC_PI_4, TAU};

use nalgebra::{Matrix3, Vector3};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{BrickClock, MountedSensor, TimeDelta, Timestamp};

use super::context::UpdateContext;
use super::recent_ranges::WINDOWS;
use super::recovery::PUT_DOWN;
use super::state::PoseState;
use crate::models::lie::Se2;
use crate::observations::absolute::range_variance;
use crate::observations::{MountingAxis, PoseView, StateTerm};

/// Share of the way between two ranges by which the motion may be wrong.
const MOTION_ERROR: f64 = 0.03;
/// Fewer say too little.
const MIN_RANGES: usize = 8;
const HEADINGS: usize = 8;
const STEPS: usize = 12;
/// Residuals beyond this many sigmas count linearly.
const HUBER: f64 = 2.0;
/// A range that is off by more sigmas is an outlier.
const OUTLIER_SIGMAS: f64 = 3.5;
/// Largest share of outliers.
const MAX_OUTLIERS: f64 = 0.3;
/// Another pose whose cost is larger by less may be the true one.
const AMBIGUITY: f64 = 12.0;
/// Two poses nearer than this are one.
const SAME_POSE_M_RAD: [f64; 2] = [0.3, 0.3];
/// A heading that is known less well is none.
const MAX_HEADING_SIGMA_RAD: f64 = 0.3;

/// A range with what is needed to predict it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocatedRange {
    /// In the arena, m.
    pub beacon: [f64; 2],
    /// The tag's position at the range's instant, in the body's present frame, m.
    pub tag: [f64; 2],
    pub range_m: f64,
    pub variance_m2: f64,
}

/// The pose that the ranges of the last seconds speak for, and the covariance of its error in the body.
pub(super) fn pose_from_ranges<const N: usize>(
    state: &PoseState<N>,
    context: &UpdateContext,
) -> Option<(Se2, Matrix3<f64>)> {
    let now = state.stamp?;
    let put_down = state.carried_at.map_or(now - WINDOWS[1], |last| last + PUT_DOWN);
    WINDOWS.iter().find_map(|window| find_pose(&located_ranges(state, context, (now - *window).max(put_down))))
}

/// The ranges since an instant, the latest first, corrected by what is known of their beacons.
fn located_ranges<const N: usize>(
    state: &PoseState<N>,
    context: &UpdateContext,
    from: Timestamp<BrickClock>,
) -> Vec<LocatedRange> {
    let view = state.view(&context.layout);
    let noise = &context.config.noise;
    let beacons = &context.config.arena_map.beacons;
    let [x_m, y_m] = [MountingAxis::Forward, MountingAxis::Left]
        .map(|axis| view.term(StateTerm::Mounting(MountedSensor::Beacons, axis)));
    let mounting = Se2 { x_m, y_m, heading_rad: 0.0 };
    let delay = TimeDelta::from_secs_f64(view.term(StateTerm::Delay(MountedSensor::Beacons)).clamp(-1.0, 1.0));
    let variance = |term| context.layout.row(term).map_or(0.0, |row| state.covariance[(row, row)]);
    let mut at = state.stamp.unwrap_or(Timestamp::ZERO);
    let mut moved = Se2::default();
    let recent = context.ranges.spread_between(from, at);
    recent
        .filter_map(|range| {
            let position = beacons.get(&range.beacon)?;
            let slot = beacons.keys().position(|id| *id == range.beacon)?;
            let shown = range.stamp - delay;
            moved = state.motion_between(shown, at, context).compose(moved);
            at = shown.min(at);
            let tag = moved.inverse().compose(mounting);
            let [offset, scale] = [StateTerm::BeaconOffset(slot), StateTerm::BeaconScale(slot)];
            let range_m = (range.range_m - view.term(offset)) / (1.0 + view.term(scale));
            let motion_m = MOTION_ERROR * tag.x_m.hypot(tag.y_m);
            let variance_m2 = range_variance(range.range_m, noise.beacon_range_m, noise.beacon_range_share)
                + variance(offset)
                + range.range_m.powi(2) * variance(scale)
                + motion_m.powi(2);
            let beacon = [position.x.0, position.y.0];
            Some(LocatedRange { beacon, tag: [tag.x_m, tag.y_m], range_m, variance_m2 })
        })
        .collect()
}

/// A pose that explains ranges.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    pose: Se2,
    cost: f64,
    /// H' R^-1 H over the pose's error in the body.
    information: Matrix3<f64>,
    outliers: usize,
}

/// The pose from ranges, the latest first, and the covariance of its error in the body; `None` where they do not determine it.
pub fn find_pose(ranges: &[LocatedRange]) -> Option<(Se2, Matrix3<f64>)> {
    if ranges.len() < MIN_RANGES {
        return None;
    }
    let mut best: Option<Candidate> = None;
    let mut other_cost = f64::INFINITY;
    for position in starting_positions(ranges)? {
        for k in 0..HEADINGS {
            let heading_rad = wrap_rad(k as f64 * FRAC_PI_4);
            let start = Se2 { x_m: position[0], y_m: position[1], heading_rad };
            let Some(found) = descend(ranges, start) else { continue };
            match best {
                Some(known) if is_same(known.pose, found.pose) => {
                    if found.cost < known.cost {
                        best = Some(found);
                    }
                }
                Some(known) if found.cost < known.cost => {
                    other_cost = other_cost.min(known.cost);
                    best = Some(found);
                }
                Some(_) => other_cost = other_cost.min(found.cost),
                None => best = Some(found),
            }
        }
    }
    let best = best?;
    let covariance = best.information.try_inverse()?;
    let is_plausible = (best.outliers as f64) <= MAX_OUTLIERS * ranges.len() as f64;
    let is_heading_known = covariance[(2, 2)] < MAX_HEADING_SIGMA_RAD.powi(2);
    let is_unambiguous = other_cost - best.cost > AMBIGUITY;
    (is_plausible && is_heading_known && is_unambiguous).then_some((best.pose, covariance))
}

fn is_same(one: Se2, other: Se2) -> bool {
    let turn_rad = wrap_rad(one.heading_rad - other.heading_rad);
    (one.x_m - other.x_m).hypot(one.y_m - other.y_m) < SAME_POSE_M_RAD[0] && turn_rad.abs() < SAME_POSE_M_RAD[1]
}

/// Where the circles of the latest range and of that to the beacon furthest from the first one's meet; where they do not, the points
/// between them.
fn starting_positions(ranges: &[LocatedRange]) -> Option<[[f64; 2]; 2]> {
    let first = ranges.first()?;
    let apart_m = |range: &LocatedRange| (range.beacon[0] - first.beacon[0]).hypot(range.beacon[1] - first.beacon[1]);
    let second = ranges.iter().max_by(|a, b| apart_m(a).total_cmp(&apart_m(b)))?;
    let baseline_m = apart_m(second);
    if baseline_m <= 0.0 {
        return None;
    }
    let along = [0, 1].map(|i| (second.beacon[i] - first.beacon[i]) / baseline_m);
    let along_m = (first.range_m.powi(2) - second.range_m.powi(2) + baseline_m.powi(2)) / (2.0 * baseline_m);
    let across_m = (first.range_m.powi(2) - along_m.powi(2)).max(0.0).sqrt();
    Some([across_m, -across_m].map(|across_m| {
        [
            first.beacon[0] + along_m * along[0] - across_m * along[1],
            first.beacon[1] + along_m * along[1] + across_m * along[0],
        ]
    }))
}

/// Gauss-Newton with Huber's weights from a start; `None` where the ranges do not determine a step.
fn descend(ranges: &[LocatedRange], start: Se2) -> Option<Candidate> {
    let mut at = start;
    for _ in 0..STEPS {
        let (candidate, gradient) = evaluate(ranges, at);
        // A little damping, for poses from which the ranges say nothing of the heading.
        let damped = candidate.information + Matrix3::from_diagonal(&Vector3::new(1e-3, 1e-3, 1e-3));
        let step = damped.try_inverse()? * gradient;
        let largest = step[0].hypot(step[1]).max(step[2].abs());
        let share = if largest > 1.0 { 1.0 / largest } else { 1.0 };
        at = at.compose(Se2::exp([share * step[0], share * step[1], share * step[2]]));
        at.heading_rad %= TAU;
        if largest < 1e-4 {
            break;
        }
    }
    let (candidate, _) = evaluate(ranges, at);
    candidate.cost.is_finite().then_some(candidate)
}

/// Cost and information at a pose, and H' R^-1 nu.
fn evaluate(ranges: &[LocatedRange], pose: Se2) -> (Candidate, Vector3<f64>) {
    let mut candidate = Candidate { pose, cost: 0.0, information: Matrix3::zeros(), outliers: 0 };
    let mut gradient = Vector3::zeros();
    for range in ranges {
        let beacon = pose.point_in_body(range.beacon[0], range.beacon[1]);
        let [dx, dy] = [range.tag[0] - beacon[0], range.tag[1] - beacon[1]];
        let predicted_m = dx.hypot(dy).max(1e-3);
        let [ux, uy] = [dx / predicted_m, dy / predicted_m];
        let row = Vector3::new(ux, uy, range.tag[0] * uy - range.tag[1] * ux);
        let innovation = range.range_m - predicted_m;
        let sigmas = innovation.abs() / range.variance_m2.sqrt();
        let weight = if sigmas > HUBER { HUBER / sigmas } else { 1.0 };
        candidate.cost += if sigmas > HUBER { HUBER * (2.0 * sigmas - HUBER) } else { sigmas * sigmas };
        candidate.outliers += usize::from(sigmas > OUTLIER_SIGMAS);
        candidate.information += row * row.transpose() * (weight / range.variance_m2);
        gradient += row * (innovation * weight / range.variance_m2);
    }
    (candidate, gradient)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEACONS: [[f64; 2]; 4] = [[-1.0, -1.2], [4.1, -0.9], [3.9, 4.0], [-1.1, 4.2]];

    /// The ranges to some beacons along a curve that ends at `pose`, the latest first.
    fn ranges(beacons: &[[f64; 2]], pose: Se2, step: [f64; 3]) -> Vec<LocatedRange> {
        (0..10)
            .flat_map(|k| {
                let moved = Se2::exp(step.map(|by| -by * f64::from(k)));
                let tag = moved.compose(Se2 { x_m: 0.05, y_m: -0.02, heading_rad: 0.0 });
                let there = pose.compose(tag);
                beacons.iter().map(move |beacon| LocatedRange {
                    beacon: *beacon,
                    tag: [tag.x_m, tag.y_m],
                    range_m: (beacon[0] - there.x_m).hypot(beacon[1] - there.y_m),
                    variance_m2: 0.0025,
                })
            })
            .collect()
    }

    #[test]
    fn a_moving_robot_is_found_from_three_beacons_and_among_wrong_ranges() {
        let pose = Se2 { x_m: 1.3, y_m: 0.4, heading_rad: 2.2 };
        for beacons in [&BEACONS[..3], &BEACONS] {
            let mut ranges = ranges(beacons, pose, [0.06, 0.0, 0.05]);
            for range in ranges.iter_mut().step_by(7) {
                range.range_m += 1.5;
            }
            let (found, covariance) = find_pose(&ranges).unwrap();
            let [forward_m, left_m, turn_rad] = pose.between(found).log();
            assert!(forward_m.hypot(left_m) < 0.1 && turn_rad.abs() < 0.2, "{found:?}");
            assert!(covariance[(0, 0)] < 0.01);
        }
    }

    #[test]
    fn what_the_ranges_leave_open_is_not_guessed() {
        let pose = Se2 { x_m: 1.3, y_m: 0.4, heading_rad: 2.2 };
        let step = [0.06, 0.0, 0.05];
        assert!(find_pose(&ranges(&BEACONS[..2], pose, step)).is_none(), "two beacons: a mirror image fits as well");
        assert!(find_pose(&ranges(&BEACONS, pose, [0.0; 3])).is_none(), "at rest: any heading fits");
        assert!(find_pose(&ranges(&BEACONS[..3], pose, step)[..6]).is_none(), "too few");
    }
}
