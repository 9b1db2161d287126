//! When frames are exposed, and when they are delivered.

use posebridge_telemetry::TimeDelta;

use crate::random::RandomStream;
use crate::scenario::RenderedCameraSettings;

/// The times of a frame, in the simulation's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTimes {
    /// From 0.
    pub number: u64,
    /// The exposure of the first row begins.
    pub start: TimeDelta,
    /// The middle of the exposure of the picture's middle row.
    pub mid: TimeDelta,
    /// The exposure of the last row ends.
    pub end: TimeDelta,
    /// The frame is delivered.
    pub due: TimeDelta,
}

/// Counts the frames of a camera. Frames are delivered in the order of their exposure.
#[derive(Clone, Debug)]
pub struct FrameSchedule {
    period_s: f64,
    exposed: TimeDelta,
    latency_ms: f64,
    jitter_ms: f64,
    stream: RandomStream,
    next: FrameTimes,
}

impl FrameSchedule {
    /// The first frame's exposure starts at time 0.
    pub fn new(settings: &RenderedCameraSettings, seed: u64) -> Self {
        let zero = TimeDelta::ZERO;
        let mut schedule = Self {
            period_s: 1.0 / settings.rate_hz,
            exposed: settings.exposure() + settings.readout(),
            latency_ms: settings.latency_ms,
            jitter_ms: settings.jitter_ms,
            stream: RandomStream::new(seed, "camera latency"),
            next: FrameTimes { number: 0, start: zero, mid: zero, end: zero, due: zero },
        };
        schedule.next = schedule.times(0);
        schedule
    }

    /// The frame that is exposed next.
    pub const fn next_exposure(&self) -> FrameTimes {
        self.next
    }

    /// Goes on to the frame behind the next one, and returns the times of that which was the next one.
    pub fn advance(&mut self) -> FrameTimes {
        let present = self.next;
        self.next = self.times(present.number + 1);
        present
    }

    /// From the next call of [`Self::advance`] on.
    pub fn set_latency(&mut self, mean: TimeDelta) {
        self.latency_ms = mean.as_millis_f64();
    }

    fn times(&mut self, number: u64) -> FrameTimes {
        let start = TimeDelta::from_secs_f64(number as f64 * self.period_s);
        let mid = start + TimeDelta::from_nanos(self.exposed.as_nanos() / 2);
        let end = start + self.exposed;
        let latency_ms = self.latency_ms + self.jitter_ms * self.stream.uniform(-1.0, 1.0);
        let due = (mid + TimeDelta::from_secs_f64(latency_ms * 1e-3)).max(end).max(self.next.due);
        FrameTimes { number, start, mid, end, due }
    }
}
