//! Where the tag was while a frame was exposed.

use posebridge_telemetry::{Arena, Heading, Meters, Pose, TimeDelta};

use super::frame_schedule::FrameTimes;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LensState {
    #[default]
    Open,
    /// No light comes in.
    Covered,
}

/// All that a frame shows of the world: enough to render it later, and elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposure {
    pub times: FrameTimes,
    pub lens: LensState,
    /// From the last step before the exposure to the first one behind it; at least one.
    track: Vec<(TimeDelta, Pose<Arena>)>,
}

impl Exposure {
    /// Of a tag whose poses at ascending times are given. `None` without a pose.
    pub fn new(times: FrameTimes, lens: LensState, track: Vec<(TimeDelta, Pose<Arena>)>) -> Option<Self> {
        (!track.is_empty()).then_some(Self { times, lens, track })
    }

    /// The pose of the tag: its middle, and its way up as heading. Between two steps it moves evenly; before and behind the recorded ones
    /// it stands.
    pub fn tag_pose(&self, time: TimeDelta) -> Pose<Arena> {
        let behind = self.track.partition_point(|(recorded, _)| *recorded < time).min(self.track.len() - 1);
        let (to_time, to) = self.track[behind];
        let (from_time, from) = self.track[behind.saturating_sub(1)];
        let length_ns = (to_time - from_time).as_nanos();
        if length_ns <= 0 {
            return to;
        }
        let share = ((time - from_time).as_nanos() as f64 / length_ns as f64).clamp(0.0, 1.0);
        let turn_rad = (to.heading - from.heading).0;
        Pose::new(
            Meters(from.x.0 + share * (to.x.0 - from.x.0)),
            Meters(from.y.0 + share * (to.y.0 - from.y.0)),
            Heading::from_rad(from.heading.rad() + share * turn_rad),
        )
    }
}
