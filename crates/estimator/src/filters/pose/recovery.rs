//! Alternatives to the believed pose, from the observations that it refuses, and from those that find no pose yet.
//!
//! An alternative A moves by the same wheels as the believed pose X, so that T = A X^-1 does not change: T is stored. Each
//! observation changes the odds of the alternative against the believed pose:
//!
//! ```text
//! ln o <- ln o + ln p(z | alternative) - ln p(z | believed)       p = (1 - e) N(nu; 0, S) + e / volume
//! ln o <- ln o + dt / 1 s                                         for what may be a fault that lasts
//! ```
//! The second line is for the sensor that speaks for the alternative while the believed pose refuses it. If the believed pose is right,
//! that sensor has a fault which agrees with itself, and only its duration speaks against it: such faults last for a second or so.
//! What the alternative does not explain of that sensor speaks against it, and more so if the believed pose does.
//! Odds begin at exp(-`reset_after_s`); higher, where the observation is no further off than noise that is some times larger than
//! configured would explain, because a fault may be anywhere:
//!
//! ```text
//! ln o = -reset_after_s + ln N(nu; 0, 9 S) + ln volume          at most -2.5
//! ```
//! or at one where the robot was carried: its gyro turned while its wheels stood. An alternative
//! with odds above one that several observations agree on becomes the pose.
//!
//! Source: docs/maths/pose.md section 4; Bar-Shalom, Li and Kirubarajan (2001), section 11.6, for hypotheses by likelihood.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, SMatrix, Vector3};
use posebridge_telemetry::{BrickClock, SensorId, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::models::lie::Se2;
use crate::observations::ObservationModel;
use crate::saved::{covariance, not_nan};
use crate::update::nis_and_log_likelihood;

/// Most alternatives beside the believed pose.
const MAX_ALTERNATIVES: usize = 3;
/// Share of observations that are anything.
const OUTLIER_SHARE: f64 = 0.01;
/// Where an observation that is anything may be, m.
const ARENA_M: f64 = 10.0;
/// The same in sigmas of the sensor.
const ARENA_SIGMAS: f64 = 100.0;
/// How many times larger than configured the noise may be.
const NOISE_FACTOR: f64 = 3.0;
/// Seconds for which observations of one sensor must agree in any case, without a sign that the robot was carried: a tag that is mistaken
/// for another is so for two seconds.
const LEAST_RESET_AFTER_S: f64 = 2.5;
/// No single observation changes the odds by more than this factor, as a logarithm.
const MAX_EVIDENCE: f64 = 5.0;
/// What an observation of the alternative's sensor takes off the odds that the alternative does not explain; as a logarithm.
const REFUTATION: f64 = 2.0;
/// Silence of a sensor counts for its fault's duration no longer than this.
const MAX_SILENCE_S: f64 = 2.0;
/// An alternative that nothing has agreed with for longer is dropped: its way since then is not kept.
pub const MAX_AGE: TimeDelta = TimeDelta::from_millis(10_000);
/// An alternative whose odds have fallen this far below their beginning is dropped, as a logarithm.
const DROP_MARGIN: f64 = 4.0;
/// A robot that was carried stands on the floor again this long after its gyro has turned last.
pub const PUT_DOWN: TimeDelta = TimeDelta::from_millis(300);

/// A pose that observations speak for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// T: the alternative pose is T X.
    from_believed: Se2,
    /// Of the pose's error in the body at the last observation that agreed: forward, left, turn.
    #[serde(deserialize_with = "covariance")]
    covariance: Matrix3<f64>,
    /// Unknown where fixes tell positions only: the heading of `from_believed` means nothing then.
    pub is_heading_known: bool,
    /// The sensor that spoke for it first.
    pub sensor: SensorId,
    #[serde(deserialize_with = "not_nan")]
    pub ln_odds: f64,
    /// Number of observations that agree with it.
    pub agreements: u32,
    #[serde(deserialize_with = "not_nan")]
    first_ln_odds: f64,
    /// Of the last observation that agreed.
    latest: Timestamp<BrickClock>,
    /// Until when the duration of its sensor's fault is counted.
    counted_until: Timestamp<BrickClock>,
}

impl Alternative {
    pub fn pose(&self, believed: Se2) -> Se2 {
        self.from_believed.compose(believed)
    }

    pub const fn covariance(&self) -> &Matrix3<f64> {
        &self.covariance
    }
}

/// The pose that an observation speaks for by itself.
#[derive(Clone, Copy, Debug)]
pub struct OwnPose {
    pub pose: Se2,
    /// Of the pose's error in the body.
    pub covariance: Matrix3<f64>,
    pub is_heading_known: bool,
}

/// The body's motion over some time, with its noise.
#[derive(Clone, Copy, Debug)]
pub struct BodyMotion {
    pub moved: Se2,
    /// Of the pose's error in the body at the end.
    pub noise: Matrix3<f64>,
}

/// What an observation says of the believed pose.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    pub believed: Se2,
    pub stamp: Timestamp<BrickClock>,
    pub sensor: SensorId,
    /// The gate of its components.
    pub gate: f64,
    /// ln p(z | believed) without outliers; `None` without a pose.
    pub ln_likelihood: Option<f64>,
    pub is_refused: bool,
    /// NIS and number of components under the believed pose.
    pub nis: f64,
    pub components: usize,
    /// Whether the robot was carried lately, or has no pose: nothing speaks against an alternative then.
    pub is_pose_doubtful: bool,
    /// ln of the density of an observation that is anything.
    pub ln_anything: f64,
    /// Seconds for which a fault must last to be no fault, and the observations that must agree.
    pub reset_after_s: f64,
    pub reset_after_fixes: f64,
}

impl Evidence {
    /// The odds of an alternative that begins with this observation, as a logarithm.
    fn first_ln_odds(&self) -> f64 {
        let square = NOISE_FACTOR.powi(2);
        let ln_larger_noise = self.ln_likelihood.map_or(f64::NEG_INFINITY, |ln| {
            ln + 0.5 * self.nis * (1.0 - 1.0 / square) - self.components as f64 * NOISE_FACTOR.ln()
        });
        let gain = (ln_larger_noise - self.ln_anything).max(0.0);
        (gain - self.reset_after_s).min(-LEAST_RESET_AFTER_S).max(-self.reset_after_s)
    }
}

/// ln of the density of something anywhere in the arena, and of any direction. The arena is large for what measures it roughly, by
/// `sigma_m`.
pub fn ln_anywhere(lengths: u32, angles: u32, sigma_m: f64) -> f64 {
    -f64::from(lengths) * (ARENA_SIGMAS * sigma_m).max(ARENA_M).ln() - f64::from(angles) * TAU.ln()
}

/// ln of a density with outliers.
fn with_outliers(ln_density: f64, ln_anything: f64) -> f64 {
    let (own, other) = ((1.0 - OUTLIER_SHARE).ln() + ln_density, OUTLIER_SHARE.ln() + ln_anything);
    let larger = own.max(other);
    larger + ((own - larger).exp() + (other - larger).exp()).ln()
}

/// The alternatives to the believed pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AlternativeBank {
    alternatives: [Option<Alternative>; MAX_ALTERNATIVES],
}

impl AlternativeBank {
    pub fn is_empty(&self) -> bool {
        self.alternatives.iter().all(Option::is_none)
    }

    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Leaves the alternatives where they are while the believed pose is corrected.
    pub fn rebase(&mut self, before: Se2, after: Se2) {
        if before != after {
            for alternative in self.alternatives.iter_mut().flatten() {
                alternative.from_believed = alternative.pose(before).compose(after.inverse());
            }
        }
    }

    /// Compares the alternatives with an observation whose model at any pose is `model`, and returns one that becomes the pose.
    /// `own` finds the pose that the observation itself speaks for, if it does.
    pub fn observe<const M: usize>(
        &mut self,
        evidence: &Evidence,
        moved_since: impl Fn(Timestamp<BrickClock>) -> BodyMotion,
        model: impl Fn(Se2) -> Option<ObservationModel<M>>,
        own: impl FnOnce() -> Option<OwnPose>,
    ) -> Option<Alternative> {
        let mut is_explained = false;
        for slot in &mut self.alternatives {
            let Some(alternative) = slot else { continue };
            if evidence.stamp - alternative.latest > MAX_AGE {
                *slot = None;
                continue;
            }
            let moved = moved_since(alternative.latest);
            is_explained |= alternative.observe(evidence, &moved, model(alternative.pose(evidence.believed)).as_ref());
            if alternative.ln_odds < alternative.first_ln_odds - DROP_MARGIN {
                *slot = None;
            }
        }
        if evidence.is_refused
            && !is_explained
            && let Some(own) = own()
        {
            self.insert(evidence, &own);
        }
        let needed = if evidence.is_pose_doubtful { 2.0 } else { evidence.reset_after_fixes };
        let is_best = |one: &&Alternative| {
            one.ln_odds >= 0.0 && f64::from(one.agreements) >= needed && one.latest == evidence.stamp
        };
        let best = self.alternatives.iter().flatten().filter(is_best).max_by(|a, b| a.ln_odds.total_cmp(&b.ln_odds));
        best.copied().filter(|_| evidence.is_refused)
    }

    fn insert(&mut self, evidence: &Evidence, own: &OwnPose) {
        let ln_odds = if evidence.is_pose_doubtful { 0.0 } else { evidence.first_ln_odds() };
        let alternative = Alternative {
            from_believed: own.pose.compose(evidence.believed.inverse()),
            covariance: own.covariance,
            is_heading_known: own.is_heading_known,
            sensor: evidence.sensor,
            ln_odds,
            first_ln_odds: ln_odds,
            agreements: 1,
            latest: evidence.stamp,
            counted_until: evidence.stamp,
        };
        let odds = |slot: &Option<Alternative>| slot.map_or(f64::NEG_INFINITY, |one| one.ln_odds);
        if let Some(slot) = self.alternatives.iter_mut().min_by(|a, b| odds(a).total_cmp(&odds(b))) {
            *slot = Some(alternative);
        }
    }
}

impl Alternative {
    /// Updates pose and odds; returns whether the alternative explains the observation.
    fn observe<const M: usize>(
        &mut self,
        evidence: &Evidence,
        moved: &BodyMotion,
        model: Option<&ObservationModel<M>>,
    ) -> bool {
        let Some(model) = model else { return false };
        let explanation = if self.is_heading_known {
            self.explain(evidence, moved, model)
        } else {
            self.explain_distance(evidence, moved, model)
        };
        let Some(explanation) = explanation else { return false };
        let explains = explanation.nis <= evidence.gate;
        let seconds_since =
            |then: Timestamp<BrickClock>| (evidence.stamp - then).as_secs_f64().clamp(0.0, MAX_SILENCE_S);
        let is_own_sensor = evidence.sensor == self.sensor;
        if explains && evidence.is_refused && is_own_sensor {
            self.ln_odds += seconds_since(self.counted_until);
            self.counted_until = evidence.stamp;
        } else if let Some(ln_likelihood) = explanation.ln_likelihood {
            let believed =
                evidence.ln_likelihood.map_or(evidence.ln_anything, |ln| with_outliers(ln, evidence.ln_anything));
            let change = with_outliers(ln_likelihood, evidence.ln_anything) - believed;
            let most = if is_own_sensor { 0.0 } else { MAX_EVIDENCE };
            self.ln_odds += change.clamp(-MAX_EVIDENCE, most);
        }
        // A landmark may look much the same from both poses, so what both explain counts by its likelihoods, where there are any. What
        // neither explains is an outlier; without a reason to doubt the pose it is one more sign of noise that is larger than told.
        let counts_by_likelihood = explains && explanation.ln_likelihood.is_some();
        if is_own_sensor && !evidence.is_refused && !counts_by_likelihood {
            self.ln_odds -= REFUTATION;
        } else if is_own_sensor && !explains && !evidence.is_pose_doubtful {
            // No more than the time since the last agreement has brought: scattered outliers must not hide a pose for good.
            self.ln_odds -= REFUTATION.min(seconds_since(self.latest));
        }
        if explains {
            // A direction or a distance alone agrees with too many poses.
            self.agreements = self.agreements.saturating_add(u32::from(is_own_sensor || M >= 2));
            self.latest = evidence.stamp;
            self.from_believed = explanation.pose.compose(evidence.believed.inverse());
            self.covariance = explanation.covariance;
        }
        explains
    }

    /// By a linear update of the pose; `None` when S is not positive definite.
    fn explain<const M: usize>(
        &self,
        evidence: &Evidence,
        moved: &BodyMotion,
        model: &ObservationModel<M>,
    ) -> Option<Explanation> {
        let adjoint = moved.moved.inverse().adjoint();
        let by_motion = Matrix3::from_fn(|i, j| adjoint[i][j]);
        let covariance = by_motion * self.covariance * by_motion.transpose() + moved.noise;
        let jacobian =
            SMatrix::<f64, M, 3>::from_fn(|i, j| [model.rows[i].forward, model.rows[i].left, model.rows[i].heading][j]);
        let s = jacobian * covariance * jacobian.transpose() + model.noise;
        let (nis, ln_likelihood) = nis_and_log_likelihood(&model.innovation, &s)?;
        let gain = covariance * jacobian.transpose() * s.try_inverse()?;
        let correction: Vector3<f64> = gain * model.innovation;
        let updated = covariance - gain * jacobian * covariance;
        Some(Explanation {
            nis,
            ln_likelihood: Some(ln_likelihood),
            pose: self.pose(evidence.believed).compose(Se2::exp([correction[0], correction[1], correction[2]])),
            covariance: 0.5 * (updated + updated.transpose()),
        })
    }

    /// Without a heading: two positions are as far apart as the body has moved; `None` for what is no position.
    fn explain_distance<const M: usize>(
        &self,
        evidence: &Evidence,
        moved: &BodyMotion,
        model: &ObservationModel<M>,
    ) -> Option<Explanation> {
        if M != 2 {
            return None;
        }
        let predicted = self.pose(evidence.believed);
        let before = predicted.compose(moved.moved.inverse());
        let seen = Se2 { x_m: model.innovation[0], y_m: model.innovation[1], heading_rad: 0.0 };
        let here = predicted.compose(seen);
        let apart_m = (here.x_m - before.x_m).hypot(here.y_m - before.y_m);
        let mismatch_m = apart_m - moved.moved.x_m.hypot(moved.moved.y_m);
        // The tag's lever turns with the unknown heading.
        let lever_m2 = model.rows[0].heading.powi(2) + model.rows[1].heading.powi(2);
        let variance_m2 = model.noise[(0, 0)] + model.noise[(1, 1)] + moved.noise[(0, 0)] + lever_m2;
        Some(Explanation {
            nis: mismatch_m * mismatch_m / variance_m2,
            ln_likelihood: None,
            pose: Se2 { heading_rad: predicted.heading_rad, ..here },
            covariance: self.covariance,
        })
    }
}

/// What an alternative says of an observation, and where it is after it.
struct Explanation {
    nis: f64,
    /// ln p(z | alternative) without outliers; `None` where it says too little.
    ln_likelihood: Option<f64>,
    pose: Se2,
    covariance: Matrix3<f64>,
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::observations::JacobianRow;

    #[test]
    fn what_both_poses_explain_takes_nothing_off_the_one_that_explains_it_better() {
        // The believed pose is at the origin; a sensor with a sigma of 1 cm says where the robot is.
        let observe = |bank: &mut AlternativeBank, millis, x_m: f64, is_refused| {
            let noise = Matrix2::from_diagonal_element(1e-4);
            let model = |pose: Se2| {
                let axis = |forward, left| JacobianRow { forward, left, ..JacobianRow::default() };
                let innovation = Vector2::new(x_m - pose.x_m, -pose.y_m);
                Some(ObservationModel { innovation, rows: [axis(1.0, 0.0), axis(0.0, 1.0)], noise })
            };
            let (nis, ln_likelihood) = nis_and_log_likelihood(&Vector2::new(x_m, 0.0), &noise).unwrap();
            let evidence = Evidence {
                believed: Se2::default(),
                stamp: Timestamp::from_millis(millis),
                sensor: SensorId::LANDMARKS,
                gate: 13.8,
                ln_likelihood: Some(ln_likelihood),
                is_refused,
                nis,
                components: 2,
                is_pose_doubtful: false,
                ln_anything: ln_anywhere(1, 1, 0.01),
                reset_after_s: 5.0,
                reset_after_fixes: 3.0,
            };
            let pose = Se2 { x_m, ..Se2::default() };
            let own = OwnPose { pose, covariance: Matrix3::from_diagonal_element(1e-4), is_heading_known: true };
            let still = BodyMotion { moved: Se2::default(), noise: Matrix3::zeros() };
            bank.observe(&evidence, |_| still, model, || Some(own))
        };
        let mut bank = AlternativeBank::default();
        // The odds begin at -2.5 and gain one in each second, also over the one observation that both explain.
        let resets: Vec<bool> = (0..=10)
            .map(|k| {
                let is_refused = k != 1;
                observe(&mut bank, 500 * k, if is_refused { 0.04 } else { 0.03 }, is_refused).is_some()
            })
            .collect();
        assert_eq!(resets.iter().position(|is_reset| *is_reset), Some(5), "{resets:?}");
    }
}
