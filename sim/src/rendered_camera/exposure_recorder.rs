//! Keeps where the tag was while a frame was exposed, until the frame is rendered.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, Body, Heading, Meters, Point2, Pose, TimeDelta};

use crate::rendered_camera::frame_schedule::{FrameSchedule, FrameTimes};
use crate::scenario::CameraSettings;

/// Older exposures that nobody takes are dropped: five seconds at 200 Hz.
const MAX_EXPOSURES: usize = 1_000;

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

/// Follows the tag on a robot step by step.
#[derive(Clone, Debug)]
pub(crate) struct ExposureRecorder {
    camera: CameraSettings,
    schedule: FrameSchedule,
    /// Set by a user's command.
    lens: LensState,
    track: VecDeque<(TimeDelta, Pose<Arena>)>,
    finished: VecDeque<Exposure>,
}

impl ExposureRecorder {
    /// With the robot at `robot` at time 0. `None` if the camera renders no pictures.
    pub(crate) fn new(camera: &CameraSettings, seed: u64, robot: Pose<Arena>) -> Option<Self> {
        let mut recorder = Self {
            schedule: FrameSchedule::new(camera.pictures.as_ref()?, seed),
            camera: camera.clone(),
            lens: LensState::default(),
            track: VecDeque::new(),
            finished: VecDeque::new(),
        };
        recorder.track.push_back((TimeDelta::ZERO, recorder.tag_of(robot)));
        Some(recorder)
    }

    /// The robot is at `robot` at the time `world`, later than at the last call.
    pub(crate) fn step(&mut self, world: TimeDelta, robot: Pose<Arena>) {
        self.track.push_back((world, self.tag_of(robot)));
        while self.schedule.next_exposure().end <= world {
            self.trim();
            let times = self.schedule.advance();
            let last = self.track.partition_point(|(time, _)| *time < times.end).min(self.track.len() - 1);
            let track = self.track.iter().take(last + 1).copied().collect();
            let lens = if self.camera.is_dark(times.mid) { LensState::Covered } else { self.lens };
            if self.finished.len() >= MAX_EXPOSURES {
                self.finished.pop_front();
            }
            self.finished.extend(Exposure::new(times, lens, track));
        }
        self.trim();
    }

    fn tag_of(&self, robot: Pose<Arena>) -> Pose<Arena> {
        let tag = robot * Point2::<Body>::new(Meters(self.camera.tag_x_m), Meters(self.camera.tag_y_m));
        Pose::new(tag.x, tag.y, robot.heading)
    }

    /// Forgets what lies before the step that the next exposure begins in.
    fn trim(&mut self) {
        let start = self.schedule.next_exposure().start;
        while self.track.get(1).is_some_and(|(time, _)| *time <= start) {
            self.track.pop_front();
        }
    }

    /// Also of a frame that is exposed right now.
    pub(crate) const fn set_lens(&mut self, lens: LensState) {
        self.lens = lens;
    }

    pub(crate) fn set_latency(&mut self, mean: TimeDelta) {
        self.schedule.set_latency(mean);
    }

    pub(crate) const fn next_exposure(&self) -> FrameTimes {
        self.schedule.next_exposure()
    }

    /// The next frame that is exposed.
    pub(crate) fn take_finished(&mut self) -> Option<Exposure> {
        self.finished.pop_front()
    }

    /// The next frame that is delivered at the time `world` or before.
    pub(crate) fn take_due(&mut self, world: TimeDelta) -> Option<Exposure> {
        self.finished.front().filter(|exposure| exposure.times.due <= world)?;
        self.finished.pop_front()
    }
}
