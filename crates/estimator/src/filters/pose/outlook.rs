//! What the pose filter tells the outside of an instant, with what the gyro says about the window that is still open.
//!
//! Inside, a window stays open until it is full, so this update is made aside. An estimate is asked for after every observation and
//! holds a third of the state: where nothing else changes, that third is all that is computed.

use posebridge_telemetry::{BrickClock, Estimate, MetersPerSecond, RadiansPerSecond, Span, Stamp, Validity};

use super::fuse::{self, Context};
use super::state::{FORWARD, HEADING, LEFT, Located, PoseBlock, PoseState, arena_pose};
use crate::filters::FilterConfig;
use crate::models::lie::Se2;
use crate::update::foretell_scalar;

/// Speeds are stale when no motion was observed for this long.
const SPEEDS_VALID: Span = Span::from_millis(500);

/// The pose and its error, as they are shown.
struct Shown {
    pose: Se2,
    covariance: PoseBlock,
}

impl Shown {
    fn of<const N: usize>(state: &PoseState<N>) -> Self {
        Self { pose: state.pose, covariance: state.pose_covariance() }
    }
}

/// The belief for an instant that does not lie before that of the state.
pub(super) fn estimate<const N: usize>(
    from: &PoseState<N>,
    stamp: Stamp<BrickClock>,
    context: &Context<'_>,
) -> Estimate {
    let is_there = from.stamp.is_some_and(|known| known == stamp);
    if is_there && let Some(shown) = with_open_window(from, context) {
        return published(from, &shown, stamp, context.config);
    }
    let mut state = *from;
    state.advance(stamp, context.track, context.config);
    fuse::use_gyro_window(&mut state, context);
    published(&state, &Shown::of(&state), stamp, context.config)
}

/// The pose with what the gyro says about the window so far; `None` where wheels have slipped, which changes more than the pose.
fn with_open_window<const N: usize>(state: &PoseState<N>, context: &Context<'_>) -> Option<Shown> {
    let Some((scalar, _)) = fuse::judged_gyro(state, context) else {
        return Some(Shown::of(state));
    };
    if fuse::shows_slip(state, &scalar, context) {
        return None;
    }
    let rows = [FORWARD, LEFT, HEADING];
    let (correction, covariance) = foretell_scalar(&state.mean, &state.covariance, &scalar, rows)?;
    Some(Shown { pose: state.pose.then(Se2::exp(correction)), covariance })
}

fn published<const N: usize>(
    state: &PoseState<N>,
    shown: &Shown,
    stamp: Stamp<BrickClock>,
    config: &FilterConfig,
) -> Estimate {
    let fix_age = state.last_fix.map(|last| (stamp - last).max(Span::ZERO));
    let timeout = Span::from_secs_f64(config.params.fix_timeout_s);
    Estimate {
        stamp,
        pose: arena_pose(shown.pose),
        forward_speed: MetersPerSecond(state.forward.value),
        turn_rate: RadiansPerSecond(state.turn.value),
        covariance: state.covariance_in_arena(shown.pose.heading_rad, &shown.covariance),
        validity: Validity {
            position: state.located != Located::No,
            heading: state.knows_heading_by(shown.covariance[2][2]),
            speeds: state.last_motion.is_some_and(|last| stamp - last <= SPEEDS_VALID),
        },
        is_dead_reckoning: fix_age.is_none_or(|age| age > timeout),
        fix_age,
        reset_counter: state.reset_counter,
        last_jump: state.last_jump,
    }
}
