//! What absolute observations do to the state of the pose filter: gate, weight, update.

use nalgebra::SMatrix;
use posebridge_telemetry::{BrickClock, Fix, FusionRecord, Observed, SensorId, Span, Stamp, Verdict};

use super::fuse::{Context, has_slipped, use_gyro_window};
use super::history::kind_of;
use super::iterate::{ITERATE_ABOVE_RAD, iterate};
use super::placing::{locate, move_to, refuse};
use super::scales::{Source, vote};
use super::state::{DELAY, HEADING, Located, PoseState, Refused};
use crate::filters::records::write_innovation;
use crate::models::lie::Se2;
use crate::observations::beacon::Beacon;
use crate::observations::landmark::Sighting;
use crate::observations::{beacon, compass, fix, landmark, wall};
use crate::update::{Measurement, apply};

/// The speeds at an earlier instant are told over this time about it: two readings of a 20 Hz brick.
const SPEED_SPAN: Span = Span::from_millis(100);
/// No camera is later than this, nor earlier.
const LONGEST_DELAY: Span = Span::from_millis(2_000);
/// How far before the state's instant the track is asked.
pub(super) const FURTHEST_BACK: Span = Span::from_millis(2_100);

/// Something absolute was seen.
pub(super) fn sight<const N: usize>(
    state: &mut PoseState<N>,
    seen: &Observed,
    stamp_sigma: Span,
    context: &Context<'_>,
    record: &mut FusionRecord,
) {
    // A slip that the gyro has noticed must not make the gate refuse the fix that would show it.
    if has_slipped(state, context)
        && let Some(window) = state.window
    {
        use_gyro_window(state, context);
        state.restart_window(window.until);
    }
    let judge = Judge { context, sensor: record.sensor, kind: kind_of(seen) };
    record.verdict = if let Observed::Fix(seen) = seen {
        judge.fix(state, seen, stamp_sigma, record)
    } else if state.located == Located::No {
        Verdict::Unused
    } else {
        judge.other(state, seen, record)
    };
    if matches!(record.verdict, Verdict::Accepted | Verdict::ResetTo) {
        state.last_fix = state.stamp;
        // A compass, a wall or a range that agrees does not tell that the position is right: only a fix answers for the fixes.
        if matches!(seen, Observed::Fix(_)) {
            state.refused = Refused::default();
        }
    }
}

/// The use of one sight.
struct Judge<'a> {
    context: &'a Context<'a>,
    sensor: SensorId,
    kind: u8,
}

/// The groups of a pose's components: the position errs alike along both axes, the heading for itself.
const POSE: [u8; 3] = [0, 0, 1];
/// The same without heading.
const POSITION: [u8; 2] = [0, 0];
/// Range and bearing have nothing in common.
const SIGHTING: [u8; 2] = [0, 1];
/// A single number.
const SINGLE: [u8; 1] = [0];

impl Judge<'_> {
    fn fix<const N: usize>(
        &self,
        state: &mut PoseState<N>,
        seen: &Fix,
        stamp_sigma: Span,
        record: &mut FusionRecord,
    ) -> Verdict {
        let circumstances = self.circumstances(state, stamp_sigma);
        let scales = [0, 1].map(|group| state.scales.factor(self.source(group)));
        let noise = fix::noise_of(seen, &self.context.config.noise, scales, &circumstances);
        let has_jumped = state.spaces.has_jumped(self.sensor, seen.reset_counter);
        if state.located == Located::No {
            return locate(state, seen, &noise, &circumstances);
        }
        if has_jumped {
            return move_to(state, seen, &noise, &circumstances);
        }
        let verdict = match seen.heading {
            Some(heading) => {
                let heading_rad = heading.rad();
                self.use_fix(state, (record, POSE), &|state: &PoseState<N>| {
                    fix::pose(state, seen, heading_rad, &noise, &circumstances)
                })
            }
            None => self.use_fix(state, (record, POSITION), &|state: &PoseState<N>| {
                fix::position(state, seen, &noise, &circumstances)
            }),
        };
        let turned_since_rad = circumstances.moved_since.heading_rad;
        let params = &self.context.config.params;
        if verdict == Verdict::Gated && refuse(state, record, turned_since_rad, params) {
            return move_to(state, seen, &noise, &circumstances);
        }
        verdict
    }

    /// One of the groups of what is judged.
    const fn source(&self, group: u8) -> Source {
        Source { sensor: self.sensor, kind: self.kind, group }
    }

    /// Uses a fix once, or again and again while the heading is hardly known.
    fn use_fix<const N: usize, const M: usize>(
        &self,
        state: &mut PoseState<N>,
        (record, groups): (&mut FusionRecord, [u8; M]),
        measure: &impl Fn(&PoseState<N>) -> Measurement<N, M>,
    ) -> Verdict {
        if state.covariance[(HEADING, HEADING)] <= ITERATE_ABOVE_RAD.powi(2) {
            return self.use_if_near(state, &measure(state), (record, groups));
        }
        if write(record, &measure(state), &state.covariance).is_none() {
            return Verdict::Malformed;
        }
        // A fix from which no correction is found is too far away: it must count among the refused, or nothing ever helps.
        let Some(found) = iterate(state, measure) else {
            return Verdict::Gated;
        };
        record.log_likelihood -= 0.5 * (found.nis - record.nis);
        record.nis = found.nis;
        if found.nis > self.context.gates[M - 1] {
            return Verdict::Gated;
        }
        *state = found.state;
        Verdict::Accepted
    }

    /// What is known about the instant that a fix shows, which may lie before its stamp.
    fn circumstances<const N: usize>(&self, state: &PoseState<N>, stamp_sigma: Span) -> fix::Circumstances {
        let now = state.stamp.unwrap_or(Stamp::ZERO);
        let delay = Span::from_secs_f64(state.value(DELAY)).clamp(-LONGEST_DELAY, LONGEST_DELAY);
        let shown = now - delay;
        let (track, config) = (self.context.track, self.context.config);
        let moved_since = if delay > Span::ZERO {
            state.moved_since(shown, track, config)
        } else {
            let ahead_s = -delay.as_secs_f64();
            Se2::exp([-state.forward.value * ahead_s, 0.0, -state.turn.value * ahead_s])
        };
        let (forward_m_per_s, turn_rad_per_s) = if N > DELAY && state.covariance[(DELAY, DELAY)] > 0.0 {
            self.speeds_about(state, shown)
        } else {
            (state.forward.value, state.turn.value)
        };
        fix::Circumstances { moved_since, stamp_sigma_s: stamp_sigma.as_secs_f64(), forward_m_per_s, turn_rad_per_s }
    }

    /// Forward speed and turn rate about an instant, by the wheels where they tell, else the held ones.
    fn speeds_about<const N: usize>(&self, state: &PoseState<N>, shown: Stamp<BrickClock>) -> (f64, f64) {
        let (track, config) = (self.context.track, self.context.config);
        let from = shown - Span::from_secs_f64(0.5 * SPEED_SPAN.as_secs_f64());
        let earlier = state.moved_since(from, track, config);
        let until = from + SPEED_SPAN;
        let later = state.moved_since(until, track, config);
        let covered_s = state.stamp.map_or(0.0, |now| (now.min(until) - from).as_secs_f64());
        if covered_s < 0.5 * SPEED_SPAN.as_secs_f64() {
            return (state.forward.value, state.turn.value);
        }
        let [forward_m, _, turn_rad] = earlier.then(later.inverse()).log();
        (forward_m / covered_s, turn_rad / covered_s)
    }

    fn other<const N: usize>(&self, state: &mut PoseState<N>, seen: &Observed, record: &mut FusionRecord) -> Verdict {
        let [scale, second] = [0, 1].map(|group| state.scales.factor(self.source(group)));
        let config = self.context.config;
        let (noise, world) = (&config.noise, &config.world);
        match *seen {
            Observed::Landmark { id, range, bearing } => {
                let variances = (scale * noise.landmark_range_m.powi(2), second * noise.landmark_bearing_rad.powi(2));
                let sighting = Sighting { range_m: range.0, bearing_rad: bearing.0 };
                let measurement = world
                    .landmarks
                    .get(&id)
                    .and_then(|place| landmark::measurement(state, *place, sighting, variances));
                self.use_if_any(state, measurement.as_ref(), (record, SIGHTING))
            }
            Observed::BeaconRange { id, range } => {
                let variance_m2 = scale * noise.beacon_range_m.powi(2);
                let known = world.beacons.iter().enumerate().find(|(_, (known, _))| **known == id);
                let measurement = known.and_then(|(slot, (_, place))| {
                    let beacon = Beacon { place: *place, slot };
                    beacon::measurement(state, beacon, range.0, variance_m2)
                });
                self.use_if_any(state, measurement.as_ref(), (record, SINGLE))
            }
            Observed::WallRange(range) => {
                let variance_m2 = scale * noise.wall_range_m.powi(2);
                let measurement = wall::measurement(state, &world.walls, range.0, variance_m2);
                self.use_if_any(state, measurement.as_ref(), (record, SINGLE))
            }
            Observed::CompassHeading(heading) => {
                let variance_rad2 = scale * noise.compass_rad.powi(2);
                let measurement = compass::measurement(state, heading.rad(), variance_rad2);
                self.use_if_any(state, Some(&measurement), (record, SINGLE))
            }
            Observed::WheelAngles { .. }
            | Observed::OdometerPose(_)
            | Observed::BodyVelocity { .. }
            | Observed::TurnRate(_)
            | Observed::WheelAccelerations { .. }
            | Observed::Fix(_)
            | Observed::Temperature(_) => Verdict::Unused,
        }
    }

    fn use_if_any<const N: usize, const M: usize>(
        &self,
        state: &mut PoseState<N>,
        measurement: Option<&Measurement<N, M>>,
        told: (&mut FusionRecord, [u8; M]),
    ) -> Verdict {
        measurement.map_or(Verdict::Unused, |measurement| self.use_if_near(state, measurement, told))
    }

    fn use_if_near<const N: usize, const M: usize>(
        &self,
        state: &mut PoseState<N>,
        measurement: &Measurement<N, M>,
        (record, groups): (&mut FusionRecord, [u8; M]),
    ) -> Verdict {
        let Some(s) = write(record, measurement, &state.covariance) else {
            return Verdict::Malformed;
        };
        let nis = record.nis;
        let params = &self.context.config.params;
        self.learn_scales(state, measurement, (&s, groups));
        let mut weighted = *measurement;
        if params.student_dof > 0.0 {
            weighted.noise *= (params.student_dof + nis) / (params.student_dof + M as f64);
        } else if nis > self.context.gates[M - 1] {
            return Verdict::Gated;
        }
        if !apply(&mut state.mean, &mut state.covariance, &weighted) {
            return Verdict::Malformed;
        }
        state.inject();
        Verdict::Accepted
    }

    /// What an innovation says about the noise of its source, group by group.
    fn learn_scales<const N: usize, const M: usize>(
        &self,
        state: &mut PoseState<N>,
        measurement: &Measurement<N, M>,
        (s, groups): (&SMatrix<f64, M, M>, [u8; M]),
    ) {
        for group in 0..=1 {
            let mut votes = 0.0;
            let mut members = 0.0;
            for (i, _) in groups.iter().enumerate().filter(|(_, of)| **of == group) {
                votes += vote(measurement.innovation[i], s[(i, i)], measurement.noise[(i, i)]);
                members += 1.0;
            }
            if members > 0.0 {
                let gain = self.context.config.params.adapt_gain;
                let source = self.source(group);
                state.scales.learn(source, votes / members, gain);
            }
        }
    }
}

/// Writes innovation, S, NIS and log-likelihood into the record, and gives S; `None` when it is not positive definite.
fn write<const N: usize, const M: usize>(
    record: &mut FusionRecord,
    measurement: &Measurement<N, M>,
    covariance: &SMatrix<f64, N, N>,
) -> Option<SMatrix<f64, M, M>> {
    let s = measurement.innovation_covariance(covariance);
    write_innovation(record, &measurement.innovation, &s).then_some(s)
}
