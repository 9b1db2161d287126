//! Follows a robot through the exposures of its camera.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, Body, Meters, Point2, Pose, TimeDelta};

use super::exposure::{Exposure, LensState};
use super::frame_schedule::{FrameSchedule, FrameTimes};
use crate::scenario::CameraSettings;

/// Older exposures that nobody takes are dropped: five seconds at 200 Hz.
const MAX_EXPOSURES: usize = 1_000;

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
