//! What each kind of observation does to the state of the pose filter.

use nalgebra::{SMatrix, Vector2};
use posebridge_telemetry::{
    BrickClock, Fix, FusionRecord, Heading, Meters, Pose, Span, Stamp, Verdict,
    quantities::wrap_rad,
};

use super::state::{FORWARD, HEADING, Located, N, PoseState, Refused, TURN, WINDOW_ERROR, X, Y};
use crate::filters::{FilterConfig, StartPose};
use crate::gate::chi_square_quantile;
use crate::models::differential_drive::{body_step, step_noise};
use crate::motion::{GyroTrack, MotionTrack};
use crate::observations::{fix, gyro_window, speed};
use crate::update::{Measurement, apply, apply_to_row, consistency};

/// What the update of one observation needs besides the state.
pub struct Context<'a> {
    /// The filter's configuration.
    pub config: &'a FilterConfig,
    /// The wheels' travel.
    pub track: &'a MotionTrack,
    /// The gyro.
    pub gyro: &'a GyroTrack,
    /// The gate for one, two and three components.
    pub gates: &'a Gates,
}

/// Quantiles of chi-square with one, two and three degrees of freedom.
pub type Gates = [f64; 3];

/// The gates of a configuration.
#[must_use]
pub fn gates_of(config: &FilterConfig) -> Gates {
    [1, 2, 3].map(|degrees| chi_square_quantile(degrees, config.params.gate_probability))
}

/// A gyro that has been silent for longer no longer outranks the encoders' turn rate.
const GYRO_SILENT: Span = Span::from_millis(500);
/// Two fixes tell a heading once the robot has gone this far between them, m: ten times a good camera's error.
const ANCHOR_BASE_M: f64 = 0.15;
/// Refused fixes agree with each other when their innovations differ by less than this many standard deviations.
const AGREEMENT_SIGMAS: f64 = 5.0;

/// Motion was observed: the pose has been carried there already; speeds and gyro window follow.
pub fn motion(state: &mut PoseState, stamp: Stamp<BrickClock>, context: &Context<'_>) {
    if let Some((before, travel)) = context.track.step_to(stamp) {
        let step = body_step(travel, &context.config.geometry);
        let noise = step_noise(travel, &context.config.geometry, &context.config.noise);
        let dt_s = (stamp - before).as_secs_f64();
        let geometry = &context.config.geometry;
        let forward = speed::forward(&state.mean, step, &noise, dt_s, geometry);
        apply_to_row(&mut state.mean, &mut state.covariance, FORWARD, &forward);
        let gyro_speaks = context
            .gyro
            .last_until(stamp)
            .is_some_and(|last| last + GYRO_SILENT > stamp);
        if !gyro_speaks {
            let turn = speed::turn(&state.mean, step, &noise, dt_s, geometry);
            apply_to_row(&mut state.mean, &mut state.covariance, TURN, &turn);
        }
    }
    state.last_motion = Some(stamp);
    let length = Span::from_secs_f64(context.config.params.gyro_window_s);
    match state.window {
        None => state.restart_window(stamp),
        Some(window) if stamp - window.start >= length => {
            if context.gyro.covers(window.start, stamp) {
                use_gyro_window(state, context);
            }
            state.restart_window(stamp);
        }
        Some(_) => {}
    }
}

/// The gyro spoke: the turn rate follows at once, the heading when the window closes.
pub fn turn_rate(state: &mut PoseState, rate_rad_per_s: f64, context: &Context<'_>) {
    let measurement = speed::gyro(&state.mean, rate_rad_per_s, &context.config.noise);
    apply_to_row(&mut state.mean, &mut state.covariance, TURN, &measurement);
}

/// Uses what the gyro says about the window so far. Where gyro and encoders disagree beyond chance the wheels slipped: the
/// disagreement is then added to the uncertainty of the encoders' turn, and the gyro decides.
pub fn use_gyro_window(state: &mut PoseState, context: &Context<'_>) {
    let Some((measurement, nis)) = gyro_measurement(state, context) else {
        return;
    };
    if nis > context.config.params.slip_nis {
        allow_for_slip(state, measurement.innovation[0].powi(2), nis, context);
    }
    if apply(&mut state.mean, &mut state.covariance, &measurement) {
        state.mean[HEADING] = wrap_rad(state.mean[HEADING]);
    }
}

/// The wheels counted a turn too much that may be all of the disagreement. Whichever wheel it was, the distance is then wrong
/// by half of what that wheel slipped, and the window's path was laid out in a wrong direction. For these the share that chance
/// explains does not count: a false alarm must not cost position.
fn allow_for_slip(state: &mut PoseState, slip_rad2: f64, nis: f64, context: &Context<'_>) {
    let forward_m = state.window.map_or(0.0, |window| window.encoder_forward_m);
    for row in [HEADING, WINDOW_ERROR] {
        for column in [HEADING, WINDOW_ERROR] {
            state.covariance[(row, column)] += slip_rad2;
        }
    }
    let beyond_chance_rad2 = slip_rad2 * (1.0 - context.config.params.slip_nis / nis);
    let along_m2 = 0.25 * beyond_chance_rad2 * context.config.geometry.track_width.0.powi(2);
    let across_m2 = 0.25 * beyond_chance_rad2 * forward_m * forward_m;
    let (sin, cos) = state.mean[HEADING].sin_cos();
    let along = Vector2::new(cos, sin);
    let across = Vector2::new(-sin, cos);
    let spread = along * along.transpose() * along_m2 + across * across.transpose() * across_m2;
    for (row, i) in [(X, 0), (Y, 1)] {
        for (column, j) in [(X, 0), (Y, 1)] {
            state.covariance[(row, column)] += spread[(i, j)];
        }
    }
}

fn gyro_measurement(state: &PoseState, context: &Context<'_>) -> Option<(Measurement<N, 1>, f64)> {
    let window = state.window?;
    if window.until <= window.start || !context.gyro.covers(window.start, window.until) {
        return None;
    }
    let turn = context.gyro.turn_between(window.start, window.until);
    let measurement = gyro_window::measurement(
        &state.mean,
        &window,
        &turn,
        &context.config.geometry,
        &context.config.noise,
    );
    let s = measurement.innovation_covariance(&state.covariance)[0];
    (s > 0.0).then(|| (measurement, measurement.innovation[0].powi(2) / s))
}

/// A fix came: gate, update, and the way out when the gate is wrong.
pub fn fix(
    state: &mut PoseState,
    seen: &Fix,
    stamp_sigma: Span,
    context: &Context<'_>,
    record: &mut FusionRecord,
) {
    // A slip that the gyro has noticed must not make the gate refuse the fix that would show it.
    if let Some((_, nis)) = gyro_measurement(state, context)
        && nis > context.config.params.slip_nis
        && let Some(window) = state.window
    {
        use_gyro_window(state, context);
        state.restart_window(window.until);
    }
    let noise = fix::noise_of(
        seen,
        &fix::Circumstances {
            noise: &context.config.noise,
            stamp_sigma_s: stamp_sigma.as_secs_f64(),
            forward_m_per_s: state.mean[FORWARD],
            turn_rad_per_s: state.mean[TURN],
        },
    );
    record.verdict = match state.located {
        Located::Yes => gated(state, seen, &noise, context, record),
        Located::No => locate(state, seen, &noise),
        Located::Anchored { x_m, y_m } => find_heading(state, seen, &noise, (x_m, y_m)),
    };
    if matches!(record.verdict, Verdict::Accepted | Verdict::ResetTo) {
        state.last_fix = state.stamp;
        state.refused = Refused::default();
    }
}

fn gated(
    state: &mut PoseState,
    seen: &Fix,
    noise: &fix::FixNoise,
    context: &Context<'_>,
    record: &mut FusionRecord,
) -> Verdict {
    let verdict = match seen.heading {
        Some(heading) => {
            let measurement = fix::pose(&state.mean, seen, heading.rad(), noise);
            use_if_near(state, &measurement, context, record)
        }
        None => use_if_near(
            state,
            &fix::position(&state.mean, seen, noise),
            context,
            record,
        ),
    };
    if verdict != Verdict::Gated {
        return verdict;
    }
    if refuse(state, record, context) {
        move_to(state, seen, noise)
    } else {
        Verdict::Gated
    }
}

fn use_if_near<const M: usize>(
    state: &mut PoseState,
    measurement: &Measurement<N, M>,
    context: &Context<'_>,
    record: &mut FusionRecord,
) -> Verdict {
    let s = measurement.innovation_covariance(&state.covariance);
    let Some((nis, log_likelihood)) = consistency(&measurement.innovation, &s) else {
        return Verdict::Malformed;
    };
    for row in 0..M {
        record.innovation[row] = measurement.innovation[row];
        for column in 0..M {
            record.innovation_covariance[row][column] = s[(row, column)];
        }
    }
    record.nis = nis;
    record.degrees_of_freedom = M as u8;
    record.log_likelihood = log_likelihood;
    if nis > context.gates[M - 1] {
        return Verdict::Gated;
    }
    if !apply(&mut state.mean, &mut state.covariance, measurement) {
        return Verdict::Malformed;
    }
    state.mean[HEADING] = wrap_rad(state.mean[HEADING]);
    Verdict::Accepted
}

/// Counts a refused fix; true when enough of them agree with each other for long enough that the estimate must be wrong.
fn refuse(state: &mut PoseState, record: &FusionRecord, context: &Context<'_>) -> bool {
    let innovation_m = [record.innovation[0], record.innovation[1]];
    let last = state.refused.innovation_m;
    let sigma_m = (record.innovation_covariance[0][0] + record.innovation_covariance[1][1])
        .max(0.0)
        .sqrt();
    let apart_m = (innovation_m[0] - last[0]).hypot(innovation_m[1] - last[1]);
    let agrees = state.refused.count == 0 || apart_m < AGREEMENT_SIGMAS * sigma_m;
    if !agrees {
        state.refused = Refused::default();
    }
    state.refused.count += 1;
    state.refused.since = state.refused.since.or(state.stamp);
    state.refused.innovation_m = innovation_m;
    let lasted = match (state.refused.since, state.stamp) {
        (Some(since), Some(stamp)) => (stamp - since).as_secs_f64(),
        _ => 0.0,
    };
    lasted >= context.config.params.reset_after_s
        && f64::from(state.refused.count) >= context.config.params.reset_after_fixes
}

/// Moves the estimate to a fix: a reset, counted, with its jump.
fn move_to(state: &mut PoseState, seen: &Fix, noise: &fix::FixNoise) -> Verdict {
    let before = state.pose();
    // Without a heading in the fix this is an anchor only: the heading may be as wrong as the position, it is found anew.
    locate(state, seen, noise);
    state.count_jump_from(before);
    Verdict::ResetTo
}

/// Takes position, and heading if there is one, from a fix.
fn locate(state: &mut PoseState, seen: &Fix, noise: &fix::FixNoise) -> Verdict {
    let heading_rad = seen.heading.map_or(state.mean[HEADING], Heading::rad);
    let (sin, cos) = heading_rad.sin_cos();
    let (lever_x, lever_y) = (seen.tag_in_body.x.0, seen.tag_in_body.y.0);
    let x_m = seen.position.x.0 - (lever_x * cos - lever_y * sin);
    let y_m = seen.position.y.0 - (lever_x * sin + lever_y * cos);
    // Without a heading the tag may be anywhere on a circle about mid-axle.
    let lever_var_m2 = if seen.heading.is_some() {
        0.0
    } else {
        lever_x * lever_x + lever_y * lever_y
    };
    let position_var_m2 = 0.5 * noise.position.trace() + lever_var_m2;
    state.place(&StartPose {
        pose: Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad)),
        position_sigma_m: position_var_m2.max(0.0).sqrt(),
        heading_sigma_rad: match seen.heading {
            Some(_) => noise.heading_rad2.max(0.0).sqrt(),
            // Uniform on the circle.
            None => std::f64::consts::PI / 3.0_f64.sqrt(),
        },
    });
    if seen.heading.is_none() {
        state.located = Located::Anchored { x_m, y_m };
    }
    Verdict::Accepted
}

/// Turns the path since the anchor so that it ends at the fix, once it is long enough to tell a direction.
fn find_heading(
    state: &mut PoseState,
    seen: &Fix,
    noise: &fix::FixNoise,
    anchor_m: (f64, f64),
) -> Verdict {
    if seen.heading.is_some() {
        return locate(state, seen, noise);
    }
    let path = (state.mean[X] - anchor_m.0, state.mean[Y] - anchor_m.1);
    let seen_path = (
        seen.position.x.0 - anchor_m.0,
        seen.position.y.0 - anchor_m.1,
    );
    let base_m = path.0.hypot(path.1);
    let position_var_m2 = 0.5 * noise.position.trace();
    if base_m < ANCHOR_BASE_M.max(10.0 * position_var_m2.sqrt()) {
        return Verdict::Unused;
    }
    let turn_rad = seen_path.1.atan2(seen_path.0) - path.1.atan2(path.0);
    let lever_var_m2 = seen.tag_in_body.x.0.powi(2) + seen.tag_in_body.y.0.powi(2);
    let turn_var_rad2 = 2.0 * (position_var_m2 + lever_var_m2) / (base_m * base_m);
    let heading_rad = state.mean[HEADING] + turn_rad;
    state.place(&StartPose {
        pose: Pose::new(
            seen.position.x,
            seen.position.y,
            Heading::from_rad(heading_rad),
        ),
        position_sigma_m: (position_var_m2 + lever_var_m2).sqrt(),
        heading_sigma_rad: turn_var_rad2.sqrt(),
    });
    Verdict::Accepted
}

/// The covariance of pose and speeds, for the outside.
#[must_use]
pub fn published_covariance(covariance: &SMatrix<f64, N, N>) -> [[f64; 5]; 5] {
    let mut published = [[0.0; 5]; 5];
    for (row, values) in published.iter_mut().enumerate() {
        for (column, value) in values.iter_mut().enumerate() {
            *value = covariance[(row, column)];
        }
    }
    published
}
