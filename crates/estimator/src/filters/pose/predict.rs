//! The pose filter's estimate for an instant, with the gyro readings of the window that is still open.
//!
//! A window stays open in the state until it is full, so this update is computed on a copy. An estimate is requested
//! after every observation and needs a third of the state: where nothing else changes, only that third is computed.

use posebridge_telemetry::{BrickClock, Estimate, MetersPerSecond, RadiansPerSecond, TimeDelta, Timestamp, Validity};

use super::motion_update::{self, UpdateContext};
use super::state::{FORWARD, HEADING, LEFT, PoseBlock, PoseState, PositionState, arena_pose};
use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::motion::SPEED_HOLD;
use crate::update::preview_scalar;

/// The pose and its covariance, as published.
struct PublishedPose {
    pose: Se2,
    covariance: PoseBlock,
}

impl PublishedPose {
    fn from_state<const N: usize>(state: &PoseState<N>) -> Self {
        Self { pose: state.pose, covariance: state.pose_covariance() }
    }
}

pub(super) fn estimate<const N: usize>(
    from: &PoseState<N>,
    stamp: Timestamp<BrickClock>,
    context: &UpdateContext<'_>,
) -> Estimate {
    let is_there = from.stamp.is_some_and(|known| known == stamp);
    if is_there && let Some(shown) = with_open_window(from, context) {
        return build_estimate(from, &shown, stamp, context.config);
    }
    let mut state = *from;
    state.advance(stamp, context.track, context.config);
    motion_update::update_gyro_window(&mut state, context);
    build_estimate(&state, &PublishedPose::from_state(&state), stamp, context.config)
}

/// The pose with the gyro readings of the window so far; `None` after wheel slip, which changes more than the pose.
fn with_open_window<const N: usize>(state: &PoseState<N>, context: &UpdateContext<'_>) -> Option<PublishedPose> {
    let Some((scalar, _)) = motion_update::preview_gyro_window(state, context) else {
        return Some(PublishedPose::from_state(state));
    };
    if motion_update::is_slip(state, &scalar, context) {
        return None;
    }
    let rows = [FORWARD, LEFT, HEADING];
    let (correction, covariance) = preview_scalar(&state.mean, &state.covariance, &scalar, rows)?;
    Some(PublishedPose { pose: state.pose.compose(Se2::exp(correction)), covariance })
}

fn build_estimate<const N: usize>(
    state: &PoseState<N>,
    shown: &PublishedPose,
    stamp: Timestamp<BrickClock>,
    config: &FilterConfig,
) -> Estimate {
    let fix_age = state.last_fix.map(|last| (stamp - last).max(TimeDelta::ZERO));
    let timeout = TimeDelta::from_secs_f64(config.params.fix_timeout_s);
    Estimate {
        stamp,
        pose: arena_pose(shown.pose),
        forward_speed: MetersPerSecond(state.forward.value),
        turn_rate: RadiansPerSecond(state.turn.value),
        covariance: state.covariance_in_arena(shown.pose.heading_rad, &shown.covariance),
        validity: Validity {
            position: state.position_state != PositionState::Unknown,
            heading: state.is_heading_known_at(shown.covariance[2][2]),
            speeds: state.last_motion.is_some_and(|last| stamp - last <= SPEED_HOLD),
        },
        is_dead_reckoning: fix_age.is_none_or(|age| age > timeout),
        fix_age,
        reset_counter: state.reset_counter,
        last_correction: state.last_jump,
    }
}
