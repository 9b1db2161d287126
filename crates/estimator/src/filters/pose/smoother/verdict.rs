//! Whether an absolute observation agrees with all others: its innovation at the smoothed state, as if it had not been used.
//!
//! ```text
//! S = R + H P H'    for one that was not used          P the smoothed covariance
//! S = R - H P H'    for one that was, because the state has moved towards it
//! ```

use nalgebra::{Matrix3, Vector3};
use posebridge_telemetry::{FusionOutcome, FusionRecord};

use super::super::absolute_update::update_absolute;
use super::super::context::UpdateContext;
use super::super::entry::{PoseEntry, UpdateKind};
use super::super::scratch_record;
use super::super::state::PoseState;
use crate::update::nis_and_log_likelihood;

#[derive(Clone, Copy, Debug)]
pub(super) struct Verdict {
    pub(super) components: usize,
    /// Normalised innovation squared against all other observations; `None` for one without which nothing would be known.
    pub(super) left_out_nis: Option<f64>,
    /// The same against its own noise alone.
    pub(super) residual: f64,
}

/// Judges an observation that had this outcome; `None` for what is no absolute observation, and for one that says nothing there.
pub(super) fn judge<const N: usize>(
    smoothed: &PoseState<N>,
    entry: &PoseEntry,
    outcome: FusionOutcome,
    context: &UpdateContext,
) -> Option<Verdict> {
    if !smoothed.is_located {
        return None;
    }
    let mut certain = *smoothed;
    certain.covariance.fill(0.0);
    let with_state = innovation(*smoothed, entry, context)?;
    let own = innovation(certain, entry, context)?;
    let components = usize::from(with_state.degrees_of_freedom);
    let was_used = matches!(outcome, FusionOutcome::Accepted | FusionOutcome::PoseReset);
    let sign = if was_used { -1.0 } else { 1.0 };
    let left_out = own.s + (with_state.s - own.s) * sign;
    Some(Verdict {
        components,
        left_out_nis: nis(&with_state.nu, left_out, components),
        residual: nis(&with_state.nu, own.s, components)?,
    })
}

struct Innovation {
    nu: Vector3<f64>,
    s: Matrix3<f64>,
    degrees_of_freedom: u8,
}

fn innovation<const N: usize>(
    mut state: PoseState<N>,
    entry: &PoseEntry,
    context: &UpdateContext,
) -> Option<Innovation> {
    let UpdateKind::Absolute(observation, stamp_sigma) = &entry.update else { return None };
    // Neither an open window nor another pose is to answer for it.
    state.close_window();
    state.forget_alternatives();
    let mut record: FusionRecord = scratch_record(entry);
    update_absolute(&mut state, observation, *stamp_sigma, context, &mut record);
    (record.degrees_of_freedom > 0).then(|| Innovation {
        nu: Vector3::from(record.innovation),
        s: Matrix3::from_fn(|i, j| record.innovation_covariance[i][j]),
        degrees_of_freedom: record.degrees_of_freedom,
    })
}

fn nis(nu: &Vector3<f64>, mut s: Matrix3<f64>, components: usize) -> Option<f64> {
    for unused in components..3 {
        s[(unused, unused)] = 1.0;
    }
    nis_and_log_likelihood(nu, &s).map(|(nis, _)| nis)
}
