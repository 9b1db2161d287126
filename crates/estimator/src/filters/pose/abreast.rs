//! A reading of the gyro that comes right behind the wheels' reading of the same instant, before which it belongs.
//!
//! Robots that read all of their sensors at once stamp both alike. To apply the wheels' reading again, behind the gyro's, would change
//! nothing but the turn rate: how the pose and its covariance go over known travel does not depend on it, and neither does anything that
//! the wheels tell while the gyro's window stays open. So the turn rate is all that is taken over, and the rest is kept as it is, bit for
//! bit the same as if the gyro had come first.

use posebridge_telemetry::{BrickClock, FusionRecord, Stamp};

use super::fuse::{Context, GYRO_SILENT};
use super::history::{Action, Told};
use super::state::PoseState;
use super::{PoseFilter, act};
use crate::motion::Leg;

impl<const N: usize> PoseFilter<N> {
    /// Whether what was told belongs right before the last entry and changes nothing of that but the turn rate. `gyro_before` is the
    /// gyro's reading before it.
    pub(super) fn is_abreast_of_last(&self, told: &Told, index: usize, gyro_before: Option<Stamp<BrickClock>>) -> bool {
        let Some(last) = self.entries.told().get(index) else {
            return false;
        };
        let is_pair = index + 1 == self.entries.len()
            && last.stamp == told.stamp
            && matches!(last.action, Action::Motion)
            && matches!(told.action, Action::TurnRate(_));
        is_pair
            && self.is_last_current
            && gyro_before.is_some_and(|before| before + GYRO_SILENT > told.stamp)
            && self.keeps_window(self.entries.before(index), self.entries.last())
    }

    /// Whether a state went to the next one over travel that is known throughout, and with its gyro window open.
    fn keeps_window(&self, from: &PoseState<N>, to: &PoseState<N>) -> bool {
        let (Some(start), Some(end)) = (from.stamp, to.stamp) else {
            return false;
        };
        let (Some(window), Some(window_after)) = (from.window, to.window) else {
            return false;
        };
        window.start == window_after.start
            && start < end
            && matches!(self.track.leg(start, end), Leg::Known { until, .. } if until == end)
    }

    /// Puts it there.
    pub(super) fn insert_abreast(&mut self, told: Told, index: usize, record: &mut FusionRecord) {
        self.entries.insert_before_last(told);
        let context = Context { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates };
        let after = self.entries.apply(index).after;
        act(after, &told, &context, record);
        let turn = after.turn;
        self.entries.last_mut().turn = turn;
    }
}
