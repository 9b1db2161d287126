//! Updates of the pose filter's state by absolute observations: gate, weight, update.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, SMatrix, SVector};
use posebridge_telemetry::{
    Arena, Fix, FusionOutcome, FusionRecord, MountedSensor, ObservationKind, Point2, TimeDelta, Timestamp,
};

use super::context::UpdateContext;
use super::entry::sort_key;
use super::layout::{FORWARD, HEADING, LEFT, MAX_BEACONS, MAX_LANDMARKS};
use super::motion_update::{has_slipped, update_gyro_window};
use super::noise_scales::{NoiseGroup, NoiseSource, scale_vote};
use super::ranging::pose_from_ranges;
use super::recovery::{Alternative, Evidence, MAX_AGE, OwnPose, PUT_DOWN, ln_anywhere};
use super::relocalize::{covariance_of_fix, initialize_from_fix, pose_of_fix, reset_to_fix};
use super::sightings::Sighting;
use super::state::{PoseState, StateView};
use crate::models::lie::Se2;
use crate::numerics::covariance::symmetrise;
use crate::observations::absolute::{self, MeasuredPoint, RangeBearing, range_variance};
use crate::observations::fix::{self, FixMeasurement};
use crate::observations::sensor_frame::{Exposure, SensorFrame};
use crate::observations::{ArenaAxis, MountingAxis, ObservationModel, PoseView, StateTerm};
use crate::update::{LinearizedMeasurement, apply_measurement};
use crate::validation::write_innovation;

/// Limit of the estimated delay of fixes, either way.
pub(super) const MAX_DELAY: TimeDelta = TimeDelta::from_millis(2_000);
/// A pose after a robot was carried has proved right when observations agree with it after this time.
const PROBATION: TimeDelta = TimeDelta::from_millis(10_000);
/// Nearer than a decimetre an error of the map says nothing of a direction, m².
const MIN_RANGE_M2: f64 = 0.01;
/// How far before the state's instant the motion track is queried.
pub(super) const MAX_LOOKBACK: TimeDelta = TimeDelta::from_nanos(MAX_AGE.as_nanos() + MAX_DELAY.as_nanos());

pub(super) fn update_absolute<const N: usize>(
    state: &mut PoseState<N>,
    observation: &ObservationKind,
    stamp_sigma: TimeDelta,
    context: &UpdateContext,
    record: &mut FusionRecord,
) {
    // A slip that the gyro has noticed must not make the gate refuse the fix that would show it.
    if has_slipped(state, context)
        && let Some(window) = state.window
    {
        update_gyro_window(state, context);
        state.restart_window(window.until);
    }
    let mut update = AbsoluteUpdate { context, kind: sort_key(observation).0, record };
    let outcome = if let ObservationKind::Fix(fix) = observation {
        update.update_fix(state, fix, stamp_sigma)
    } else {
        update.update_other(state, observation)
    };
    record.outcome = outcome;
    if matches!(outcome, FusionOutcome::Accepted | FusionOutcome::PoseReset) {
        state.status.last_fix = state.stamp;
    }
}

struct AbsoluteUpdate<'a> {
    context: &'a UpdateContext,
    kind: u8,
    record: &'a mut FusionRecord,
}

/// The position has the same noise along both axes; the heading has its own.
const POSE_GROUPS: [NoiseGroup; 3] = [NoiseGroup::Position, NoiseGroup::Position, NoiseGroup::Heading];
const POSITION_GROUPS: [NoiseGroup; 2] = [NoiseGroup::Position; 2];

impl AbsoluteUpdate<'_> {
    fn update_fix<const N: usize>(
        &mut self,
        state: &mut PoseState<N>,
        fix: &Fix,
        stamp_sigma: TimeDelta,
    ) -> FusionOutcome {
        let layout = &self.context.layout;
        let exposure = self.exposure(state, StateTerm::FixDelay);
        let scales = [NoiseGroup::Position, NoiseGroup::Heading].map(|group| self.noise_scale(state, group));
        let noise = fix::fix_noise(fix, &self.context.config.noise, scales, &exposure, stamp_sigma.as_secs_f64());
        let has_jumped = state.observer_frames.has_jumped(self.record.sensor, fix.reset_counter);
        let source = state.observer_frames.number_of(self.record.sensor);
        let sigma_m = (0.5 * noise.position.trace()).sqrt();
        let measured = FixMeasurement { fix, noise, exposure, source };
        if !state.is_located && !state.motion_evidence.has_been_heard {
            // Nobody has seen a relative pose yet: this is where the robot starts, and no reset.
            return initialize_from_fix(state, &measured, layout);
        }
        if !state.is_located || has_jumped {
            return reset_to_fix(state, &measured, layout);
        }
        let (mean, pose) = (state.mean, state.pose);
        let view = StateView::new(&mean, pose, layout);
        let context = self.context;
        let own = |state: &PoseState<N>| {
            let (pose, model) = pose_of_fix(&view, &measured);
            let model = with_uncertain_constants(state, context, model);
            Some(OwnPose { pose, covariance: covariance_of_fix(&model)?, is_heading_known: fix.heading.is_some() })
        };
        let (verdict, winner) = if let Some(heading) = fix.heading {
            let heading_rad = heading.rad();
            let model = |view: &StateView<'_, N>| Some(measured.pose_model(view, heading_rad));
            let verdict = self.apply_fix(state, POSE_GROUPS, &|state: &PoseState<N>| {
                layout.linearize(&measured.pose_model(&state.view(layout), heading_rad))
            });
            (verdict, self.ask_alternatives(state, &view, verdict, ln_anywhere(2, 1, sigma_m), model, own))
        } else {
            let model = |view: &StateView<'_, N>| Some(measured.position_model(view));
            let verdict = self.apply_fix(state, POSITION_GROUPS, &|state: &PoseState<N>| {
                layout.linearize(&measured.position_model(&state.view(layout)))
            });
            (verdict, self.ask_alternatives(state, &view, verdict, ln_anywhere(2, 0, sigma_m), model, own))
        };
        match winner {
            Some(winner) if winner.is_heading_known => {
                state.adopt(&winner, view.pose());
                FusionOutcome::PoseReset
            }
            // Without a heading in the fixes the heading may be as wrong as the position was: it is estimated from scratch.
            Some(_) => reset_to_fix(state, &measured, layout),
            None => verdict,
        }
    }

    const fn noise_source(&self, group: NoiseGroup) -> NoiseSource {
        NoiseSource { sensor: self.record.sensor, kind: self.kind, group }
    }

    fn noise_scale<const N: usize>(&self, state: &PoseState<N>, group: NoiseGroup) -> f64 {
        state.noise_scales.factor(self.noise_source(group))
    }

    /// Applies a fix once, or iterates while the heading is hardly known.
    fn apply_fix<const N: usize, const M: usize>(
        &mut self,
        state: &mut PoseState<N>,
        groups: [NoiseGroup; M],
        measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
    ) -> FusionOutcome {
        if state.covariance[(HEADING, HEADING)] <= ITERATE_ABOVE_RAD.powi(2) {
            return self.gate_and_apply(state, &measure(state), groups);
        }
        if self.record_innovation(&measure(state), &state.covariance).is_none() {
            return FusionOutcome::Malformed;
        }
        // A fix from which no correction is found is too far away: it must count among the refused, or nothing ever helps.
        let Some(found) = iterate(state, measure) else {
            return FusionOutcome::Gated;
        };
        self.record.log_likelihood -= 0.5 * (found.nis - self.record.nis);
        self.record.nis = found.nis;
        if found.nis > self.context.gate(M) {
            return FusionOutcome::Gated;
        }
        *state = found.state;
        FusionOutcome::Accepted
    }

    /// Motion and speeds at an exposure, which is earlier than the timestamp by the delay of this term, and later by that of the
    /// odometer.
    fn exposure<const N: usize>(&self, state: &PoseState<N>, delay: StateTerm) -> Exposure {
        let layout = &self.context.layout;
        let rows = [layout.row(delay), layout.row(StateTerm::OdometryDelay)];
        let [delay_s, odometry_s] = rows.map(|row| row.map_or(0.0, |row| state.mean[row]));
        let delay = TimeDelta::from_secs_f64(delay_s - odometry_s).clamp(-MAX_DELAY, MAX_DELAY);
        let moved_since = state.motion_over_delay(delay, self.context);
        let is_learned = rows.into_iter().flatten().any(|row| state.covariance[(row, row)] > 0.0);
        let (forward_m_per_s, turn_rad_per_s) = if is_learned {
            let shown = state.stamp.unwrap_or(Timestamp::ZERO) - delay;
            state.speeds_near(shown, self.context)
        } else {
            (state.forward.value, state.turn.value)
        };
        Exposure { moved_since, forward_m_per_s, turn_rad_per_s }
    }

    fn update_other<const N: usize>(
        &mut self,
        state: &mut PoseState<N>,
        observation: &ObservationKind,
    ) -> FusionOutcome {
        let config = &self.context.config;
        let (noise, map) = (&config.noise, &config.arena_map);
        match *observation {
            ObservationKind::Landmark { id, range, bearing } => {
                let Some((slot, position)) = numbered(&map.landmarks, &id) else { return FusionOutcome::Unused };
                let own_m2 = range_variance(range.0, noise.landmark_range_m, noise.landmark_range_share);
                let layout = &self.context.layout;
                // An error of the map that is no state is noise of the sighting.
                let has_state = layout.row(StateTerm::LandmarkPlace(slot, ArenaAxis::X)).is_some();
                let map_m2 = if has_state { 0.0 } else { noise.landmark_place_m.powi(2) };
                let variances = [
                    self.noise_scale(state, NoiseGroup::Range) * own_m2 + map_m2,
                    self.noise_scale(state, NoiseGroup::Bearing) * noise.landmark_bearing_rad.powi(2)
                        + map_m2 / range.0.powi(2).max(map_m2).max(MIN_RANGE_M2),
                ];
                let sighting = RangeBearing { range_m: range.0, bearing_rad: bearing.0 };
                let exposure = self.exposure(state, StateTerm::Delay(MountedSensor::Landmarks));
                let model = |view: &StateView<'_, N>| {
                    let frame = SensorFrame::of_sensor(view, MountedSensor::Landmarks, &exposure);
                    let point = MeasuredPoint::landmark(position, slot);
                    absolute::landmark(view, &frame, &point, sighting, variances)
                };
                let groups = [NoiseGroup::Range, NoiseGroup::Bearing];
                let view = state.view(layout);
                let [scale, offset_m] = [StateTerm::LandmarkScale, StateTerm::LandmarkOffset].map(|of| view.term(of));
                let [x_m, y_m] = ArenaAxis::ALL.map(|axis| view.term(StateTerm::LandmarkPlace(slot, axis)));
                let corrected = RangeBearing { range_m: (range.0 - offset_m) / (1.0 + scale), ..sighting };
                let variance_of = |term| layout.row(term).map_or(0.0, |row| state.covariance[(row, row)]);
                let of_constants = variance_of(StateTerm::LandmarkOffset)
                    + range.0.powi(2) * variance_of(StateTerm::LandmarkScale)
                    + variance_of(StateTerm::LandmarkPlace(slot, ArenaAxis::X));
                let sighting = Sighting {
                    landmark: [position.x.0 + x_m, position.y.0 + y_m],
                    seen: believed_place(&view, &exposure, corrected),
                    variance_m2: variances[0] + range.0.powi(2) * variances[1] + of_constants,
                    stamp: state.stamp.unwrap_or(Timestamp::ZERO),
                };
                let (pose, sightings) = (state.pose, state.sightings);
                let own = |_: &PoseState<N>| sightings.pose_with(&sighting, pose);
                let verdict = self.update_or_recover(state, groups, ln_anywhere(1, 1, variances[0].sqrt()), model, own);
                let is_adopted = verdict == FusionOutcome::PoseReset;
                if !is_adopted && self.is_refused(state, verdict, 2) && !is_being_carried(state) {
                    state.sightings.push(sighting);
                }
                verdict
            }
            ObservationKind::BeaconRange { id, range } => {
                let own_m2 = range_variance(range.0, noise.beacon_range_m, noise.beacon_range_share);
                let variance_m2 = self.noise_scale(state, NoiseGroup::Range) * own_m2;
                let Some((slot, position)) = numbered(&map.beacons, &id) else { return FusionOutcome::Unused };
                let exposure = self.exposure(state, StateTerm::Delay(MountedSensor::Beacons));
                let model = |view: &StateView<'_, N>| {
                    let frame = SensorFrame::of_sensor(view, MountedSensor::Beacons, &exposure);
                    absolute::beacon(view, &frame, &MeasuredPoint::beacon(position, slot), range.0, variance_m2)
                };
                let own = |state: &PoseState<N>| pose_from_ranges(state, self.context);
                self.update_or_recover(state, [NoiseGroup::Range], ln_anywhere(1, 0, variance_m2.sqrt()), model, own)
            }
            ObservationKind::WallRange(range) => {
                let variance_m2 = self.noise_scale(state, NoiseGroup::Range) * noise.wall_range_m.powi(2);
                let exposure = self.exposure(state, StateTerm::Delay(MountedSensor::Range));
                let model = |view: &StateView<'_, N>| {
                    let frame = SensorFrame::of_sensor(view, MountedSensor::Range, &exposure);
                    absolute::wall(&frame, &map.walls, range.0, variance_m2)
                };
                self.update_or_recover(state, [NoiseGroup::Range], ln_anywhere(1, 0, variance_m2.sqrt()), model, |_| {
                    None
                })
            }
            ObservationKind::CompassHeading(heading) => {
                let variance_rad2 = self.noise_scale(state, NoiseGroup::Heading) * noise.compass_rad.powi(2);
                let exposure = self.exposure(state, StateTerm::Delay(MountedSensor::Compass));
                let model = |view: &StateView<'_, N>| {
                    let frame = SensorFrame::of_sensor(view, MountedSensor::Compass, &exposure);
                    Some(absolute::compass(&frame, heading.rad(), variance_rad2))
                };
                self.update_or_recover(state, [NoiseGroup::Heading], ln_anywhere(0, 1, 0.0), model, |_| None)
            }
            ObservationKind::WheelAngles { .. }
            | ObservationKind::OdometerPose(_)
            | ObservationKind::BodyVelocity { .. }
            | ObservationKind::TurnRate(_)
            | ObservationKind::WheelAccelerations { .. }
            | ObservationKind::Fix(_)
            | ObservationKind::Temperature(_) => FusionOutcome::Unused,
        }
    }

    /// Updates a located state, and lets the alternatives to its pose answer for the observation, too.
    fn update_or_recover<const N: usize, const M: usize>(
        &mut self,
        state: &mut PoseState<N>,
        groups: [NoiseGroup; M],
        ln_anything: f64,
        model: impl Fn(&StateView<'_, N>) -> Option<ObservationModel<M>>,
        own: impl FnOnce(&PoseState<N>) -> Option<(Se2, Matrix3<f64>)>,
    ) -> FusionOutcome {
        let (mean, pose) = (state.mean, state.pose);
        let view = StateView::new(&mean, pose, &self.context.layout);
        let verdict = if state.is_located {
            let Some(own) = model(&view) else { return FusionOutcome::Unused };
            self.gate_and_apply(state, &self.context.layout.linearize(&own), groups)
        } else {
            FusionOutcome::Unused
        };
        let own = |state: &PoseState<N>| {
            let (pose, covariance) = own(state)?;
            Some(OwnPose { pose, covariance, is_heading_known: true })
        };
        let winner = self.ask_alternatives(state, &view, verdict, ln_anything, model, own);
        let Some(winner) = winner else { return verdict };
        state.adopt(&winner, view.pose());
        FusionOutcome::PoseReset
    }

    /// Whether the believed pose does not explain an observation of `components`.
    fn is_refused<const N: usize>(&self, state: &PoseState<N>, verdict: FusionOutcome, components: usize) -> bool {
        !state.is_located || verdict == FusionOutcome::Gated || self.record.nis > self.context.gate(components)
    }

    /// Compares the alternatives with an observation, and returns one that becomes the pose. `own` is the pose that the observation
    /// speaks for.
    fn ask_alternatives<const N: usize, const M: usize>(
        &self,
        state: &mut PoseState<N>,
        view: &StateView<'_, N>,
        verdict: FusionOutcome,
        ln_anything: f64,
        model: impl Fn(&StateView<'_, N>) -> Option<ObservationModel<M>>,
        own: impl FnOnce(&PoseState<N>) -> Option<OwnPose>,
    ) -> Option<Alternative> {
        let stamp = state.stamp?;
        let is_refused = self.is_refused(state, verdict, M);
        if !is_refused {
            state.carried_at = state.carried_at.filter(|last| stamp - *last < PROBATION);
            if state.alternatives.is_empty() {
                return None;
            }
        }
        if is_being_carried(state) {
            return None;
        }
        let params = &self.context.config.params;
        let evidence = Evidence {
            believed: view.pose(),
            stamp,
            sensor: self.record.sensor,
            gate: self.context.gate(M),
            ln_likelihood: state.is_located.then_some(self.record.log_likelihood),
            is_refused,
            nis: self.record.nis,
            components: M,
            is_pose_doubtful: !state.is_located || state.carried_at.is_some(),
            ln_anything,
            reset_after_s: params.reset_after_s,
            reset_after_fixes: params.reset_after_fixes,
        };
        let moved_since = |from| state.noisy_motion_since(from, self.context);
        let mut alternatives = state.alternatives;
        let model = |pose| model(&view.at(pose)).map(|model| with_uncertain_constants(state, self.context, model));
        let winner = alternatives.observe(&evidence, moved_since, model, || own(state));
        alternatives.rebase(view.pose(), state.pose);
        state.alternatives = alternatives;
        state.sightings.rebase(view.pose(), state.pose);
        winner
    }

    /// Updates the state if the innovation passes the gate; with `student_dof` outliers are weighted down instead.
    fn gate_and_apply<const N: usize, const M: usize>(
        &mut self,
        state: &mut PoseState<N>,
        measurement: &LinearizedMeasurement<N, M>,
        groups: [NoiseGroup; M],
    ) -> FusionOutcome {
        let Some(s) = self.record_innovation(measurement, &state.covariance) else {
            return FusionOutcome::Malformed;
        };
        let nis = self.record.nis;
        let params = &self.context.config.params;
        self.learn_scales(state, measurement, &s, groups);
        let mut weighted = *measurement;
        if params.student_dof > 0.0 {
            weighted.noise *= (params.student_dof + nis) / (params.student_dof + M as f64);
        } else if nis > self.context.gate(M) {
            return FusionOutcome::Gated;
        }
        if !apply_measurement(&mut state.mean, &mut state.covariance, &weighted) {
            return FusionOutcome::Malformed;
        }
        state.inject();
        FusionOutcome::Accepted
    }

    fn learn_scales<const N: usize, const M: usize>(
        &self,
        state: &mut PoseState<N>,
        measurement: &LinearizedMeasurement<N, M>,
        s: &SMatrix<f64, M, M>,
        groups: [NoiseGroup; M],
    ) {
        for group in NoiseGroup::ALL {
            let mut votes = 0.0;
            let mut members = 0.0;
            for (i, _) in groups.iter().enumerate().filter(|(_, of)| **of == group) {
                votes += scale_vote(measurement.innovation[i], s[(i, i)], measurement.noise[(i, i)]);
                members += 1.0;
            }
            if members > 0.0 {
                let gain = self.context.config.params.adapt_gain;
                let source = self.noise_source(group);
                state.noise_scales.learn(source, votes / members, gain, state.wheel_path_m);
            }
        }
    }

    /// Writes innovation, S, NIS and log-likelihood into the record, and returns S; `None` when it is not positive definite.
    fn record_innovation<const N: usize, const M: usize>(
        &mut self,
        measurement: &LinearizedMeasurement<N, M>,
        covariance: &SMatrix<f64, N, N>,
    ) -> Option<SMatrix<f64, M, M>> {
        let s = measurement.innovation_covariance(covariance);
        write_innovation(self.record, &measurement.innovation, &s).then_some(s)
    }
}

/// A model whose noise includes what is unknown of all other states: alternatives have none of their own.
fn with_uncertain_constants<const N: usize, const M: usize>(
    state: &PoseState<N>,
    context: &UpdateContext,
    mut model: ObservationModel<M>,
) -> ObservationModel<M> {
    let has_row = |&(term, _): &(StateTerm, f64)| context.layout.row(term).is_some();
    if model.rows.iter().any(|row| row.terms.iter().flatten().any(has_row)) {
        let mut jacobian = context.layout.linearize::<N, M>(&model).jacobian;
        for row in [FORWARD, LEFT, HEADING] {
            jacobian.column_mut(row).fill(0.0);
        }
        model.noise += jacobian * state.covariance * jacobian.transpose();
    }
    model
}

/// Whether the robot is carried: what is seen then belongs to no place on the floor.
fn is_being_carried<const N: usize>(state: &PoseState<N>) -> bool {
    state.stamp.zip(state.carried_at).is_some_and(|(stamp, last)| stamp - last < PUT_DOWN)
}

/// Where a sighted landmark would be if the believed pose were right, m.
fn believed_place(view: &impl PoseView, exposure: &Exposure, sighting: RangeBearing) -> [f64; 2] {
    let [x_m, y_m, yaw_rad] =
        MountingAxis::ALL.map(|axis| view.term(StateTerm::Mounting(MountedSensor::Landmarks, axis)));
    let (sin, cos) = (yaw_rad + sighting.bearing_rad).sin_cos();
    let seen = Se2 { x_m: x_m + sighting.range_m * cos, y_m: y_m + sighting.range_m * sin, heading_rad: 0.0 };
    let place = view.pose().compose(exposure.moved_since.inverse()).compose(seen);
    [place.x_m, place.y_m]
}

/// A point of the map with its number there, which is none beyond those that may have states.
fn numbered<K: Ord>(points: &BTreeMap<K, Point2<Arena>>, id: &K) -> Option<(usize, Point2<Arena>)> {
    let position = points.get(id)?;
    let slot = points.keys().take(MAX_LANDMARKS.max(MAX_BEACONS)).position(|known| known == id);
    Some((slot.unwrap_or(usize::MAX), *position))
}

// The update that works with an almost unknown heading: Gauss-Newton on one observation.
//
//     minimise   c(xi) = xi' P^-1 xi + nu' R^-1 nu         nu the innovation at X exp xi
//     aim at     P H' S^-1 (nu + H xi)                     H taken at X exp xi, S = H P H' + R
//     xi <- xi + a (aim - xi)                              a = 1, 1/2, 1/4 ..: the first with which c falls
// With left-invariant errors an unknown heading is a straight line in xi however far the robot has moved, so that P expresses exactly
// what is known; only the observation bends, and the iteration follows it. Whole steps would swing to and fro where a tag far from
// mid-axle has been seen for long: there an innovation of millimetres bends the valley of c by radians. P may be singular (rows
// that are certain), so xi = P y is sought by its y. The minimum is chi-square distributed like a NIS.
// Source: Barrau and Bonnabel (2017); Bell and Cathey (1993) for the iterated update as Gauss-Newton; docs/maths/pose.md section 4.

/// Above this heading sigma an update is iterated: at 0.15 rad the curvature of a circle is 1 % of its radius.
pub(super) const ITERATE_ABOVE_RAD: f64 = 0.15;
/// An update that starts on the far side of the circle takes about twenty steps.
const MAX_STEPS: usize = 60;
/// Number of halvings of a step before the line search gives up: a thousandth of the step.
const MAX_HALVINGS: usize = 10;
/// Converged when c falls by less: a thirty-thousandth of a sigma.
const CONVERGED: f64 = 1e-9;
/// The same after the last step, for a long and flat minimum: a thirtieth of a sigma.
const NEARLY_CONVERGED: f64 = 1e-3;

pub(super) struct IteratedUpdate<const N: usize> {
    pub(super) state: PoseState<N>,
    /// c at the minimum: the NIS if the observation were linear.
    pub(super) nis: f64,
}

/// Finds the most likely correction; `None` when R or S has no inverse, or when the iteration does not converge.
pub(super) fn iterate<const N: usize, const M: usize>(
    state: &PoseState<N>,
    measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
) -> Option<IteratedUpdate<N>> {
    let mut at = TrialStep::at(state, SVector::zeros(), measure)?;
    let mut fall = f64::INFINITY;
    for _ in 0..MAX_STEPS {
        let aim = at.gauss_newton_target(&state.covariance)?;
        let Some(next) = at.line_search(&aim, state, measure) else {
            // Nowhere on the way is it better than here, but for rounding.
            return at.to_update(state);
        };
        fall = at.cost - next.cost;
        at = next;
        if fall < CONVERGED {
            return at.to_update(state);
        }
    }
    if fall < NEARLY_CONVERGED { at.to_update(state) } else { None }
}

struct TrialStep<const N: usize, const M: usize> {
    /// y of xi = P y.
    y: SVector<f64, N>,
    xi: SVector<f64, N>,
    /// Taken at X exp xi.
    measurement: LinearizedMeasurement<N, M>,
    cost: f64,
}

impl<const N: usize, const M: usize> TrialStep<N, M> {
    fn at(
        state: &PoseState<N>,
        y: SVector<f64, N>,
        measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
    ) -> Option<Self> {
        let xi = state.covariance * y;
        let measurement = measure(&corrected_state(state, &xi));
        let nu = measurement.innovation;
        let cost = y.dot(&xi) + nu.dot(&(measurement.noise.try_inverse()? * nu));
        cost.is_finite().then_some(Self { y, xi, measurement, cost })
    }

    /// The y of the most likely correction if the observation were linear.
    fn gauss_newton_target(&self, p: &SMatrix<f64, N, N>) -> Option<SVector<f64, N>> {
        let jacobian = self.measurement.jacobian * error_transport(&self.xi);
        let s = jacobian * p * jacobian.transpose() + self.measurement.noise;
        let nu = self.measurement.innovation;
        Some(jacobian.transpose() * (s.try_inverse()? * (nu + jacobian * self.xi)))
    }

    /// The first trial from `aim` back towards this one that has a lower cost.
    fn line_search(
        &self,
        aim: &SVector<f64, N>,
        state: &PoseState<N>,
        measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
    ) -> Option<Self> {
        let mut share = 1.0;
        for _ in 0..=MAX_HALVINGS {
            let y = self.y + (aim - self.y) * share;
            let better = Self::at(state, y, measure).filter(|next| next.cost < self.cost);
            if better.is_some() {
                return better;
            }
            share *= 0.5;
        }
        None
    }

    /// The state moved to this trial; its covariance stays as it is in the body's frame, to which the errors in P
    /// besides the turn are fixed. The correction's right Jacobian would give a robot at rest information about its
    /// heading from nothing but the noise of its fixes.
    fn to_update(&self, state: &PoseState<N>) -> Option<IteratedUpdate<N>> {
        let p = &state.covariance;
        let jacobian = self.measurement.jacobian;
        let s = self.measurement.innovation_covariance(p);
        let gain = p * jacobian.transpose() * s.try_inverse()?;
        let mut settled = corrected_state(state, &self.xi);
        settled.covariance = p - gain * jacobian * p;
        symmetrise(&mut settled.covariance);
        Some(IteratedUpdate { state: settled, nis: self.cost })
    }
}

fn corrected_state<const N: usize>(state: &PoseState<N>, xi: &SVector<f64, N>) -> PoseState<N> {
    let mut moved = *state;
    moved.mean += xi;
    moved.inject();
    moved
}

/// How errors about X exp xi follow from errors about X.
fn error_transport<const N: usize>(xi: &SVector<f64, N>) -> SMatrix<f64, N, N> {
    let mut turn = SMatrix::identity();
    let of_pose = Se2::right_jacobian([xi[FORWARD], xi[LEFT], xi[HEADING]]);
    for row in 0..3 {
        for column in 0..3 {
            turn[(row, column)] = of_pose[(row, column)];
        }
    }
    turn
}
