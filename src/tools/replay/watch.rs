//! Which part of a recording counts, how fast it is given, and who sees what the engine makes of it.

use anyhow::{Result, ensure};
use posebridge_link::HostTimer;
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, Output, TimeDelta, Timestamp};

use crate::flags::SessionFlags;
use crate::station::event_collector::EventCollector;
use crate::station::per_robot::PerRobot;

/// Sees what one estimator's station does.
pub trait EventWatcher {
    /// Something happened when the input of `now` was handled.
    ///
    /// # Errors
    /// It cannot be kept.
    fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()>;
    /// All that follows from the input of `now` has happened.
    fn after_input(&mut self, _now: Timestamp<HostClock>, _station: &Station) {}
}

/// For a caller that needs no more than tracks and counts.
impl EventWatcher for EventCollector {
    fn observe(&mut self, _now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.on_event(event);
        Ok(())
    }
}

/// The same for each robot.
impl EventWatcher for PerRobot<EventCollector> {
    fn observe(&mut self, _now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.push(event, EventCollector::on_event);
        Ok(())
    }
}

/// Whether progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowPosition {
    /// Before the part that counts: only the filter needs it.
    Before,
    /// Within it.
    Within,
    /// Behind it.
    After,
}

/// The part of a recording that counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// Behind the first input.
    from: Option<TimeDelta>,
    /// Behind the first input.
    to: Option<TimeDelta>,
}

impl Window {
    /// The window from the flags.
    ///
    /// # Errors
    /// It ends before it begins.
    pub fn from_flags(flags: &SessionFlags) -> Result<Self> {
        if let (Some(from), Some(to)) = (flags.from, flags.to) {
            ensure!(from < to, "--from {from} does not lie before --to {to}: nothing would be left");
        }
        Ok(Self { from: flags.from.map(TimeDelta::from_secs_f64), to: flags.to.map(TimeDelta::from_secs_f64) })
    }

    /// Whether everything counts.
    pub fn is_unbounded(self) -> bool {
        self == Self::default()
    }

    /// Where an instant lies, by the time since the first input.
    pub fn position(self, elapsed: TimeDelta) -> WindowPosition {
        if self.to.is_some_and(|to| elapsed > to) {
            WindowPosition::After
        } else if self.from.is_some_and(|from| elapsed < from) {
            WindowPosition::Before
        } else {
            WindowPosition::Within
        }
    }
}

/// Waits until an input's turn has come.
pub struct ReplayPacer {
    runtime: tokio::runtime::Runtime,
    timer: HostTimer,
    speed: f64,
    start: Timestamp<HostClock>,
}

impl ReplayPacer {
    /// One that begins when its first input does.
    ///
    /// # Errors
    /// The system gives no timer.
    pub fn new(speed: f64) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        let timer = HostTimer::start();
        Ok(Self { runtime, timer, speed, start: timer.now() })
    }

    /// The next run begins.
    pub fn restart(&mut self) {
        self.start = self.timer.now();
    }

    /// Waits until so much of the recording is due.
    pub fn wait(&self, elapsed: TimeDelta) {
        let due = self.start + TimeDelta::from_secs_f64(elapsed.as_secs_f64() / self.speed);
        if due > self.timer.now() {
            self.runtime.block_on(self.timer.sleep_until(due));
        }
    }
}

/// One estimator with its watcher.
pub struct ReplayLane<'w> {
    /// The engine.
    pub station: Station,
    /// Who sees what it does.
    pub watcher: &'w mut dyn EventWatcher,
}

impl ReplayLane<'_> {
    /// Gives an input.
    ///
    /// # Errors
    /// As the watcher says.
    pub fn push(&mut self, now: Timestamp<HostClock>, input: &Input, place: WindowPosition) -> Result<()> {
        self.station.handle(now, input);
        while let Some(output) = &self.station.poll() {
            if let (Output::Event(event), WindowPosition::Within) = (output, place) {
                self.watcher.observe(now, event)?;
            }
        }
        if place == WindowPosition::Within {
            self.watcher.after_input(now, &self.station);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(window: Window, elapsed_s: f64) -> WindowPosition {
        window.position(TimeDelta::from_secs_f64(elapsed_s))
    }

    #[test]
    fn a_window_holds_both_of_its_ends_and_without_ends_everything() {
        let window = Window { from: Some(TimeDelta::from_millis(1_000)), to: Some(TimeDelta::from_millis(2_000)) };
        let places = [0.999, 1.0, 2.0, 2.001].map(|elapsed_s| place(window, elapsed_s));
        assert_eq!(
            places,
            [WindowPosition::Before, WindowPosition::Within, WindowPosition::Within, WindowPosition::After]
        );
        assert_eq!(place(Window::default(), 1e6), WindowPosition::Within);
    }
}
