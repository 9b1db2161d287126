//! Windows over which gyro, wheels and fixes are compared under a hypothesis.
//!
//! ```text
//! turn window   dth_gyro - dth_wheels                                    over 0.3 s to 5 s, as soon as the wheels have turned enough
//! segment       dpsi - dth_wheels,  dpsi - dth_gyro                      between two fixes with headings
//!               R(-psi_1) (z_2 - z_1) - p                                likewise; p: path by the wheels in the body's frame
//!               (z_3 - z_2) - R (p_3 - p_2)  with  R (p_2 - p_1) || z_2 - z_1     three fixes without headings
//! ```
//! Expected standard deviations are generous: faults change signs, or sizes by a factor of two and more.

use posebridge_telemetry::{BrickClock, Fix, SensorId, Timestamp, quantities::wrap_rad};
use serde::{Deserialize, Serialize};

use super::evidence::{Comparison, Comparisons};
use super::fault::Hypothesis;
use super::finding::RatioKind;
use super::motion_log::MotionLog;
use super::settings::Settings;
use crate::saved::{finite, not_negative};

/// A fix is believed to be this good at least, however large the covariance that it brings: that may be in millimetres.
const MAX_FIX_SIGMA_M: f64 = 0.2;
/// A heading that is less certain is no heading.
const MAX_HEADING_SIGMA_RAD: f64 = 0.5;
/// Share of a turn by which geometry, gyro scale and slip may falsify it.
const TURN_TOLERANCE: f64 = 0.12;
/// The same for a path.
const PATH_TOLERANCE: f64 = 0.12;
const TURN_FLOOR_RAD: f64 = 0.03;
const PATH_FLOOR_M: f64 = 0.01;
/// A fix may be late by this, unless its delay is known: its pose is off by what the robot moves meanwhile.
const FIX_DELAY_S: f64 = 0.1;
/// Turns above this are equally uncertain: headings wrap.
const MAX_TURN_RAD: f64 = 3.0;
/// A smaller turn shows no ratio.
const MIN_RATIO_TURN_RAD: f64 = 0.1;
/// A smaller factor leaves little of a motion.
const SHRUNK: f64 = 0.1;
/// A chord shows a direction if it is so many times longer than its noise.
const DIRECTION_SIGMAS: f64 = 5.0;

/// Disagreement in expected standard deviations, squared.
fn cost(error: f64, variance: f64) -> f64 {
    error * error / variance
}

fn ratio(
    kind: RatioKind,
    hypothesis: &Hypothesis,
    [with, without]: [f64; 2],
    other: f64,
) -> Option<(RatioKind, [f64; 2])> {
    let by_wheels = if hypothesis.has_broken_turn { with } else { without };
    (by_wheels.abs() >= MIN_RATIO_TURN_RAD * hypothesis.turn_gain().recip().min(1.0))
        .then_some((kind, [by_wheels, other]))
}

/// What gyro and wheels observed over the same time.
#[derive(Clone, Copy, Debug)]
pub(super) struct TurnWindow {
    travel_m: [f64; 2],
    gyro_rad: f64,
    duration_s: f64,
    radius_m: f64,
}

impl TurnWindow {
    pub(super) fn new(rotation_rad: [f64; 2], gyro_rad: f64, duration_s: f64, radii_m: [f64; 2]) -> Self {
        let travel_m = [rotation_rad[0] * radii_m[0], rotation_rad[1] * radii_m[1]];
        Self { travel_m, gyro_rad, duration_s, radius_m: radii_m[0].max(radii_m[1]) }
    }

    pub(super) fn compare(&self, hypothesis: &Hypothesis, settings: &Settings) -> Comparisons {
        let track_m = settings.geometry.track_width.0;
        let [_, by_wheels] = hypothesis.body_motion(self.travel_m, track_m);
        let [_, without] = Hypothesis::CORRECT.body_motion(self.travel_m, track_m);
        let unbiased_rad = self.gyro_rad - settings.gyro_bias_rad_per_s * self.duration_s;
        let by_gyro = hypothesis.gyro_factor * unbiased_rad;
        let bias_rad = settings.gyro_bias_sigma_rad_per_s * self.duration_s;
        let noise = wheel_variance(hypothesis, settings, self.radius_m) + TURN_FLOOR_RAD.powi(2) + bias_rad * bias_rad;
        let error = by_gyro - by_wheels;
        let comparison = Comparison {
            observed: [by_wheels, by_gyro],
            cost: cost(error, noise + (TURN_TOLERANCE * by_wheels.abs().max(by_gyro.abs())).powi(2)),
            error,
            noise: noise.sqrt(),
            ratio: ratio(RatioKind::GyroTurn, hypothesis, [by_wheels, without], unbiased_rad),
            is_path: false,
            is_shrunk: hypothesis.turn_gain().abs().min(hypothesis.gyro_factor.abs()) < SHRUNK,
        };
        [Some(comparison), None, None]
    }
}

/// Of the wheels' turn over a window: play of the gears and rounding at both ends.
fn wheel_variance(hypothesis: &Hypothesis, settings: &Settings, radius_m: f64) -> f64 {
    let rotation_rad = settings.backlash_rad.max(2.0 * settings.geometry.tick.0);
    let turn_rad = hypothesis.turn_gain() * rotation_rad * radius_m / settings.geometry.track_width.0;
    turn_rad * turn_rad
}

/// A fix as the detector keeps it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct FixPoint {
    pub(super) time: Timestamp<BrickClock>,
    pub(super) sensor: SensorId,
    pub(super) reset_counter: u8,
    #[serde(deserialize_with = "not_negative")]
    pub(super) sigma_m: f64,
    #[serde(deserialize_with = "finite")]
    position_m: [f64; 2],
    /// With its standard deviation.
    #[serde(deserialize_with = "finite")]
    heading_rad: Option<[f64; 2]>,
    #[serde(deserialize_with = "finite")]
    lever_m: [f64; 2],
}

impl FixPoint {
    /// `None` if a number is not finite. `sigmas`: of position and heading, where the fix does not bring its own.
    pub(super) fn new(time: Timestamp<BrickClock>, sensor: SensorId, fix: &Fix, sigmas: [f64; 2]) -> Option<Self> {
        let position_m = [fix.position.x.0, fix.position.y.0];
        let own = fix.covariance.map(|covariance| [covariance.xx_m2.max(covariance.yy_m2), covariance.heading_rad2]);
        let [sigma_m, heading_sigma_rad] = own.map_or(sigmas, |variances| variances.map(f64::sqrt));
        let heading = fix.heading.filter(|_| heading_sigma_rad <= MAX_HEADING_SIGMA_RAD);
        let is_finite = position_m.iter().all(|value| value.is_finite()) && sigma_m >= 0.0;
        is_finite.then(|| Self {
            time,
            sensor,
            reset_counter: fix.reset_counter,
            sigma_m: sigma_m.min(MAX_FIX_SIGMA_M),
            position_m,
            heading_rad: heading.map(|heading| [heading.rad(), heading_sigma_rad]),
            lever_m: [fix.tag_in_body.x.0, fix.tag_in_body.y.0],
        })
    }
}

/// From one fix to another one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    pub(super) from: FixPoint,
    pub(super) to: FixPoint,
    /// `None` without a gyro at that time.
    pub(super) gyro_rad: Option<f64>,
    pub(super) radii_m: [f64; 2],
}

/// Motion by the wheels over a segment, under one hypothesis.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct SegmentMotion {
    /// Displacement of the tag in the body's frame at the start.
    #[serde(deserialize_with = "finite")]
    chord_m: [f64; 2],
    #[serde(deserialize_with = "finite")]
    turn_rad: f64,
    #[serde(deserialize_with = "finite")]
    length_m: f64,
}

impl Segment {
    fn duration_s(&self) -> f64 {
        (self.to.time - self.from.time).as_secs_f64()
    }

    /// The rotation of the wheels from the first fix to the second one; empty where the log does not reach.
    pub(super) fn path(&self, log: &MotionLog<2>) -> impl Iterator<Item = [f64; 2]> + Clone {
        let start = log.at(self.from.time).into_iter();
        start.chain(log.between(self.from.time, self.to.time)).chain(log.at(self.to.time))
    }

    pub(super) fn motion(
        &self,
        mut path: impl Iterator<Item = [f64; 2]>,
        hypothesis: &Hypothesis,
        settings: &Settings,
    ) -> SegmentMotion {
        let Some(mut before) = path.next() else {
            return SegmentMotion::default();
        };
        let (mut x_m, mut y_m, mut turn_rad, mut length_m) = (0.0, 0.0, 0.0_f64, 0.0);
        for rotation in path {
            let travel_m = [(rotation[0] - before[0]) * self.radii_m[0], (rotation[1] - before[1]) * self.radii_m[1]];
            before = rotation;
            let [forward_m, step_rad] = hypothesis.body_motion(travel_m, settings.geometry.track_width.0);
            let (sin, cos) = (turn_rad + 0.5 * step_rad).sin_cos();
            x_m += forward_m * cos;
            y_m += forward_m * sin;
            turn_rad += step_rad;
            length_m += f64::abs(forward_m);
        }
        let [lever_x_m, lever_y_m] = rotated(self.to.lever_m, turn_rad);
        let [from_x_m, from_y_m] = self.from.lever_m;
        SegmentMotion { chord_m: [x_m + lever_x_m - from_x_m, y_m + lever_y_m - from_y_m], turn_rad, length_m }
    }

    /// Displacement by the fixes, corrected, in the arena.
    fn fix_chord(&self, hypothesis: &Hypothesis) -> [f64; 2] {
        let [dx_m, dy_m] = [0, 1].map(|axis| self.to.position_m[axis] - self.from.position_m[axis]);
        [hypothesis.camera_factor * dx_m, hypothesis.camera_factor * hypothesis.camera_y_sign * dy_m]
    }

    /// Without the tolerances.
    fn path_noise(&self) -> f64 {
        self.from.sigma_m.powi(2) + self.to.sigma_m.powi(2) + PATH_FLOOR_M.powi(2)
    }

    fn path_variance(&self, motion: &SegmentMotion, fix_chord_m: f64) -> f64 {
        let delay_m = FIX_DELAY_S * motion.length_m / self.duration_s();
        let bend_m = TURN_TOLERANCE * motion.turn_rad.abs().min(MAX_TURN_RAD) * 0.5 * motion.length_m;
        (PATH_TOLERANCE * fix_chord_m.max(length(motion.chord_m))).powi(2)
            + self.path_noise()
            + delay_m * delay_m
            + bend_m * bend_m
    }

    /// Turns by heading against wheels and gyro, then the path.
    pub(super) fn compare(
        &self,
        motion: SegmentMotion,
        previous: Option<PreviousMotion>,
        hypothesis: &Hypothesis,
        settings: &Settings,
    ) -> Comparisons {
        let [by_wheels, by_gyro] = self.compare_turns(&motion, hypothesis, settings);
        [by_wheels, by_gyro, Some(self.compare_path(&motion, previous, hypothesis))]
    }

    fn compare_turns(
        &self,
        motion: &SegmentMotion,
        hypothesis: &Hypothesis,
        settings: &Settings,
    ) -> [Option<Comparison>; 2] {
        let (Some([from_rad, from_sigma]), Some([to_rad, to_sigma])) = (self.from.heading_rad, self.to.heading_rad)
        else {
            return [None; 2];
        };
        let seen_rad = wrap_rad(to_rad - from_rad);
        let turned_rad = hypothesis.camera_y_sign * seen_rad;
        let compare = |other_rad: f64, own_variance: f64, factor: f64| {
            let size_rad = other_rad.abs().min(MAX_TURN_RAD);
            let delay_rad = FIX_DELAY_S * size_rad / self.duration_s();
            let noise = from_sigma * from_sigma + to_sigma * to_sigma + TURN_FLOOR_RAD.powi(2) + own_variance;
            let error = wrap_rad(turned_rad - other_rad);
            Comparison {
                observed: [other_rad, turned_rad],
                cost: cost(error, noise + delay_rad * delay_rad + (TURN_TOLERANCE * size_rad).powi(2)),
                error,
                noise: noise.sqrt(),
                ratio: None,
                is_path: false,
                is_shrunk: factor.abs() < SHRUNK,
            }
        };
        let radius_m = self.radii_m[0].max(self.radii_m[1]);
        let gain = hypothesis.turn_gain();
        let wheels = compare(motion.turn_rad, wheel_variance(hypothesis, settings, radius_m), gain);
        let without_rad = motion.turn_rad / gain;
        let signed = if hypothesis.reverses_turn() { -without_rad } else { without_rad };
        let wheels =
            Comparison { ratio: ratio(RatioKind::FixTurn, hypothesis, [motion.turn_rad, signed], seen_rad), ..wheels };
        let gyro = self.gyro_rad.map(|gyro_rad| {
            let unbiased_rad = gyro_rad - settings.gyro_bias_rad_per_s * self.duration_s();
            let bias_rad = settings.gyro_bias_sigma_rad_per_s * self.duration_s();
            compare(hypothesis.gyro_factor * unbiased_rad, bias_rad * bias_rad, hypothesis.gyro_factor)
        });
        [Some(wheels), gyro]
    }

    fn compare_path(
        &self,
        motion: &SegmentMotion,
        previous: Option<PreviousMotion>,
        hypothesis: &Hypothesis,
    ) -> Comparison {
        let seen_m = self.fix_chord(hypothesis);
        let (seen_length_m, length_m) = (length(seen_m), length(motion.chord_m));
        let variance = self.path_variance(motion, seen_length_m);
        let raw = [length_m / hypothesis.travel_factor, seen_length_m / hypothesis.camera_factor];
        let comparison = |error: f64, variance: f64, ratio: Option<(RatioKind, [f64; 2])>| Comparison {
            observed: [length_m, seen_length_m],
            cost: cost(error, variance),
            error,
            noise: self.path_noise().sqrt(),
            ratio,
            is_path: true,
            is_shrunk: hypothesis.travel_factor.min(hypothesis.camera_factor) < SHRUNK,
        };
        let by_distance = Some((RatioKind::FixDistance, raw));
        if let Some([heading_rad, sigma_rad]) = self.from.heading_rad {
            let [x_m, y_m] = rotated(seen_m, -hypothesis.camera_y_sign * heading_rad);
            let error_m = length([x_m - motion.chord_m[0], y_m - motion.chord_m[1]]);
            let turned_m = sigma_rad * length_m;
            return comparison(error_m, variance + turned_m * turned_m, by_distance);
        }
        let noise_m = DIRECTION_SIGMAS * self.from.sigma_m.max(PATH_FLOOR_M);
        if let Some(previous) = previous {
            let before_m = previous.fix_chord(hypothesis);
            let before_length_m = length(before_m).min(length(previous.motion.chord_m));
            if before_length_m > noise_m {
                let in_first = rotated(motion.chord_m, previous.motion.turn_rad);
                let to_arena_rad = direction(before_m) - direction(previous.motion.chord_m);
                let [x_m, y_m] = rotated(in_first, to_arena_rad);
                let error_m = length([seen_m[0] - x_m, seen_m[1] - y_m]);
                let direction_rad = 2.0 * self.from.sigma_m / before_length_m + TURN_TOLERANCE;
                let turned_m = direction_rad * length_m;
                let bends = (seen_length_m.min(length_m) > noise_m).then(|| {
                    let by_wheels = wrap_rad(direction(in_first) - direction(previous.motion.chord_m));
                    let sign = if hypothesis.reverses_turn() { -1.0 } else { 1.0 };
                    let seen = wrap_rad(direction(self.fix_chord(&Hypothesis::CORRECT)) - direction(previous.seen_m));
                    (RatioKind::FixTurn, [sign * by_wheels, seen])
                });
                let mirrors = hypothesis.reverses_turn() || hypothesis.camera_y_sign < 0.0;
                let shown = if mirrors { bends } else { by_distance };
                return comparison(error_m, variance + turned_m * turned_m, shown);
            }
        }
        comparison(seen_length_m - length_m, variance, by_distance)
    }
}

/// The segment before this one, with its motion under one hypothesis.
#[derive(Clone, Copy, Debug)]
pub(super) struct PreviousMotion {
    seen_m: [f64; 2],
    motion: SegmentMotion,
}

impl PreviousMotion {
    fn fix_chord(&self, hypothesis: &Hypothesis) -> [f64; 2] {
        let [dx_m, dy_m] = self.seen_m;
        [hypothesis.camera_factor * dx_m, hypothesis.camera_factor * hypothesis.camera_y_sign * dy_m]
    }
}

/// The segment before this one, with its motion under each hypothesis.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct PreviousSegment {
    #[serde(deserialize_with = "finite")]
    seen_m: [f64; 2],
    without_fault: SegmentMotion,
    with_fault: [SegmentMotion; super::fault::WiringFault::ALL.len()],
}

impl PreviousSegment {
    pub(super) fn new(segment: &Segment) -> Self {
        Self {
            seen_m: segment.fix_chord(&Hypothesis::CORRECT),
            without_fault: SegmentMotion::default(),
            with_fault: Default::default(),
        }
    }

    /// `None` is the hypothesis of no fault.
    pub(super) fn set(&mut self, index: Option<usize>, motion: SegmentMotion) {
        match index {
            None => self.without_fault = motion,
            Some(index) => self.with_fault[index] = motion,
        }
    }

    pub(super) fn with(&self, index: Option<usize>) -> PreviousMotion {
        let motion = index.map_or(self.without_fault, |index| self.with_fault[index]);
        PreviousMotion { seen_m: self.seen_m, motion }
    }
}

fn length([x_m, y_m]: [f64; 2]) -> f64 {
    x_m.hypot(y_m)
}

fn direction([x_m, y_m]: [f64; 2]) -> f64 {
    y_m.atan2(x_m)
}

fn rotated([x_m, y_m]: [f64; 2], angle_rad: f64) -> [f64; 2] {
    let (sin, cos) = angle_rad.sin_cos();
    [x_m * cos - y_m * sin, x_m * sin + y_m * cos]
}
