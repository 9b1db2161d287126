//! Updates of the pose filter's state by motion observations: speeds, gyro windows, slip.

use posebridge_telemetry::{BrickClock, FusionRecord, MountedSensor, TimeDelta, Timestamp};

use super::context::UpdateContext;
use super::layout::{FORWARD, GYRO_BIAS, GYRO_SCALE, HEADING, LEFT, ROUNDING, WINDOW_TURN};
use super::state::{MotionEvidence, PoseState, Slip, linearize_gyro_window};
use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, body_step, step_noise};
use crate::models::planar_speeds::Acceleration;
use crate::observations::gyro_window::{GyroWindow, largest_rounding, rounding_variance};
use crate::observations::{gyro_window, speed};
use crate::update::{ScalarMeasurement, ScalarOutcome, UpdateOutcome, use_scalar};
use crate::validation::add_innovation;

/// A gyro that has been silent for longer no longer takes precedence over the encoders' turn rate.
const GYRO_TIMEOUT: TimeDelta = TimeDelta::from_millis(500);
/// Wheels whose counts have not changed for this time stand.
const STANDING: TimeDelta = TimeDelta::from_millis(200);
/// A robot that has turned by this while its wheels stood is carried, however slowly: six degrees, more than the play of its gears allows.
const CARRIED_RAD: f64 = 0.1;
/// A robot that turns faster than its wheels say by this is carried, or turned by hand: 17 degrees per second.
const CARRIED_RAD_PER_S: f64 = 0.3;
/// The acceleration between two samples further apart than this is unknown.
const MAX_ACCELERATION_INTERVAL: TimeDelta = TimeDelta::from_millis(200);

/// Updates speeds and gyro window by a motion reading; the pose must have been propagated to its instant.
pub fn update_motion<const N: usize>(
    state: &mut PoseState<N>,
    stamp: Timestamp<BrickClock>,
    context: &UpdateContext,
    record: &mut FusionRecord,
) {
    let step = context.track.step_to(stamp);
    if step.is_none_or(|(_, travel)| travel != WheelTravel::default()) {
        state.tick_activity.record_change(stamp);
    }
    if let Some((before, travel)) = step {
        let geometry = &context.config.geometry;
        let step = body_step(travel, geometry);
        let noise = step_noise(travel, geometry, &context.config.noise);
        let dt_s = (stamp - before).as_secs_f64();
        state.forward.observe(speed::forward_reading(step, &noise, dt_s, geometry));
        let has_gyro = context.gyro.last_at_or_before(stamp).is_some_and(|last| last + GYRO_TIMEOUT > stamp);
        if !has_gyro {
            state.turn.observe(speed::turn_reading(step, &noise, dt_s, geometry));
        }
    }
    state.status.last_motion = Some(stamp);
    state.motion_evidence = MotionEvidence { has_been_heard: true, may_turn: true };
    let length_s = context.config.params.gyro_window_s;
    match state.window {
        None => {
            // The rounding at the end of the last window says nothing about the beginning of this one.
            state.reset_rounding(rounding_variance(&context.config.geometry));
            state.restart_window(stamp);
        }
        Some(window) if (stamp - window.start).as_secs_f64() >= length_s => {
            if context.gyro.covered_turn(window.start, stamp).is_some()
                && let Some((scalar, outcome)) = update_gyro_window(state, context)
            {
                add_innovation(record, scalar.innovation, &outcome);
            } else {
                state.reset_rounding(rounding_variance(&context.config.geometry));
            }
            state.restart_window(stamp);
        }
        Some(_) => {}
    }
}

/// Updates the turn rate by a gyro sample; the heading follows when the window closes.
pub fn update_turn_rate<const N: usize>(state: &mut PoseState<N>, rate_rad_per_s: f64, context: &UpdateContext) {
    let known = |row: usize| speed::Speed { value: state.mean[row], variance: state.covariance[(row, row)] };
    let reading = speed::gyro_reading(rate_rad_per_s, known(GYRO_BIAS), known(GYRO_SCALE), &context.config.noise);
    state.turn.observe(reading);
    state.motion_evidence.may_turn = true;
    let stamp = state.speeds_predicted_to.unwrap_or(Timestamp::ZERO);
    let stands = state.tick_activity.changed_at.is_some_and(|last| stamp - last >= STANDING)
        && state.status.last_motion.is_some_and(|last| stamp - last < STANDING);
    let turns = stands && reading.value.abs() > CARRIED_RAD_PER_S && reading.value.powi(2) > 9.0 * reading.variance;
    // One reading may be a fault.
    if turns && state.turned_at_rest {
        state.note_carried(stamp);
    }
    state.turned_at_rest = turns;
}

pub fn update_accelerations<const N: usize>(
    state: &mut PoseState<N>,
    felt: Acceleration,
    stamp: Timestamp<BrickClock>,
    context: &UpdateContext,
) {
    let since = state.last_acceleration.map(|last| stamp - last);
    if let Some(dt) = since.filter(|dt| *dt > TimeDelta::ZERO && *dt <= MAX_ACCELERATION_INTERVAL) {
        let config = &context.config;
        let imu = &config.calibration.mountings[MountedSensor::Imu];
        let felt =
            felt.at_mid_axle([imu.x_m.value, imu.y_m.value, imu.yaw_rad.value], state.forward.value, state.turn.value);
        let changes = speed::speed_changes(felt, dt.as_secs_f64(), &config.geometry, &config.noise);
        for (speed, change) in [&mut state.forward, &mut state.turn].into_iter().zip(changes) {
            speed.value += change.value;
            speed.variance += change.variance;
        }
    }
    state.last_acceleration = Some(stamp);
}

/// Uses the gyro readings of the window so far. Where gyro and encoders disagree beyond chance, the wheels slipped: the
/// disagreement is added to the variance of the encoders' turn, so that the gyro decides.
pub fn update_gyro_window<const N: usize>(
    state: &mut PoseState<N>,
    context: &UpdateContext,
) -> Option<(ScalarMeasurement<4>, ScalarOutcome)> {
    let scalar = preview_gyro_window(state, context)?;
    if is_slip(state, &scalar, context) {
        let innovation_variance = scalar.innovation_variance(&state.covariance);
        if let Some(window) = state.window {
            record_slip(state, &window, scalar.innovation, innovation_variance, &context.config);
        }
    }
    let outcome = match end_rounding(state, context) {
        Some(variance_rad2) => update_with_end_rounding(state, &scalar, variance_rad2),
        None => use_scalar(&mut state.mean, &mut state.covariance, &scalar, f64::INFINITY),
    };
    state.inject();
    (outcome.outcome == UpdateOutcome::Used).then_some((scalar, outcome))
}

/// Uses the window, and puts the rounding at its end in the place of that at its beginning. The new rounding n takes part in the
/// innovation with -1, so that after the update
///
/// ```text
/// mean n = -v nu / S      var n = v - v^2 / S      cov(x, n) = v P H' / S         v its variance before
/// ```
fn update_with_end_rounding<const N: usize>(
    state: &mut PoseState<N>,
    scalar: &ScalarMeasurement<4>,
    variance: f64,
) -> ScalarOutcome {
    let cross = scalar.cross_covariance(&state.covariance);
    let (mean, covariance) = (&mut state.mean, &mut state.covariance);
    let outcome = use_scalar(mean, covariance, scalar, f64::INFINITY);
    if outcome.outcome == UpdateOutcome::Used {
        let share = variance / outcome.innovation_variance;
        for row in 0..N {
            covariance[(row, ROUNDING)] = cross[row] * share;
            covariance[(ROUNDING, row)] = cross[row] * share;
        }
        covariance[(ROUNDING, ROUNDING)] = variance * (1.0 - share);
        mean[ROUNDING] = -share * scalar.innovation;
    }
    outcome
}

pub fn has_slipped<const N: usize>(state: &PoseState<N>, context: &UpdateContext) -> bool {
    preview_gyro_window(state, context).is_some_and(|scalar| is_slip(state, &scalar, context))
}

/// Whether gyro and encoders disagree by more than rounding can, beyond what chance adds. Rounding is not normal but bounded: while
/// a robot turns slowly, counts of both wheels that come together reach the bound again and again.
pub(super) fn is_slip<const N: usize>(
    state: &PoseState<N>,
    scalar: &ScalarMeasurement<4>,
    context: &UpdateContext,
) -> bool {
    let counted_rad = (scalar.innovation + scalar.jacobian[2] * state.mean[ROUNDING]).abs();
    let beyond_rad = counted_rad - largest_rounding(&context.config.geometry);
    if beyond_rad <= 0.0 {
        return false;
    }
    let but_rounding = ScalarMeasurement {
        innovation: beyond_rad,
        rows: [scalar.rows[0], scalar.rows[1], scalar.rows[3]],
        jacobian: [scalar.jacobian[0], scalar.jacobian[1], scalar.jacobian[3]],
        variance: scalar.variance - end_rounding(state, context).unwrap_or(0.0),
    };
    let chance_rad2 = but_rounding.innovation_variance(&state.covariance);
    beyond_rad.powi(2) > context.config.params.slip_nis * chance_rad2
}

/// Notes a slip of this window and adds its variance. A robot that is carried looks like one that slips.
fn record_slip<const N: usize>(
    state: &mut PoseState<N>,
    window: &GyroWindow,
    innovation_rad: f64,
    innovation_variance: f64,
    config: &FilterConfig,
) {
    let wheels_rad = state.mean[WINDOW_TURN];
    let before = state.slip.filter(|slip| slip.until >= window.start);
    let beyond_chance_rad = beyond_chance_rad(innovation_rad, innovation_variance, config);
    let slip = Slip {
        until: window.until,
        turned_rad: before.map_or(0.0, |slip| slip.turned_rad) + beyond_chance_rad,
        wheels_stood: wheels_rad == 0.0 && window.forward_m == 0.0 && before.is_none_or(|slip| slip.wheels_stood),
    };
    inflate_heading(state, innovation_rad.powi(2));
    // Wheels that stood have not measured any travel that could be wrong.
    if !slip.wheels_stood {
        inflate_position(state, before.map_or(0.0, |slip| slip.turned_rad), beyond_chance_rad, config);
    }
    state.slip = Some(slip);
    let length_s = (window.until - window.start).as_secs_f64();
    // One whose wheels go on turning in the air turns more than its wheels.
    let turns_in_the_air = (innovation_rad + wheels_rad).abs() > wheels_rad.abs() + CARRIED_RAD_PER_S * length_s;
    if turns_in_the_air || (slip.wheels_stood && slip.turned_rad.abs() > CARRIED_RAD) {
        state.note_carried(window.until);
    }
}

/// The part of a disagreement that chance does not explain. A rounding that is known to be large can hide a slip in a small innovation:
/// then none of it is beyond chance.
fn beyond_chance_rad(innovation_rad: f64, innovation_variance: f64, config: &FilterConfig) -> f64 {
    let nis = innovation_rad.powi(2) / innovation_variance;
    innovation_rad * (1.0 - config.params.slip_nis / nis).max(0.0).sqrt()
}

/// Adds the variance of a slip to the turns by the wheels, which may be the whole disagreement.
fn inflate_heading<const N: usize>(state: &mut PoseState<N>, slip_rad2: f64) {
    for row in [HEADING, WINDOW_TURN] {
        for column in [HEADING, WINDOW_TURN] {
            state.covariance[(row, column)] += slip_rad2;
        }
    }
}

/// Adds the variance of a slip to the position. The share of each wheel is unknown: the distance is wrong by something between minus
/// and plus half of the slip's total, uniformly, and the window's path was integrated in a wrong direction. The share that chance
/// explains is left out: a false alarm must not cost position.
fn inflate_position<const N: usize>(
    state: &mut PoseState<N>,
    before_rad: f64,
    beyond_chance_rad: f64,
    config: &FilterConfig,
) {
    let forward_m = state.window.map_or(0.0, |window| window.forward_m);
    // Of one slip over several windows the total counts: its windows are wrong in the same way.
    let total_rad2 = ((before_rad + beyond_chance_rad).powi(2) - before_rad.powi(2)).max(0.0);
    let along_m2 = total_rad2 * config.geometry.track_width.0.powi(2) / 12.0;
    let across_m2 = 0.25 * beyond_chance_rad.powi(2) * forward_m * forward_m;
    state.covariance[(FORWARD, FORWARD)] += along_m2;
    state.covariance[(LEFT, LEFT)] += across_m2;
}

/// The variance of the rounding at the window's end; `None` where it is that at the beginning, because the robot
/// rested.
fn end_rounding<const N: usize>(state: &PoseState<N>, context: &UpdateContext) -> Option<f64> {
    let rested = state.window.is_some_and(|window| state.tick_activity.is_stationary(window.start, window.until));
    (!rested).then(|| rounding_variance(&context.config.geometry))
}

/// Evaluates the window so far without changing the state.
pub(super) fn preview_gyro_window<const N: usize>(
    state: &PoseState<N>,
    context: &UpdateContext,
) -> Option<ScalarMeasurement<4>> {
    let window = state.window?;
    if window.until <= window.start {
        return None;
    }
    let turn = context.gyro.covered_turn(window.start, window.until)?;
    let noise = &context.config.noise;
    let model =
        gyro_window::measurement(&state.view(&context.layout), &window, &turn, noise, end_rounding(state, context));
    let scalar = linearize_gyro_window(&model);
    (scalar.innovation_variance(&state.covariance) > 0.0).then_some(scalar)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::tests::config;
    use crate::filters::pose::layout::{CORE_STATES, StateLayout};

    #[test]
    fn a_slip_costs_position_only_as_far_as_chance_does_not_explain_it() {
        let config = config();
        let slip_rad2: f64 = 0.04;
        let grown_by = |nis: f64| {
            let mut state = PoseState::<CORE_STATES>::initial(&config, &StateLayout::new(&config, CORE_STATES));
            state.window = Some(GyroWindow { forward_m: 0.3, ..GyroWindow::starting(Timestamp::ZERO) });
            let before = state.covariance;
            let beyond_rad = beyond_chance_rad(slip_rad2.sqrt(), slip_rad2 / nis, &config);
            inflate_heading(&mut state, slip_rad2);
            inflate_position(&mut state, 0.0, beyond_rad, &config);
            state.covariance - before
        };
        // Half of the disagreement's square is beyond chance: the distance is uniform over half of the track times it either way, and
        // the path of 0.3 m was integrated in a direction that is wrong by half of it.
        let grown = grown_by(2.0 * config.params.slip_nis);
        let track_m = config.geometry.track_width.0;
        for (row, expected) in [
            (FORWARD, 0.02 * track_m * track_m / 12.0),
            (LEFT, 0.02 * 0.15 * 0.15),
            (HEADING, 0.04),
            (WINDOW_TURN, 0.04),
        ] {
            assert!((grown[(row, row)] - expected).abs() < 1e-12, "row {row}: {}", grown[(row, row)]);
        }
        let grown = grown_by(0.5 * config.params.slip_nis);
        assert_eq!((grown[(FORWARD, FORWARD)], grown[(LEFT, LEFT)]), (0.0, 0.0));
    }
}
